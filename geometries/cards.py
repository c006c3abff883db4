"""The cards of an Abaqus deck: keywords with their parameters, and the rows of data below them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple


class Card(NamedTuple):
    """A keyword with its parameters, both in capitals, and the rows of data below it."""

    keyword: str
    parameters: dict[str, str]
    rows: list[list[str]]


def cards_of(path: Path, including: tuple[Path, ...] = ()) -> Iterator[Card]:
    """The cards of a deck and of the files that it includes.

    ``including`` are the files on the way from the deck to this one.
    """
    if path in including:
        raise ValueError(f"{path} includes itself")
    for line, rows in _statements(_lines(path)):
        keyword, parameters = _read(line)
        source = parameters.get("INPUT")
        if source and keyword == "INCLUDE":
            yield from cards_of(_included(path, source), (*including, path))
            continue
        if source and keyword in ("NODE", "ELEMENT"):
            text = _included(path, source).read_text(errors="replace")
            read = [row for row in text.splitlines() if row.strip() and row[0] != "*"]
            rows = [*map(_entries, read), *rows]
        yield Card(keyword, parameters, rows)


def _lines(path: Path) -> list[str]:
    """The lines of a deck without comments and empty ones."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    lines = [line.strip() for line in lines if line.strip()]
    return [line for line in lines if not line.startswith("**")]


def _statements(lines: list[str]) -> Iterator[tuple[str, list[list[str]]]]:
    """Each line of a keyword with those that continue it, and the rows of data below it.

    Rows above the first keyword are left out.
    """
    begins = [number for number, line in enumerate(lines) if line.startswith("*")]
    for begin, end in zip(begins, [*begins[1:], len(lines)], strict=True):
        keyword = lines[begin]
        first = begin + 1
        while keyword.endswith(",") and first < end and not _is_data(lines[first]):
            keyword += lines[first]
            first += 1
        yield keyword, [_entries(row) for row in lines[first:end]]


def _entries(row: str) -> list[str]:
    """The entries of a row of data."""
    return [entry.strip() for entry in row.split(",")]


def _included(path: Path, source: str) -> Path:
    """The file that a deck names with INPUT=, beside the deck unless its path is absolute."""
    found = path.parent / source.strip("\"'")
    if not found.is_file():
        raise FileNotFoundError(f"{path} needs {found}: there is no such file")
    return found


def _is_data(line: str) -> bool:
    """Whether a line below a keyword that ends in a comma is data, not more parameters."""
    return "=" not in line and line.upper().rstrip(" ,") != "GENERATE"


def _read(line: str) -> tuple[str, dict[str, str]]:
    """The keyword and the parameters of a line."""
    keyword, *rest = line[1:].split(",")
    parameters = {}
    for part in rest:
        name, _, value = part.partition("=")
        parameters[name.strip().upper()] = value.strip()
    return " ".join(keyword.upper().split()), parameters
