"""The work of the commands: a function for each, which returns the exit status, and its output."""

import argparse
import importlib
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
from ngsolve import GridFunction

import ngepc
from ngepc.bounds.bound import error_bound
from ngepc.bounds.outcome import ErrorBound
from ngepc.checks.sentences import at_most_percent, counted, outward
from ngepc.cli.commands import NEWTON, PATH, STUDIES, Command, given
from ngepc.discretisation.spaces import displacement_space
from ngepc.dual.path import PathOptions, follow_path
from ngepc.dual.result import DualResult
from ngepc.dual.solver import prepared
from ngepc.dual.spaces import Coupled
from ngepc.goals.adaptive import BoundedResult, MeshRecord, solve_to
from ngepc.limit.load import limit_load
from ngepc.limit.outcome import LimitRecord
from ngepc.limit.shakedown import shakedown_load
from ngepc.model.problem import Problem
from ngepc.results import checkpoint, records
from ngepc.results.files import check_folder, check_writable
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import IterationRecord, Status
from ngepc.results.progress import progress_line
from ngepc.results.result import Result
from ngepc.results.stored import array_of, reading, stored_record
from ngepc.studies.examples import coarse_start, example, solved_by
from ngepc.studies.limit_problems import GROWING, LIMITS
from ngepc.studies.shakedown_problems import SHAKEDOWNS
from ngepc.studies.work import Work

FINGERPRINT = {"kind": "run of ngepc solve", "version": 5}
OF_PATHS = ("message", "outer_iterations", "inner_iterations", "total_inner_iterations",
            "gammas", "gamma_end", "path_values", "residual_norms")  # fmt: skip
"""Fields of the record of a path that replace or extend those of its last solve."""


def solve(args: argparse.Namespace) -> int:
    """``ngepc solve``: one problem by the default, the paper's or the primal method."""
    _check_options(args)
    check_targets(args.json, args.save)
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
    written = []
    how = "use --save FILE to be able to resume"
    if args.save is not None:
        _save_run(args, record, result)
        written = [args.save]
        how = f"resume with: {record['command']} --start {args.save}"
    if args.figures is not None:
        written += drawing().of_solution(args, result, run)
    if not args.quiet and str(args.json) != "-":
        name_written(written)
    return exit_status("solve", record["status"], f"step {record['iterations']}", how)


def _check_options(args: argparse.Namespace) -> None:
    """A ValueError for options of ``ngepc solve`` that exclude each other."""
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


def drawing() -> ModuleType:
    """``ngepc.cli.figures``; to load matplotlib takes as long as a small solve and its bound."""
    return importlib.import_module("ngepc.cli.figures")


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


def limit(args: argparse.Namespace) -> int:
    """``ngepc limit``: bounds of the limit load of a problem, or of loads that vary."""
    check_targets(args.json)
    if args.figures is not None:
        check_folder(args.figures)
    report = reporter(args.quiet)
    begin = time.perf_counter()

    def note(mesh: LimitRecord) -> None:
        """Report a mesh: elements and the bounds of the load factor."""
        width = at_most_percent(mesh.relative_width, 3)
        bounds = " to ".join(outward(mesh.lower, mesh.upper))
        report(f"{mesh.cells:6d} elements: {bounds}, {width}")

    options = {"max_cells": args.max_cells, "monitor": note}
    if args.body in SHAKEDOWNS:
        varying = SHAKEDOWNS[args.body]
        found = shakedown_load(
            varying.problem(), varying.vertices, args.width, **options
        )
        loads = {"vertices": list(found.vertices), "guaranteed": found.exact}
    else:
        growing = GROWING.get(args.body)
        found = limit_load(LIMITS[args.body](), args.width, growing, **options)
        loads = {"growing": list(found.growing)}
    record = {
        "problem": args.body,
        "status": found.status.label,
        "lower": found.lower,
        "upper": found.upper,
        "relative_width": found.relative_width,
        **loads,
        "meshes": [vars(mesh) for mesh in found.records],
        "wall_time_s": time.perf_counter() - begin,
        **records.provenance(),
    }
    _write_limit(args, record, found.message)
    if args.figures is not None:
        name_written(drawing().of_limit(args, found))
    return 0 if found.status.is_success else 1


def _write_limit(args: argparse.Namespace, record: dict, message: str) -> None:
    """The bounds of a limit load on standard output, the record into the file of ``--json``."""
    if str(args.json) == "-":
        sys.stdout.write(records.to_json(record))
        return
    if not args.quiet:
        sys.stdout.write(f"load factor at least  {record['lower']:.10g}\n")
        sys.stdout.write(f"and at most           {record['upper']:.10g}\n")
        sys.stdout.write(f"{message}\n")
    if args.json is not None:
        records.write_text(args.json, records.to_json(record))
        name_written([args.json])


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


