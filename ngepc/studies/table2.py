"""Table 2: Newton steps of Algorithm 7.1 for Example (b), from v = 0."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.examples import wrench_problem
from ngepc.geometries import wrench
from ngepc.newton import NewtonOptions, semismooth_newton
from ngepc.storage import records
from ngepc.studies.output import Table, write_table
from ngepc.studies.paper import TABLE_2
from ngepc.studies.tables import Cell, CellStore, Outcome

ROWS = tuple(TABLE_2)

Progress = Callable[[str], None]


class Table2:
    """The study; each cell is solved once and kept in ``folder``/cells.

    Parameters
    ----------
    folder
        Where results go.
    nodes
        Node counts of the columns, members of the wrench's mesh family.
    rows
        Row labels of the paper's table, '1e1' to '1e6'.
    options
        Newton options.
    progress
        Called with a line of text after each cell.

    Raises
    ------
    ValueError
        If a row is not in the table.
    """

    def __init__(
        self,
        folder: Path,
        nodes: Sequence[int] = wrench.PAPER_NODES,
        rows: Sequence[str] = ROWS,
        options: NewtonOptions | None = None,
        progress: Progress | None = None,
    ) -> None:
        unknown = [row for row in rows if row not in TABLE_2]
        if unknown:
            raise ValueError(f"rows={unknown}: the table has {', '.join(TABLE_2)}")
        self.folder, self.nodes, self.rows = Path(folder), tuple(nodes), tuple(rows)
        self.options = NewtonOptions(max_iterations=2000) if options is None else options
        self.progress = progress or (lambda line: None)
        settings = {
            "study": "table2",
            "tolerance": self.options.tolerance,
            "quadrature_points": self.options.quadrature_points,
            "ngepc": records.provenance()["version"],
        }
        self.store = CellStore(self.folder / "cells", settings)

    def run(self) -> list[dict]:
        """Fill the table, coarse meshes first; returns one record for each cell."""
        cells = [Cell(row, nodes) for nodes in self.nodes for row in self.rows]
        table = []
        for number, cell in enumerate(cells, 1):
            record = self.store.get(cell, self._solve).record
            self.progress(
                f"[{number}/{len(cells)}] gamma {cell.row:>4} nodes {cell.nodes:>5}: "
                f"{record['iterations']} steps (paper {paper_value(cell)}), {record['status']}, "
                f"{record['wall_time_s']:.1f} s"
            )
            table.append(record)
        return table

    def _solve(self, cell: Cell) -> Outcome:
        problem = wrench_problem(wrench.paper_mesh(cell.nodes))
        result = semismooth_newton(problem, float(cell.row), options=self.options)
        record = {
            "row": cell.row,
            "gamma": float(cell.row),
            "nodes": cell.nodes,
            "iterations": result.iterations,
            "paper": paper_value(cell),
            "status": result.status.label,
            "dual_energy": result.dual_energy,
            "residual_norm": result.residual_norm,
            "halvings": result.history.halvings,
            "history": result.history.as_rows(),
        }
        return Outcome(record, {"v": result.v.FV().NumPy().copy()})

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write table2.csv, table2.md and table2.json; returns their paths."""
        found = {(r["row"], r["nodes"]): r for r in table}
        rows = [[row, *(_entry(found.get((row, n))) for n in self.nodes)] for row in self.rows]
        notes = [
            "Newton steps of Algorithm 7.1 for Example (b) from v = 0, ours (the paper's in "
            f"parentheses). Tolerance {self.options.tolerance:g}, "
            f"{self.options.quadrature_points} quadrature points per triangle. The paper prints "
            "24927 nodes for the mesh with 24993; its polygon is lost, ours is reconstructed "
            "(docs/reading.md).",
        ]
        head = ["gamma", *(f"{n} nodes" for n in self.nodes)]
        cells = [{key: r[key] for key in r if key != "history"} for r in table]
        return write_table(
            self.folder,
            Table(name="table2", title="Table 2", head=head, rows=rows, notes=notes, cells=cells),
        )


def _entry(record: dict | None) -> str:
    """Ours (paper), with the status where the run did not converge."""
    if record is None:
        return ""
    ended = "" if record["status"] == "converged" else f" {record['status']}"
    return f"{record['iterations']} ({record['paper']}){ended}"


def paper_value(cell: Cell) -> int | None:
    """The paper's count for a cell, None where it has none."""
    if cell.nodes not in wrench.PAPER_NODES:
        return None
    return TABLE_2[cell.row][wrench.PAPER_NODES.index(cell.nodes)]
