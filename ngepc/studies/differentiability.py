"""Definition 6.1 and the norm gap in numbers: section 6 as two tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.work import Cell, Outcome, Table, Work
from ngepc.theory.differentiability import counts_without_tichonov, difference_quotients

COARSER = (113, 225, 417)


TABLES = {
    "differentiability": (
        "Difference quotients of Definition 6.1",
        "||M(q+h) - M(q) - G(q+h) h|| / ||h|| for directions h on shrinking discs: it tends to "
        "zero between spaces with a norm gap and does not from L2 to L2, "
        "docs/differentiability.md.",
    ),
    "without_tichonov": (
        "Newton steps with and without the Tichonov term",
        "Example (a) from v = 0; without the term the counts grow with the mesh.",
    ),
}
"""File -> title and note."""


@dataclass(eq=False)
class Differentiability(Work):
    """The study; it takes seconds, so nothing is kept.

    Parameters
    ----------
    levels
        Radii of the discs.
    nodes, gamma
        Finest mesh of the counts and the gamma at which they are taken.
    """

    levels: int = 7
    nodes: int = 1601
    gamma: float = 1e4

    name = "differentiability"

    def __post_init__(self) -> None:
        example("lshape", self.nodes)

    def cells(self) -> list[Cell]:
        """The meshes of the counts."""
        return [Cell("counts", n) for n in (*COARSER, *FAMILIES["lshape"]) if n <= self.nodes]

    def kept(self, cell: Cell) -> Outcome:
        """Counts with and without the Tichonov term."""
        problem = example("lshape", cell.nodes)
        (record,) = counts_without_tichonov([problem], self.gamma)
        return Outcome(record)

    solve = kept

    def line(self, record: dict) -> str:
        """The counts."""
        return ", ".join(f"{key} {_text(value)}" for key, value in record.items())

    def run(self) -> list[dict]:
        """The quotients, then the counts."""
        return [*difference_quotients(self.levels), *super().run()]

    def table(self, records: Sequence[dict]) -> Table:
        """Of the quotients, or of the counts."""
        name = "without_tichonov" if "nodes" in records[0] else self.name
        title, note = TABLES[name]
        rows = [[_text(v) for v in row.values()] for row in records]
        head = list(records[0])
        return Table(name=name, title=title, head=head, rows=rows, notes=[note], cells=records)

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write differentiability.* and without_tichonov.*; returns their paths."""
        quotients = super().write([row for row in table if "nodes" not in row])
        return quotients + super().write([row for row in table if "nodes" in row])


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
