"""``ngepc path``: follow the path in gamma by Algorithm 7.2."""

import argparse
import time

from ngepc.cli import arguments
from ngepc.cli.arguments import count, location, positive

EXAMPLES = """examples:
  ngepc path wrench --nodes 1641                        as in Table 3
  ngepc path lshape --gamma-end 1e6 --checkpoint p.npz  Ctrl-C, and on with the same command
"""

NUMBERS = {
    "gamma_start": "first gamma, default 10",
    "growth": "theta > 1, default 7",
    "gamma_end": "go up to this gamma, whatever the path value does",
    "inner_tolerance": "tau_in, default 10",
    "inner_scale": "factor c on the inner tolerances, default 0.1, 1 in the paper",
    "outer_tolerance": "tau_out, default 0.7",
    "residual_tolerance": "follow the path until the residual is below",
}


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    arguments.add_body(parser)
    for name, text in NUMBERS.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=positive, help=text)
    text = "values of gamma, default 30"
    parser.add_argument("--max-outer-iterations", type=count, help=text)
    text = "kept after each gamma; the same command goes on from it"
    parser.add_argument("--checkpoint", metavar="FILE", type=location, help=text)
    arguments.add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Follow the path, report, write."""
    from ngepc.dual.path import follow_path
    from ngepc.dual.path_options import PathOptions
    from ngepc.results import records
    from ngepc.studies.examples import example

    arguments.check_targets((args.json,))
    given = {name: getattr(args, name) for name in (*NUMBERS, "max_outer_iterations")}
    options = PathOptions(**{name: value for name, value in given.items() if value is not None})
    problem = example(args.problem, args.nodes, args.maxh)
    tell = arguments.teller(args.quiet)
    begin = time.perf_counter()
    path = follow_path(problem, options, lambda s: tell(_line(s)), checkpoint=args.checkpoint)
    record = {
        **path_record(args.problem, path, time.perf_counter() - begin),
        **records.provenance(),
    }
    steps = f"{record['total_inner_iterations']} for {record['outer_iterations']} values of gamma"
    lines = arguments.summary({**record, "method": "path", "iterations": steps}, "not bounded")
    arguments.report(record, lines, args.json, args.quiet)
    kept = "give --checkpoint FILE next time to be able to go on"
    how = kept if args.checkpoint is None else "resume with the same command"
    done = f"{len(path.steps)} values of gamma"
    return arguments.exit_status("path", record["status"], done, how)


def path_record(name: str, path: object, wall_time: float) -> dict:
    """A path as a dictionary: its own records first, then the fields of its last solve."""
    from ngepc.results import records

    names = ("message", "outer_iterations", "inner_iterations", "total_inner_iterations",
             "gammas", "gamma_end", "path_values", "residual_norms")  # fmt: skip
    own = {key: getattr(path, key) for key in names}
    own |= {"status": path.status.label, "changes": [step.change for step in path.steps]}
    return {**records.solve_record(name, path.last, wall_time), **own}


def _line(step: object) -> str:
    change = "" if step.change is None else f", V changes by {step.change:.3g}"
    return (
        f"gamma {step.gamma:.4g}: {step.iterations} steps, {step.status.label}, "
        f"residual {step.residual_norm:.3g}{change}"
    )