def path(args: argparse.Namespace) -> int:
    """``ngepc path``: follow the path in gamma by Algorithm 7.2."""
    check_targets(args.json)
    options = PathOptions(**given(args, PATH))
    report = reporter(args.quiet)
    problem = example(args.problem, args.nodes, args.maxh)
    begin = time.perf_counter()

    def note(step: object) -> None:
        """Report a value of gamma."""
        change = "" if step.change is None else f", V changes by {step.change:.3g}"
        report(f"gamma {step.gamma:.4g}: {counted(step.iterations, 'step')}, "
             f"{step.status.label}, residual {step.residual_norm:.3g}{change}")  # fmt: skip

    followed = follow_path(problem, options, note, checkpoint=args.checkpoint)
    record = {
        **records.solve_record(
            args.problem, followed.last, time.perf_counter() - begin
        ),
        **{name: getattr(followed, name) for name in OF_PATHS},
        "status": followed.status.label,
        "changes": [step.change for step in followed.steps],
        **records.provenance(),
    }
    values = counted(record["outer_iterations"], "value")
    steps = f"{record['total_inner_iterations']} for {values} of gamma"
    shown = {"method": "path", "iterations": steps}
    summarise(record, "not bounded", args.json, args.quiet, **shown)
    kept = "use --checkpoint FILE to be able to resume"
    how = kept if args.checkpoint is None else "resume with the same command"
    done = f"{counted(len(followed.steps), 'value')} of gamma"
    return exit_status("path", record["status"], done, how)


def study_class(study: Command) -> type[Work]:
    """The class that does the work of a study."""
    module, _, name = study.work.partition(":")
    return getattr(importlib.import_module(f"ngepc.studies.{module}"), name)


def study(args: argparse.Namespace) -> int:
    """``ngepc study NAME``: measure, write, name what was written."""
    chosen = STUDIES[args.study]
    check_folder(args.out)
    report = reporter(args.quiet)
    options = given(args, chosen.options)
    work = study_class(chosen)(args.out, progress=report, **options)
    found = work.run()
    name_written(work.write(found))
    return 0 if work.succeeded(found) else 1


def notebooks(args: argparse.Namespace) -> int:
    """``ngepc notebooks DIR``: copy all notebooks, none if one is there, and say how to go on."""
    start = Path(ngepc.__file__).parent / "notebooks"
    folders = ("", "exercises", "solutions") if args.solutions else ("", "exercises")
    wanted = [
        file for folder in folders for file in sorted((start / folder).glob("*.ipynb"))
    ]
    if not wanted:
        raise FileNotFoundError(
            f"there are no notebooks in {start}: install ngepc again"
        )
    if args.folder.is_file():
        raise NotADirectoryError(f"{args.folder} is a file: give the name of a folder")
    copies = {file: args.folder / file.relative_to(start) for file in wanted}
    present = [copy for copy in copies.values() if copy.exists()]
    if present and not args.force:
        how = "give another folder, or --force to replace them"
        raise FileExistsError(
            f"{present[0]} is there already ({counted(len(present), 'file')}): {how}"
        )
    for original, copy in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(original, copy)
    sys.stdout.write(f"wrote {len(copies)} notebooks to {args.folder}\n")
    sys.stdout.write(f"open the first one with: jupyter lab {copies[wanted[0]]}\n")
    return 0


def reporter(quiet: bool) -> Callable[[str], None]:
    """A function that writes lines of progress to standard error, and raises a lost Ctrl-C."""

    def report(line: str) -> None:
        """Write a line to standard error; Ctrl-C that was pressed meanwhile interrupts."""
        if not quiet:
            sys.stderr.write(line + "\n")
            sys.stderr.flush()
        if getattr(signal.getsignal(signal.SIGINT), "pressed", False):
            raise KeyboardInterrupt

    return report


def check_targets(*files: Path | None) -> None:
    """Raise OSError now, not after the work, if results cannot be written."""
    for file in files:
        if file is not None and str(file) != "-":
            check_writable(file)


def name_written(paths: Iterable[Path]) -> None:
    """One line on standard output for each file that was written."""
    sys.stdout.write("".join(f"wrote {path}\n" for path in paths))


def summarise(
    record: dict,
    error: str,
    target: Path | None,
    quiet: bool,
    interval: str = "",
    **other: object,
) -> None:
    """Write a summary of a solve to standard output, and the record into ``target``.

    A ``target`` '-' puts the JSON on standard output instead; ``quiet`` leaves out the rest;
    ``error`` says how far the bound goes, ``interval`` what is known of a goal; ``other`` entries
    stand in place of those of the record.
    """
    if str(target) == "-":
        sys.stdout.write(records.to_json(record))
        return
    if target is not None:
        records.write_text(target, records.to_json(record))
    if quiet:
        return
    record = record | other
    elements = counted(record["elements"], "element")
    lines = {
        "mesh": f"{record['problem']}, {record['nodes']} nodes, {elements}",
        "unknowns": record["unknowns"],
        "method": ", ".join(filter(None, (record["method"], record["label"]))),
        "status": record["status"],
        "steps": record["iterations"],
        "residual": f"{record['residual_norm']:.3g}",
        "energy J": f"{record['primal_energy']:.10g}",
        "-J*": f"{-record['dual_energy']:.10g}",
        "contact force": f"{record['contact_force']:.7g}",
        "energy error": error,
        "goal": interval,
        "time": f"{record['wall_time_s']:.2f} s",
    }
    sys.stdout.write(
        "".join(
            f"{label:13s}  {value}\n" for label, value in lines.items() if value != ""
        )
    )
    sys.stdout.write(f"{record['message']}\n" if record["message"] else "")
    name_written([] if target is None else [target])


def exit_status(command: str, status: str, done: str, how: str) -> int:
    """The exit status of a run; after Ctrl-C it writes a line on how to resume."""
    if status != "stopped":
        return 0 if status in ("converged", "bounded") else 1
    sys.stderr.write(f"ngepc {command}: interrupted after {done}; {how}\n")
    return 130
