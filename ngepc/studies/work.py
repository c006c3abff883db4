"""What all studies share: cells kept on disk, so that work survives Ctrl-C, and written tables."""

import csv
import io
import re
import shutil
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from ngepc.results import checkpoint
from ngepc.results.files import check_folder
from ngepc.results.records import provenance, to_json, write_text
from ngepc.results.stored import reading

FORM = 2
"""Grows with what studies say in their records: cells of another one are refused."""


@dataclass(eq=False)
class Work(ABC):
    """A study: ``run`` returns the records of all cells, ``write`` writes the files.

    A cell is a dictionary of what makes it, such as an example and the nodes of its mesh;
    ``solve(**cell)`` gives further numbers, both together are a record.  Each cell is solved once
    and, if the study ``keeps`` them, stored in ``folder``/cells; ``progress`` gets a line of text
    after it.  Options of a study are further fields, ``ngepc.cli.commands.STUDIES`` lists them.

    Files are called ``name``.  ``columns`` of the table are 'head = format', separated by ' | ',
    with fields of the record, {nodes}, of a run in it, {direct[steps]}, or of what ``spoken`` adds;
    ``across`` are formats of the head and entry of further ones: records that agree in ``columns``
    are one row then, with an entry for each head.  {study.gamma:g} in the note is an option.
    """

    folder: Path
    progress: Callable[[str], None] = field(default=lambda line: None, kw_only=True)

    name: ClassVar[str]
    title: ClassVar[str] = ""
    columns: ClassVar[str] = ""
    note: ClassVar[str] = ""
    across: ClassVar[tuple[str, str] | None] = None
    keeps: ClassVar[bool] = True

    @abstractmethod
    def cells(self) -> Sequence[dict]:
        """The cells, in the order in which they are solved."""

    @abstractmethod
    def solve(self, **cell: object) -> dict | list[dict]:
        """What a cell gives: a record, or several."""

    def line(self, record: dict) -> str:
        """What progress says about a record: the first of its numbers and texts."""
        flat = _flat(record).items()
        return ", ".join(
            [f"{k} {_short(v)}" for k, v in flat if v not in ("", None)][:8]
        )

    def notes(self, records: Sequence[dict]) -> list[str]:
        """The lines below the table."""
        return [self.note.format(study=self)]

    def table_rows(self, records: Sequence[dict]) -> Sequence[dict]:
        """The rows of the table: the records, or groups or parts of them."""
        return records

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Write pictures of the records; returns their paths."""
        return []

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Whether every status in the records, also in nested ones, is 'converged'."""
        nested = [
            inner for r in records for inner in r.values() if isinstance(inner, dict)
        ]
        return all(
            r.get("status", "converged") == "converged" for r in (*records, *nested)
        )

    def run(self) -> list[dict]:
        """Do the work; returns the records of all cells."""
        cells = self.cells()
        found = []
        for number, cell in enumerate(cells, 1):
            found += self.kept(cell)
            self.progress(f"[{number}/{len(cells)}] {self.line(found[-1])}")
        return found

    def path_of(self, cell: Mapping) -> Path:
        """The file that keeps a cell."""
        named = "-".join(str(value) for value in (self.name, *cell.values()))
        return self.folder / "cells" / (re.sub(r"[^\w.+-]", "_", named) + ".npz")

    def kept(self, cell: Mapping) -> list[dict]:
        """The stored records of a cell, or those that ``solve`` gives, which are then stored."""
        about = {
            "study": self.name,
            "form": FORM,
            "ngepc": provenance()["version"],
            **cell,
        }
        path = self.path_of(cell)
        if self.keeps:
            check_folder(path.parent)
            if (stored := checkpoint.load(path, about)) is not None:
                with reading(path):
                    return _records(stored.record, cell)
        found = self.solve(**cell)
        records = [
            {**cell, **r} for r in ([found] if isinstance(found, dict) else found)
        ]
        if self.keeps:
            checkpoint.save(path, about, {"records": records}, {})
        return records

    def table(self, records: Sequence[dict]) -> list[list[str]]:
        """The headings of the table, then its entries, row by row."""
        columns = [
            c.partition("=") for c in " ".join(self.columns.split()).split(" | ")
        ]
        heads, entries = ([c[k].strip() for c in columns] for k in (0, 2))
        shown_records = [with_endings(record) for record in self.table_rows(records)]
        rows = [[shown(entry, record) for entry in entries] for record in shown_records]
        if self.across is None:
            return [heads, *rows]
        merged: dict[tuple, dict] = {}
        for row, record in zip(rows, shown_records, strict=True):
            head, entry = (shown(text, record) for text in self.across)
            merged.setdefault(tuple(row), {})[head] = entry
        over = list(dict.fromkeys(head for found in merged.values() for head in found))
        rows = [
            [*row, *(found.get(h, "") for h in over)] for row, found in merged.items()
        ]
        return [[*heads, *over], *rows]

    def write(self, records: Sequence[dict]) -> list[Path]:
        """Write what ``run`` has returned as NAME.csv, .md and .json, and pictures; the paths."""
        heads, *rows = self.table(records)
        escaped = [
            [entry.replace("|", "\\|") for entry in row] for row in (heads, *rows)
        ]
        escaped.insert(1, ["---"] * len(heads))
        made_with = {**provenance(), "commit": commit()}
        lines = [
            f"# {self.title}",
            "",
            *(f"| {' | '.join(row)} |" for row in escaped),
            "",
        ]
        lines += [
            *self.notes(records),
            "",
            *(f"- {k}: {v}" for k, v in made_with.items()),
            "",
        ]
        flat = [_flat(record) for record in records]
        stream = io.StringIO()
        names = list(dict.fromkeys(name for row in flat for name in row))
        writer = csv.DictWriter(stream, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows(flat)
        data = to_json({**made_with, "cells": list(records)})
        texts = {"csv": stream.getvalue(), "md": "\n".join(lines), "json": data}
        for kind, text in texts.items():
            write_text(self.folder / f"{self.name}.{kind}", text)
        return [
            *(self.folder / f"{self.name}.{kind}" for kind in texts),
            *self.draw(records),
        ]


@dataclass(eq=False)
class OverMeshes(Work):
    """A study on the first ``levels`` meshes of some families."""

    levels: int = 3


PACKAGE = Path(__file__).parents[1]


def commit() -> str | None:
    """The commit of branch main that this package comes from, with + where code was changed since.

    None outside of a checkout with its history.  A branch that is not on main yet names the
    commit that it started from, and +: its own commits may still be replaced.
    """
    if _git("ls-files", "--error-unmatch", "__init__.py") is None:
        return None
    started = _git("merge-base", "HEAD", "main") or _git("rev-parse", "HEAD")
    if started is None:
        return None
    unchanged = _git("diff", "--quiet", started, "--", ".") is not None
    return started[:12] + ("" if unchanged else "+")


def _git(*words: str) -> str | None:
    """What git says of the package's folder; None where it fails or is missing."""
    if (program := shutil.which("git")) is None:
        return None
    done = subprocess.run(
        [program, "-C", str(PACKAGE), *words], capture_output=True, text=True
    )
    return done.stdout.strip() if done.returncode == 0 else None


def _records(kept: Mapping, cell: Mapping) -> list[dict]:
    """The records of a cell; TypeError if they are none."""
    found = kept["records"]
    theirs = found and all(
        isinstance(r, dict) and all(r.get(k) == v for k, v in cell.items())
        for r in found
    )
    if not isinstance(found, list) or not theirs:
        raise TypeError(f"no records of the cell {dict(cell)}")
    return found


def with_endings(record: Mapping) -> dict:
    """A record with texts for each run in it: ``steps``, and ``ending``, ' status' if it failed."""
    texts = {
        key: with_endings(v) if isinstance(v, dict) else v for key, v in record.items()
    }
    status = texts.get("status", "converged")
    texts["ending"] = "" if status == "converged" else f" {status.replace('_', ' ')}"
    if "iterations" in texts:
        texts["steps"] = f"{texts['iterations']}{texts['ending']}"
    return texts


def shown(entry: str, record: Mapping) -> str:
    """What a format says about a record; nothing where it has no such number, or None."""
    try:
        return entry.format(**record)
    except (KeyError, TypeError):
        return ""


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


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """The a in y ~ x^a, by least squares."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


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
    return (
        f"{item:.6g}" if isinstance(item, float) else "" if item is None else str(item)
    )
