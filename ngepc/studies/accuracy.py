"""Time to a given accuracy of a number, by default options, beside CalculiX and GetFEM.

Each problem has one number of interest: a limit load, a force, a deflection.  Each program solves
it on a sequence of meshes.  The table has the processor time (one thread) at which the error of the
number falls to 5 and to 1 percent, interpolated between meshes in logarithms.  Short runs are
repeated, and the fastest one counts, for all programs.  ngepc runs with all its defaults.
CalculiX has the elements that its manual recommends, increments of its own choice, and isotropic
hardening.  GetFEM solves the problems without contact, with quadratic simplices, the displacement
as the only unknown, and the fastest of its line searches and numbers of increments.  Times of ngepc
and GetFEM do not include the generation of the mesh; those of CalculiX are the whole run of
``ccx``.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from operator import itemgetter
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from ngepc.local.pyamg import PyAMG
from ngepc.methods.newton import semismooth_newton
from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.studies import by_getfem, calculix
from ngepc.studies.accuracy_cases import CASES, Case
from ngepc.studies.accuracy_decks import deck_of
from ngepc.studies.work import OverMeshes, in_markdown

ACROSS = 3  # panels of the figure in a row
PROGRAMS = (
    "default",
    "default, bricks",
    "order 1",
    "order 2, direct",
    "order 2, PyAMG",
    "ccx",
    "ccx, bricks",
    "GetFEM",
)
"""ngepc by default and by own choices; CalculiX and GetFEM on the same meshes; both on bricks."""

BRICKS = ", bricks"

REPEATS = 3
LONG = 1.0
"""Most runs on a mesh, of which the fastest counts, and processor time that ends them (s)."""

CHOICES = ("order 1", "order 2, direct", "order 2, PyAMG")


def choice(program: str, problem: Problem) -> tuple[Problem, NewtonOptions]:
    """The problem and the options of a row of ngepc."""
    if program == "order 1":
        return replace(problem, order=1), NewtonOptions(inverse="sparsecholesky")
    if program == "order 2, direct":
        return replace(problem, order=2), NewtonOptions(inverse="sparsecholesky")
    if program == "order 2, PyAMG":
        return replace(problem, order=2), NewtonOptions(inverse=PyAMG())
    return problem, NewtonOptions()


def fastest(run: Callable[[], dict | None]) -> dict | None:
    """The fastest of several runs; one is sufficient if it takes long or fails."""
    runs = []
    while len(runs) < REPEATS and sum(found["cpu"] for found in runs) < LONG:
        found = run()
        if found is None:
            return None
        runs.append(found)
    return min(runs, key=itemgetter("cpu"))


def by_ngepc(case: Case, program: str, level: int) -> dict:
    """The number of a case by ngepc, and the cost without mesh generation."""
    mesh = case.mesh(level, not program.endswith(BRICKS))
    begin = time.process_time()
    problem = Problem(mesh, case.metal.material, **case.loads)
    problem, options = choice(program, problem)
    result = semismooth_newton(problem, options=options)
    value = case.number(result)
    spent = time.process_time() - begin
    return {
        "status": result.status.label,
        "value": value,
        "cpu": spent,
        "iterations": result.iterations,
    }


def by_calculix(case: Case, bricks: bool, level: int) -> dict:
    """The same by CalculiX."""
    deck = deck_of(case, case.mesh(level, not bricks))
    with tempfile.TemporaryDirectory() as folder:
        answer = calculix.run(deck, Path(folder))
    kind, _, component, factor = case.printed
    numbers = answer.force if kind == "force" else answer.displacement
    known = answer.finished and numbers is not None
    return {
        "status": "converged" if known else "failed",
        "value": factor * float(numbers[component]) if known else None,
        "cpu": answer.cpu,
        "iterations": answer.iterations,
    }


def can_run(program: str, case: Case) -> bool:
    """Whether a program is installed, and the study has the case for it."""
    if program.startswith("ccx"):
        return calculix.available()
    if program == "GetFEM":
        return "contact" not in case.loads and by_getfem.interpreter() is not None
    return True


def runs_by_getfem(case: Case, levels: int) -> list[dict]:
    """The same by GetFEM on all meshes up to the first one on which it fails."""
    runs = []
    increments = 1
    for level in range(levels):
        mesh = case.mesh(level, True)
        found = fastest(partial(by_getfem.best_run, case, mesh, increments))
        if found is None:
            break
        increments = found["increments"]
        runs.append({"status": "converged", **found})
    return runs


def time_to(errors: Sequence[float], times: Sequence[float], wanted: float) -> float:
    """The least time to an error of at most ``wanted``; inf if there is none.

    Runs count from which on all finer meshes have it, too; a finer mesh may need less time.
    """
    good = [error <= wanted for error in errors]
    first = len(good)
    while first > 0 and good[first - 1]:
        first -= 1
    if first == len(good):
        return math.inf
    least = min(times[first:])
    if first == 0:
        return least
    pair = slice(first - 1, first + 1)
    logs = np.log(np.maximum(errors[pair], 1e-12))[::-1]
    between = np.interp(math.log(wanted), logs, np.log(times[pair])[::-1])
    return min(least, float(np.exp(between)))


@dataclass(eq=False)
class Accuracy(OverMeshes):
    """All cases by all programs on at most ``levels`` meshes; each run measures again."""

    name = "accuracy"
    title = "Time to 5 and to 1 percent of the number that a user wants"
    keeps = False
    columns = """problem = {case} | program = {program} | CPU s to 5 % = {five}
        | to 1 % = {one} | finest error (%) = {finest:.2g} | steps there = {steps_there}"""
    note = (
        "CPU seconds of one thread, the fastest of up to three runs on each mesh; '-' where no "
        "mesh of the family reaches it. References: closed form for the punch, finer meshes of "
        "their own for sphere and hinge, else order 2 on a finer mesh. 'default' is ngepc with all "
        "defaults."
    )

    def cells(self) -> list[dict]:
        """One cell for each case and program that can solve it."""
        found = []
        for case, data in CASES.items():
            for program in PROGRAMS:
                has_meshes = data.levels[program.endswith(BRICKS)] > 0
                if has_meshes and can_run(program, data):
                    found.append({"case": case, "program": program})
        return found

    def solve(self, case: str, program: str) -> dict:
        """The number on all meshes, its errors, and the times to 5 and 1 percent."""
        data = CASES[case]
        bricks = program.endswith(BRICKS)
        exact = reference(case)
        runs = []
        levels = min(self.levels, data.levels[bricks])
        if program == "GetFEM":
            runs = runs_by_getfem(data, levels)
            levels = 0
        for level in range(levels):
            run = partial(by_ngepc, data, program, level)
            if program.startswith("ccx"):
                run = partial(by_calculix, data, bricks, level)
            runs.append(fastest(run))
        good = [run for run in runs if run["value"] is not None]
        errors = [abs(run["value"] / exact - 1) for run in good]
        times = [run["cpu"] for run in good]
        return {
            "status": "converged",
            "reference": exact,
            "values": [run["value"] for run in good],
            "errors": errors,
            "cpu": times,
            "failed": len(runs) - len(good),
            "five": shown_time(time_to(errors, times, 0.05)),
            "one": shown_time(time_to(errors, times, 0.01)),
            "finest": 100 * errors[-1] if errors else math.nan,
            "steps_there": good[-1]["iterations"] if good else "",
        }

    def notes(self, records: Sequence[dict]) -> list[str]:
        """The ratios of times, and what the table shows."""
        lines = [
            "Ratios of these times. 'CalculiX': ngepc by default over CalculiX, each with its "
            "faster elements. 'own choice': ngepc by default on simplices over the fastest order "
            "and solver there.",
            "",
        ]
        table = [["problem", "CalculiX, 5 %", "1 %", "own choice, 5 %", "1 %"]]
        for case in dict.fromkeys(record["case"] for record in records):
            times = {
                record["program"]: [
                    time_to(record["errors"], record["cpu"], wanted)
                    for wanted in (0.05, 0.01)
                ]
                for record in records
                if record["case"] == case
            }
            shown = ratios(
                times, ("default", "default, bricks"), ("ccx", "ccx, bricks")
            )
            shown += ratios(times, ("default",), CHOICES)
            table.append([case, *shown])
        return [*lines, *in_markdown(table), "", *super().notes(records)]

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Errors over times, one panel for each case."""
        names = list(dict.fromkeys(record["case"] for record in records))
        rows = -(-len(names) // ACROSS)
        size = (3.4 * ACROSS, 3.0 * rows)
        figure, panels = plt.subplots(
            rows, ACROSS, figsize=size, squeeze=False, layout="constrained"
        )
        for panel in panels.flat[len(names) :]:
            panel.set_axis_off()
        for row in panels:
            row[0].set_ylabel("error in percent")
        lines = {}
        for panel, name in zip(panels.flat, names, strict=False):
            for record in records:
                if record["case"] == name:
                    error = 100 * np.array(record["errors"])
                    program = record["program"]
                    colour = f"C{PROGRAMS.index(program)}"
                    (line,) = panel.loglog(record["cpu"], error, "o-", color=colour)
                    lines[program] = line
            panel.set_title(name)
            panel.set_xlabel("CPU seconds")
            panel.axhline(1, color="0.7", linewidth=0.8)
            panel.axhline(5, color="0.7", linewidth=0.8)
        figure.legend(lines.values(), lines, loc="outside lower center", ncols=4)
        path = self.folder / "accuracy.png"
        figure.savefig(path, dpi=130)
        plt.close(figure)
        return [path]


@cache
def reference(case: str) -> float:
    """The known number of a case, else that of order 2 on one finer mesh."""
    data = CASES[case]
    if data.reference is not None:
        return data.reference
    return by_ngepc(data, "order 2, direct", data.finest)["value"]


def ratios(
    times: dict[str, list[float]], ours: Sequence[str], theirs: Sequence[str]
) -> list[str]:
    """The least of our times over the least of theirs, to 5 and to 1 percent; '-' for never."""
    shown = []
    for number in range(2):
        least = [
            min(
                (times[name][number] for name in names if name in times),
                default=math.inf,
            )
            for names in (ours, theirs)
        ]
        if not math.isfinite(least[0]):
            shown.append("-")
        elif not math.isfinite(least[1]):
            shown.append("ngepc alone")
        else:
            shown.append(f"{least[0] / least[1]:.2f}")
    return shown


def shown_time(seconds: float) -> str:
    """Seconds with two digits, '-' for never."""
    return f"{seconds:.2g}" if math.isfinite(seconds) else "-"
