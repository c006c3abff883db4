"""Table 3: Algorithm 7.2 for Example (b); beside it a direct solve."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from ngepc.dual.widths import mesh_width
from ngepc.geometries import wrench
from ngepc.model.examples import wrench_problem
from ngepc.path.options import PathOptions
from ngepc.path.solver import follow_path
from ngepc.results import records
from ngepc.studies.output import Table, write_table
from ngepc.studies.paper import TABLE_3_INNER, TABLE_3_OUTER
from ngepc.studies.tables import Cell, CellStore, Outcome

Progress = Callable[[str], None]


class Table3:
    """The study; paths and direct solves are kept in ``folder``/cells, paths gamma by gamma.

    Parameters
    ----------
    folder
        Where results go.
    nodes
        Node counts of the columns, members of the wrench's mesh family.
    options
        Path options; those of Table 3 by default.
    progress
        Called with a line of text after each path and each direct solve.
    """

    def __init__(
        self,
        folder: Path,
        nodes: Sequence[int] = wrench.PAPER_NODES,
        options: PathOptions | None = None,
        progress: Progress | None = None,
    ) -> None:
        self.folder, self.nodes = Path(folder), tuple(nodes)
        self.options = PathOptions() if options is None else options
        self.progress = progress or (lambda line: None)
        o = self.options
        settings = {
            "study": "table3",
            "gamma_start": o.gamma_start,
            "growth": o.growth,
            "inner_tolerance": o.inner_tolerance,
            "outer_tolerance": o.outer_tolerance,
            "quadrature_points": o.newton.quadrature_points,
            "ngepc": records.provenance()["version"],
        }
        self.store = CellStore(self.folder / "cells", settings)
        self._scale = f"c{o.inner_scale:g}"

    def run(self) -> list[dict]:
        """Fill the table; returns one record for each mesh."""
        table = []
        for nodes in self.nodes:
            path = self.store.get(Cell(f"path-{self._scale}", nodes), self._follow).record
            self.progress(
                f"nodes {nodes:>5}: {path['outer_iterations']}"
                f"({path['total_inner_iterations']}) (paper {paper_value(nodes)}), "
                f"gamma_end {path['gamma_end']:.3g}, {path['status']}, {path['wall_time_s']:.1f} s"
            )
            direct = self.store.get(Cell(f"direct-{self._scale}", nodes), self._direct).record
            self.progress(
                f"nodes {nodes:>5}: directly {direct['iterations']} steps, {direct['status']}, "
                f"{direct['wall_time_s']:.1f} s"
            )
            table.append(path | {f"direct_{key}": direct[key] for key in direct})
        return table

    def _follow(self, cell: Cell) -> Outcome:
        problem = wrench_problem(wrench.paper_mesh(cell.nodes))
        begin = time.perf_counter()
        path = follow_path(
            problem,
            self.options,
            lambda s: self.progress(f"  gamma {s.gamma:9.4g}: {s.iterations} steps"),
            checkpoint=self.folder / "cells" / f"{cell.name}.path.npz",
        )
        h = mesh_width(problem.mesh)
        record = {
            "nodes": cell.nodes,
            "h": h,
            "inner_scale": self.options.inner_scale,
            "outer_iterations": path.outer_iterations,
            "total_inner_iterations": path.total_inner_iterations,
            "paper": paper_value(cell.nodes),
            "inner_iterations": path.inner_iterations,
            "gamma_end": path.gamma_end,
            "status": path.status.label,
            "path_values": path.path_values,
            "changes": [step.change for step in path.steps],
            "outer_bound": self.options.outer_tolerance * h,
            "residual_norms": path.residual_norms,
            "primal_energy": path.last.primal_energy,
            "path_seconds": time.perf_counter() - begin,
        }
        return Outcome(record, {"v": path.last.v.FV().NumPy().copy()})

    def _direct(self, cell: Cell) -> Outcome:
        """Algorithm 7.1 from v = 0 at the last gamma of the path, to the same precision."""
        path = self.store.get(Cell(f"path-{self._scale}", cell.nodes), self._follow).record
        gamma = path["gamma_end"]
        options = replace(self.options, gamma_start=gamma, gamma_end=gamma)
        direct = follow_path(wrench_problem(wrench.paper_mesh(cell.nodes)), options)
        record = {
            "iterations": direct.total_inner_iterations,
            "status": direct.status.label,
            "path_value": direct.path_values[-1],
            "residual_norm": direct.residual_norms[-1],
            "halvings": direct.steps[-1].halvings,
        }
        return Outcome(record)

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write table3.csv, table3.md and table3.json (with _cX for another scale)."""
        head = [
            *("nodes", "iterations", "paper", "gamma_end", "inner"),
            *("last two changes / (tau_out h)", "directly at gamma_end", "directly / path"),
            *("residual", "V"),
        ]
        o = self.options
        notes = [
            "Outer (total inner) iterations of Algorithm 7.2 for Example (b) from v = 0, "
            f"gamma_0 = {o.gamma_start:g}, theta = {o.growth:g}, tau_out = {o.outer_tolerance:g}, "
            f"tau_in = {o.inner_tolerance:g}; inner tolerances times c = {o.inner_scale:g}, at "
            "least one Newton step for each gamma, h the smallest altitude of a triangle "
            "(docs/reading.md says why). The path ends when the quotient in the sixth column "
            "falls below 1.",
            "",
            "Directly: Newton steps of Algorithm 7.1 from v = 0 at gamma_end to the same "
            "precision; the paper reports more than double the iterations of the path for the "
            "finest mesh, the column beside it is what we count.",
        ]
        rows = [_row(record) for record in table]
        usual = o.inner_scale == PathOptions().inner_scale
        name = "table3" if usual else f"table3_{self._scale}"
        title = "Table 3" if usual else f"Table 3 with c = {o.inner_scale:g}"
        return write_table(
            self.folder,
            Table(name=name, title=title, head=head, rows=rows, notes=notes, cells=table),
        )


def _row(r: dict) -> list[str]:
    quotients = [c / r["outer_bound"] for c in r["changes"][-2:] if c is not None]
    ended = "" if r["status"] == "converged" else f" {r['status']}"
    direct = "" if r["direct_status"] == "converged" else f" {r['direct_status']}"
    return [
        str(r["nodes"]),
        f"{r['outer_iterations']}({r['total_inner_iterations']}){ended}",
        str(r["paper"]),
        f"{r['gamma_end']:.3g}",
        " ".join(map(str, r["inner_iterations"])),
        ", ".join(f"{q:.3f}" for q in quotients),
        f"{r['direct_iterations']}{direct}",
        f"{r['direct_iterations'] / r['total_inner_iterations']:.2f}",
        f"{r['residual_norms'][-1]:.1e}",
        f"{r['path_values'][-1]:.6f}",
    ]


def paper_value(nodes: int) -> str | None:
    """The paper's entry 'outer(inner)', None where it has none."""
    if nodes not in wrench.PAPER_NODES:
        return None
    column = wrench.PAPER_NODES.index(nodes)
    return f"{TABLE_3_OUTER[column]}({TABLE_3_INNER[column]})"
