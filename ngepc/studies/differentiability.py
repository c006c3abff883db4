"""Definition 6.1 and the norm gap in numbers: section 6 as a table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ngepc.studies.output import Table, write_table


def _text(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def write_differentiability(
    folder: Path, quotients: Sequence[dict], counts: Sequence[dict]
) -> list[Path]:
    """Write the quotients and the counts as two tables; returns the paths.

    Parameters
    ----------
    folder
        Where they go.
    quotients, counts
        Rows of ``difference_quotients`` and ``counts_without_tichonov``.
    """
    tables = [
        Table(
            name="differentiability",
            title="Difference quotients of Definition 6.1",
            head=list(quotients[0]),
            rows=[[_text(v) for v in row.values()] for row in quotients],
            notes=[
                "||M(q+h) - M(q) - G(q+h) h|| / ||h|| for directions h on shrinking discs: it "
                "tends to zero between spaces with a norm gap and does not from L2 to L2, "
                "docs/differentiability.md."
            ],
            cells=quotients,
        ),
        Table(
            name="without_tichonov",
            title="Newton steps with and without the Tichonov term",
            head=list(counts[0]),
            rows=[[_text(v) for v in row.values()] for row in counts],
            notes=["Example (a) from v = 0; without the term the counts grow with the mesh."],
            cells=counts,
        ),
    ]
    return [path for table in tables for path in write_table(folder, table)]
