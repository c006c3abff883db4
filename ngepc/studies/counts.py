"""Newton steps over meshes: Tables 1 and 2 of the paper, and the default method beside them.

Rows are numbers (the paper's method at that gamma), 'default' and 'primal'; a star marks nested
iteration, each mesh started from the solution on the next coarser one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from matplotlib.figure import Figure

from ngepc.bounds.bound import error_bound
from ngepc.dual.newton import NewtonOptions
from ngepc.pictures.curves import plot_counts, plot_history
from ngepc.pictures.fields import plot_comparison
from ngepc.pictures.report import solution_sections, standard_figures, write_report
from ngepc.pictures.style import save_figure
from ngepc.results import records as texts
from ngepc.results.result import Result
from ngepc.studies.examples import BODIES, FAMILIES, THRESHOLDS, TITLES, example, solved_by
from ngepc.studies.paper import TABLE_1, TABLE_2
from ngepc.studies.runs import restore
from ngepc.studies.work import Cell, Work, chosen, ending, first_of, pivoted

OWN_ROWS = ("default", "default*", "primal", "primal*")
ALWAYS_ONE_STEP = 1e2
"""Up to this gamma Example (a) is elastic and takes one step on every mesh."""


@dataclass(eq=False)
class CountTable(Work):
    """A table of the paper with our counts; its rows and further ones of other methods.

    ``paper`` has its counts on the meshes of the family of ``body`` by rows, ``about`` says from
    where the runs start.
    """

    levels: int = 3
    rows: Sequence[str] | None = None
    tolerance: float = 1e-10
    figures: bool = False

    body: ClassVar[str]
    paper: ClassVar[Mapping[str, Sequence[int]]]
    about: ClassVar[str]

    note = (
        "Newton steps for {study.example}, ours (the paper's in parentheses). {study.about} Rows "
        "'default' are the default method and 'primal' the primal one, cold or with * nested. "
        "Tolerance {study.tolerance:g}, {study.options.quadrature_points} quadrature points per "
        "triangle for the paper's rows."
    )
    settings, internal = ("tolerance",), ("history",)

    def __post_init__(self) -> None:
        self.family = (BODIES[self.body].COARSE_NODES, *FAMILIES[self.body])
        self.nodes = first_of(FAMILIES[self.body], self.levels)
        self.example, self.title = TITLES[self.body], f"Table {self.name[-1]}"
        heads = [f"{n} nodes" for n in self.nodes]
        self.columns = [("gamma", "{row}"), *((head, f"{{{head}}}") for head in heads)]
        self.rows = chosen([*self.paper, *OWN_ROWS], self.rows or [*self.paper, "default"])
        self.options = NewtonOptions(tolerance=self.tolerance, max_iterations=2000)
        self._results: dict[Cell, Result] = {}

    def cells(self) -> list[Cell]:
        """All rows on one mesh after the other."""
        return [Cell(row, nodes) for nodes in self.nodes for row in self.rows]

    def result(self, cell: Cell) -> Result:
        """A cell with all its fields: the paper's method from its dual variable, others again."""
        if cell not in self._results:
            gamma = gamma_of(cell.row)
            found = self._solved(cell) if math.isinf(gamma) else self._restored(cell, gamma)
            self._results[cell] = found
        return self._results[cell]

    def start_of(self, cell: Cell) -> Cell | None:
        """The cell whose solution a cell starts from, None for zero."""
        place = self.family.index(cell.nodes)
        nested = cell.row.endswith("*") and place > 0
        return Cell(cell.row, self.family[place - 1]) if nested else None

    def paper_value(self, cell: Cell) -> int | None:
        """The paper's count for a cell, None where it has none."""
        counts = self.paper.get(cell.row, ())
        return dict(zip(self.family[1:], counts, strict=False)).get(cell.nodes)

    def told(self, records: Sequence[dict]) -> list[dict]:
        """Rows over meshes."""
        return pivoted(records, ("row",), "{nodes} nodes", entry)

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Pictures and a page about the finest mesh, if they were asked for."""
        if not self.figures:
            return []
        row = "default" if "default" in self.rows else max(self.rows, key=gamma_of)
        cell, bounds = Cell(row, self.nodes[-1]), THRESHOLDS[self.body]
        histories = {f"{n} nodes": self.result(Cell(row, n)).history for n in self.nodes}
        beside = regularised_beside(self, cell)
        curves = {
            f"{self.name}_steps": counts_figure(self, records),
            f"{self.name}_residuals": plot_history(histories, tolerance=self.tolerance),
        }
        fields = standard_figures(self.result(cell), bounds) | beside
        figures = {f"{self.body}_{name}": figure for name, figure in fields.items()} | curves
        drawn = [save_figure(f, self.folder / f"{name}.png") for name, f in figures.items()]
        return [*drawn, write_page(self, cell, records, [*beside.values(), *curves.values()])]

    def solve(self, cell: Cell) -> dict:
        """Solve, and keep the dual variable of the paper's method."""
        result = self._results[cell] = self._solved(cell)
        names = ("iterations", "primal_energy", "dual_energy", "residual_norm")
        record = {
            "row": cell.row,
            "nodes": cell.nodes,
            "paper": self.paper_value(cell),
            "status": result.status.label,
            **{name: getattr(result, name) for name in names},
            "halvings": result.history.halvings,
            "history": result.history.as_rows(),
        }
        own = math.isinf(gamma_of(cell.row))
        return record if own else record | {"v": result.v.FV().NumPy().copy()}

    def _solved(self, cell: Cell) -> Result:
        start = self.start_of(cell)
        begin = None if start is None else self.result(start)
        return solved_by(cell.row.rstrip("*"), example(self.body, cell.nodes), begin, self.options)

    def _restored(self, cell: Cell, gamma: float) -> Result:
        (kept,) = self.kept(cell)
        run = kept["status"], kept["history"]
        return restore(example(self.body, cell.nodes), gamma, kept["v"], self.options, *run)


