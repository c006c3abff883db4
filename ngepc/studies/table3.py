"""Table 3: Algorithm 7.2 for Example (b), and beside it a direct solve at the last gamma."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ngepc.dual.path import follow_path
from ngepc.dual.path_options import PathOptions
from ngepc.dual.widths import mesh_width
from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.paper import TABLE_3_INNER, TABLE_3_OUTER
from ngepc.studies.work import Cell, Table, Work, ending, first_of, steps

PATH = ("outer_iterations", "total_inner_iterations", "inner_iterations", "gamma_end",
        "path_values", "residual_norms")  # fmt: skip
"""What is recorded of a path."""


def last_changes(record: dict) -> str:
    """The last changes of the value, over what stops the path."""
    changes = [c for c in record["changes"][-2:] if c is not None]
    return ", ".join(f"{c / record['outer_bound']:.3f}" for c in changes)


@dataclass(eq=False)
class Table3(Work):
    """Paths on ``levels`` meshes, kept gamma by gamma; ``inner_scale`` is c."""

    levels: int = 3
    inner_scale: float = PathOptions().inner_scale

    name = "table3"
    columns = (
        ("nodes", "{nodes}"),
        ("iterations",
         lambda r: f"{r['outer_iterations']}({r['total_inner_iterations']}){ending(r)}"),
        ("paper", "{paper}"),
        ("gamma_end", "{gamma_end:.3g}"),
        ("inner", lambda r: " ".join(map(str, r["inner_iterations"]))),
        ("last two changes / (tau_out h)", last_changes),
        ("directly at gamma_end", lambda r: steps(r, "direct_")),
        ("directly / path",
         lambda r: f"{r['direct_iterations'] / r['total_inner_iterations']:.2f}"),
        ("residual", lambda r: f"{r['residual_norms'][-1]:.1e}"),
        ("V", lambda r: f"{r['path_values'][-1]:.6f}"),
    )  # fmt: skip

    def __post_init__(self) -> None:
        self.options = PathOptions(inner_scale=self.inner_scale)

    def cells(self) -> list[Cell]:
        """The meshes."""
        meshes = first_of(FAMILIES["wrench"], self.levels)
        return [Cell(f"c{self.inner_scale:g}", n) for n in meshes]

    def solve(self, cell: Cell) -> dict:
        """A path, and the direct solve at its end: Algorithm 7.1 from v = 0, as precise."""
        problem = example("wrench", cell.nodes)
        path = follow_path(
            problem,
            self.options,
            lambda s: self.progress(f"  gamma {s.gamma:9.4g}: {s.iterations} steps"),
            checkpoint=self.folder / "cells" / f"{self.name}-{cell.name}.path.npz",
        ).or_interrupted()
        there = replace(self.options, gamma_start=path.gamma_end, gamma_end=path.gamma_end)
        direct = follow_path(problem, there).or_interrupted()
        h = mesh_width(problem.mesh)
        return {
            "nodes": cell.nodes,
            "h": h,
            "inner_scale": self.inner_scale,
            "paper": paper_value(cell.nodes),
            "status": path.status.label,
            **{name: getattr(path, name) for name in PATH},
            "changes": [step.change for step in path.steps],
            "outer_bound": self.options.outer_tolerance * h,
            "direct_iterations": direct.total_inner_iterations,
            "direct_status": direct.status.label,
            "direct_path_value": direct.path_values[-1],
            "direct_residual_norm": direct.residual_norms[-1],
            "direct_halvings": direct.steps[-1].halvings,
        }

    def table(self, records: Sequence[dict]) -> Table:
        """One row for each mesh, in table3.* (with _cX for another scale)."""
        c = self.inner_scale
        if c == PathOptions().inner_scale:
            return replace(super().table(records), title="Table 3")
        name, title = f"table3_c{c:g}", f"Table 3 with c = {c:g}"
        return replace(super().table(records), name=name, title=title)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What is counted."""
        o = self.options
        return [
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


def paper_value(nodes: int) -> str | None:
    """The paper's entry 'outer(inner)', None where it has none."""
    if nodes not in FAMILIES["wrench"]:
        return None
    column = FAMILIES["wrench"].index(nodes)
    return f"{TABLE_3_OUTER[column]}({TABLE_3_INNER[column]})"
