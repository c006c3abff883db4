"""Both bounds on one mesh, and where they differ."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ngepc.limit.data import LimitData, barycentric
from ngepc.limit.quadratic import Kinematics2, Mechanism
from ngepc.limit.static import AdmissibleStress, Statics
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.conic import cone_solution

UNBOUNDED = ("DualInfeasible", "AlmostDualInfeasible")
"""The solver's words for a program without a smallest value."""

INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
"""Those for conditions that contradict each other."""


@dataclass(frozen=True, eq=False)
class MeshBracket:
    """What one mesh says.

    Parameters
    ----------
    data
        The data on it.
    stress, mechanism
        Behind the bounds; None where the solver found none.
    unlimited
        Whether any load factor can be carried.
    unknowns, steps, words
        Of the programs for the lower and the upper bound: unknowns, interior point steps, how they
        ended.
    """

    data: LimitData
    stress: AdmissibleStress | None
    mechanism: Mechanism | None
    unlimited: bool
    unknowns: tuple[int, int]
    steps: tuple[int, int]
    words: tuple[str, str]

    @property
    def lower(self) -> float:
        """The lower bound, minus infinity without a stress."""
        return -math.inf if self.stress is None else self.stress.factor

    @property
    def upper(self) -> float:
        """The upper bound, infinite without a mechanism."""
        return math.inf if self.mechanism is None else self.mechanism.factor

    @property
    def gaps(self) -> np.ndarray:
        """Dissipation minus power of the stress on each cell; all of it without a stress."""
        cells = self.data.cells
        if self.mechanism is None:
            return cells.volume
        if self.stress is None:
            return self.mechanism.dissipated
        N = cells.N
        stress = self.stress.coordinates
        strain = self.mechanism.strain
        at_vertices = np.einsum("tic,tic->t", stress, strain)
        of_sums = np.einsum("tc,tc->t", stress.sum(axis=1), strain.sum(axis=1))
        power = cells.volume / ((N + 1) * (N + 2)) * (at_vertices + of_sums)
        return self.mechanism.dissipated - power


def centre_of(statics: Statics) -> np.ndarray | None:
    """A point with equilibrium and less than all of the strength, None if there is none here."""
    if not statics.data.has_constant:
        return np.zeros(statics.count + 1)
    found = cone_solution(statics.least_stressed())
    if not found.is_success or found.x[-1] > 1 - 1e-3:
        return None
    x, _ = statics.balanced(found.x[:-1])
    return x


def carried_centre(
    coarse: LimitData, fine: LimitData, parents: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """The stress of ``centre`` on cells that lie in those which it belongs to."""
    corners = fine.cells.points[fine.cells.nodes]
    shares = barycentric(coarse.cells, parents, corners)
    coordinates = centre[:-1].reshape(len(coarse.cells.nodes), coarse.cells.N + 1, -1)
    values = np.einsum("tvi,tic->tvc", shares, coordinates[parents])
    return np.append(values.ravel(), centre[-1])


def bracket_on(
    data: LimitData, shape: YieldShape, centre: np.ndarray | None
) -> tuple[MeshBracket, np.ndarray | None]:
    """Both bounds on a mesh, and the admissible point that the lower one starts from."""
    statics = Statics(data, shape)
    program = statics.program(statics.gain())
    stress = None
    word = "NoStress"
    steps = 0
    if centre is None:
        centre = centre_of(statics)
    if centre is not None:
        found = cone_solution(program)
        word = found.status
        steps = found.steps
        if np.isfinite(found.x).all() and word not in UNBOUNDED:
            x, _ = statics.admissible(found.x, centre)
            stress = statics.stress(x)
    kinematics = Kinematics2(data, shape)
    flow = kinematics.program()
    moved = cone_solution(flow)
    mechanism = None
    if moved.status not in (*INFEASIBLE, *UNBOUNDED) and np.isfinite(moved.x).all():
        mechanism = kinematics.admissible(moved.x[: kinematics.directions.shape[1]])
    bracket = MeshBracket(
        data,
        stress,
        mechanism,
        word in UNBOUNDED,
        (len(program.cost), len(flow.cost)),
        (steps, moved.steps),
        (word, moved.status),
    )
    return bracket, centre
