"""Table 3: Algorithm 7.2 for Example (b), and beside it a direct solve at the last gamma."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ngepc.path.options import PathOptions
from ngepc.path.solver import follow_path
from ngepc.path.widths import mesh_width
from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.paper import TABLE_3_INNER, TABLE_3_OUTER
from ngepc.studies.work import Cell, Outcome, Table, Work, ending, first_of

HEAD = (
    *("nodes", "iterations", "paper", "gamma_end", "inner"),
    *("last two changes / (tau_out h)", "directly at gamma_end", "directly / path"),
    *("residual", "V"),
)


@dataclass(eq=False)
class Table3(Work):
    """The study; paths are kept gamma by gamma.

    Parameters
    ----------
    levels, nodes
        How many meshes of the wrench's family, or their node counts.
    inner_scale
        Factor c on the inner tolerances.
    """

    levels: int = 3
    inner_scale: float = PathOptions().inner_scale
    nodes: Sequence[int] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        self.nodes = self.nodes or first_of(FAMILIES["wrench"], self.levels)
        self.options = PathOptions(inner_scale=self.inner_scale)
        self._scale = f"c{self.inner_scale:g}"

    name = "table3"

    def settings(self) -> dict:
        """The options of the path."""
        names = ("gamma_start", "growth", "inner_tolerance", "outer_tolerance")
        return {name: getattr(self.options, name) for name in names}

    def cells(self) -> list[Cell]:
        """The paths."""
        return [Cell(f"path-{self._scale}", n) for n in self.nodes]

    def run(self) -> list[dict]:
        """Fill the table; returns one record for each mesh."""
        table = []
        for path in super().run():
            n = path["nodes"]
            direct = self.kept(Cell(f"direct-{self._scale}", n)).record
            self.progress(f"nodes {n:>5}: directly {direct['iterations']} steps")
            table.append(path | {f"direct_{key}": value for key, value in direct.items()})
        return table

    def line(self, r: dict) -> str:
        """The counts beside the paper's."""
        return (
            f"nodes {r['nodes']:>5}: {r['outer_iterations']}({r['total_inner_iterations']}) "
            f"(paper {r['paper']}), gamma_end {r['gamma_end']:.3g}, {r['status']}"
        )

    def solve(self, cell: Cell) -> Outcome:
        """A path, or the direct solve at its end."""
        return self._follow(cell) if cell.row.startswith("path") else self._direct(cell)

    def _follow(self, cell: Cell) -> Outcome:
        problem = example("wrench", cell.nodes)
        path = follow_path(
            problem,
            self.options,
            lambda s: self.progress(f"  gamma {s.gamma:9.4g}: {s.iterations} steps"),
            checkpoint=self.folder / "cells" / f"{cell.name}.path.npz",
        )
        h = mesh_width(problem.mesh)
        names = ("outer_iterations", "total_inner_iterations", "inner_iterations", "gamma_end",
                 "path_values", "residual_norms")  # fmt: skip
        return Outcome(
            {
                "nodes": cell.nodes,
                "h": h,
                "inner_scale": self.inner_scale,
                "paper": paper_value(cell.nodes),
                "status": path.status.label,
                **{name: getattr(path, name) for name in names},
                "changes": [step.change for step in path.steps],
                "outer_bound": self.options.outer_tolerance * h,
            }
        )

    def _direct(self, cell: Cell) -> Outcome:
        """Algorithm 7.1 from v = 0 at the last gamma of the path, to the same precision."""
        gamma = self.kept(Cell(f"path-{self._scale}", cell.nodes)).record["gamma_end"]
        options = replace(self.options, gamma_start=gamma, gamma_end=gamma)
        direct = follow_path(example("wrench", cell.nodes), options)
        return Outcome(
            {
                "iterations": direct.total_inner_iterations,
                "status": direct.status.label,
                "path_value": direct.path_values[-1],
                "residual_norm": direct.residual_norms[-1],
                "halvings": direct.steps[-1].halvings,
            }
        )

    def row(self, r: dict) -> list[str]:
        """A path, and the direct solve at its end."""
        quotients = [c / r["outer_bound"] for c in r["changes"][-2:] if c is not None]
        return [
            str(r["nodes"]),
            f"{r['outer_iterations']}({r['total_inner_iterations']}){ending(r)}",
            str(r["paper"]),
            f"{r['gamma_end']:.3g}",
            " ".join(map(str, r["inner_iterations"])),
            ", ".join(f"{q:.3f}" for q in quotients),
            f"{r['direct_iterations']}{ending(r, 'direct_')}",
            f"{r['direct_iterations'] / r['total_inner_iterations']:.2f}",
            f"{r['residual_norms'][-1]:.1e}",
            f"{r['path_values'][-1]:.6f}",
        ]

    def table(self, records: Sequence[dict]) -> Table:
        """One row for each mesh, in table3.* (with _cX for another scale)."""
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
        usual = o.inner_scale == PathOptions().inner_scale
        return Table(
            name="table3" if usual else f"table3_{self._scale}",
            title="Table 3" if usual else f"Table 3 with c = {o.inner_scale:g}",
            head=HEAD,
            rows=[self.row(record) for record in records],
            notes=notes,
            cells=records,
        )


def paper_value(nodes: int) -> str | None:
    """The paper's entry 'outer(inner)', None where it has none."""
    if nodes not in FAMILIES["wrench"]:
        return None
    column = FAMILIES["wrench"].index(nodes)
    return f"{TABLE_3_OUTER[column]}({TABLE_3_INNER[column]})"
