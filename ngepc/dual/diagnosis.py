"""What was seen in a run of Algorithm 7.1 that did not converge, and what to try."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np
from ngsolve import H1, CoefficientFunction, GridFunction
from ngsolve.la import BaseVector

from ngepc.checks.arguments import is_number
from ngepc.discretisation.prolongation import vertex_dofs
from ngepc.dual.functional import DualFunctional
from ngepc.parallel import gathered, vertex_coordinates, vertex_numbers
from ngepc.results.outcome import History, IterationRecord, Status

WINDOW = 5
"""Iterates that are looked at for active sets that flicker."""

ADVICE = {
    Status.ITERATION_LIMIT: (
        "Start from the solution for a smaller gamma or a smaller load step, raise max_iterations, "
        "or take Balanced()."
    ),
    Status.LINESEARCH_FAILED: "Start from the solution for a smaller gamma or a smaller load step.",
    Status.STAGNATED: "Energies only change by rounding: ask for a tolerance above this residual.",
    Status.LINEAR_SOLVER_FAILED: (
        "Raise max_iterations or sweeps of Krylov, start from the solution for a smaller gamma, "
        "or take a direct solver."
    ),
    Status.NONFINITE: (
        "Check loads and coefficients for NaN and for values that changed during the run, or "
        "start from the solution for a smaller gamma."
    ),
}


def describe(
    status: Status,
    history: History,
    last: IterationRecord | None,
    rule: object,
    recent: RecentDuals,
    cause: str = "",
) -> str:
    """The message of a result: what was seen and what to try, empty for a run that converged.

    Parameters
    ----------
    status, history
        How the run ended and its records.
    last
        The record of the last iterate, None if there is none.
    rule
        The stopping rule; its text names the bounds.
    recent
        The last iterates.
    cause
        A sentence about an exception, if there was one.
    """
    if status is Status.CONVERGED or last is None:
        return cause
    sentences = [
        cause,
        f"After {last.iteration} steps the residual is {last.residual_norm:.3g} "
        f"(contact {last.contact_residual_norm:.3g}, plastic {last.plastic_residual_norm:.3g}), "
        f"{rule}; last step length {last.step_length:.3g}.",
        "" if status is Status.STOPPED else damped(history),
        "" if status is Status.STOPPED else recent.flicker(),
        ADVICE.get(status, ""),
    ]
    return " ".join(sentence for sentence in sentences if sentence)


def damped(history: History) -> str:
    """The shortest of the last steps, if it was damped."""
    steps = history.records[1:][-WINDOW:]
    if not steps:
        return ""
    shortest = min(steps, key=lambda record: record.step_length)
    if shortest.step_length >= 1:
        return f"None of the last {len(steps)} steps was damped."
    return (
        f"Step {shortest.iteration} was damped to {shortest.step_length:.3g}, the shortest of the "
        f"last {len(steps)}."
    )


class RecentDuals:
    """The last few dual iterates of a run, for ``flicker``.

    Parameters
    ----------
    functional
        J*_gamma of the run.
    """

    def __init__(self, functional: DualFunctional) -> None:
        self._functional = functional
        self._duals: deque[BaseVector] = deque(maxlen=WINDOW)

    def append(self, v: BaseVector) -> None:
        """Keep an iterate; it must not change afterwards."""
        self._duals.append(v)

    def flicker(self) -> str:
        """Which active set changed most in the last steps, by how much and where."""
        if len(self._duals) < 2:
            return ""
        parts = self._functional.blocks.parts
        changes = [self._changed(number) for number in range(len(parts))]
        most = max(range(len(parts)), key=lambda number: len(changes[number][0]))
        points, count = changes[most]
        steps = f"the last {len(self._duals) - 1} steps"
        if len(points) == 0:
            return f"No vertex changed sides in {steps}."
        centre = ", ".join(f"{x:.3g}" for x in points.mean(axis=0))
        return (
            f"In {steps} {len(points)} of {count} vertices entered or left the active set of "
            f"the {parts[most].name} term, around ({centre})."
        )

    def _changed(self, number: int) -> tuple[np.ndarray, int]:
        """Points of the vertices of a part that changed sides lately, and how many it has."""
        blocks = self._functional.blocks
        mesh = blocks.problem.mesh
        space, name = blocks.spaces[number], blocks.parts[number].name
        components = GridFunction(space).dim
        scalar = space if components == 1 else space.components[0]
        vertices, dofs = vertex_dofs(scalar, mesh)
        sets = []
        for v in self._duals:
            values = np.array(blocks.part_of(v, number).FV().NumPy()).reshape(components, -1)
            sets.append(self._active(name, values[:, dofs], vertices))
        changed = np.zeros(len(vertices), dtype=bool)
        for before, after in pairwise(sets):
            changed |= before != after
        numbers, _ = vertex_numbers(mesh)
        of_part, moved = (
            np.unique(gathered(numbers[some], mesh)) for some in (vertices, vertices[changed])
        )
        return vertex_coordinates(mesh)[moved], len(of_part)

    def _active(self, name: str, values: np.ndarray, vertices: np.ndarray) -> np.ndarray:
        """Where the max term of a part is active at the vertices; values have shape (d, m)."""
        if name == "contact":
            return values[0] >= 0
        if name != "plastic":
            return np.zeros(values.shape[1], dtype=bool)
        bound = self._functional.regularisation.yield_bound(self._functional.blocks.problem)
        return np.linalg.norm(values, axis=0) > self._at_vertices(bound)[vertices]

    def _at_vertices(self, bound: float | CoefficientFunction) -> np.ndarray:
        mesh = self._functional.blocks.problem.mesh
        if is_number(bound):
            return np.full(mesh.nv, float(bound))
        nodal = GridFunction(H1(mesh, order=1))
        nodal.Set(bound)
        return nodal.vec.FV().NumPy().copy()
