"""The commands that draw, and the figures of the others: loaded when one is asked for."""

import argparse
import sys
from pathlib import Path

from ngepc.cli.output import check_targets, name_written
from ngepc.cli.solve import load_run
from ngepc.goals.refinement import BoundedResult
from ngepc.limit.outcome import Bracketed
from ngepc.pictures import live
from ngepc.pictures.collapse import plot_bracket, plot_mechanism, plot_residual_stress
from ngepc.pictures.intervals import plot_interval
from ngepc.pictures.report import standard_figures, write_report
from ngepc.pictures.style import save_figure
from ngepc.pictures.views import EXTRA, show, viewer_installed
from ngepc.results import records
from ngepc.results.result import Result
from ngepc.studies.examples import THRESHOLDS, TITLES, example, solved_by
from ngepc.studies.large import indented_block
from ngepc.studies.shakedown_problems import SHAKEDOWNS

NUMBERS = {
    "status": "status",
    "iterations": "Newton steps",
    "residual_norm": "residual",
    "primal_energy": "energy J",
    "dual_energy": "dual energy J*",
    "error_bound": "bound of the relative energy error",
    "guaranteed": "the bound is guaranteed",
    "contact_force": "contact force",
    "displacement_l2": "displacement, L2 norm",
    "plastic_strain_l2": "plastic strain, L2 norm",
    "wall_time_s": "time (s)",
}
"""Fields of a record -> words for them in a report."""
PROVENANCE = ("command", "version", "ngsolve", "numpy", "python")


def of_solution(
    args: argparse.Namespace, result: Result, run: BoundedResult | None
) -> list[Path]:
    """The files of the figures of ``ngepc solve``; ``run`` is that of ``--error`` or ``--goal``."""
    figures = standard_figures(result, THRESHOLDS[args.problem])
    if run is not None and run.goal is not None:
        figures["interval"] = plot_interval(run)
    return saved_figures(figures, args.figures, args.problem)


def of_limit(args: argparse.Namespace, found: Bracketed) -> list[Path]:
    """The files of the figures of ``ngepc limit``."""
    figures = {"bracket": plot_bracket(found)}
    if found.last.mechanism is not None:
        figures["mechanism"] = plot_mechanism(found)
    if args.body in SHAKEDOWNS and found.last.stress is not None:
        figures["residual"] = plot_residual_stress(found)
    return saved_figures(figures, args.figures, args.body)


def saved_figures(figures: dict, folder: Path, start: str) -> list[Path]:
    """Save figures by their names, which follow the ``start`` of the file names."""
    return [
        save_figure(figure, folder / f"{start}_{name}.png")
        for name, figure in figures.items()
    ]


def report(args: argparse.Namespace) -> int:
    """``ngepc report RUN``: one HTML file about a saved run.

    The default and the primal method solve again, in a dozen steps, also what was not finished.
    """
    check_targets(args.out)
    record, problem, result = load_run(args.run_file)
    if record["method"] != "paper":
        result = solved_by(record["method"], problem)
        record |= records.solve_record(record["problem"], result, record["wall_time_s"])
    view = (
        show(result) if viewer_installed() else f"For a view to turn and zoom: {EXTRA}"
    )
    *figures, residuals = standard_figures(
        result, THRESHOLDS[record["problem"]]
    ).values()
    numbers = [
        {"quantity": words, "value": _spelt(record[key])}
        for key, words in NUMBERS.items()
    ]
    page = write_report(
        args.out or args.run_file.with_suffix(".html"),
        f"{record['problem']}: {record['method']} method on {record['nodes']} nodes",
        ("The problem", [problem]),
        ("Numbers", [numbers, *filter(None, [record["message"]])]),
        ("The deformed body", [view, *figures]),
        ("Convergence of the solver", [residuals]),
        footer=", ".join(f"{key} {record[key]}" for key in PROVENANCE),
    )
    name_written([page])
    return 0


def _spelt(value: object) -> object:
    """A number, or a text; yes or no in place of a flag."""
    return ("no", "yes")[value] if isinstance(value, bool) else value


LAB_TITLES = TITLES | {"sphere": "Sphere pressed into a block"}
LABS = {
    "lshape": {
        "load": (0.0, 12.0),
        "gap": (0.0, 0.2),
        "yield_stress": (0.5, 3.0),
        "hardening": (5.0, 500.0),
    },
    "wrench": {"load": (0.0, 8e-3), "gap": (0.0, 2.0), "yield_stress": (0.1, 0.4)},
    "sphere": {"obstacle": (-0.02, 0.03), "yield_stress": (2.0, 20.0)},
}
"""Example -> the sliders of its laboratory."""


def open_lab(args: argparse.Namespace) -> int:
    """``ngepc lab``: serve the laboratory of an example on this machine until Ctrl-C."""
    name = args.example
    problem = indented_block(2) if name == "sphere" else example(name)
    laboratory = live.lab(problem, title=LAB_TITLES[name], **LABS[name])
    server = laboratory.serve(args.port or 0, browser=not args.no_browser)
    sys.stdout.write(f"the laboratory is at {server.address} (Ctrl-C ends it)\n")
    sys.stdout.flush()
    try:
        server.run()
    except KeyboardInterrupt:
        sys.stdout.write("\n")
    return 0
