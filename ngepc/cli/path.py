"""``ngepc path``: follow the path in gamma by Algorithm 7.2."""

import argparse
import time

from ngepc.cli import output
from ngepc.cli.commands import PATH, given
from ngepc.dual.path import PathOptions, follow_path
from ngepc.results import records
from ngepc.studies.examples import example

OWN = ("message", "outer_iterations", "inner_iterations", "total_inner_iterations",
       "gammas", "gamma_end", "path_values", "residual_norms")  # fmt: skip
"""What the record of a path has beside that of its last solve, and in its place."""


def run(args: argparse.Namespace) -> int:
    """Follow the path, report, write."""
    output.check_targets((args.json,))
    options, tell = PathOptions(**given(args, PATH)), output.teller(args.quiet)
    problem, begin = example(args.problem, args.nodes, args.maxh), time.perf_counter()
    path = follow_path(problem, options, lambda s: tell(line_of(s)), checkpoint=args.checkpoint)
    record = {
        **records.solve_record(args.problem, path.last, time.perf_counter() - begin),
        **{name: getattr(path, name) for name in OWN},
        "status": path.status.label,
        "changes": [step.change for step in path.steps],
        **records.provenance(),
    }
    steps = f"{record['total_inner_iterations']} for {record['outer_iterations']} values of gamma"
    shown = {"method": "path", "iterations": steps}
    output.report(record, "not bounded", args.json, args.quiet, **shown)
    kept = "give --checkpoint FILE next time to be able to go on"
    how = kept if args.checkpoint is None else "resume with the same command"
    done = f"{len(path.steps)} values of gamma"
    return output.exit_status("path", record["status"], done, how)


def line_of(step: object) -> str:
    """What progress says about a value of gamma."""
    change = "" if step.change is None else f", V changes by {step.change:.3g}"
    return (
        f"gamma {step.gamma:.4g}: {step.iterations} steps, {step.status.label}, "
        f"residual {step.residual_norm:.3g}{change}"
    )
