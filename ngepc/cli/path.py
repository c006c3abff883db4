"""``ngepc path``: follow the path in gamma by Algorithm 7.2."""

import argparse
import sys
import time
from pathlib import Path

from ngepc.cli.arguments import (
    add_body,
    build_problem,
    count,
    file_name,
    positive,
    report,
)

REPORTED = (
    "status",
    "outer_iterations",
    "inner_iterations",
    "total_inner_iterations",
    "gamma_end",
    "dual_energy",
    "primal_energy",
    "contact_force",
)
"""Entries of the record that are printed."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_body(parser)
    parser.add_argument("--gamma-start", type=positive, default=10.0, help="default 10")
    parser.add_argument("--growth", type=positive, default=7.0, help="theta > 1, default 7")
    parser.add_argument(
        "--gamma-end", type=positive, help="go up to this gamma, whatever the path value does"
    )
    parser.add_argument("--inner-tolerance", type=positive, default=10.0, help="default 10")
    parser.add_argument(
        "--inner-scale", type=positive, help="factor on the inner tolerances, 1 in the paper"
    )
    parser.add_argument("--outer-tolerance", type=positive, default=0.7, help="default 0.7")
    parser.add_argument(
        "--residual-tolerance", type=positive, help="follow the path until the residual is below"
    )
    parser.add_argument(
        "--max-outer-iterations", type=count, default=30, help="values of gamma, default 30"
    )
    parser.add_argument(
        "--checkpoint", metavar="FILE", type=file_name, help="kept after each gamma; go on from it"
    )
    parser.add_argument(
        "--json", metavar="FILE", type=file_name, help="write the result there, - for stdout"
    )


def run(args: argparse.Namespace) -> int:
    """Follow the path, report, write."""
    from ngepc.path.options import PathOptions
    from ngepc.path.solver import follow_path
    from ngepc.results import records

    if args.json not in (None, "-"):
        records.check_writable(Path(args.json))
    chosen = {"inner_scale": args.inner_scale} if args.inner_scale is not None else {}
    options = PathOptions(
        gamma_start=args.gamma_start,
        growth=args.growth,
        gamma_end=args.gamma_end,
        inner_tolerance=args.inner_tolerance,
        outer_tolerance=args.outer_tolerance,
        residual_tolerance=args.residual_tolerance,
        max_outer_iterations=args.max_outer_iterations,
        **chosen,
    )
    problem = build_problem(args.problem, args.nodes, args.maxh)
    begin = time.perf_counter()
    path = follow_path(problem, options, _say, checkpoint=args.checkpoint)
    record = path_record(args.problem, path, time.perf_counter() - begin)
    report({**record, **records.provenance()}, REPORTED, args.json)
    return 0 if path.status.label == "converged" else 1


def path_record(name: str, path: object, wall_time: float) -> dict:
    """A path as a dictionary: its own records first, then the fields of its last solve.

    Parameters
    ----------
    name
        Name of the problem.
    path
        A PathResult.
    wall_time
        Seconds for the whole path.
    """
    from ngepc.results import records

    own = {
        "status": path.status.label,
        "message": path.message,
        "outer_iterations": path.outer_iterations,
        "inner_iterations": path.inner_iterations,
        "total_inner_iterations": path.total_inner_iterations,
        "gammas": path.gammas,
        "gamma_end": path.gamma_end,
        "path_values": path.path_values,
        "changes": [step.change for step in path.steps],
        "residual_norms": path.residual_norms,
    }
    last = records.solve_record(name, path.last, wall_time)
    return {**own, **{key: value for key, value in last.items() if key not in own}}


def _say(step: object) -> None:
    change = "" if step.change is None else f", V changes by {step.change:.3g}"
    sys.stderr.write(
        f"gamma {step.gamma:.4g}: {step.iterations} steps, {step.status.label}, "
        f"residual {step.residual_norm:.3g}{change}\n"
    )
    sys.stderr.flush()
