"""Published problems with numbers, solved and compared: one table."""

import inspect
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from matplotlib.figure import Figure

from ngepc.model.elements import vertex_coordinates
from ngepc.pictures.fields import plot_field
from ngepc.pictures.style import save_figure, styled
from ngepc.results.result import Result
from ngepc.studies import contact_problems as contact
from ngepc.studies import limit_problems as limits
from ngepc.studies import material_problems as materials
from ngepc.studies import shakedown_problems as shakedowns
from ngepc.studies import solid_problems as solids
from ngepc.studies.solid_problems import Solved
from ngepc.studies.work import Work, chosen


@dataclass(frozen=True)
class Benchmark:
    """A problem that ``solve`` solves, and the source of its numbers.

    The second paragraph of the docstring of ``solve`` is printed below the table.  The picture
    shows ``field``; there is none if ``field`` is empty.  ``view`` restricts it: half width about
    the origin (length), and upper end of the colour scale.
    """

    solve: Callable[[], Solved]
    source: str
    field: str = "von_mises"
    view: tuple[float, float] | None = None

    @property
    def remark(self) -> str:
        """The remark below the table; may be empty."""
        solve = getattr(self.solve, "func", self.solve)
        return " ".join((inspect.getdoc(solve) or "").partition("\n\n")[2].split())


PEEQ = "accumulated_plastic_strain"
PLANE, ROUND = (
    partial(contact.hertz, kind) for kind in ("plane strain", "axisymmetric")
)
FIT = "Jackson and Green 2005, as printed by Ghaednia et al. 2019"

BENCHMARKS = {
    "NAFEMS NL1": Benchmark(solids.nl1, "NNB rev. 1, 1989", ""),
    "SSNP15": Benchmark(solids.ssnp15, "Code_Aster V6.03.015, AFNOR", ""),
    "SSNP14": Benchmark(solids.ssnp14, "Code_Aster V6.03.014", ""),
    "Hill's cylinder": Benchmark(
        solids.hill, "R. Hill, The mathematical theory of plasticity, 1950", ""
    ),
    "Prandtl's punch": Benchmark(solids.prandtl, "(2 + pi) k", PEEQ),
    "SSNP303": Benchmark(materials.three_sheets, "NAFEMS; Code_Aster V6.03.303", ""),
    "bars in parallel": Benchmark(
        materials.three_bars, "J. F. Besseling, 1958: sub-elements", ""
    ),
    "thin ring": Benchmark(materials.ring, "A. Nadai, 1950", PEEQ),
    "turning disc": Benchmark(materials.disc, "limit of the equation of the disc", ""),
    "Masing's loops": Benchmark(materials.masing, "G. Masing, 1926", ""),
    "Bree's plate": Benchmark(materials.bree, "J. Bree, 1967", ""),
    "relaxation": Benchmark(materials.relaxation, "F. H. Norton, 1929", ""),
    "Hill's sheet": Benchmark(materials.sheet, "R. Hill, 1948", ""),
    "vertical cut": Benchmark(limits.cut_height, "Kammoun et al. 2010", ""),
    "Prandtl's strip": Benchmark(limits.strip_pressure, "2 + pi", ""),
    "SSNV124": Benchmark(limits.square_traction, "Code_Aster V6.04.124", ""),
    "sheet with a hole": Benchmark(limits.sheet_traction, "Gaydon and McCrum 1954", ""),
    "Bree's plate, shakedown": Benchmark(
        shakedowns.bree_shakedown, "J. Bree, 1967", ""
    ),
    "step-42": Benchmark(contact.step42, "deal.II, documentation of step-42"),
    "NAFEMS R94": Benchmark(
        contact.r94, "Konter 2005; Code_Aster SSNP154", view=(20.0, 2000.0)
    ),
    "Hertz cylinder": Benchmark(PLANE, "H. Hertz, 1881", view=(2.0, 16.0)),
    "Hertz sphere": Benchmark(ROUND, "H. Hertz, 1881", view=(2.0, 30.0)),
    "Mindlin": Benchmark(
        contact.mindlin, "Cattaneo 1938, Mindlin 1949", "stress_xy", (3.0, 2.0)
    ),
    "shrink fit": Benchmark(contact.shrink_fit, "G. Lame, 1852"),
    "sphere on a flat": Benchmark(contact.flattened_sphere, FIT, PEEQ, (0.06, 0.012)),
    "SSNV506": Benchmark(contact.ssnv506, "Code_Aster V6.04.506", PEEQ, (700.0, 0.9)),
}
"""Name -> problem, in the order of the table."""


