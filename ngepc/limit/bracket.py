"""Both bounds on one mesh, and where they differ."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ngepc.bounds.simplices import FACETS
from ngepc.limit.continuous import ContinuousVelocities
from ngepc.limit.data import GROWS, LimitData, barycentric
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.sliding import SlidingVelocities
from ngepc.limit.static import AdmissibleStress, Statics
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.bernstein import times_hats
from ngepc.linalg.conic import ACCURATE, ConicAccuracy, cone_solution

UNBOUNDED = ("DualInfeasible", "AlmostDualInfeasible")
"""Statuses of the solver for an unbounded program."""

INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
"""Statuses of the solver for an infeasible program."""

DEGREE = 2
"""Degree of the velocities in the plane whose gaps mark cells for refinement."""

LAST_DEGREE = 3
"""Degree of the velocities of the last mesh: three times the unknowns, about half the width."""


EXCESS = 3.0
"""Price of the strength of a cell over its dissipation from which on it holds the bound down."""

ROUNDED = 1e-12
"""Relative rounding errors of upper bounds, whose difference may be small beside them."""

TINY = 1e-300
"""Smallest number that is divided by."""


@dataclass(frozen=True, eq=False)
class MeshBracket:
    """The result of one mesh.

    Parameters
    ----------
    data, shape
        The data on it, and the yield condition.
    stress, mechanism
        Stress and mechanism of the bounds; None if the solver found none.
    marks
        Indicators for refinement, one for each cell: the gaps of the first mechanism of the mesh,
        and where the lower bound is held down.
    unlimited, overloaded
        Whether the body carries any load factor, or none because of its constant loads.
    unknowns, steps, words
        Numbers of unknowns and of interior point steps, and final statuses of the solver, of the
        programs for the lower and the upper bound.
    """

    data: LimitData
    shape: YieldShape
    stress: AdmissibleStress | None
    mechanism: Mechanism | None
    marks: np.ndarray
    unlimited: bool
    overloaded: bool
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
        return gaps_of(self.data, self.shape, self.stress, self.mechanism)


def centre_of(statics: Statics) -> np.ndarray | None:
    """A stress in equilibrium strictly inside the yield condition, or None."""
    if not statics.data.has_constant:
        return np.zeros(statics.count + 1)
    found = cone_solution(statics.least_stressed())
    if not found.is_success or found.x[-1] > 1 - 1e-3:
        return None
    return statics.balanced(found.x[:-1])


def carried_centre(
    coarse: LimitData, fine: LimitData, parents: np.ndarray, centre: np.ndarray
) -> np.ndarray:
    """The stress ``centre`` of coarse cells on the fine cells inside them."""
    coordinates = centre[:-1].reshape(len(coarse.cells.nodes), coarse.cells.N + 1, -1)
    values = carried_stress(coarse, fine, parents, coordinates)
    return np.append(values.ravel(), centre[-1])


def carried_stress(
    coarse: LimitData, fine: LimitData, parents: np.ndarray, coordinates: np.ndarray
) -> np.ndarray:
    """Stress coordinates at the vertices of cells (nc, N + 1, s), from those of their parents."""
    corners = fine.cells.points[fine.cells.nodes]
    shares = barycentric(coarse.cells, parents, corners)
    return np.einsum("tvi,tic->tvc", shares, coordinates[parents])


def gaps_of(
    data: LimitData,
    shape: YieldShape,
    stress: AdmissibleStress | None,
    mechanism: Mechanism | None,
) -> np.ndarray:
    """Dissipation minus power of the stress on each cell; all of it without a stress."""
    cells = data.cells
    if mechanism is None:
        return cells.volume
    if stress is None:
        return mechanism.dissipated
    hats = times_hats(cells.N, mechanism.degree - 1)
    strain = mechanism.strain
    mean = np.einsum("tac,aj,tjc->t", strain, hats, stress.coordinates, optimize=True)
    gaps = mechanism.dissipated - cells.volume * mean
    return gaps + slip_gaps(data, shape, stress, mechanism)


def slip_gaps(
    data: LimitData, shape: YieldShape, stress: AdmissibleStress, mechanism: Mechanism
) -> np.ndarray:
    """The gaps of slips on facets; the cells on both sides get half of each."""
    cells = data.cells
    if not mechanism.slipped.any():
        return np.zeros(len(cells.nodes))
    N = cells.N
    tensors = np.einsum("tic,cpq->tipq", stress.coordinates, shape.basis)
    first = cells.sign > 0
    values = np.zeros((len(cells.facets), N, N, N))
    for k, vertices in enumerate(FACETS[N]):
        own = np.flatnonzero(first[:, k])
        facets = cells.facet_of[own, k]
        for m, i in enumerate(vertices):
            values[facets, cells.place[own, k, m]] = tensors[own, i]
    traction = np.einsum("fipq,fq->fip", values, cells.normal)
    slips = mechanism.slips
    hats = times_hats(N - 1, mechanism.degree)
    mean = np.einsum("fap,ai,fip->f", slips, hats, traction, optimize=True)
    power = cells.measure * mean
    gaps = mechanism.slipped + power
    owners = cells.owners
    sides = np.where(cells.outer, 1, 2)
    result = np.bincount(owners[:, 0], gaps / sides, minlength=len(cells.nodes))
    inside = ~cells.outer
    second = owners[inside, 1]
    return result + np.bincount(second, gaps[inside] / 2, minlength=len(result))


@dataclass(frozen=True, eq=False)
class Found:
    """The solution of the program of one bound.

    Parameters
    ----------
    field
        A stress or a mechanism; None if the solver found none.
    unknowns, steps, word
        Numbers of unknowns and of interior point steps, and the final status of the solver.
    price
        Of a lower bound: the strength of each cell times its multiplier, (nc,).  It is what the
        solver's own mechanism dissipates.
    """

    field: AdmissibleStress | Mechanism | None
    unknowns: int
    steps: int
    word: str
    price: np.ndarray | None = None


def lower_on(
    statics: Statics, centre: np.ndarray | None, accuracy: ConicAccuracy
) -> Found:
    """The best stress of a mesh, from an admissible ``centre``."""
    program = statics.program(statics.gain())
    count = len(program.cost)
    if centre is None:
        return Found(None, count, 0, "NoStress")
    found = cone_solution(program, accuracy)
    stress = None
    if np.isfinite(found.x).all() and found.status not in UNBOUNDED:
        x = statics.admissible(found.x, centre)
        stress = None if x is None else statics.stress(x)
    price = statics.price(found.multipliers[0])
    return Found(stress, count, found.steps, found.status, price)


def upper_on(
    velocities: ContinuousVelocities | SlidingVelocities, accuracy: ConicAccuracy
) -> Found:
    """The best mechanism of a mesh."""
    program = velocities.flow.program()
    found = cone_solution(program, accuracy)
    mechanism = None
    refused = found.status in (*INFEASIBLE, *UNBOUNDED)
    if not refused and np.isfinite(found.x).all():
        mechanism = velocities.mechanism(found.x)
    return Found(mechanism, len(program.cost), found.steps, found.status)


def velocities_on(
    data: LimitData, shape: YieldShape, degree: int
) -> ContinuousVelocities | SlidingVelocities:
    """The velocities of a mesh, of this degree in the plane."""
    if data.cells.N == 2:
        return ContinuousVelocities(data, shape, degree)
    return SlidingVelocities(data, shape)


def none_holds(above: Found, back: Callable[[], Found]) -> bool:
    """Whether mechanisms prove that no factor holds the constant loads.

    The program of the upper bound has no minimum then, or a negative value of any size.  A negative
    upper bound alone leaves factors that act the other way.  The upper bound of these is that of
    the reversed growing loads, ``back``: no factor is left if both add up to less than zero.
    """
    if above.field is None:
        return above.word in UNBOUNDED
    if above.field.factor >= 0:
        return False
    reversed_ = back()
    if reversed_.field is None:
        return reversed_.word in UNBOUNDED
    forwards, backwards = above.field.factor, reversed_.field.factor
    return forwards + backwards < -ROUNDED * (abs(forwards) + abs(backwards))


def reversed_data(data: LimitData) -> LimitData:
    """The same data with growing loads, or motions of supports, that act the other way."""
    force = data.force.copy()
    traction = data.traction.copy()
    force[GROWS] *= -1
    traction[GROWS] *= -1
    return replace(data, force=force, traction=traction, motion=-data.motion)


def locked(data: LimitData, below: Found, above: Found) -> np.ndarray:
    """Indicators of cells that hold the lower bound down where the mechanism does not flow.

    Gaps do not see them: there is no dissipation.  What the price of their strength exceeds
    ``EXCESS`` times the dissipation by counts as much as the bracket is wide.
    """
    if below.field is None or above.field is None:
        return np.zeros(len(data.bound))
    lower = below.field.factor
    width = (above.field.factor - lower) / max(abs(lower), TINY)
    flows = EXCESS * dissipation_of(data, above.field)
    excess = np.maximum(below.price - flows, 0.0)
    return min(width, 1.0) * excess


def dissipation_of(data: LimitData, mechanism: Mechanism) -> np.ndarray:
    """The dissipation of each cell and of its half of the slips on its facets."""
    cells = data.cells
    sides = np.where(cells.outer, 1, 2)
    shares = (mechanism.slipped / sides)[cells.facet_of]
    return mechanism.dissipated + shares.sum(axis=1)


def bracket_on(
    data: LimitData,
    shape: YieldShape,
    centre: np.ndarray | None,
    accuracy: ConicAccuracy = ACCURATE,
    within: float = 0.0,
    is_last: bool = False,
) -> tuple[MeshBracket, np.ndarray | None]:
    """Both bounds on a mesh, and the admissible stress that the lower bound starts from.

    ``accuracy`` is that of the conic programs.  In the plane, velocities of degree
    ``LAST_DEGREE`` are used for the upper bound once the relative width is at most ``within``; on
    a mesh that is expected to be the last one, from the start.
    """
    statics = Statics(data, shape)
    if centre is None:
        centre = centre_of(statics)
    below = lower_on(statics, centre, accuracy)
    flat = data.cells.N == 2
    degree = LAST_DEGREE if is_last else DEGREE
    above = upper_on(velocities_on(data, shape, degree), accuracy)

    def back() -> Found:
        """The best mechanism of the growing loads that act the other way."""
        return upper_on(velocities_on(reversed_data(data), shape, degree), accuracy)

    overloaded = below.field is None and none_holds(above, back)
    marks = gaps_of(data, shape, below.field, above.field)
    marks = marks + locked(data, below, above)
    both = below.field is not None and above.field is not None
    if flat and both and not is_last:
        width = above.field.factor - below.field.factor
        if width <= within * abs(below.field.factor):
            finest = ContinuousVelocities(data, shape, LAST_DEGREE)
            best = upper_on(finest, accuracy)
            if best.field is not None and best.field.factor < above.field.factor:
                above = best
    bracket = MeshBracket(
        data,
        shape,
        below.field,
        above.field,
        marks,
        below.word in UNBOUNDED,
        overloaded,
        (below.unknowns, above.unknowns),
        (below.steps, above.steps),
        (below.word, above.word),
    )
    return bracket, centre
