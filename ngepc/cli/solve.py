"""``ngepc solve``: one problem on one mesh, by the default, the paper's or the primal method."""

from __future__ import annotations

import argparse
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from ngepc.cli import arguments
from ngepc.cli.arguments import count, location, positive

if TYPE_CHECKING:
    from ngepc.bounds.adaptive import BoundedResult
    from ngepc.model.problem import Problem
    from ngepc.results.result import Result

EXAMPLES = """examples:
  ngepc solve lshape                               the default method on 833 nodes
  ngepc solve wrench --nodes 6353 --figures out    with pictures
  ngepc solve lshape --gamma 1e4 --start coarse    the paper's method, as in Table 1
  ngepc solve lshape --error 1e-2                  refine until the error is guaranteed
  ngepc solve lshape --save run.npz                keep it for: ngepc report run.npz
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    arguments.add_body(parser)
    add, methods = parser.add_argument, ("default", "primal")
    add("--method", choices=methods, default="default", help="default: default")
    add("--gamma", type=positive, help="the paper's method, regularised by gamma")
    text = "zero, coarse (the solution on the paper's coarse mesh), or a file of --save"
    add("--start", metavar="START", default="zero", help=text)
    text = "bisect the mesh until the energy error is guaranteed to be at most this part"
    add("--error", type=positive, metavar="PART", help=f"{text} of the strain energy")
    add("--tolerance", type=positive, default=1e-10, help="default 1e-10")
    add("--max-iterations", type=count, default=300, help="default 300")
    arguments.add_json(parser)
    add("--save", metavar="FILE", type=location, help="keep the run in a .npz file")
    add("--figures", metavar="DIR", type=location, help="write PNG figures there")


def run(args: argparse.Namespace) -> int:
    """Solve, report, write."""
    from ngepc.results import records
    from ngepc.studies.examples import example

    method = _method(args)
    arguments.check_targets((args.json, args.save), args.figures)
    problem = example(args.problem, args.nodes, args.maxh)
    begin, bounded = time.perf_counter(), None
    if args.error is None:
        result = _solved(args, method, problem)
    else:
        bounded = _refined(args, problem)
        result = bounded.result
    seconds = time.perf_counter() - begin
    error = _error_of(result) if bounded is None else bounded.bound.relative
    record = {
        **records.solve_record(args.problem, result, seconds),
        "method": method,
        "gamma": args.gamma,
        "start": args.start,
        "error_asked": args.error,
        "error_bound": error,
        **records.provenance(),
    }
    bound = "not bounded" if error is None else f"at most {100 * error:.3g} percent, guaranteed"
    arguments.report(record, arguments.summary(record, bound), args.json, args.quiet)
    written = _files(args, method, record, result)
    if not args.quiet and str(args.json) != "-":
        arguments.name_written(written)
    how = "give --save FILE next time to be able to go on"
    if args.save is not None:
        how = f"resume with: {record['command']} --start {args.save}"
    return arguments.exit_status("solve", record["status"], f"step {record['iterations']}", how)


def _refined(args: argparse.Namespace, problem: Problem) -> BoundedResult:
    """The mesh bisected until the bound is as small as asked, a line for each mesh."""
    from ngepc.bounds.adaptive import MeshRecord, solve_to

    tell = arguments.teller(args.quiet)

    def note(mesh: MeshRecord) -> None:
        part = f"energy error at most {100 * mesh.relative:.3g} percent"
        tell(f"{mesh.nodes:6d} nodes, {mesh.iterations} Newton steps: {part}")

    bounded = solve_to(problem, args.error, monitor=note)
    if bounded.message:
        tell(f"ngepc solve: {bounded.message}")
    return bounded


def _error_of(result: Result) -> float | None:
    """The guaranteed relative energy error of a solution of the problem itself, None for others."""
    from ngepc.bounds.bound import error_bound

    solution = result.status.is_success and not hasattr(result, "regularisation")
    return error_bound(result).relative if solution else None


def _method(args: argparse.Namespace) -> str:
    if args.error is not None:
        given = {"--gamma": args.gamma is not None, "--save": args.save is not None}
        given |= {"--method primal": args.method == "primal", "--start": args.start != "zero"}
        for option in (name for name, there in given.items() if there):
            raise ValueError(f"--error {args.error:g} and {option}: leave one of them out")
    if args.method == "primal" and args.gamma is not None:
        raise ValueError(f"--gamma {args.gamma:g}: the primal method has no regularisation")
    return args.method if args.gamma is None else "paper"


def _solved(args: argparse.Namespace, method: str, problem: Problem) -> Result:
    from ngepc.dual.newton import NewtonOptions
    from ngepc.pictures.monitors import ProgressLine
    from ngepc.studies.examples import solved_by

    options = NewtonOptions(tolerance=args.tolerance, max_iterations=args.max_iterations)
    name = method if args.gamma is None else args.gamma
    start = _start(args, name, options)
    silent = args.quiet or args.verbose or not sys.stderr.isatty()
    with nullcontext() if silent else ProgressLine(args.problem) as line:
        return solved_by(name, problem, start, options, line)


def _start(args: argparse.Namespace, method: str | float, options: object) -> Result | None:
    from ngepc.dual.starts import coarse_problem, coarse_start
    from ngepc.studies.examples import example, solved_by
    from ngepc.studies.runs import load_run

    if args.start == "zero":
        return None
    if args.start != "coarse":
        if not Path(args.start).is_file():
            raise ValueError(f"--start {args.start}: zero, coarse or a file of --save is needed")
        return load_run(Path(args.start), example)[1]
    if args.gamma is not None:
        return coarse_start(args.problem, args.gamma, options)
    return solved_by(method, coarse_problem(args.problem), options=options).or_interrupted()


def _files(args: argparse.Namespace, method: str, record: dict, result: Result) -> list[Path]:
    written = []
    if args.save is not None:
        from ngepc.studies.runs import save_run

        place = {"name": args.problem, "nodes": args.nodes, "maxh": args.maxh}
        save_run(args.save, place, args.gamma, record, result)
        written.append(args.save)
    if args.figures is not None:
        from ngepc.pictures.report import standard_figures
        from ngepc.pictures.style import save_figure
        from ngepc.studies.examples import THRESHOLDS

        figures = standard_figures(result, THRESHOLDS[args.problem]).items()
        written += [
            save_figure(f, args.figures / f"{args.problem}_{name}.png") for name, f in figures
        ]
    return written
