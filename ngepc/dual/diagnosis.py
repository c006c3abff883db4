"""What was seen in a run of Algorithm 7.1 that did not converge, and what to try."""

from __future__ import annotations

from collections import deque
from itertools import pairwise

import numpy as np
from ngsolve import H1, GridFunction
from ngsolve.la import BaseVector

from ngepc.checks.arguments import is_number
from ngepc.discretisation.prolongation import vertex_dofs
from ngepc.dual.functional import DualFunctional
from ngepc.dual.parts import CONTACT
from ngepc.model.elements import vertex_coordinates
from ngepc.results.outcome import History, IterationRecord, Status

WINDOW = 5
"""Iterates that are looked at for active sets that flicker."""

ADVICE = {
    Status.ITERATION_LIMIT: (
        "Start from the solution for a smaller gamma or a smaller load step, raise max_iterations, "
        "or leave gamma out."
    ),
    Status.LINESEARCH_FAILED: "Start from the solution for a smaller gamma or a smaller load step.",
    Status.STAGNATED: "Energies only change by rounding: ask for a tolerance above this residual.",
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
        changes = {name: self._changed(name) for name in self._functional.blocks.parts}
        most = max(changes, key=lambda name: len(changes[name][0]))
        points, count = changes[most]
        steps = f"the last {len(self._duals) - 1} steps"
        if len(points) == 0:
            return f"No vertex changed sides in {steps}."
        centre = ", ".join(f"{x:.3g}" for x in points.mean(axis=0))
        return (
            f"In {steps} {len(points)} of {count} vertices entered or left the active set of "
            f"the {most} term, around ({centre})."
        )

    def _changed(self, name: str) -> tuple[np.ndarray, int]:
        """Points of the vertices of a part that changed sides lately, and how many it has."""
        blocks = self._functional.blocks
        mesh, space = blocks.problem.mesh, blocks.parts[name].space
        components = GridFunction(space).dim
        scalar = space if components == 1 else space.components[0]
        vertices, dofs = vertex_dofs(scalar, mesh)
        changed, threshold = np.zeros(len(vertices), dtype=bool), self._thresholds(name)[vertices]
        sizes = []
        for v in self._duals:
            values = np.array(blocks.part_of(v, name).FV()).reshape(components, -1)[:, dofs]
            sizes.append(values[0] if name == CONTACT else np.linalg.norm(values, axis=0))
        for before, after in pairwise(sizes):
            changed |= (before > threshold) != (after > threshold)
        return vertex_coordinates(mesh)[vertices[changed]], len(vertices)

    def _thresholds(self, name: str) -> np.ndarray:
        """What z or |q| is compared with at the vertices."""
        mesh = self._functional.blocks.problem.mesh
        bound = 0.0 if name == CONTACT else self._functional.weights.yield_bound
        if is_number(bound):
            return np.full(mesh.nv, float(bound))
        nodal = GridFunction(H1(mesh, order=1))
        nodal.Set(bound)
        return nodal.vec.FV().NumPy().copy()
