"""Checkpoints of ``evolve``: after each step the finished steps, in one file, written whole."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.pointfunctions import PointFunctions
from ngepc.discretisation.spaces import displacement_space
from ngepc.evolution.load_path import Schedule
from ngepc.evolution.result import EvolutionStep, StepRecord
from ngepc.model.problem import Problem
from ngepc.results.checkpoint import load, save
from ngepc.results.fields import Fields
from ngepc.results.files import check_writable
from ngepc.results.fingerprint import problem_fingerprint, work_fingerprint

Stored = tuple[dict, np.ndarray, np.ndarray]
"""The row of a step, its displacement and its plastic increment."""


class EvolutionFile:
    """The checkpoint file of one evolution; OSError if it cannot be written.

    Processes that share the mesh have one each, '<stem>_0000<suffix>', ..., with what is on their
    parts.
    """

    def __init__(self, path: Path, problem: Problem, schedule: Schedule, solver: object) -> None:
        self._processes = problem.processes
        if self._processes.size > 1:
            path = path.with_name(f"{path.stem}_{self._processes.rank:04d}{path.suffix}")
        self._processes.together(partial(check_writable, path))
        self.path = path
        self._rows: list[dict] = []
        times, name = list(schedule.times), type(solver).__qualname__
        told = {"times": times, "solver": getattr(solver, "__qualname__", name)}
        if self._processes.size > 1:
            told["processes"] = self._processes.size
        self.fingerprint = work_fingerprint("evolution", problem, **told)

    def load(self) -> tuple[list[Stored], list[tuple[float, int]]]:
        """The steps that an earlier run left, and what was pending; none if there is no file.

        ValueError if the file is damaged or belongs to other work.
        """
        stored = self._processes.together(partial(load, self.path, self.fingerprint))
        count = -1 if stored is None else len(stored.record["steps"])
        records = self._processes.all((count, None if stored is None else stored.record["pending"]))
        count, pending = min(records, key=itemgetter(0))  # a run may end between two files
        if count < 0:
            return [], []
        rows, arrays = stored.record["steps"][:count], stored.arrays
        steps = [(row, arrays[f"u{i}"], arrays[f"p{i}"]) for i, row in enumerate(rows)]
        return steps, [(float(time), int(level)) for time, level in pending]

    def step(self, problem: Problem, stored: Stored, functions: PointFunctions) -> EvolutionStep:
        """A stored step.  ValueError if ``problem`` is not what the step was solved for."""
        row, u, p = stored
        differs = problem_fingerprint(problem) != row.pop("fingerprint")
        if self._processes.any(np.array(differs)):
            raise ValueError(
                f"checkpoint {self.path} belongs to other work: the step to time "
                f"{row['time']:g} had other data; move it away"
            )
        displacement = GridFunction(displacement_space(problem), name="displacement")
        displacement.vec.FV().NumPy()[:] = u
        increment = functions.function(np.zeros((len(functions.points), problem.kinematics.d)))
        if len(increment.vec) != len(p):
            raise ValueError(f"checkpoint {self.path} has plastic strains of another solver")
        increment.vec.FV().NumPy()[:] = p
        return EvolutionStep(Fields(problem, displacement, increment), StepRecord(**row))

    def save(self, steps: Sequence, pending: Sequence[tuple[float, int]]) -> None:
        """Write all finished steps and the pending times."""
        arrays = {}
        for i, step in enumerate(steps):
            arrays[f"u{i}"] = step.fields.displacement.vec.FV().NumPy()
            arrays[f"p{i}"] = step.fields.plastic_increment.vec.FV().NumPy()
        for step in steps[len(self._rows) :]:
            digest = problem_fingerprint(step.problem)
            self._rows.append(vars(step.record) | {"fingerprint": digest})
        record = {"steps": self._rows, "pending": [list(p) for p in pending]}
        self._processes.together(partial(save, self.path, self.fingerprint, record, arrays))
