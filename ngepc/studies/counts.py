"""Newton steps over meshes: Tables 1 and 2 of the paper, and the default method beside them.

Rows are numbers (the paper's method at that gamma), 'default' and 'primal'; a star marks nested
iteration, each mesh started from the solution on the next coarser one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ngepc.dual.newton import NewtonOptions
from ngepc.dual.regularisation import Coupled
from ngepc.dual.restore import restore
from ngepc.results.outcome import History, IterationRecord, Result, Status
from ngepc.studies.counts_page import write_page, write_pictures
from ngepc.studies.examples import BODIES, FAMILIES, TITLES, example, solved
from ngepc.studies.paper import TABLE_1, TABLE_2
from ngepc.studies.work import Cell, Outcome, Table, Work, chosen, ending, first_of

OWN_ROWS = ("default", "default*", "primal", "primal*")


class CountTable(Work):
    """A table of the paper with our counts; its rows and further ones of other methods.

    Parameters
    ----------
    folder, progress
        As for ``Work``.
    levels, nodes
        How many meshes of the family, or their node counts.
    rows
        Labels of rows; None for all of the paper's and 'default'.
    tolerance
        On the residual norm.
    figures
        Whether to write pictures and an HTML page, too.

    Attributes
    ----------
    body
        'lshape' or 'wrench'.
    paper
        Row label -> the paper's counts on the meshes of the family.
    about
        What is counted, for the notes below the table.
    """

    body: str
    paper: Mapping[str, Sequence[int]]
    about: str

    def __init__(
        self,
        folder: Path,
        levels: int = 3,
        rows: Sequence[str] | None = None,
        tolerance: float = 1e-10,
        figures: bool = False,
        *,
        nodes: Sequence[int] | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        self.family, self.figures = FAMILIES[self.body], figures
        self.nodes = first_of(self.family, levels) if nodes is None else tuple(nodes)
        known = dict.fromkeys([*self.paper, *OWN_ROWS])
        self.rows = (*self.paper, "default") if rows is None else chosen(known, rows)
        self.options = NewtonOptions(tolerance=tolerance, max_iterations=2000)
        points = self.options.quadrature_points
        super().__init__(folder, progress, tolerance=tolerance, quadrature_points=points)
        self._results: dict[Cell, Result] = {}

    def run(self) -> list[dict]:
        """Fill the table, coarse meshes first; returns one record for each cell."""
        cells = [Cell(row, nodes) for nodes in self.nodes for row in self.rows]
        table = []
        for number, cell in enumerate(cells, 1):
            record = self.outcome(cell).record
            paper = "" if record["paper"] is None else f" (paper {record['paper']})"
            self.progress(
                f"[{number}/{len(cells)}] {cell.row:>8} nodes {cell.nodes:>5}: "
                f"{record['iterations']} steps{paper}, {record['status']}, "
                f"{record['wall_time_s']:.1f} s"
            )
            table.append(record)
        return table

    def outcome(self, cell: Cell) -> Outcome:
        """The outcome of a cell, from disk or solved now."""
        return self.kept(cell, self._solved)

    def result(self, cell: Cell) -> Result:
        """A cell with all its fields: the paper's method from its dual variable, others again."""
        if cell not in self._results:
            method = cell.row.rstrip("*")
            if method in ("default", "primal"):
                self._results[cell] = self._solve(cell)
            else:
                self._results[cell] = self._restored(cell, float(method))
        return self._results[cell]

    def start_of(self, cell: Cell) -> Cell | None:
        """The cell whose solution a cell starts from, None for zero."""
        coarse = BODIES[self.body].COARSE_NODES
        if not cell.row.endswith("*") or cell.nodes == coarse:
            return None
        place = self.family.index(cell.nodes)
        return Cell(cell.row, self.family[place - 1] if place else coarse)

    def paper_value(self, cell: Cell) -> int | None:
        """The paper's count for a cell, None where it has none."""
        if cell.nodes not in self.family or cell.row not in self.paper:
            return None
        return self.paper[cell.row][self.family.index(cell.nodes)]

    def entry(self, record: dict) -> str:
        """Ours (paper), with the status where the run did not converge."""
        paper = "" if record["paper"] is None else f" ({record['paper']})"
        return f"{record['iterations']}{paper}{ending(record)}"

    def rows_of(self, table: Sequence[dict]) -> list[list[str]]:
        """The entries, row by row with its label in front."""
        found = {(r["row"], r["nodes"]): self.entry(r) for r in table}
        return [[row, *(found.get((row, n), "") for n in self.nodes)] for row in self.rows]

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write the table, and pictures if they were asked for; returns the paths."""
        notes = [
            f"Newton steps for {TITLES[self.body]}, ours (the paper's in parentheses). "
            f"{self.about} Rows 'default' are the default method and 'primal' the primal one, cold "
            f"or with * nested. Tolerance {self.options.tolerance:g}, "
            f"{self.options.quadrature_points} quadrature points per triangle for the paper's rows."
        ]
        written = Table(
            name=self.name,
            title=f"Table {self.name[-1]}",
            head=["gamma", *(f"{n} nodes" for n in self.nodes)],
            rows=self.rows_of(table),
            notes=notes,
            cells=[{key: r[key] for key in r if key != "history"} for r in table],
        ).write(self.folder)
        return written + (write_pictures(self, table) if self.figures else [])

    def _solved(self, cell: Cell) -> Outcome:
        result = self._results[cell] = self._solve(cell)
        record = {
            "row": cell.row,
            "nodes": cell.nodes,
            "iterations": result.iterations,
            "paper": self.paper_value(cell),
            "status": result.status.label,
            "primal_energy": result.primal_energy,
            "dual_energy": result.dual_energy,
            "residual_norm": result.residual_norm,
            "halvings": result.history.halvings,
            "history": result.history.as_rows(),
        }
        own = cell.row.rstrip("*") in ("default", "primal")
        return Outcome(record, {} if own else {"v": result.v.FV().NumPy().copy()})

    def _solve(self, cell: Cell) -> Result:
        start = self.start_of(cell)
        begin = None if start is None else self.result(start)
        problem, method = example(self.body, cell.nodes), cell.row.rstrip("*")
        return solved(method, problem, begin, self.options)

    def _restored(self, cell: Cell, gamma: float) -> Result:
        outcome = self.outcome(cell)
        history = History([IterationRecord(**row) for row in outcome.record["history"]])
        status, problem = Status[outcome.record["status"].upper()], example(self.body, cell.nodes)
        v = outcome.arrays["v"]
        return restore(problem, Coupled(gamma), v, self.options, status, history)


class Table1(CountTable):
    """Example (a); the paper's rows start from the prolongated solution on 417 nodes."""

    name, body, paper = "table1", "lshape", TABLE_1
    about = (
        "The paper's method starts from the prolongated solution on 417 nodes, rows with * from "
        "the next coarser mesh."
    )

    def start_of(self, cell: Cell) -> Cell | None:
        """For the paper's rows the 417-node solution, which takes steps of ten in gamma."""
        coarse, method = BODIES[self.body].COARSE_NODES, cell.row.rstrip("*")
        if method in ("default", "primal"):
            return super().start_of(cell)
        if cell.nodes == coarse:
            decade = round(math.log10(float(method)))
            return Cell(f"1e{decade - 1}", coarse) if decade > 3 else None
        nested = cell.row.endswith("*") and cell.nodes > self.family[0]
        return super().start_of(cell) if nested else Cell(method, coarse)


class Table2(CountTable):
    """Example (b); the paper's rows start from v = 0."""

    name, body, paper = "table2", "wrench", TABLE_2
    about = (
        "The paper's method starts from v = 0. The paper prints 24927 nodes for the mesh with "
        "24993; its polygon is lost, ours is reconstructed (docs/reading.md)."
    )


def folder_report(folder: Path, path: Path) -> Path:
    """The HTML report of a finished table1 folder, from its table1.json and its cells.

    Raises
    ------
    ValueError
        If the folder has no finished study.
    """
    source = folder / "table1.json"
    if not source.is_file():
        raise ValueError(f"{folder} holds no table1.json: run ngepc study table1 --out {folder}")
    table = json.loads(source.read_text(encoding="utf-8"))["cells"]
    nodes, rows = (tuple(dict.fromkeys(r[key] for r in table)) for key in ("nodes", "row"))
    return write_page(Table1(folder, rows=rows, nodes=nodes), table, path)
