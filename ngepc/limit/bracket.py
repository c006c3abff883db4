"""Both bounds on one mesh, and where they differ."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ngepc.bounds.simplices import FACETS
from ngepc.limit.data import LimitData, barycentric
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.quadratic import QuadraticVelocities
from ngepc.limit.sliding import SlidingVelocities
from ngepc.limit.static import AdmissibleStress, Statics
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.conic import cone_solution

UNBOUNDED = ("DualInfeasible", "AlmostDualInfeasible")
"""Status of the solver for a program without a minimum."""

INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
"""Status of the solver for conditions that contradict each other."""

VELOCITIES = {2: QuadraticVelocities, 3: SlidingVelocities}
"""Space dimension -> class of velocities."""


@dataclass(frozen=True, eq=False)
class MeshBracket:
    """The result of one mesh.

    Parameters
    ----------
    data, shape
        The data on it, and the yield condition.
    stress, mechanism
        Stress and mechanism of the bounds; None if the solver found none.
    unlimited
        Whether any load factor can be carried.
    unknowns, steps, words
        Of the programs for the lower and the upper bound: unknowns, interior point steps, how they
        ended.
    """

    data: LimitData
    shape: YieldShape
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
        return self.mechanism.dissipated - power + self._slip_gaps()

    def _slip_gaps(self) -> np.ndarray:
        """The same for slips on facets, half of it for the cell on each side."""
        cells = self.data.cells
        if not self.mechanism.slipped.any():
            return np.zeros(len(cells.nodes))
        N = cells.N
        tensors = np.einsum("tic,cpq->tipq", self.stress.coordinates, self.shape.basis)
        first = cells.sign > 0
        stress = np.zeros((len(cells.facets), N, N, N))
        for k, vertices in enumerate(FACETS[N]):
            own = np.flatnonzero(first[:, k])
            facets = cells.facet_of[own, k]
            for m, i in enumerate(vertices):
                stress[facets, cells.place[own, k, m]] = tensors[own, i]
        traction = np.einsum("fipq,fq->fip", stress, cells.normal)
        slips = self.mechanism.slips
        at_vertices = np.einsum("fip,fip->f", traction, slips)
        of_sums = np.einsum("fp,fp->f", traction.sum(axis=1), slips.sum(axis=1))
        power = cells.measure / (N * (N + 1)) * (at_vertices + of_sums)
        gaps = self.mechanism.slipped + power
        owners = cells.owners
        sides = np.where(cells.outer, 1, 2)
        result = np.bincount(owners[:, 0], gaps / sides, minlength=len(cells.nodes))
        inside = ~cells.outer
        second = owners[inside, 1]
        return result + np.bincount(second, gaps[inside] / 2, minlength=len(result))


def centre_of(statics: Statics) -> np.ndarray | None:
    """A stress in equilibrium strictly inside the yield condition, or None."""
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
    velocities = VELOCITIES[data.cells.N](data, shape)
    flow = velocities.flow.program()
    moved = cone_solution(flow)
    mechanism = None
    if moved.status not in (*INFEASIBLE, *UNBOUNDED) and np.isfinite(moved.x).all():
        mechanism = velocities.mechanism(moved.x)
    bracket = MeshBracket(
        data,
        shape,
        stress,
        mechanism,
        word in UNBOUNDED,
        (len(program.cost), len(flow.cost)),
        (steps, moved.steps),
        (word, moved.status),
    )
    return bracket, centre
