"""How fine the next mesh of an adaptive refinement is to be."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ngsolve import Mesh

from ngepc.bounds.copies import bisected_to, with_matching
from ngepc.bounds.outcome import ErrorBound
from ngepc.model.problem import Problem

FEWER = 0.4  # approximate ratio of the nodes of a mesh and of the next one
LEAST_LEFT = 1e-6  # smallest part of an error that a sequence of meshes aims at
AIM = 0.97  # meshes aim at this fraction of the tolerance, as expected errors are not exact
SLOWEST = 1.6
"""Largest factor by which errors are expected to exceed those that indicators predict."""


@dataclass(frozen=True)
class Pace:
    """How much the error is to decrease from mesh to mesh.

    ``expected`` is the error planned for the next mesh, and ``slowness`` the ratio of the error
    that was found on the last mesh to that which its indicators had predicted; of first meshes it
    is mostly 1.1 to 1.3.
    """

    expected: float = math.inf
    slowness: float = 1.2

    def after(self, error: float, part: float) -> Pace:
        """The same after a mesh with this error, of which ``part`` is to remain."""
        missed = self.slowness
        if math.isfinite(self.expected):
            missed *= error / self.expected
        return Pace(part * error, min(max(missed, 1.0), SLOWEST))


def planned_part(left: float, dim: int) -> float:
    """The ratio of the errors of a mesh and of the next one.

    ``left`` is the ratio of the tolerance to the present error.  The meshes are planned such that
    the error decreases by the same factor from each mesh to the next.
    """
    wanted = AIM * max(left, LEAST_LEFT)
    meshes = max(1, round(math.log(wanted) / (2 / dim * math.log(FEWER))))
    return wanted ** (1 / meshes)


def next_mesh(
    bound: ErrorBound, left: float, marking: float
) -> tuple[Mesh, np.ndarray]:
    """The next mesh, bisected by the indicators of a bound, and the parents of its elements.

    ``left`` is the ratio of the tolerance to the present error, ``marking`` as in ``Refinement``.
    """
    problem = bound.problem
    part = planned_part(left, problem.N)
    return refined_mesh(problem, bound.per_cell, part, marking)


def refined_mesh(
    problem: Problem, per_cell: np.ndarray, part: float, marking: float
) -> tuple[Mesh, np.ndarray]:
    """The mesh bisected until this part of the indicators should remain, and the parents.

    It matches where two bodies meet.  If the bound is infinite or zero, all elements count alike.
    """
    some_stand_out = np.isfinite(per_cell).all() and per_cell.max() > 0
    indicators = np.maximum(per_cell, 0.0) if some_stand_out else np.ones(len(per_cell))
    finer = bisected_to(problem.mesh, indicators, marking, part)
    return with_matching(problem, finer)
