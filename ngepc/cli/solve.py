"""``ngepc solve``: its options, its methods, and the file from which a run goes on."""

import argparse
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
from ngsolve import GridFunction

from ngepc.bounds.bound import error_bound
from ngepc.bounds.outcome import ErrorBound
from ngepc.checks.kinds import require_path
from ngepc.checks.sentences import at_most_percent, counted, outward
from ngepc.cli.commands import NEWTON, given
from ngepc.cli.output import (
    check_targets,
    drawing,
    exit_status,
    name_written,
    reporter,
    summarise,
)
from ngepc.discretisation.spaces import displacement_space
from ngepc.dual.result import DualResult
from ngepc.dual.solver import prepared
from ngepc.dual.spaces import Coupled
from ngepc.goals.adaptive import solve_to
from ngepc.goals.receipt import write_receipt
from ngepc.goals.refinement import BoundedResult, MeshRecord
from ngepc.model.problem import Problem
from ngepc.results import checkpoint, records
from ngepc.results.files import check_folder
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import IterationRecord, Status
from ngepc.results.progress import progress_line
from ngepc.results.result import Result
from ngepc.results.stored import array_of, reading, stored_record
from ngepc.studies.examples import coarse_start, example, solved_by

FINGERPRINT = {"kind": "run of ngepc solve", "version": 5}


def solve(args: argparse.Namespace) -> int:
    """``ngepc solve``: one problem by the default, the paper's or the primal method."""
    _check_options(args)
    check_targets(args.json, args.save, args.receipt)
    if args.figures is not None:
        check_folder(args.figures)
    result, seconds, bound, run = _solution(args)
    record = {
        **records.solve_record(args.problem, result, seconds),
        "method": args.method if args.gamma is None else "paper",
        "gamma": args.gamma,
        "start": args.start,
        "error_asked": args.error,
        "error_bound": None,
        "guaranteed": None,
        "goal_lower": None,
        "goal_upper": None,
        **records.provenance(),
    }
    goal = None if run is None else run.goal
    if goal is not None:
        record |= {"goal_lower": goal.lower, "goal_upper": goal.upper}
    error = "not bounded"
    if bound is not None:
        record["error_bound"] = bound.relative
        record["guaranteed"] = bound.guaranteed
        error = f"at most {at_most_percent(bound.relative, 3)}, {bound.kind}"
    interval = "" if goal is None else str(goal)
    summarise(record, error, args.json, args.quiet, interval)
    written = _write_files(args, record, result, run)
    if not args.quiet and str(args.json) != "-":
        name_written(written)
    how = "use --save FILE to be able to resume"
    if args.save is not None:
        how = f"resume with: {record['command']} --start {args.save}"
    return exit_status("solve", record["status"], f"step {record['iterations']}", how)


def _write_files(
    args: argparse.Namespace, record: dict, result: Result, run: BoundedResult | None
) -> list[Path]:
    """Write the files of ``--save``, ``--receipt`` and ``--figures``; their names."""
    written = []
    if args.save is not None:
        _save_run(args, record, result)
        written.append(args.save)
    if args.receipt is not None:
        has_goal = run is not None and run.goal is not None
        write_receipt(run.goal if has_goal else result, args.receipt)
        written.append(args.receipt)
    if args.figures is not None:
        written += drawing().of_solution(args, result, run)
    return written


def _check_options(args: argparse.Namespace) -> None:
    """A ValueError for options of ``ngepc solve`` that exclude each other."""
    if args.receipt is not None:
        require_path("--receipt", args.receipt, ".npz")
        if args.method == "primal" or args.gamma is not None:
            raise ValueError(
                f"--receipt {args.receipt}: only the exact method proves intervals; "
                "leave --gamma and --method out"
            )
    if args.method == "primal" and args.gamma is not None:
        raise ValueError(
            f"--gamma {args.gamma:g}: the primal method has no regularisation"
        )
    if args.percent is not None and args.goal is None:
        raise ValueError(f"--percent {args.percent:g}: --goal is needed with it")
    found = given(args, ("--gamma G", "--save FILE", *NEWTON))
    others = ["--" + name.replace("_", "-") for name in found]
    if args.method == "primal":
        others.append("--method primal")
    if args.start != "zero":
        others.append("--start")
    if args.error is not None:
        if args.goal is not None:
            others.append("--goal")
        if others:
            raise ValueError(
                f"--error {args.error:g} and {others[0]}: leave one of them out"
            )
    elif others and args.goal is not None:
        raise ValueError(f"--goal {args.goal} and {others[0]}: leave one of them out")