@dataclass(eq=False)
class Benchmarks(Work):
    """The problems of ``BENCHMARKS``, or those that ``rows`` names."""

    rows: Sequence[str] | None = None
    figures: bool = False

    name = "benchmarks"
    title = "Published problems"
    columns = """problem = {problem} ({source}) | quantity = {name}
        | reference = {reference:.6g} {kind} | ours = {ours:.6g}
        | difference = {percent:+.2f} %{beyond}
        | tolerance = {allowed:.3g} %"""

    def __post_init__(self) -> None:
        self.rows = chosen(BENCHMARKS, self.rows)

    def cells(self) -> list[dict]:
        """One cell for each problem, with the file of its picture if there is one."""
        cells = [{"problem": name} for name in self.rows]
        drawn = [c for c in cells if self.figures and BENCHMARKS[c["problem"]].field]
        for cell in drawn:
            name = "".join(c if c.isalnum() else "_" for c in cell["problem"].lower())
            cell["file"] = f"benchmark_{name}.png"
        return cells

    def solve(self, problem: str, file: str = "") -> list[dict]:
        """A record for each quantity; data of the whole problem are in the first one."""
        benchmark = BENCHMARKS[problem]
        begin = time.process_time()
        result, quantities = benchmark.solve()
        about: dict[str, object] = {"cpu_s": time.process_time() - begin}
        about |= {
            "source": benchmark.source,
            "elements": result.problem.mesh.ne if result else "",
            "unknowns": result.displacement.space.ndof if result else "",
        }
        if file:
            figure = picture(result, benchmark)
            figure.axes[0].set_title(problem)
            save_figure(figure, self.folder / file)
        rows = []
        for q in quantities:
            row = {**q._asdict(), "beyond": "" if q.holds else " (beyond)"}
            row |= {"difference": q.difference, "percent": 100 * q.difference}
            rows.append(row | {"allowed": 100 * q.tolerance})
        return [about | rows[0], *rows[1:]]

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Whether every difference beyond its tolerance is explained."""
        return all(not r["beyond"] or BENCHMARKS[r["problem"]].remark for r in records)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """The types of references, then the remarks."""
        remarks = {r["problem"]: BENCHMARKS[r["problem"]].remark for r in records}
        said = [
            f"- {problem}: {remark}" for problem, remark in remarks.items() if remark
        ]
        what = (
            "References: P published, C closed form, O own computation. The CSV file has also the "
            "numbers of elements and unknowns, and processor times."
        )
        return [what, "", *said]


@styled
def picture(result: Result, benchmark: Benchmark) -> Figure:
    """A field on the body, or on a part of a plane body."""
    if benchmark.view is None:
        return plot_field(result, benchmark.field, view=(-135, 25))
    half, top = benchmark.view
    least = -top if benchmark.field.startswith("stress") else 0.0
    figure = plot_field(result, benchmark.field, vmin=least, vmax=top)
    axes = figure.axes[0]
    places = vertex_coordinates(result.problem.mesh)
    for limit, x in zip((axes.set_xlim, axes.set_ylim), places.T, strict=True):
        limit(max(x.min() - half / 20, -half), min(x.max() + half / 20, half))
    return figure
