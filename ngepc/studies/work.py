"""What all studies share: cells kept on disk, so that work survives Ctrl-C, and written tables."""

from __future__ import annotations

import csv
import io
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from ngepc.results import checkpoint, records
from ngepc.results.files import check_folder
from ngepc.results.outcome import Status

Entry = str | Callable[[dict], object]
"""What a column shows of a record: a format of it, such as "{force:.4f}", or a function."""


@dataclass(frozen=True)
class Cell:
    """One solve of a study: label of its row, and the number of nodes or cells of its mesh."""

    row: str
    nodes: int = 0

    @property
    def name(self) -> str:
        """File name for the checkpoint of the cell."""
        return f"{self.row.replace('*', '-nested').replace('/', ' over ')}-{self.nodes}"


def silent(line: str) -> None:
    """Progress that nobody wants to read."""


@dataclass(eq=False)
class Work(ABC):
    """A study at work: ``run`` gives the records of all cells, ``write`` the files.

    Each cell is solved once and kept in ``folder``/cells; ``progress`` gets a line of text after
    it.  Options of a study are further fields, ``ngepc.cli.commands.STUDIES`` lists them.

    Attributes
    ----------
    name
        File name of the results without ending.
    title, columns, note
        Of the table: (head, entry) for each column; {study.gamma:g} in the note is an option.
    settings
        Options that change what a cell gives; kept cells with other values are refused.
    internal
        Entries of records that stay out of the files.
    keeps
        Whether cells are kept on disk.
    """

    folder: Path
    progress: Callable[[str], None] = field(default=silent, kw_only=True)

    name: ClassVar[str]
    title: ClassVar[str] = ""
    columns: ClassVar[Sequence[tuple[str, Entry]]] = ()
    note: ClassVar[str] = ""
    settings: ClassVar[Sequence[str]] = ()
    internal: ClassVar[Sequence[str]] = ()
    keeps: ClassVar[bool] = True

    @abstractmethod
    def cells(self) -> Sequence[Cell]:
        """The cells, in the order in which they are solved."""

    @abstractmethod
    def solve(self, cell: Cell) -> dict | list[dict]:
        """What a cell gives: a record, or several; arrays in them are kept but not written."""

    def row(self, record: dict) -> list[str]:
        """The entries of a record in the columns."""
        return [str(shown(entry, record)) for _, entry in self.columns]

    def line(self, record: dict) -> str:
        """What progress says about a record: the first of its numbers and texts."""
        plain = [(key, value) for key, value in _flat(record).items() if value not in ("", None)]
        return ", ".join(f"{key} {_short(value)}" for key, value in plain[:8])

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What is said below the table."""
        return [self.note.format(study=self)]

    def told(self, records: Sequence[dict]) -> Sequence[dict]:
        """What the rows of the table show: the records, groups or parts of them."""
        return records

    def table(self, records: Sequence[dict]) -> Table:
        """The table of the records that ``run`` has returned."""
        return Table(
            name=self.name,
            title=self.title,
            head=[head for head, _ in self.columns],
            rows=[self.row(record) for record in self.told(records)],
            notes=self.notes(records),
            cells=[{k: r[k] for k in r if k not in self.internal} for r in records],
        )

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Write pictures of the records; returns their paths."""
        return []

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Whether every status in the records, also in nested ones, is 'converged'."""
        nested = [inner for r in records for inner in r.values() if isinstance(inner, dict)]
        return all(
            value == "converged"
            for record in (*records, *nested)
            for key, value in record.items()
            if key.endswith("status")
        )

    def run(self) -> list[dict]:
        """Do the work; returns the records of all cells."""
        cells, found = self.cells(), []
        for number, cell in enumerate(cells, 1):
            found += map(without_arrays, self.kept(cell))
            self.progress(f"[{number}/{len(cells)}] {self.line(found[-1])}")
        return found

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write what ``run`` has returned as NAME.csv, .md and .json, and pictures; the paths."""
        return [*self.table(table).write(self.folder), *self.draw(table)]

    def kept(self, cell: Cell) -> list[dict]:
        """The stored records of a cell, or those that ``solve`` gives, which are then stored.

        KeyboardInterrupt if the solve was stopped: half a cell is not stored.
        """
        about = {name: getattr(self, name) for name in self.settings}
        about |= {"study": self.name, "ngepc": records.provenance()["version"]}
        about |= {"row": cell.row, "nodes": cell.nodes}
        path = self.folder / "cells" / f"{self.name}-{cell.name}.npz"
        if self.keeps:
            check_folder(path.parent)
            if (stored := checkpoint.load(path, about)) is not None:
                return [record | stored.arrays for record in stored.record["records"]]
        found = self.solve(cell)
        found = [found] if isinstance(found, dict) else found
        if any(record.get("status") == Status.STOPPED.label for record in found):
            raise KeyboardInterrupt
        if self.keeps:
            arrays = {k: a for r in found for k, a in r.items() if isinstance(a, np.ndarray)}
            checkpoint.save(path, about, {"records": list(map(without_arrays, found))}, arrays)
        return found


