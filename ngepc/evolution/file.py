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
from ngepc.results.checkpoint import load, problem_fingerprint, save, work_fingerprint
from ngepc.results.fields import Fields
from ngepc.results.files import check_writable

Stored = tuple[dict, dict[str, np.ndarray]]
"""The row of a step; its displacement, its plastic increment and, if known, forces of contact."""

Pending = list[tuple[float, int]]
"""Ends of steps that are to be solved, the next one last, and how often they were halved."""


class EvolutionFile:
    """The checkpoint file of one evolution; OSError if it cannot be written.

    Processes that share the mesh have one each, '<stem>_0000<suffix>', ..., with what is on their
    parts.
    """

    def __init__(self, path: Path, problem: Problem, schedule: Schedule, solver: object) -> None:
        self._processes, self._rows = problem.processes, []
        name = getattr(solver, "__qualname__", type(solver).__qualname__)
        told = {"times": list(schedule.times), "solver": name, "keeps": "forces of contact"}
        if self._processes.size > 1:
            path = path.with_name(f"{path.stem}_{self._processes.rank:04d}{path.suffix}")
            told["processes"] = self._processes.size
        self._processes.together(partial(check_writable, path))
        self.path, self.fingerprint = path, work_fingerprint("evolution", problem, **told)

    def load(self) -> tuple[list[Stored], Pending]:
        """The steps that an earlier run left, and what was pending; none if there is no file.

        ValueError if the file is damaged or belongs to other work.
        """
        stored = self._processes.together(partial(load, self.path, self.fingerprint))
        rows = [] if stored is None else stored.record["steps"]
        pending = [] if stored is None else stored.record["pending"]
        reached = self._processes.all((len(rows), pending))
        count, pending = min(reached, key=itemgetter(0))  # a run may end between two files
        steps = []
        for i, row in enumerate(rows[:count]):
            arrays = {name: stored.arrays.get(f"{name}{i}") for name in ("u", "p", "contact")}
            steps.append((row, arrays))
        return steps, [(float(time), int(level)) for time, level in pending]

    def step(self, problem: Problem, stored: Stored, functions: PointFunctions) -> EvolutionStep:
        """A stored step.  ValueError if ``problem`` is not what the step was solved for."""
        row, arrays = stored
        differs = problem_fingerprint(problem) != row.pop("fingerprint")
        if self._processes.any(np.array(differs)):
            raise ValueError(
                f"checkpoint {self.path} belongs to other work: the step to time "
                f"{row['time']:g} had other data; move it away"
            )
        displacement = GridFunction(displacement_space(problem), name="displacement")
        increment = functions.function(np.zeros((len(functions.points), problem.kinematics.d)))
        for function, name in ((displacement, "u"), (increment, "p")):
            function.vec.FV().NumPy()[:] = arrays[name]
        fields = Fields(problem, displacement, increment)
        return EvolutionStep(fields, StepRecord(**row), arrays["contact"])

    def save(self, steps: Sequence[EvolutionStep], pending: Pending) -> None:
        """Write all finished steps and the pending times."""
        arrays = {}
        for i, step in enumerate(steps):
            arrays[f"u{i}"] = step.fields.displacement.vec.FV().NumPy()
            arrays[f"p{i}"] = step.fields.plastic_increment.vec.FV().NumPy()
            if step.contact is not None:
                arrays[f"contact{i}"] = step.contact
        for step in steps[len(self._rows) :]:
            digest = problem_fingerprint(step.problem)
            self._rows.append(vars(step.record) | {"fingerprint": digest})
        record = {"steps": self._rows, "pending": pending}
        self._processes.together(partial(save, self.path, self.fingerprint, record, arrays))
