"""What every study writes: CSV and Markdown of its table, JSON with records and provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ngepc.results import records
from ngepc.studies.tables import csv_table, markdown_table, provenance_lines


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
    """

    name: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    notes: Sequence[str]
    cells: Sequence[dict]


def write_table(folder: Path, table: Table, seed: int | None = None) -> list[Path]:
    """Write NAME.csv, NAME.md and NAME.json into ``folder``; returns their paths."""
    notes = [*table.notes, "", *provenance_lines(seed)]
    texts = {
        "csv": csv_table([_flat(cell) for cell in table.cells]),
        "md": markdown_table(
            table.title, _escaped(table.head), [_escaped(row) for row in table.rows], notes
        ),
        "json": records.to_json({**records.provenance(seed), "cells": list(table.cells)}),
    }
    paths = {ending: folder / f"{table.name}.{ending}" for ending in texts}
    for ending, text in texts.items():
        records.write_text(paths[ending], text)
    return list(paths.values())


def _escaped(row: Sequence[object]) -> list[str]:
    """Entries in which a bar does not end the column."""
    return [str(entry).replace("|", "\\|") for entry in row]


def _flat(cell: dict) -> dict:
    """The cell with lists of numbers as text and without nested records."""
    flat = {}
    for key, value in cell.items():
        if isinstance(value, list) and not any(isinstance(item, dict) for item in value):
            flat[key] = " ".join("" if item is None else f"{item:.6g}" for item in value)
        elif not isinstance(value, list | dict):
            flat[key] = value
    return flat
