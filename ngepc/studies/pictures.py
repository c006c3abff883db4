"""Figures and the HTML page of the mesh-independence study."""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.figure import Figure

from ngepc.dual.result import DualResult
from ngepc.pictures import (
    plot_contact_pressure,
    plot_counts,
    plot_history,
    plot_plastic_zone,
    plot_yield_function,
)
from ngepc.pictures.figures import THRESHOLDS, save, write_figures
from ngepc.pictures.report import Report
from ngepc.pictures.views import show
from ngepc.results import records
from ngepc.studies.count_table import cell_gamma
from ngepc.studies.table1 import Table1
from ngepc.studies.tables import Cell


def finest(study: Table1) -> Cell:
    """The cell with the largest gamma on the finest mesh."""
    row = max(study.rows, key=lambda label: cell_gamma(Cell(label, 0)))
    return Cell(row, study.nodes[-1])


def counts_figure(study: Table1, table: list[dict]) -> Figure:
    """Newton steps over nodes, rows from gamma = 1e3 on, with the paper's dashed."""
    rows = [row for row in study.rows if float(row.rstrip("*")) >= 1e3]
    ours = {
        f"gamma = {row}": {r["nodes"]: r["iterations"] for r in table if r["row"] == row}
        for row in rows
    }
    paper = {
        f"gamma = {row}": {n: study.paper_value(Cell(row, n)) for n in study.nodes} for row in rows
    }
    return plot_counts(ours, paper)


def table1_pictures(study: Table1, table: list[dict]) -> list[Path]:
    """Write the figures and ``lshape.html``; returns their paths."""
    cell = finest(study)
    result = study.result(cell)
    histories = {f"{n} nodes": study.result(Cell(cell.row, n)).history for n in study.nodes}
    written = write_figures("lshape", result, study.folder)
    written.append(save(counts_figure(study, table), study.folder / "table1_steps.png"))
    written.append(
        save(
            plot_history(histories, tolerance=study.options.tolerance),
            study.folder / "table1_residuals.png",
        )
    )
    return [*written, _page(study, table, cell, result, study.folder / "lshape.html")]


def folder_report(folder: Path, path: Path) -> Path:
    """The report of a finished table1 folder, from its table1.json and its cells.

    Raises
    ------
    ValueError
        If the folder has no finished study.
    """
    source = folder / "table1.json"
    if not source.is_file():
        raise ValueError(f"{folder} holds no table1.json: run ngepc study table1 --out {folder}")
    table = json.loads(source.read_text(encoding="utf-8"))["cells"]
    nodes = dict.fromkeys(record["nodes"] for record in table)
    rows = dict.fromkeys(record["row"] for record in table)
    study = Table1(folder, tuple(nodes), tuple(rows))
    cell = finest(study)
    return _page(study, table, cell, study.result(cell), path)


def _page(study: Table1, table: list[dict], cell: Cell, result: DualResult, path: Path) -> Path:
    report = Report(
        "Example (a): the L-shape and mesh independence",
        "Table 1 of Hintermüller and Rösel, mesh by mesh, and the last of its solutions.",
    )
    report.add_problem(result.problem)
    report.add_section("Newton steps")
    rows = [
        {
            "gamma": row,
            **{
                f"{n} nodes": f"{_count(table, row, n)} ({study.paper_value(Cell(row, n))})"
                for n in study.nodes
            },
        }
        for row in study.rows
    ]
    report.add_table(rows, caption="Ours, and in parentheses the paper's Table 1.")
    histories = {f"{n} nodes": study.result(Cell(cell.row, n)).history for n in study.nodes}
    report.add_figure(plot_history(histories), f"Residuals at gamma = {cell.row}.")
    report.add_section(f"The solution at gamma = {cell.row} on {cell.nodes} nodes")
    report.add_text(
        "As long as `gamma` is moderate the Tichonov term leaves the body too soft, and it enters "
        "the ceiling, the red line; only as `gamma` grows does it approach the problem itself. "
        "The default method, without gamma, is right at once."
    )
    report.add_view(show(result), "Deformed body with |p|_F; drag to move, scroll to zoom.")
    report.add_figure(plot_yield_function(result), "Yield function: zero where it yields")
    report.add_figure(plot_plastic_zone(result, THRESHOLDS["lshape"]), "Plastic zone")
    report.add_figure(plot_contact_pressure(result), "Contact pressure")
    made_with = ", ".join(f"{key} {value}" for key, value in records.provenance().items())
    return report.write(path, footer=made_with)


def _count(table: list[dict], row: str, nodes: int) -> int:
    return next(r["iterations"] for r in table if (r["row"], r["nodes"]) == (row, nodes))