class Table1(CountTable):
    """Example (a); the paper's rows start from the prolongated solution on 417 nodes."""

    name, body, paper = "table1", "lshape", TABLE_1
    about = (
        "The paper's method starts from the prolongated solution on 417 nodes, rows with * from "
        "the next coarser mesh."
    )

    def start_of(self, cell: Cell) -> Cell | None:
        """For the paper's rows the 417-node solution, which takes steps of ten in gamma."""
        (coarse, first, *_), gamma = self.family, gamma_of(cell.row)
        if math.isinf(gamma) or (cell.row.endswith("*") and cell.nodes > first):
            return super().start_of(cell)
        if cell.nodes > coarse:
            return Cell(cell.row.rstrip("*"), coarse)
        decade = round(math.log10(gamma))
        return Cell(f"1e{decade - 1}", coarse) if decade > 3 else None


class Table2(CountTable):
    """Example (b); the paper's rows start from v = 0."""

    name, body, paper = "table2", "wrench", TABLE_2
    about = (
        "The paper's method starts from v = 0. The paper prints 24927 nodes for the mesh with "
        "24993; its polygon is lost, ours is reconstructed (docs/reading.md)."
    )


def entry(record: dict) -> str:
    """Ours (paper), with the status where the run did not converge."""
    paper = "" if record["paper"] is None else f" ({record['paper']})"
    return f"{record['iterations']}{paper}{ending(record)}"


def gamma_of(row: str) -> float:
    """Gamma of a row, infinity for the methods without one."""
    method = row.rstrip("*")
    return math.inf if method in ("default", "primal") else float(method)


def label_of(row: str) -> str:
    """What a row is called in pictures."""
    method = row.rstrip("*")
    name = f"{method} method" if math.isinf(gamma_of(row)) else f"gamma = {method}"
    return f"{name}, nested" if row.endswith("*") else name


def counts_figure(study: CountTable, table: Sequence[dict]) -> Figure:
    """Newton steps over nodes, one curve for each row, with the paper's dashed.

    Rows of an elastic body are left out if there are others, and named in the title.
    """
    rows = [r for r in study.rows if gamma_of(r) > ALWAYS_ONE_STEP] or study.rows
    ours = {r: {c["nodes"]: c["iterations"] for c in table if c["row"] == r} for r in rows}
    paper = {r: {n: study.paper_value(Cell(r, n)) for n in study.nodes} for r in rows}
    figure = plot_counts(
        {label_of(row): counts for row, counts in ours.items()},
        {label_of(row): counts for row, counts in paper.items() if row in study.paper},
    )
    if left_out := [row for row in study.rows if row not in rows]:
        most = max(c["iterations"] for c in table if c["row"] in left_out)
        title = f"not drawn: gamma = {', '.join(left_out)}, at most {most} steps"
        figure.axes[0].set_title(title, loc="left", fontsize="medium")
    return figure


def regularised_beside(study: CountTable, cell: Cell) -> dict[str, Figure]:
    """The plastic strain of a cell beside that of the paper's method at the largest gamma there."""
    regularised = [row for row in study.rows if not math.isinf(gamma_of(row))]
    if not regularised or not math.isinf(gamma_of(cell.row)):
        return {}
    beside = Cell(max(regularised, key=gamma_of), cell.nodes)
    title = f"the paper's regularised state, gamma = {beside.row.rstrip('*')}"
    sources = {"the solution (exact)": study.result(cell), title: study.result(beside)}
    return {"plastic_strain": plot_comparison(sources, "equivalent_plastic_strain")}


def write_page(
    study: CountTable, cell: Cell, table: Sequence[dict], pictures: Sequence[Figure]
) -> Path:
    """Write an HTML page of the counts, pictures and the solution of a cell; returns its path."""
    result, written = study.result(cell), study.table(table)
    counts = [dict(zip(written.head, row, strict=True)) for row in written.rows]
    about = (
        "Ours, and in parentheses the paper's. Rows named `default` are the default method, "
        "which solves the problem itself instead of a regularised one."
    )
    what = f"{label_of(cell.row)}, {cell.nodes} nodes"
    (head, body), *more = solution_sections(result, f"The solution: {what}", THRESHOLDS[study.body])
    if math.isinf(gamma_of(cell.row)):
        part = f"{100 * error_bound(result).relative:.3g} percent"
        said = f"Energy error at most {part} of what the body stores and dissipates, guaranteed."
        study.progress(f"{what}. {said}")
        body = [said, *body]
    return write_report(
        study.folder / f"{study.body}.html",
        f"Mesh independence: {study.name} of Hintermüller and Rösel",
        ("The problem", [result.problem]),
        ("Newton steps", [about, counts, *pictures]),
        (head, body),
        *more,
        footer=", ".join(f"{key} {value}" for key, value in texts.provenance().items()),
    )
