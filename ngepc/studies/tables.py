"""Tables of iteration counts that are filled cell by cell and survive interruptions."""

from __future__ import annotations

import csv
import io
import logging
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ngepc.results import checkpoint, records
from ngepc.results.files import check_folder
from ngepc.results.outcome import Status

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cell:
    """One solve of a table.

    Parameters
    ----------
    row, nodes
        Label of the row and number of nodes of the column.
    """

    row: str
    nodes: int

    @property
    def name(self) -> str:
        """File name for the checkpoint of the cell."""
        return f"{self.row.replace('*', '-nested')}-{self.nodes}"


@dataclass
class Outcome:
    """What solving a cell gave: the record to keep, and arrays that later cells start from."""

    record: dict
    arrays: dict = field(default_factory=dict)


class CellStore:
    """Cells on disk: one checkpoint file for each, in a folder of their own.

    Parameters
    ----------
    folder
        Where the files go; made if missing.
    settings
        Everything that determines the cells; files with other settings are refused.
    """

    def __init__(self, folder: Path, settings: dict) -> None:
        check_folder(folder)
        self._folder, self._settings = folder, settings

    def get(self, cell: Cell, solve: Callable[[Cell], Outcome]) -> Outcome:
        """The stored outcome of a cell, or the one that ``solve`` gives, which is then stored.

        Raises
        ------
        KeyboardInterrupt
            If the solve was stopped: half a cell is not stored.
        """
        path = self._folder / f"{cell.name}.npz"
        fingerprint = {**self._settings, "row": cell.row, "nodes": cell.nodes}
        stored = checkpoint.load(path, fingerprint)
        if stored is not None:
            return Outcome(stored.record, stored.arrays)
        begin = time.perf_counter()
        outcome = solve(cell)
        if outcome.record.get("status") == Status.STOPPED.label:
            raise KeyboardInterrupt
        outcome.record["wall_time_s"] = time.perf_counter() - begin
        checkpoint.save(path, fingerprint, outcome.record, outcome.arrays)
        return outcome


def markdown_table(
    title: str, head: Sequence[str], rows: Iterable[Sequence[object]], notes: Sequence[str]
) -> str:
    """A Markdown table with a title above and notes below."""
    lines = [f"# {title}", "", "| " + " | ".join(map(str, head)) + " |"]
    lines.append("|" + "|".join([" --- "] * len(head)) + "|")
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    return "\n".join([*lines, "", *notes, ""])


def csv_table(rows: Sequence[dict]) -> str:
    """CSV text of dictionaries with the same keys."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def provenance_lines(seed: int | None = None) -> list[str]:
    """Versions and command as Markdown list items."""
    return [f"- {key}: {value}" for key, value in records.provenance(seed).items()]
