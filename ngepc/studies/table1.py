"""Table 1: Newton steps of Algorithm 7.1 for Example (a) over meshes and gamma."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.dual_result import DualResult
from ngepc.examples import lshape_problem
from ngepc.geometries import lshape
from ngepc.newton import NewtonOptions, semismooth_newton
from ngepc.problem import Problem
from ngepc.regularisation import Coupled
from ngepc.results import History, IterationRecord, Status
from ngepc.storage import records
from ngepc.storage.restore import restore
from ngepc.studies.paper import TABLE_1
from ngepc.studies.tables import (
    Cell,
    CellStore,
    Outcome,
    csv_table,
    markdown_table,
    provenance_lines,
)

ROWS = tuple(TABLE_1)
QUICK_ROWS = ("1e0", "1e1", "1e2", "1e3", "1e4")

Progress = Callable[[str], None]


class Table1:
    """The study; each cell is solved once and kept in ``folder``/cells.

    Parameters
    ----------
    folder
        Where results go.
    nodes
        Node counts of the columns, members of the paper's family in ascending order.
    rows
        Row labels of the paper's table: '1e4' from the prolongated 417-node solution, '1e5*'
        from the solution on the next coarser mesh.
    options
        Newton options.
    progress
        Called with a line of text after each cell.
    """

    def __init__(
        self,
        folder: Path,
        nodes: Sequence[int] = lshape.PAPER_NODES,
        rows: Sequence[str] = ROWS,
        options: NewtonOptions | None = None,
        progress: Progress | None = None,
    ) -> None:
        unknown = [row for row in rows if row not in TABLE_1]
        if unknown:
            raise ValueError(f"rows={unknown}: the table has {', '.join(TABLE_1)}")
        self.folder, self.nodes, self.rows = Path(folder), tuple(nodes), tuple(rows)
        self.options = NewtonOptions(max_iterations=2000) if options is None else options
        self.progress = progress or (lambda line: None)
        settings = {
            "study": "table1",
            "tolerance": self.options.tolerance,
            "quadrature_points": self.options.quadrature_points,
            "ngepc": records.provenance()["version"],
        }
        self.store = CellStore(self.folder / "cells", settings)
        self._problems: dict = {}

    def problem(self, nodes: int) -> Problem:
        """Example (a) on the mesh with so many nodes."""
        if nodes not in self._problems:
            self._problems[nodes] = lshape_problem(lshape.paper_mesh(nodes))
        return self._problems[nodes]

    def run(self) -> list[dict]:
        """Fill the table; returns one record for each cell."""
        cells = [Cell(row, nodes) for row in self.rows for nodes in self.nodes]
        table = []
        for number, cell in enumerate(cells, 1):
            record = self.outcome(cell).record
            paper = paper_value(cell)
            self.progress(
                f"[{number}/{len(cells)}] gamma {cell.row:>4} nodes {cell.nodes:>5}: "
                f"{record['iterations']} steps (paper {paper}), {record['status']}, "
                f"{record['wall_time_s']:.1f} s"
            )
            table.append(record)
        return table

    def outcome(self, cell: Cell) -> Outcome:
        """The outcome of a cell, from disk or solved now."""
        return self.store.get(cell, self._solve)

    def result(self, cell: Cell) -> DualResult:
        """A solved cell as a result with all its fields."""
        outcome = self.outcome(cell)
        history = History([IterationRecord(**row) for row in outcome.record["history"]])
        status = Status[outcome.record["status"].upper()]
        v, regularisation = outcome.arrays["v"], Coupled(cell_gamma(cell))
        return restore(self.problem(cell.nodes), regularisation, v, self.options, status, history)

    def start_of(self, cell: Cell) -> Cell | None:
        """Where a cell starts: the 417-node solution, or the next coarser mesh's when nested.

        The 417-node solution itself is reached from v = 0 by steps of a factor of ten in gamma.
        """
        if cell.nodes == lshape.COARSE_NODES:
            gamma = cell_gamma(cell)
            return Cell(f"1e{round(math.log10(gamma)) - 1}", cell.nodes) if gamma > 1e3 else None
        if cell.row.endswith("*") and cell.nodes > lshape.PAPER_NODES[0]:
            finer = lshape.PAPER_NODES.index(cell.nodes)
            return Cell(cell.row, lshape.PAPER_NODES[finer - 1])
        return Cell(cell.row.rstrip("*"), lshape.COARSE_NODES)

    def _solve(self, cell: Cell) -> Outcome:
        start = self.start_of(cell)
        begin = None if start is None else self.result(start)
        result = semismooth_newton(self.problem(cell.nodes), cell_gamma(cell), begin, self.options)
        record = {
            "row": cell.row,
            "gamma": cell_gamma(cell),
            "nodes": cell.nodes,
            "iterations": result.iterations,
            "status": result.status.label,
            "dual_energy": result.dual_energy,
            "residual_norm": result.residual_norm,
            "halvings": result.history.halvings,
            "history": result.history.as_rows(),
        }
        return Outcome(record, {"v": result.v.FV().NumPy().copy()})

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write table1.csv, table1.md and table1.json; returns their paths."""
        counts = {(r["row"], r["nodes"]): r["iterations"] for r in table}
        head = ["gamma", *(f"{n} nodes" for n in self.nodes)]
        rows = [
            [row, *(f"{counts[row, n]} ({paper_value(Cell(row, n))})" for n in self.nodes)]
            for row in self.rows
        ]
        notes = [
            "Newton steps of Algorithm 7.1 for Example (a), ours (the paper's in parentheses). "
            "Start: the prolongated solution on 417 nodes; rows with * start from the next coarser "
            f"mesh. Tolerance {self.options.tolerance:g}, {self.options.quadrature_points} "
            "quadrature points per triangle.",
            "",
            *provenance_lines(),
        ]
        short = [
            {
                **{k: r[k] for k in r if k != "history"},
                "paper": paper_value(Cell(r["row"], r["nodes"])),
            }
            for r in table
        ]
        texts = {
            "table1.csv": csv_table(short),
            "table1.md": markdown_table("Table 1", head, rows, notes),
            "table1.json": records.to_json({**records.provenance(), "cells": list(table)}),
        }
        for name, text in texts.items():
            records.write_text(self.folder / name, text)
        return [self.folder / name for name in texts]


def cell_gamma(cell: Cell) -> float:
    """The gamma of a row label."""
    return float(cell.row.rstrip("*"))


def paper_value(cell: Cell) -> int | None:
    """The paper's count for a cell, None where it has none."""
    if cell.nodes not in lshape.PAPER_NODES:
        return None
    return TABLE_1[cell.row][lshape.PAPER_NODES.index(cell.nodes)]
