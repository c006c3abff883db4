"""``ngepc solve``: one regularised problem on one mesh."""

import argparse
import sys
import time
from pathlib import Path

from ngepc.commands.arguments import add_body, build_problem, count, positive

COARSE_NODES = {"lshape": 417, "wrench": 437}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_body(parser)
    parser.add_argument("--gamma", type=positive, default=1e4, help="regularisation, default 1e4")
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
    parser.add_argument("--json", metavar="FILE", help="write the result there, - for stdout")
    parser.add_argument("--figures", metavar="DIR", type=Path, help="write PNG figures there")


def run(args: argparse.Namespace) -> int:
    """Solve, report, write."""
    from ngepc import records
    from ngepc.newton import NewtonOptions, semismooth_newton
    from ngepc.starts import coarse_start

    if args.json not in (None, "-"):
        records.check_writable(Path(args.json))
    options = NewtonOptions(
        tolerance=args.tolerance,
        max_iterations=args.max_iterations,
        quadrature_points=args.quadrature_points,
    )
    problem = build_problem(args.problem, args.nodes, args.maxh)
    begin = time.perf_counter()
    start = coarse_start(args.problem, args.gamma, options) if args.start == "coarse" else None
    result = semismooth_newton(problem, args.gamma, start, options)
    record = records.solve_record(args.problem, result, time.perf_counter() - begin)
    record = {**record, "gamma": args.gamma, "start": args.start, **records.provenance()}
    _report(record, args.json)
    if args.figures is not None:
        from ngepc.figures import write_figures

        for path in write_figures(args.problem, result, args.figures):
            sys.stderr.write(f"wrote {path}\n")
    return 0 if result.status.label == "converged" else 1


def _report(record: dict, target: str | None) -> None:
    from ngepc import records

    if target == "-":
        sys.stdout.write(records.to_json(record))
        return
    for key in (
        "status",
        "iterations",
        "residual_norm",
        "dual_energy",
        "primal_energy",
        "contact_force",
    ):
        sys.stdout.write(f"{key:15s} {record[key]}\n")
    if record["message"]:
        sys.stdout.write(f"{record['message']}\n")
    if target is not None:
        records.write_text(Path(target), records.to_json(record))
        sys.stdout.write(f"wrote {target}\n")
