"""The checkpoint of a load history: written after each step, read to continue."""

from __future__ import annotations

from functools import partial
from operator import itemgetter
from pathlib import Path

import numpy as np

from ngepc.evolution.load_path import Schedule
from ngepc.evolution.result import EvolutionStep
from ngepc.model.problem import Problem
from ngepc.results.checkpoint import (
    Checkpoint,
    load,
    problem_fingerprint,
    save,
    work_fingerprint,
)
from ngepc.results.files import check_writable
from ngepc.results.stored import array_of, reading, value_of


class EvolutionFile:
    """The checkpoint of an evolution, written atomically; OSError if it cannot be written.

    Processes that share the mesh have one each, '<stem>_0000<suffix>', ..., with what is on their
    parts.
    """

    def __init__(
        self, path: Path, problem: Problem, schedule: Schedule, solver: object
    ) -> None:
        self._processes = problem.processes
        self._rows = []
        name = getattr(solver, "__qualname__", type(solver).__qualname__)
        settings = {
            "times": list(schedule.times),
            "solver": name,
            "keeps": "forces of contact",
        }
        if self._processes.size > 1:
            path = path.with_name(
                f"{path.stem}_{self._processes.rank:04d}{path.suffix}"
            )
            settings["processes"] = self._processes.size
        self._processes.together(partial(check_writable, path))
        self.path = path
        self.fingerprint = work_fingerprint("evolution", problem, **settings)

    def load(self) -> tuple[list[tuple[dict, dict]], list[tuple[float, int]]]:
        """Rows and arrays of the steps of an earlier run, and the pending steps.

        ValueError if the file is damaged or belongs to other work.
        """
        stored = self._processes.together(partial(load, self.path, self.fingerprint))
        found = {"steps": [], "pending": []}
        if stored is not None:
            found = self._processes.together(partial(self._checked, stored))
        reached = self._processes.all((len(found["steps"]), found["pending"]))
        # a run may end between two files
        count, pending = min(reached, key=itemgetter(0))
        names = ("u", "p", "contact")
        rows = found["steps"][:count]
        arrays = [
            {n: stored.arrays.get(f"{n}{i}") for n in names} for i in range(count)
        ]
        return list(zip(rows, arrays, strict=True)), pending

    def _checked(self, stored: Checkpoint) -> dict:
        """The record of a file, with steps and pending times as they must be."""
        with reading(self.path):
            steps = stored.record["steps"]
            pending = stored.record["pending"]
            if not all(isinstance(row["fingerprint"], str) for row in steps):
                raise TypeError("steps without fingerprints")
            for time, level in pending:
                value_of("pending time", float, time)
                value_of("level", int, level)
            sizes = set()
            for number in range(len(steps)):
                forces = stored.arrays.get(f"contact{number}")
                if forces is not None:
                    array_of(self.path, {"contact": forces}, "contact", forces.size)
                sizes.add(None if forces is None else forces.size)
            if len(sizes) > 1:
                raise ValueError(f"forces of contact of different sizes, {sizes}")
            return {"steps": steps, "pending": pending}

    def check(self, problem: Problem, time: float, digest: str) -> None:
        """ValueError if ``problem`` is not what the step to a time was solved for."""
        differs = problem_fingerprint(problem) != digest
        if self._processes.any(np.array(differs)):
            other = f"the step to time {time:g} had other data; move it away"
            raise ValueError(f"checkpoint {self.path} belongs to other work: {other}")

    def save(
        self, steps: list[EvolutionStep], pending: list[tuple[float, int]]
    ) -> None:
        """Write all finished steps and the pending times."""
        arrays = {}
        for i, step in enumerate(steps):
            arrays[f"u{i}"] = step.values_of("displacement")
            arrays[f"p{i}"] = step.values_of("plastic_increment")
            arrays |= {} if step.contact is None else {f"contact{i}": step.contact}
        for step in steps[len(self._rows) :]:
            digest = problem_fingerprint(step.problem)
            self._rows.append(vars(step.record) | {"fingerprint": digest})
        record = {"steps": self._rows, "pending": pending}
        self._processes.together(
            partial(save, self.path, self.fingerprint, record, arrays)
        )
