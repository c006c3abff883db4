"""``ngepc report RUN``: one HTML file about a saved run."""

import argparse

from ngepc.cli.output import name_written
from ngepc.pictures.report import solution_sections, write_report
from ngepc.studies.examples import THRESHOLDS
from ngepc.studies.runs import load_run

NUMBERS = ("status", "iterations", "residual_norm", "dual_energy", "primal_energy",
           "contact_force", "displacement_l2", "plastic_strain_l2", "wall_time_s")  # fmt: skip
PROVENANCE = ("command", "version", "ngsolve", "numpy", "python")


def run(args: argparse.Namespace) -> int:
    """Write the report and name it."""
    record, result = load_run(args.run_file)
    numbers = [{"what": key.replace("_", " "), "value": record[key]} for key in NUMBERS]
    path = write_report(
        args.out or args.run_file.with_suffix(".html"),
        f"{record['problem']}: {record['method']} method on {record['nodes']} nodes",
        ("The problem", [result.problem]),
        ("Numbers", [numbers, *filter(None, [record["message"]])]),
        *solution_sections(result, "The deformed body", THRESHOLDS[record["problem"]]),
        footer=", ".join(f"{key} {record[key]}" for key in PROVENANCE),
    )
    name_written([path])
    return 0
