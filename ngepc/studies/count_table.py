"""A table of Newton steps over gamma and meshes, ours beside the paper's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ngepc.dual.newton import NewtonOptions
from ngepc.dual.result import DualResult
from ngepc.results import records
from ngepc.studies.output import Table, write_table
from ngepc.studies.tables import Cell, CellStore, Outcome


class CountTable(ABC):
    """The study; each cell is solved once and kept in ``folder``/cells.

    Parameters
    ----------
    folder
        Where results go.
    nodes
        Node counts of the columns, members of ``family`` in ascending order; None for all.
    rows
        Row labels of ``paper``; None for all.
    options
        Newton options.
    progress
        Called with a line of text after each cell.

    Attributes
    ----------
    number
        Which table of the paper.
    paper
        Row label -> the paper's counts on the meshes of ``family``.
    family
        Node counts of the paper's meshes.
    about
        What is counted, for the notes below the table.

    Raises
    ------
    ValueError
        If a row is not in the table.
    """

    number: int
    paper: Mapping[str, Sequence[int]]
    family: Sequence[int]
    about: str

    def __init__(
        self,
        folder: Path,
        nodes: Sequence[int] | None = None,
        rows: Sequence[str] | None = None,
        options: NewtonOptions | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.nodes = tuple(self.family if nodes is None else nodes)
        self.rows = tuple(self.paper if rows is None else rows)
        unknown = [row for row in self.rows if row not in self.paper]
        if unknown:
            raise ValueError(f"rows={unknown}: the table has {', '.join(self.paper)}")
        self.options = NewtonOptions(max_iterations=2000) if options is None else options
        self.progress = progress or (lambda line: None)
        settings = {
            "study": self.name,
            "tolerance": self.options.tolerance,
            "quadrature_points": self.options.quadrature_points,
            "ngepc": records.provenance()["version"],
        }
        self.store = CellStore(self.folder / "cells", settings)

    @property
    def name(self) -> str:
        """File name without ending."""
        return f"table{self.number}"

    @abstractmethod
    def solve(self, cell: Cell) -> DualResult:
        """Solve one cell."""

    def run(self) -> list[dict]:
        """Fill the table, coarse meshes first; returns one record for each cell."""
        cells = [Cell(row, nodes) for nodes in self.nodes for row in self.rows]
        table = []
        for number, cell in enumerate(cells, 1):
            record = self.outcome(cell).record
            self.progress(
                f"[{number}/{len(cells)}] gamma {cell.row:>4} nodes {cell.nodes:>5}: "
                f"{record['iterations']} steps (paper {self.paper_value(cell)}), "
                f"{record['status']}, {record['wall_time_s']:.1f} s"
            )
            table.append(record)
        return table

    def outcome(self, cell: Cell) -> Outcome:
        """The outcome of a cell, from disk or solved now."""
        return self.store.get(cell, self._solved)

    def _solved(self, cell: Cell) -> Outcome:
        result = self.solve(cell)
        record = {
            "row": cell.row,
            "gamma": cell_gamma(cell),
            "nodes": cell.nodes,
            "iterations": result.iterations,
            "paper": self.paper_value(cell),
            "status": result.status.label,
            "dual_energy": result.dual_energy,
            "residual_norm": result.residual_norm,
            "halvings": result.history.halvings,
            "history": result.history.as_rows(),
        }
        return Outcome(record, {"v": result.v.FV().NumPy().copy()})

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write the table as CSV, Markdown and JSON; returns their paths."""
        found = {(r["row"], r["nodes"]): r for r in table}
        notes = [
            f"{self.about} Ours (the paper's in parentheses). Tolerance "
            f"{self.options.tolerance:g}, {self.options.quadrature_points} quadrature points per "
            "triangle."
        ]
        rows = [[row, *(self._entry(found.get((row, n))) for n in self.nodes)] for row in self.rows]
        return write_table(
            self.folder,
            Table(
                name=self.name,
                title=f"Table {self.number}",
                head=["gamma", *(f"{n} nodes" for n in self.nodes)],
                rows=rows,
                notes=notes,
                cells=[{key: r[key] for key in r if key != "history"} for r in table],
            ),
        )

    def _entry(self, record: dict | None) -> str:
        """Ours (paper), with the status where the run did not converge."""
        if record is None:
            return ""
        ended = "" if record["status"] == "converged" else f" {record['status']}"
        paper = self.paper_value(Cell(record["row"], record["nodes"]))
        return f"{record['iterations']} ({paper}){ended}"

    @classmethod
    def paper_value(cls, cell: Cell) -> int | None:
        """The paper's count for a cell, None where it has none."""
        if cell.nodes not in cls.family:
            return None
        return cls.paper[cell.row][cls.family.index(cell.nodes)]


def cell_gamma(cell: Cell) -> float:
    """The gamma of a row label; a star marks nested iteration."""
    return float(cell.row.rstrip("*"))
