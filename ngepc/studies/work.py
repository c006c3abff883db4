"""What all studies share: cells kept on disk, so that work survives Ctrl-C, and written tables."""

from __future__ import annotations

import csv
import io
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from ngepc.results import checkpoint, records
from ngepc.results.files import check_folder
from ngepc.results.outcome import Status


@dataclass(frozen=True)
class Cell:
    """One solve of a study: label of its row, and the number of nodes or cells of its mesh."""

    row: str
    nodes: int = 0

    @property
    def name(self) -> str:
        """File name for the checkpoint of the cell."""
        return f"{self.row.replace('*', '-nested').replace('/', ' over ')}-{self.nodes}"


@dataclass
class Outcome:
    """What solving a cell gave: the record to keep, and arrays that later cells start from."""

    record: dict
    arrays: dict = field(default_factory=dict)


def silent(line: str) -> None:
    """Progress that nobody wants to read."""


@dataclass(eq=False)
class Work(ABC):
    """A study at work: ``run`` gives one record for each cell, ``write`` the files.

    Parameters
    ----------
    folder
        Where results go; each cell is solved once and kept in ``folder``/cells.
    progress
        Called with a line of text after each cell.

    Attributes
    ----------
    name
        File name of the results without ending.
    title, head
        Of the table.
    """

    folder: Path
    progress: Callable[[str], None] = field(default=silent, kw_only=True)

    name: ClassVar[str]
    title: ClassVar[str] = ""
    head: ClassVar[Sequence[str]] = ()

    def settings(self) -> dict:
        """Everything that determines a cell beside its name; kept ones with others are refused."""
        return {}

    @abstractmethod
    def cells(self) -> Sequence[Cell]:
        """The cells, in the order in which they are solved."""

    @abstractmethod
    def solve(self, cell: Cell) -> Outcome:
        """Solve a cell."""

    @abstractmethod
    def line(self, record: dict) -> str:
        """What progress says about a record."""

    def row(self, record: dict) -> Sequence[object]:
        """The entries of a record under ``head``."""
        return list(record.values())

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What is said below the table."""
        return []

    def table(self, records: Sequence[dict]) -> Table:
        """The table of the records that ``run`` has returned, a row for each."""
        return Table(
            name=self.name,
            title=self.title,
            head=self.head,
            rows=[self.row(record) for record in records],
            notes=self.notes(records),
            cells=records,
        )

    def run(self) -> list[dict]:
        """Do the work; returns one record for each cell."""
        cells, table = self.cells(), []
        for number, cell in enumerate(cells, 1):
            table.append(self.kept(cell).record)
            self.progress(f"[{number}/{len(cells)}] {self.line(table[-1])}")
        return table

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write what ``run`` has returned as NAME.csv, .md and .json; returns their paths."""
        return self.table(table).write(self.folder)

    def kept(self, cell: Cell) -> Outcome:
        """The stored outcome of a cell, or the one that ``solve`` gives, which is then stored.

        Raises
        ------
        KeyboardInterrupt
            If the solve was stopped: half a cell is not stored.
        """
        check_folder(self.folder / "cells")
        path = self.folder / "cells" / f"{self.name}-{cell.name}.npz"
        about = {"study": self.name, "ngepc": records.provenance()["version"], **self.settings()}
        fingerprint = {**about, "row": cell.row, "nodes": cell.nodes}
        stored = checkpoint.load(path, fingerprint)
        if stored is not None:
            return Outcome(stored.record, stored.arrays)
        begin = time.perf_counter()
        outcome = self.solve(cell)
        if outcome.record.get("status") == Status.STOPPED.label:
            raise KeyboardInterrupt
        outcome.record["wall_time_s"] = time.perf_counter() - begin
        checkpoint.save(path, fingerprint, outcome.record, outcome.arrays)
        return outcome


def first_of(family: Sequence[int], levels: int) -> tuple[int, ...]:
    """The first meshes of a family; ValueError if there are not so many."""
    if not 1 <= levels <= len(family):
        raise ValueError(f"levels={levels}: 1 to {len(family)} are available")
    return tuple(family[:levels])


def chosen(known: Mapping[str, object], rows: Sequence[str] | None) -> tuple[str, ...]:
    """The rows asked for, all of them for None; ValueError for unknown ones."""
    rows = tuple(known if rows is None else rows)
    unknown = [row for row in rows if row not in known]
    if unknown or not rows:
        raise ValueError(f"rows={unknown}: the table has {', '.join(known)}")
    return rows


def ending(record: dict, prefix: str = "") -> str:
    """' status' for a run that has not converged, nothing for one that has."""
    status = record[f"{prefix}status"]
    return "" if status == "converged" else f" {status.replace('_', ' ')}"


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table to be written.

    Parameters
    ----------
    name
        File name without ending.
    title, head, rows, notes
        Of the Markdown table.
    cells
        One record for each cell; values that are no numbers or text stay out of the CSV.
    seed
        Where chance took part.
    """

    name: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    notes: Sequence[str]
    cells: Sequence[dict]
    seed: int | None = None

    def write(self, folder: Path) -> list[Path]:
        """Write NAME.csv, NAME.md and NAME.json into ``folder``; returns their paths."""
        made_with = records.provenance(self.seed)
        texts = {
            "csv": _csv([_flat(cell) for cell in self.cells]),
            "md": self._markdown([f"- {key}: {value}" for key, value in made_with.items()]),
            "json": records.to_json({**made_with, "cells": list(self.cells)}),
        }
        paths = {kind: folder / f"{self.name}.{kind}" for kind in texts}
        for kind, text in texts.items():
            records.write_text(paths[kind], text)
        return list(paths.values())

    def _markdown(self, made_with: Sequence[str]) -> str:
        def line(entries: Sequence[object]) -> str:
            return "| " + " | ".join(str(e).replace("|", "\\|") for e in entries) + " |"

        rows = [line(self.head), "|" + " --- |" * len(self.head), *map(line, self.rows)]
        return "\n".join([f"# {self.title}", "", *rows, "", *self.notes, "", *made_with, ""])


def _csv(rows: Sequence[dict]) -> str:
    stream = io.StringIO()
    writer = csv.DictWriter(stream, fieldnames=list(rows[0]), lineterminator="\n", restval="")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _flat(cell: dict) -> dict:
    """Lists as text, one level of nested records as 'name_key', deeper ones left out."""
    flat = {}
    for key, value in cell.items():
        if isinstance(value, list | tuple) and not any(isinstance(i, dict) for i in value):
            flat[key] = " ".join(map(_short, value))
        elif isinstance(value, dict):
            flat |= {f"{key}_{name}": item for name, item in value.items()}
        elif not isinstance(value, list | tuple):
            flat[key] = value
    return flat


def _short(item: object) -> str:
    return f"{item:.6g}" if isinstance(item, float) else "" if item is None else str(item)
