"""``ngepc solve``: one regularised problem on one mesh."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from ngepc.cli.arguments import (
    add_body,
    build_problem,
    count,
    file_name,
    location,
    positive,
    report,
    say,
)

if TYPE_CHECKING:
    from ngepc.dual.result import DualResult
    from ngepc.primal.result import PrimalResult

REPORTED = (
    "status",
    "iterations",
    "residual_norm",
    "dual_energy",
    "primal_energy",
    "contact_force",
)
"""Entries of the record that are printed."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_body(parser)
    parser.add_argument(
        "--method",
        choices=("dual", "primal"),
        default="dual",
        help="Algorithm 7.1, or the primal reference solver without regularisation",
    )
    parser.add_argument(
        "--gamma", type=positive, help="the paper's regularisation; without it there is none"
    )
    parser.add_argument(
        "--start",
        choices=("zero", "coarse"),
        default="zero",
        help="v = 0, or the prolongated solution of the coarse mesh of the paper",
    )
    parser.add_argument("--tolerance", type=positive, default=1e-10, help="default 1e-10")
    parser.add_argument("--max-iterations", type=count, default=300, help="default 300")
    parser.add_argument(
        "--quadrature-points", type=count, default=400, help="per triangle, default 400"
    )
    parser.add_argument(
        "--json", metavar="FILE", type=file_name, help="write the result there, - for stdout"
    )
    parser.add_argument(
        "--save", metavar="FILE", type=location, help="keep the run for ngepc report"
    )
    parser.add_argument("--figures", metavar="DIR", type=location, help="write PNG figures there")


def run(args: argparse.Namespace) -> int:
    """Solve, report, write."""
    from ngepc.results import records
    from ngepc.results.files import check_folder

    if args.json not in (None, "-"):
        records.check_writable(Path(args.json))
    if args.save is not None:
        records.check_writable(args.save)
    if args.figures is not None:
        check_folder(args.figures)
    begin = time.perf_counter()
    result = (_primal if args.method == "primal" else _dual)(args)
    record = {
        **records.solve_record(args.problem, result, time.perf_counter() - begin),
        "method": args.method,
        "gamma": args.gamma,
        "start": args.start,
        **records.provenance(),
    }
    report(record, REPORTED, args.json)
    if args.save is not None:
        from ngepc.results.runs import save_run

        save_run(args.save, vars(args), record, result)
        say(f"wrote {args.save}")
    if args.figures is not None:
        from ngepc.pictures.figures import write_figures

        for path in write_figures(args.problem, result, args.figures):
            say(f"wrote {path}")
    return 0 if result.status.label == "converged" else 1


def _dual(args: argparse.Namespace) -> DualResult:
    from ngepc.dual.newton import NewtonOptions, semismooth_newton
    from ngepc.dual.starts import coarse_problem, coarse_start

    options = NewtonOptions(
        tolerance=args.tolerance,
        max_iterations=args.max_iterations,
        quadrature_points=args.quadrature_points,
    )
    problem, start = build_problem(args.problem, args.nodes, args.maxh), None
    if args.start == "coarse" and args.gamma is None:
        start = semismooth_newton(coarse_problem(args.problem), options=options).or_interrupted()
    elif args.start == "coarse":
        start = coarse_start(args.problem, args.gamma, options)
    return semismooth_newton(problem, args.gamma, start, options)


def _primal(args: argparse.Namespace) -> PrimalResult:
    from ngepc.dual.starts import coarse_problem
    from ngepc.primal.solver import primal_newton

    if args.gamma is not None:
        raise ValueError(f"--gamma {args.gamma:g}: the primal method has no regularisation")
    problem = build_problem(args.problem, args.nodes, args.maxh)
    start = None
    if args.start == "coarse":
        start = primal_newton(coarse_problem(args.problem)).or_interrupted()
    return primal_newton(problem, start)
