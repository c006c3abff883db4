"""Published problems with numbers, solved and compared: one table."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from matplotlib.figure import Figure

from ngepc.model.elements import vertex_coordinates
from ngepc.pictures.fields import plot_field
from ngepc.pictures.stills import renderer
from ngepc.pictures.style import Picture, save_figure, styled
from ngepc.results.result import Result
from ngepc.studies import contact_problems, solid_problems
from ngepc.studies.solid_problems import Quantity, Solved
from ngepc.studies.work import Work, chosen


@dataclass(frozen=True)
class Benchmark:
    """A problem that ``solve`` solves, the source of its numbers, what is to be said about ours.

    The picture shows a field, by default of the whole body, or, where ``field`` is empty, the
    numbers: ``view`` is its half width about the origin (length) and the top of its colours.
    """

    solve: Callable[[], Solved]
    source: str
    field: str = "von_mises"
    remark: str = ""
    view: tuple[float, float] | None = None


PEEQ = "accumulated_plastic_strain"

BENCHMARKS = {
    "NAFEMS NL1": Benchmark(
        solid_problems.nl1,
        "NNB rev. 1, 1989",
        remark="Ours is the limit of many increments, extrapolated from 50 and 100 on each leg; "
        "the published values of the last two legs lie up to 1 percent beside the limit.",
    ),
    "SSNP15": Benchmark(
        solid_problems.ssnp15,
        "Code_Aster V6.03.015, AFNOR",
        remark="50 increments to A and 50 from there to B.",
    ),
    "SSNP14": Benchmark(solid_problems.ssnp14, "Code_Aster V6.03.014"),
    "Hill's cylinder": Benchmark(
        solid_problems.hill,
        "R. Hill, The mathematical theory of plasticity, 1950",
        "",
        remark="Hardening 1e-5 mu. The closed form takes sigma_zz for the mean of the other two "
        "stresses, which is exact for nu = 1/2.",
    ),
    "Prandtl's punch": Benchmark(
        solid_problems.prandtl,
        "(2 + pi) k",
        PEEQ,
        "Hardening 1e-5 mu, displacements of order two; from above, as the theorems say.",
    ),
    "step-42": Benchmark(
        contact_problems.step42,
        "deal.II, documentation of step-42",
        remark="One node touches: the number is the mesh's. Finer ones: `ngepc study step42`.",
    ),
    "NAFEMS R94": Benchmark(
        contact_problems.r94, "Konter 2005; Code_Aster SSNP154", view=(20.0, 2000.0)
    ),
    "Hertz cylinder": Benchmark(
        partial(contact_problems.hertz, "plane strain"), "H. Hertz, 1881", view=(2.0, 16.0)
    ),
    "Hertz sphere": Benchmark(
        partial(contact_problems.hertz, "axisymmetric"), "H. Hertz, 1881", view=(2.0, 30.0)
    ),
    "Mindlin": Benchmark(
        contact_problems.mindlin,
        "Cattaneo 1938, Mindlin 1949",
        "stress_xy",
        "The tolerance of the stick half width is a cell; tractions in the mean square.",
        view=(3.0, 2.0),
    ),
    "shrink fit": Benchmark(
        contact_problems.shrink_fit,
        "G. Lame, 1852",
        remark="The mean pressure. Facets of the two circles do not match: their gaps, of size "
        "h^2/8R, leave local errors of the pressure like E h/R, 8 percent rms here.",
    ),
    "sphere on a flat": Benchmark(
        contact_problems.flattened_sphere,
        "Jackson and Green 2005, as printed by Ghaednia et al. 2019",
        PEEQ,
        "A fit to finite elements. Ours is a rigid sphere in a block, the same linearised problem. "
        "The fit of Kogut and Etsion is left out: its constants were not at hand in print.",
        view=(0.06, 0.012),
    ),
    "SSNV506": Benchmark(
        contact_problems.ssnv506,
        "Code_Aster V6.04.506",
        PEEQ,
        "The reference is an estimate linear in the depth; Code_Aster's own values are +1.5, -0.7 "
        "and -4.7 percent. Ours, with the gap linearised, comes to lie above it at every depth: "
        "on half the mesh size -5.6, -0.1, +3.1 percent with steps of 5 mm, +0.1, +3.1, +5.3 with "
        "2.5 mm, +3.2, +5.8, +5.4 with 1.25 mm, +3.2, +7.2, +5.4 with 0.625 mm, a mean "
        "pressure of 3.05 yield stresses on 1.41 times the area of the undeformed cut. The "
        "picture draws displacements "
        "along the surface as well, which the linearised gap does not see. The size of the "
        "block, 2000 mm, is ours "
        "and does not matter: 1000 and 4000 change half a percent.",
        view=(700.0, 0.9),
    ),
}
"""Name -> problem, in the order of the table."""


@dataclass(eq=False)
class Benchmarks(Work):
    """The problems of ``BENCHMARKS``, or those that ``rows`` names."""

    rows: Sequence[str] | None = None
    figures: bool = False

    name, title = "benchmarks", "Published problems"
    columns = (
        ("problem", "{problem} ({source})"),
        ("quantity", "{name}"),
        ("reference", "{reference:.6g}"),
        ("type", "{kind}"),
        ("ours", "{ours:.6g}"),
        ("difference", lambda r: f"{r['difference']:+.2%}".replace("%", " %") + r["beyond"]),
        ("tolerance", lambda r: f"{100 * r['tolerance']:.3g} %"),
        ("elements", "{elements}"),
        ("unknowns", "{unknowns}"),
        ("seconds", "{cpu_s:.1f}"),
    )

    def __post_init__(self) -> None:
        self.rows = chosen(BENCHMARKS, self.rows)
        if self.figures and "step-42" in self.rows:
            renderer()

    def cells(self) -> list[dict]:
        """One for each problem."""
        return [{"problem": name} for name in self.rows]

    def solve(self, problem: str) -> list[dict]:
        """A record for each quantity; what belongs to the whole problem stands in the first one."""
        benchmark, begin = BENCHMARKS[problem], time.process_time()
        result, quantities = benchmark.solve()
        about: dict[str, object] = {"cpu_s": time.process_time() - begin}
        about |= {
            "source": benchmark.source,
            "elements": result.problem.mesh.ne if result else 0,
            "unknowns": result.displacement.space.ndof if result else 0,
        }
        if self.figures:
            file = "".join(c if c.isalnum() else "_" for c in problem.lower())
            shows = benchmark.field and result is not None
            figure = picture(result, benchmark) if shows else drawn_numbers(quantities)
            figure.axes[0].set_title(problem)
            save_figure(figure, self.folder / f"benchmark_{file}.png")
        rows = [
            {**q._asdict(), "difference": q.difference, "beyond": "" if q.holds else " (beyond)"}
            for q in quantities
        ]
        return [about | rows[0], *rows[1:]]

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Whether every difference beyond its tolerance is explained."""
        return all(not r["beyond"] or BENCHMARKS[r["problem"]].remark for r in records)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What the types are, then the remarks."""
        remarks = {r["problem"]: BENCHMARKS[r["problem"]].remark for r in records}
        said = [f"- {problem}: {remark}" for problem, remark in remarks.items() if remark]
        what = "P published, C closed form, O own computation; seconds of one processor."
        return [what, "", *said]


@styled
def picture(result: Result, benchmark: Benchmark) -> Figure:
    """A field on the body."""
    if benchmark.view is None:
        planes = (-135, 25)  # onto the planes of symmetry of a quarter
        return plot_field(result, benchmark.field, view=planes)
    half, top = benchmark.view
    least = -top if benchmark.field.startswith("stress") else 0.0
    figure = plot_field(result, benchmark.field, vmin=least, vmax=top)
    axes = figure.axes[0]
    places = vertex_coordinates(result.problem.mesh)
    for limit, x in zip((axes.set_xlim, axes.set_ylim), places.T, strict=True):
        limit(max(x.min() - half / 20, -half), min(x.max() + half / 20, half))
    return figure


@styled
def drawn_numbers(quantities: Sequence[Quantity]) -> Figure:
    """Our numbers and the references, by name."""
    figure = Picture(figsize=(4.8, 4.0))
    axes, names = figure.subplots(), [q.name for q in quantities]
    axes.plot(names, [q.ours for q in quantities], "o", label="ours")
    axes.plot(names, [q.reference for q in quantities], "kx", label="reference")
    axes.tick_params("x", rotation=90)
    axes.legend()
    return figure
