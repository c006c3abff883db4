"""The report of one result: problem, numbers, figures and a view to turn."""

from __future__ import annotations

from pathlib import Path

from ngepc.pictures import (
    plot_contact_pressure,
    plot_field,
    plot_history,
    plot_plastic_zone,
    plot_yield_function,
)
from ngepc.pictures.figures import THRESHOLDS
from ngepc.pictures.report import Report
from ngepc.pictures.views import show

NUMBERS = ("status", "iterations", "residual_norm", "dual_energy", "primal_energy",
           "contact_force", "displacement_l2", "plastic_strain_l2", "wall_time_s")  # fmt: skip

PROVENANCE = ("command", "version", "ngsolve", "numpy", "python")


def run_report(record: dict, result: object, path: Path) -> Path:
    """Write the HTML file; returns its path.

    Parameters
    ----------
    record
        What ``ngepc solve --json`` prints.
    result
        The result with its fields.
    path
        The file to write.
    """
    name = record["problem"]
    report = Report(f"{name}: {record['method']} method on {record['nodes']} nodes")
    report.add_problem(result.problem)
    report.add_section("Numbers")
    report.add_table([{"what": key.replace("_", " "), "value": record[key]} for key in NUMBERS])
    if record["message"]:
        report.add_text(record["message"])
    report.add_section("The deformed body")
    report.add_view(show(result), "Plastic strain |p|_F; drag to move, scroll to zoom.")
    report.add_figure(plot_field(result), "Plastic strain")
    report.add_figure(plot_yield_function(result), "Yield function: zero where it yields")
    report.add_figure(plot_plastic_zone(result, THRESHOLDS[name]), "Plastic zone")
    if result.problem.contact_names:
        report.add_figure(plot_contact_pressure(result), "Contact pressure")
    report.add_section("How the solver got there")
    report.add_figure(plot_history(result.history), "Residuals and step lengths")
    footer = ", ".join(f"{key} {record[key]}" for key in PROVENANCE if key in record)
    return report.write(path, footer=footer)
