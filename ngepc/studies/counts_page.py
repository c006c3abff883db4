"""Figures and the HTML page of a count table: the counts, the curves, the last of its solutions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ngepc.pictures.curves import plot_counts, plot_history
from ngepc.pictures.report import solution_sections, standard_figures, write_report
from ngepc.pictures.style import save_figure
from ngepc.results import records
from ngepc.studies.examples import THRESHOLDS
from ngepc.studies.work import Cell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ngepc.studies.counts import CountTable

ALWAYS_ONE_STEP = 1e2
"""Up to this gamma Example (a) is elastic and takes one step on every mesh."""


def last_cell(study: CountTable) -> Cell:
    """The default method, or else the largest gamma, on the finest mesh."""
    row = "default" if "default" in study.rows else max(study.rows, key=_size)
    return Cell(row, study.nodes[-1])


def counts_figure(study: CountTable, table: list[dict]) -> Figure:
    """Newton steps over nodes, one curve for each row, with the paper's dashed.

    Rows that count one step everywhere are left out if there are others.
    """
    rows = [row for row in study.rows if _size(row) > ALWAYS_ONE_STEP] or list(study.rows)
    counts = {
        _label(row): {r["nodes"]: r["iterations"] for r in table if r["row"] == row} for row in rows
    }
    paper = {
        _label(row): {n: study.paper_value(Cell(row, n)) for n in study.nodes}
        for row in rows
        if row in study.paper
    }
    return plot_counts(counts, paper)


def write_pictures(study: CountTable, table: list[dict]) -> list[Path]:
    """Write the figures of the table and of its last solution, and the page; returns the paths."""
    cell = last_cell(study)
    figures = {
        f"{study.name}_steps": counts_figure(study, table),
        f"{study.name}_residuals": _residuals(study, cell.row),
        **{
            f"{study.body}_{name}": figure
            for name, figure in standard_figures(study.result(cell), THRESHOLDS[study.body]).items()
        },
    }
    written = [
        save_figure(figure, study.folder / f"{name}.png") for name, figure in figures.items()
    ]
    return [*written, write_page(study, table, study.folder / f"{study.body}.html")]


def write_page(study: CountTable, table: list[dict], path: Path) -> Path:
    """Write the HTML page; returns its path."""
    cell = last_cell(study)
    result = study.result(cell)
    head = ["gamma", *(f"{n} nodes" for n in study.nodes)]
    counts = [dict(zip(head, row, strict=True)) for row in study.rows_of(table)]
    return write_report(
        path,
        f"Mesh independence: {study.name} of Hintermüller and Rösel",
        ("The problem", [result.problem]),
        (
            "Newton steps",
            [
                "Ours, and in parentheses the paper's. Rows named `default` are the default "
                "method, which solves the problem itself instead of a regularised one.",
                counts,
                counts_figure(study, table),
                _residuals(study, cell.row),
            ],
        ),
        *solution_sections(
            result,
            f"The solution: {_label(cell.row)}, {cell.nodes} nodes",
            THRESHOLDS[study.body],
        ),
        footer=", ".join(f"{key} {value}" for key, value in records.provenance().items()),
    )


def _residuals(study: CountTable, row: str) -> Figure:
    histories = {f"{n} nodes": study.result(Cell(row, n)).history for n in study.nodes}
    return plot_history(histories, tolerance=study.options.tolerance)


def _label(row: str) -> str:
    method = row.rstrip("*")
    name = f"{method} method" if method in ("default", "primal") else f"gamma = {method}"
    return f"{name}, nested" if row.endswith("*") else name


def _size(row: str) -> float:
    """Gamma of a row, infinity for the methods without one."""
    method = row.rstrip("*")
    return float("inf") if method in ("default", "primal") else float(method)
