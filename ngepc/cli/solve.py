"""``ngepc solve``: one problem on one mesh, by the default, the paper's or the primal method."""

from __future__ import annotations

import argparse
import time
from contextlib import nullcontext
from pathlib import Path

from ngepc.bounds.adaptive import BoundedResult, MeshRecord, solve_to
from ngepc.bounds.bound import error_bound
from ngepc.cli import output
from ngepc.cli.commands import NEWTON, given
from ngepc.cli.report import load_run, save_run
from ngepc.dual.newton import NewtonOptions
from ngepc.model.problem import Problem
from ngepc.pictures.monitors import progress_line
from ngepc.pictures.report import standard_figures
from ngepc.pictures.style import save_figure
from ngepc.results import records
from ngepc.results.result import Result
from ngepc.studies.examples import THRESHOLDS, coarse_start, example, solved_by


def run(args: argparse.Namespace) -> int:
    """Solve, report, write."""
    check_combination(args)
    output.check_targets((args.json, args.save), args.figures)
    problem, begin = example(args.problem, args.nodes, args.maxh), time.perf_counter()
    if args.error is None:
        result = on_this_mesh(args, problem)
        seconds, error = time.perf_counter() - begin, error_of(result)
    else:
        bounded = refined(args, problem)
        result, seconds, error = bounded.result, time.perf_counter() - begin, bounded.bound.relative
    record = {
        **records.solve_record(args.problem, result, seconds),
        "method": args.method if args.gamma is None else "paper",
        "gamma": args.gamma,
        "start": args.start,
        "error_asked": args.error,
        "error_bound": error,
        **records.provenance(),
    }
    bound = "not bounded" if error is None else f"at most {100 * error:.3g} percent, guaranteed"
    output.report(record, bound, args.json, args.quiet)
    written = write_files(args, record, result)
    if not args.quiet and str(args.json) != "-":
        output.name_written(written)
    how = "give --save FILE next time to be able to go on"
    if args.save is not None:
        how = f"resume with: {record['command']} --start {args.save}"
    return output.exit_status("solve", record["status"], f"step {record['iterations']}", how)


def check_combination(args: argparse.Namespace) -> None:
    """ValueError for options that exclude each other."""
    if args.method == "primal" and args.gamma is not None:
        raise ValueError(f"--gamma {args.gamma:g}: the primal method has no regularisation")
    others = {"--gamma": args.gamma is not None, "--save": args.save is not None}
    others |= {"--method primal": args.method == "primal", "--start": args.start != "zero"}
    for option in (name for name, there in others.items() if there and args.error is not None):
        raise ValueError(f"--error {args.error:g} and {option}: leave one of them out")


def refined(args: argparse.Namespace, problem: Problem) -> BoundedResult:
    """The mesh bisected until the bound is as small as asked, a line for each mesh."""
    tell = output.teller(args.quiet)

    def note(mesh: MeshRecord) -> None:
        part = f"energy error at most {100 * mesh.relative:.3g} percent"
        tell(f"{mesh.nodes:6d} nodes, {mesh.iterations} Newton steps: {part}")

    bounded = solve_to(problem, args.error, monitor=note)
    if bounded.message:
        tell(f"ngepc solve: {bounded.message}")
    return bounded


def error_of(result: Result) -> float | None:
    """The guaranteed relative energy error of a solution of the problem itself, None for others."""
    solution = result.status.is_success and not hasattr(result, "regularisation")
    return error_bound(result).relative if solution else None


def on_this_mesh(args: argparse.Namespace, problem: Problem) -> Result:
    """The result on the mesh as it is, with progress on a terminal."""
    options = NewtonOptions(**given(args, NEWTON))
    method = args.method if args.gamma is None else args.gamma
    start = start_of(args, method, options)
    silent = args.quiet or args.verbose
    with nullcontext() if silent else progress_line(args.problem) as line:
        return solved_by(method, problem, start, options, line)


def start_of(
    args: argparse.Namespace, method: str | float, options: NewtonOptions
) -> Result | None:
    """What --start names."""
    if args.start == "zero":
        return None
    if args.start == "coarse":
        return coarse_start(args.problem, method, options)
    if not Path(args.start).is_file():
        raise ValueError(f"--start {args.start}: zero, coarse or a file of --save is needed")
    return load_run(Path(args.start))[1]


def write_files(args: argparse.Namespace, record: dict, result: Result) -> list[Path]:
    """The run and its figures, where they were asked for; the paths."""
    written = []
    if args.save is not None:
        place = {"name": args.problem, "nodes": args.nodes, "maxh": args.maxh}
        save_run(args.save, place, record, result)
        written.append(args.save)
    if args.figures is not None:
        for name, figure in standard_figures(result, THRESHOLDS[args.problem]).items():
            written.append(save_figure(figure, args.figures / f"{args.problem}_{name}.png"))
    return written
