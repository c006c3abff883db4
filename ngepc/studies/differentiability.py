"""Definition 6.1 and the norm gap in numbers: section 6 as two tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.work import Table, Work
from ngepc.theory.differentiability import counts_without_tichonov, difference_quotients

COARSER = (113, 225, 417)


class Differentiability(Work):
    """The study.

    Parameters
    ----------
    folder, progress
        As for ``Work``.
    levels
        Radii of the discs.
    nodes, gamma
        Finest mesh of the counts and the gamma at which they are taken.
    """

    name = "differentiability"

    def __init__(
        self,
        folder: Path,
        levels: int = 7,
        nodes: int = 1601,
        gamma: float = 1e4,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(folder, progress)
        example("lshape", nodes)
        self.levels, self.gamma = levels, gamma
        self.nodes = [n for n in (*COARSER, *FAMILIES["lshape"]) if n <= nodes]

    def run(self) -> list[dict]:
        """The quotients, then the counts."""
        quotients = difference_quotients(self.levels)
        self.progress("quotients done")
        problems = [example("lshape", n) for n in self.nodes]
        return [*quotients, *counts_without_tichonov(problems, self.gamma)]

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write differentiability.* and without_tichonov.*; returns their paths."""
        counts = [row for row in table if "nodes" in row]
        quotients = [row for row in table if "nodes" not in row]
        tables = {
            "differentiability": (
                "Difference quotients of Definition 6.1",
                "||M(q+h) - M(q) - G(q+h) h|| / ||h|| for directions h on shrinking discs: it "
                "tends to zero between spaces with a norm gap and does not from L2 to L2, "
                "docs/differentiability.md.",
                quotients,
            ),
            "without_tichonov": (
                "Newton steps with and without the Tichonov term",
                "Example (a) from v = 0; without the term the counts grow with the mesh.",
                counts,
            ),
        }
        return [
            path
            for name, (title, note, cells) in tables.items()
            for path in Table(
                name=name,
                title=title,
                head=list(cells[0]),
                rows=[[_text(v) for v in row.values()] for row in cells],
                notes=[note],
                cells=cells,
            ).write(self.folder)
        ]


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
