"""The work of the other commands: a function for each, which returns the exit status."""

import argparse
import importlib
import shutil
import sys
import time
from pathlib import Path

import ngepc
from ngepc.checks.sentences import at_most_percent, counted, outward
from ngepc.cli.commands import PATH, STUDIES, Command, given
from ngepc.cli.output import (
    check_targets,
    drawing,
    exit_status,
    name_written,
    reporter,
    summarise,
)
from ngepc.dual.path import PathOptions, follow_path
from ngepc.limit.load import limit_load
from ngepc.limit.outcome import LimitRecord
from ngepc.limit.shakedown import shakedown_load
from ngepc.results import records
from ngepc.results.files import check_folder
from ngepc.studies.examples import example
from ngepc.studies.limit_problems import GROWING, LIMITS
from ngepc.studies.shakedown_problems import SHAKEDOWNS
from ngepc.studies.work import Work

OF_PATHS = ("message", "outer_iterations", "inner_iterations", "total_inner_iterations",
            "gammas", "gamma_end", "path_values", "residual_norms")  # fmt: skip
"""Fields of the record of a path that replace or extend those of its last solve."""


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