def _save_run(args: argparse.Namespace, record: dict, result: Result) -> None:
    """Write a run into the file of ``--save``, for ``load_run``."""
    place = {"name": args.problem, "nodes": args.nodes, "maxh": args.maxh}
    kept = {"place": place, "record": record, "history": result.history.as_rows()}
    vector = result.v if record["method"] == "paper" else result.displacement.vec
    state = {"state": np.array(vector.FV().NumPy())}
    checkpoint.save(args.save, FINGERPRINT, kept, state)


def _solution(
    args: argparse.Namespace,
) -> tuple[Result, float, ErrorBound | None, BoundedResult | None]:
    """The result, the seconds it took, and the bound of the energy error of solutions.

    The last one is the run of ``--error`` or ``--goal``, None without them.
    """
    problem = example(args.problem, args.nodes, args.maxh)
    begin = time.perf_counter()
    if args.goal is not None or args.error is not None:
        result, run = _refined(args, problem)
        return result, time.perf_counter() - begin, run.bound, run
    options = NewtonOptions(**given(args, NEWTON))
    method = args.method if args.gamma is None else args.gamma
    start = _start(args, method, options)
    silent = args.quiet or args.verbose
    with nullcontext() if silent else progress_line(args.problem) as line:
        result = solved_by(method, problem, start, options, line)
    seconds = time.perf_counter() - begin
    solution = result.status.is_success and not hasattr(result, "regularisation")
    return result, seconds, error_bound(result) if solution else None, None


def _refined(
    args: argparse.Namespace, problem: Problem
) -> tuple[Result, BoundedResult]:
    """The result on the last mesh for ``--error`` or ``--goal``, and the run."""
    report = reporter(args.quiet)

    def note(mesh: MeshRecord) -> None:
        """Report a mesh: nodes, steps, and the error or the interval of the goal."""
        size = f"{mesh.nodes:6d} nodes, {counted(mesh.iterations, 'Newton step')}"
        found = f"energy error at most {at_most_percent(mesh.relative, 3)}"
        if args.goal is not None:
            ends = " and ".join(outward(mesh.lower, mesh.upper))
            found = f"{args.goal.replace('_', ' ')} between {ends}"
        report(f"{size}: {found}")

    if args.goal is None:
        bounded = solve_to(problem, args.error, monitor=note)
    else:
        bounded = solve_to(problem, goal=args.goal, percent=args.percent, monitor=note)
    result = bounded.result
    if result.status.is_success and not bounded.reached:
        result = replace(result, status=Status.MESH_LIMIT, ending=bounded.message)
    return result, bounded


def _start(
    args: argparse.Namespace, method: str | float, options: NewtonOptions
) -> GridFunction | Result | None:
    """What ``--start`` names: None for zero, a coarse solution, or a saved state."""
    if args.start == "zero":
        return None
    if args.start == "coarse":
        return coarse_start(args.problem, method, options)
    if not Path(args.start).is_file():
        raise ValueError(
            f"--start {args.start}: zero, coarse or a file of --save is needed"
        )
    record, _, state = load_run(Path(args.start))
    if record["problem"] != args.problem:
        raise ValueError(
            f"--start {args.start}: a run of {record['problem']}, one of {args.problem} is needed"
        )
    return state


def load_run(path: Path) -> tuple[dict, Problem, GridFunction | DualResult]:
    """The record of a saved run, its problem and its state, to start from.

    That is the displacement, of the paper's method the result.  ValueError if there is no such
    file, or it is damaged or no run.
    """
    if not path.is_file():
        raise ValueError(
            f"{path}: no such run; make one by ngepc solve ... --save {path}"
        )
    stored = checkpoint.load(path, FINGERPRINT)
    with reading(path):
        return _restored(path, stored)


def _restored(
    path: Path, stored: checkpoint.Checkpoint
) -> tuple[dict, Problem, GridFunction | DualResult]:
    """The result of ``load_run`` from the contents of the file."""
    kept = stored.record
    problem = example(**kept["place"])
    record = records.checked(kept["record"])
    rows = kept["history"]
    history = [stored_record(path, IterationRecord, row) for row in rows]
    if record["method"] != "paper":
        u = GridFunction(displacement_space(problem))
        values = u.vec.FV().NumPy()
        size = len(values)
        values[:] = array_of(path, stored.arrays, "state", size)
        return record, problem, u
    coupled = Coupled(record["gamma"])
    functional = prepared(problem, coupled, NewtonOptions())
    name = record["status"].upper()
    size = len(functional.blocks.H_vector())
    state = array_of(path, stored.arrays, "state", size)
    result = DualResult.restored(functional, state, Status[name], history)
    return record, problem, result
