"""Definition 6.1 and the norm gap in numbers: section 6 as two tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.dual.spaces import Coupled
from ngepc.model.problem import Problem
from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.work import Cell, Table, Work
from ngepc.theory.differentiability import difference_quotients

COARSER = (113, 225, 417)

WITHOUT = 1e12
"""gamma_T of a Tichonov term that no longer acts: what is left is the Moreau-Yosida
regularisation alone, whose max functions map L2 to L2."""

QUOTIENTS = "||M(q+h) - M(q) - G(q+h) h|| / ||h||"

TABLES = {
    "differentiability": (
        "Difference quotients of Definition 6.1",
        f"{QUOTIENTS} for directions h on shrinking discs: it tends to zero between spaces with a "
        "norm gap and does not from L2 to L2, docs/differentiability.md.",
    ),
    "without_tichonov": (
        "Newton steps with and without the Tichonov term",
        "Example (a) from v = 0; without the term the counts grow with the mesh.",
    ),
}
"""File -> title and note."""


def with_and_without(problem: Problem, gamma: float, options: NewtonOptions | None = None) -> dict:
    """Newton steps from v = 0 with the Tichonov term, and, named ``_without``, without it."""
    record: dict = {"nodes": problem.mesh.nv}
    kinds = {"": Coupled(gamma), "_without": Coupled(gamma, gamma_tichonov=WITHOUT)}
    for suffix, kind in kinds.items():
        result = semismooth_newton(problem, options=options, regularisation=kind).or_interrupted()
        record[f"iterations{suffix}"] = result.iterations
        record[f"halvings{suffix}"] = result.history.halvings
        record[f"status{suffix}"] = result.status.label
    return record


@dataclass(eq=False)
class Differentiability(Work):
    """Discs of ``levels`` radii; counts on meshes of up to ``nodes`` nodes, which take seconds."""

    levels: int = 7
    nodes: int = 1601
    gamma: float = 1e4

    name, keeps = "differentiability", False

    def __post_init__(self) -> None:
        example("lshape", self.nodes)

    def cells(self) -> list[Cell]:
        """The quotients, then the meshes of the counts."""
        meshes = [n for n in (*COARSER, *FAMILIES["lshape"]) if n <= self.nodes]
        return [Cell("quotients"), *(Cell("counts", n) for n in meshes)]

    def solve(self, cell: Cell) -> list[dict]:
        """All quotients, or the counts with and without the Tichonov term."""
        if cell.row == "quotients":
            return difference_quotients(self.levels)
        return [with_and_without(example("lshape", cell.nodes), self.gamma)]

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Runs that do not converge are part of what is shown."""
        return bool(records)

    def row(self, record: dict) -> list[str]:
        """Three digits."""
        return [f"{v:.3g}" if isinstance(v, float) else str(v) for v in record.values()]

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write differentiability.* and without_tichonov.*; returns their paths."""
        quotients = [row for row in table if "nodes" not in row]
        counts = [row for row in table if "nodes" in row]
        written = []
        for (name, (title, note)), part in zip(TABLES.items(), (quotients, counts), strict=True):
            head, rows = list(part[0]), list(map(self.row, part))
            whole = Table(name=name, title=title, head=head, rows=rows, notes=[note], cells=part)
            written += whole.write(self.folder)
        return written
