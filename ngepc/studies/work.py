"""The base class of studies, which stores cells, continues runs and writes tables."""

import csv
import hashlib
import inspect
import io
import re
import shutil
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ngepc.results import checkpoint
from ngepc.results.files import check_folder
from ngepc.results.records import provenance, to_json, write_text
from ngepc.results.stored import reading

FORM = 2
"""Version of the stored records; cells with another version are not used."""


@dataclass(eq=False)
class Work(ABC):
    """A study: ``run`` returns the records of all cells, ``write`` writes the files.

    A cell is a dictionary of parameters, such as an example and the nodes of its mesh;
    ``solve(**cell)`` returns numbers; a record is both together.  Each cell is solved once and, if
    the study ``keeps`` cells, stored in ``folder``/cells; cells of other code are solved again.
    ``progress`` is called with a line of
    text after each cell.  Options of a study are further fields of the class;
    ``ngepc.cli.commands.STUDIES`` lists them.

    ``name`` is the name of the files.  ``columns`` describes the table: 'head = format', separated
    by ' | '.  A format contains fields of the record, {nodes}, fields of a run in it,
    {direct[steps]}, or the texts of ``with_endings``.  ``across`` are two formats, of the head and
    the entry of further columns: records that agree in ``columns`` share a row, with one entry for
    each head.  {study.gamma:g} in ``note`` is an option of the study.
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
    def solve(self, *args: Any, **cell: Any) -> dict | list[dict]:
        """Solve a cell; returns the numbers of one record, or a list of several.

        A study names the parameters of its cells here.
        """

    def line(self, record: dict) -> str:
        """The line of progress of a record: its first numbers and texts."""
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
        """Solve all cells; returns their records."""
        _ = self.code, self.started_on  # those of the start
        cells = self.cells()
        found = []
        for number, cell in enumerate(cells, 1):
            found += self.kept(cell)
            self.progress(f"[{number}/{len(cells)}] {self.line(found[-1])}")
        return found

    def path_of(self, cell: Mapping) -> Path:
        """The file in which a cell is stored."""
        named = "-".join(str(value) for value in (self.name, *cell.values()))
        return self.folder / "cells" / (re.sub(r"[^\w.+-]", "_", named) + ".npz")

    @cached_property
    def started_on(self) -> str | None:
        """``commit`` when the cells began to be solved."""
        return commit()

    @cached_property
    def code(self) -> str:
        """``code_today`` when the cells began to be solved."""
        return self.code_today()

    def made_on(self) -> str | None:
        """The commit at the start of the run, with + also if code was changed since then."""
        if self.started_on is None or self.code_today() == self.code:
            return self.started_on
        self.progress(f"code was changed during the run: {self.started_on} gets a +")
        return self.started_on.rstrip("+") + "+"

    def code_today(self) -> str:
        """A digest of the package, and of the folder with the file of the study."""
        files = set(PACKAGE.rglob("*.py"))
        module = inspect.getmodule(type(self))
        if file := getattr(module, "__file__", None):
            files.update(Path(file).parent.glob("*.py"))
        digest = hashlib.sha256()
        for path in sorted(files):
            digest.update(path.read_bytes())
        return digest.hexdigest()

    def kept(self, cell: Mapping) -> list[dict]:
        """The stored records of a cell; if today's code has stored none, it is solved and stored.

        ValueError if the file is damaged or belongs to other work.
        """
        about = {
            "study": self.name,
            "form": FORM,
            "ngepc": provenance()["version"],
            "code": self.code,
            **cell,
        }
        path = self.path_of(cell)
        if self.keeps:
            check_folder(path.parent)
            if (stored := stored_by(about, path)) is not None:
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
        columns = " ".join(self.columns.split()).split(" | ")
        pairs = [column.partition("=") for column in columns]
        heads = [head.strip() for head, _, _ in pairs]
        entries = [entry.strip() for _, _, entry in pairs]
        shown_records = [with_endings(record) for record in self.table_rows(records)]
        rows = [[shown(entry, record) for entry in entries] for record in shown_records]
        if self.across is None:
            return [heads, *rows]
        merged: dict[tuple, dict] = {}
        for row, record in zip(rows, shown_records, strict=True):
            head, entry = (shown(text, record) for text in self.across)
            merged.setdefault(tuple(row), {})[head] = entry
        more_heads = dict.fromkeys(h for found in merged.values() for h in found)
        wide_rows = []
        for row, found in merged.items():
            more = [found.get(head, "") for head in more_heads]
            wide_rows.append([*row, *more])
        return [[*heads, *more_heads], *wide_rows]

    def write(self, records: Sequence[dict]) -> list[Path]:
        """Write what ``run`` has returned as NAME.csv, .md and .json, and pictures; the paths."""
        made_with = {**provenance(), "commit": self.made_on()}
        lines = [f"# {self.title}", "", *in_markdown(self.table(records)), ""]
        pictures = self.draw(records)
        lines += [*self.notes(records), ""]
        for path in pictures:
            lines += [f"![{self.title}: {path.stem}]({path.name})", ""]
        lines += ["Made with:", "", *(f"- {k}: {v}" for k, v in made_with.items()), ""]
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
        return [*(self.folder / f"{self.name}.{kind}" for kind in texts), *pictures]


@dataclass(eq=False)
class OverMeshes(Work):
    """A study on the first ``levels`` meshes of some families."""

    levels: int = 3


PACKAGE = Path(__file__).parents[1]


def stored_by(about: Mapping, path: Path) -> checkpoint.Checkpoint | None:
    """The checkpoint in a file; None if there is none, or if it is one of other code."""
    try:
        return checkpoint.load(path, about)
    except checkpoint.OtherWork as error:
        if error.different == ["code"]:
            return None
        raise


def commit() -> str | None:
    """The commit of branch main that this package comes from, with + if code was changed since.

    None outside of a checkout with its history.  On another branch it is the commit of main that
    the branch started from, with +, as commits of the branch may still be replaced.
    """
    if _git("ls-files", "--error-unmatch", "__init__.py") is None:
        return None
    started = _git("merge-base", "HEAD", "main") or _git("rev-parse", "HEAD")
    if started is None:
        return None
    unchanged = _git("diff", "--quiet", started, "--", ".") is not None
    return started[:12] + ("" if unchanged else "+")


def _git(*words: str) -> str | None:
    """The output of git in the package's folder; None if git fails or is missing."""
    if (program := shutil.which("git")) is None:
        return None
    done = subprocess.run(
        [program, "-C", str(PACKAGE), *words], capture_output=True, text=True
    )
    return done.stdout.strip() if done.returncode == 0 else None