def without_arrays(record: dict) -> dict:
    """The numbers and texts of a record."""
    return {key: value for key, value in record.items() if not isinstance(value, np.ndarray)}


def shown(entry: Entry, record: dict) -> object:
    """What a column shows of a record; empty where it has no such number, or None."""
    if not isinstance(entry, str):
        return entry(record)
    try:
        return entry.format(**record)
    except (KeyError, TypeError):
        return ""


def pivoted(records: Sequence[dict], keys: Sequence[str], column: str, entry: Entry) -> list[dict]:
    """A record for each combination of ``keys``; entries stand under their ``column``."""
    found: dict[tuple, dict] = {}
    for record in records:
        about = {key: record[key] for key in keys}
        row = found.setdefault(tuple(about.values()), about)
        row[shown(column, record)] = shown(entry, record)
    return list(found.values())


def first_of(family: Sequence[int], levels: int) -> tuple[int, ...]:
    """The first meshes of a family; ValueError if there are not so many."""
    if not 1 <= levels <= len(family):
        raise ValueError(f"levels={levels}: 1 to {len(family)} are available")
    return tuple(family[:levels])


def chosen(known: Collection[str], rows: Sequence[str] | None) -> tuple[str, ...]:
    """The rows asked for, all of them for None; ValueError for unknown ones."""
    rows = tuple(known if rows is None else rows)
    unknown = [row for row in rows if row not in known]
    if unknown or not rows:
        raise ValueError(f"rows={unknown}: the table has {', '.join(known)}")
    return rows


def ending(record: Mapping, prefix: str = "") -> str:
    """' status' for a run that has not converged, nothing for one that has."""
    status = record[f"{prefix}status"]
    return "" if status == "converged" else f" {status.replace('_', ' ')}"


def steps(record: Mapping, prefix: str = "") -> str:
    """The Newton steps of a run, with its status if it has not converged."""
    return f"{record[f'{prefix}iterations']}{ending(record, prefix)}"


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table to be written into files with this name: Markdown, JSON and CSV.

    ``cells`` has one record for each cell, as in the JSON; the CSV has those values that are short.
    """

    name: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    notes: Sequence[str]
    cells: Sequence[dict]

    def write(self, folder: Path) -> list[Path]:
        """Write NAME.csv, NAME.md and NAME.json into ``folder``; returns their paths."""
        made_with = records.provenance()
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
        rows = [self.head, ["---"] * len(self.head), *self.rows]
        lines = [" | ".join(str(e).replace("|", "\\|") for e in row) for row in rows]
        lines = [f"| {line} |" for line in lines]
        return "\n".join([f"# {self.title}", "", *lines, "", *self.notes, "", *made_with, ""])


def _csv(rows: Sequence[dict]) -> str:
    stream = io.StringIO()
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(stream, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def _flat(cell: dict) -> dict:
    """Lists as text, one level of nested records as 'name_key', deeper ones left out."""
    flat = {}
    for key, value in cell.items():
        if isinstance(value, dict):
            flat |= {f"{key}_{name}": item for name, item in value.items()}
        elif not isinstance(value, list | tuple):
            flat[key] = value
        elif not any(isinstance(item, dict) for item in value):
            flat[key] = " ".join(map(_short, value))
    return flat


def _short(item: object) -> str:
    return f"{item:.6g}" if isinstance(item, float) else "" if item is None else str(item)