def _records(kept: Mapping, cell: Mapping) -> list[dict]:
    """The stored records of a cell; TypeError if they do not belong to it."""
    found = kept["records"]
    if not isinstance(found, list) or not found:
        raise TypeError(f"no records of the cell {dict(cell)}")
    for record in found:
        if not isinstance(record, dict) or not cell.items() <= record.items():
            raise TypeError(f"no records of the cell {dict(cell)}")
    return found


def in_markdown(table: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown, headings first; bars in entries end no cell."""
    heads, *rows = [[entry.replace("|", "\\|") for entry in row] for row in table]
    rule = ["---"] * len(heads)
    return [f"| {' | '.join(row)} |" for row in (heads, rule, *rows)]


def with_endings(record: Mapping) -> dict:
    """A record with texts for each run in it.

    ``steps`` are the Newton steps, ``ending`` is ' status' if the run failed, and ``in_paper`` the
    paper's number in parentheses.
    """
    texts = {
        key: with_endings(v) if isinstance(v, dict) else v for key, v in record.items()
    }
    status = texts.get("status", "converged")
    texts["ending"] = "" if status == "converged" else f" {status.replace('_', ' ')}"
    texts["in_paper"] = f" ({texts['paper']})" if texts.get("paper") else ""
    if "iterations" in texts:
        texts["steps"] = f"{texts['iterations']}{texts['ending']}"
    return texts


def shown(entry: str, record: Mapping) -> str:
    """A record in a format; empty if the record has no such number, or None."""
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
    """The given rows, all for None; ValueError for unknown rows."""
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
