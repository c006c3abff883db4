"""What a velocity that is nearly free of divergence dissipates at most, with rounding enclosed.

The velocity v of a mechanism has a divergence r that rounding leaves, a polynomial of degree m on
each cell.  A velocity w with div w = -r, and w . n = 0 where supports or obstacles are, makes v + w
admissible.  It may slide along facets, which dissipates beta |slip| / 2^(1/2).

1. With barycentric coordinates l and Bernstein polynomials B the field
   B_(b + e_i + e_j) (x_i - x_j) / (m + 1) has the divergence B_(b + e_j) - B_(b + e_i), and goes
   through no facet.  At most m such steps lead from one multi-index to another: sum |c_a| m of them
   remove the part sum c_a B_a of r whose mean is zero.
2. The mean of r leaves the cell along a tree of cells, whose way ends where the boundary is free.
   The flux Q of a facet has the field Q (x - x_F) / (N |T|), with the vertex x_F opposite to it.
   It is a dilatation, of which only the slips dissipate.

The dissipation of w is added to that of v, and its power is taken from, or added to, that of v.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.enclosed import LARGER, UNIT, Enclosed
from ngepc.limit.flow import DissipatedPart
from ngepc.limit.outline import Outline, Tree, connected_parts, tree_from
from ngepc.limit.yielding import SLIP, YieldShape
from ngepc.linalg.bernstein import distinct_parts, multi_indices, raised, times_hats


@dataclass(frozen=True, eq=False)
class Removal:
    """What it takes to remove a divergence.

    Parameters
    ----------
    dissipated
        Bound of the dissipation of w on each cell and its facets, (nc,).
    power
        Bounds of the power of the loads that grow and of those that stay.
    """

    dissipated: np.ndarray
    power: tuple[float, float]


def removal(
    data: LimitData, outline: Outline, divergence: np.ndarray, degree: int
) -> Removal:
    """The removal of divergences with these bounds of Bernstein coefficients times the volume.

    Parameters
    ----------
    data
        Loads, supports, obstacles, strength.
    outline
        Of the cells.
    divergence
        Bounds of the sizes of the coefficients times the volume, (nc, n).
    degree
        Of these polynomials.
    """
    cells = data.cells
    N = cells.N
    volume = outline.volumes.least
    areas = outline.areas.length()
    around = areas.sum(axis=1)
    x = cells.points[cells.nodes]
    longest = np.linalg.norm(x[:, :, None] - x[:, None], axis=3).max(axis=(1, 2))
    means = divergence.mean(axis=1)
    uneven = (divergence + means[:, None]).sum(axis=1) if degree else 0 * means
    # over the volume; each is moved at most ``degree`` steps
    steps = degree * uneven / volume
    speed = steps * longest / (degree + 1)
    # the gradient of a hat function is the size of the opposite facet over N |T|
    share = 1 / math.comb(degree + N, N)
    strained = steps * longest * around / N * share
    through = _fluxes(data, means)[cells.facet_of].sum(axis=1)
    speed = (speed + through * longest / (N * volume)) * LARGER
    return _of_speeds(data, outline, speed, strained * LARGER)


def _fluxes(data: LimitData, means: np.ndarray) -> np.ndarray:
    """Bounds of the fluxes through facets that lead the means of divergences out of the body."""
    cells = data.cells
    outer = cells.outer & ~data.contact
    normal = np.einsum("frp,fp->fr", data.frame, cells.normal)
    held = np.arange(cells.N) < data.held[:, None]
    closed = (np.abs(np.where(held, normal, 0.0)) > 0).any(axis=1)
    tree = tree_from(cells, np.flatnonzero(outer & ~closed))
    result = np.zeros(len(cells.facets))
    if _fills_while_closed(data, tree):
        return result + np.inf
    flux = tree.sums(means)
    leaves = tree.facet >= 0
    result[tree.facet[leaves]] = flux[leaves]
    return result


def _fills_while_closed(data: LimitData, tree: Tree) -> bool:
    """Whether a part without a free boundary has normal speeds on its boundary.

    They need not add up to zero exactly; elsewhere the means of divergences do.
    """
    cells = data.cells
    ends = np.flatnonzero(tree.facet < 0)
    parts = connected_parts(cells)
    inside = np.isin(parts, parts[ends])[cells.owners[:, 0]] & cells.outer
    normal = np.einsum("fvp,fp->fv", data.motion, cells.normal)
    moves = data.contact | (normal != 0).any(axis=1)
    return bool((inside & moves).any())


def _of_speeds(
    data: LimitData, outline: Outline, speed: np.ndarray, strained: np.ndarray
) -> Removal:
    """Dissipation and power for bounds of the speed and of the integral of the gradient."""
    cells = data.cells
    areas = outline.areas.length()
    rubbed = data.friction.max(axis=1)[cells.facet_of]
    resistance = SLIP * data.bound[:, None] + rubbed
    slipped = (resistance * areas).sum(axis=1) * speed
    dissipated = (data.bound * strained + slipped) * LARGER
    powers = []
    owner = cells.owners[cells.outer, 0]
    for kind in (GROWS, STAYS):
        force = np.linalg.norm(data.force[kind], axis=1) * outline.volumes.size
        pull = np.linalg.norm(data.traction[kind], axis=2).max(axis=1) * outline.sizes
        whole = (force * speed).sum() + (pull[cells.outer] * speed[owner]).sum()
        powers.append(float(whole) * LARGER)
    return Removal(dissipated, tuple(powers))


ROUNDED = 1e-13
"""Relative rounding error of sums of lengths, beyond those of their vectors."""

CUTS = {2: 12, 3: 8}
"""Edges of a cell are cut into so many parts to integrate the dissipation of a solution."""


def gradients(outline: Outline, values: Enclosed, degree: int) -> Enclosed:
    """Bernstein coefficients of velocity gradients times the volume, (nc, m, N, N).

    ``values`` are those of the velocities, (nc, n, N).
    """
    N = outline.cells.N
    above = raised(N, degree - 1)
    slopes = outline.areas * Enclosed(-degree / N, np.spacing(degree / N))
    changes = values[:, above[:, 1:]] - values[:, above[:, :1]]
    return (changes[..., None] * slopes[:, None, 1:, None]).sum(axis=2)


def coordinates(shape: YieldShape, gradient: Enclosed) -> tuple[np.ndarray, np.ndarray]:
    """Strain rates in the basis of a yield condition, and bounds of the lengths of their errors."""
    rates = np.einsum("cpq,tapq->tac", shape.basis, gradient.middle)
    size = np.linalg.norm(shape.basis.reshape(shape.size, -1), 2)
    error = np.linalg.norm(gradient.radius, axis=(2, 3))
    rounded = 16 * UNIT * np.linalg.norm(gradient.middle, axis=(2, 3))
    return rates, size * (error + rounded) * LARGER


def dissipation(N: int, strain: np.ndarray, error: np.ndarray) -> np.ndarray:
    """No less than the integrals of |strain|, from its coefficients (nc, m, s) times the volume.

    ``error`` (nc, m) bounds the errors of their lengths.
    """
    parts, weights = distinct_parts(N, _degree(N, strain.shape[1]), CUTS[N])
    sizes = np.linalg.norm(parts @ strain, axis=2) @ weights
    largest = np.linalg.norm(strain, axis=2).max(axis=1)
    return sizes + error.max(axis=1) + ROUNDED * largest


def _degree(N: int, count: int) -> int:
    """The degree of polynomials with so many coefficients on a simplex."""
    degree = 0
    while math.comb(degree + N, N) < count:
        degree += 1
    return degree


def divergences(gradient: Enclosed) -> np.ndarray:
    """Bounds of the sizes of the traces of gradients."""
    N = gradient.middle.shape[-1]
    trace = gradient[..., 0, 0]
    for i in range(1, N):
        trace = trace + gradient[..., i, i]
    return trace.size


def strain_rates(
    data: LimitData,
    shape: YieldShape,
    outline: Outline,
    velocity: Enclosed,
    degree: int,
) -> tuple[np.ndarray, np.ndarray, Removal]:
    """Strain rates of a velocity as of ``coordinates``, and what removes their divergence."""
    gradient = gradients(outline, velocity, degree)
    strain, error = coordinates(shape, gradient)
    if not shape.free:
        return strain, error, NOTHING
    left = divergences(gradient)
    return strain, error, removal(data, outline, left, degree - 1)


def rubbed(parts: Sequence[DissipatedPart], y: np.ndarray, fastest: float) -> float:
    """What friction dissipates at most at unknowns y, with speeds up to ``fastest``."""
    total = 0.0
    for part in parts:
        lengths = part.lengths(y) + ROUNDED * fastest
        total += float(part.weights @ lengths) * (1 + ROUNDED)
    return total


def power_of(
    data: LimitData, outline: Outline, values: Enclosed, degree: int, kind: int
) -> Enclosed:
    """The power of the loads that grow or stay, one number."""
    cells = data.cells
    N = cells.N
    share = Enclosed(1 / len(multi_indices(N, degree)))
    mean = values.sum(axis=1) * share
    by_volume = (mean * data.force[kind]).sum(axis=1) * outline.volumes
    owner, place = outline.first
    outer = cells.outer
    owner = owner[outer]
    place = place[outer]
    hats = Enclosed(times_hats(N - 1, degree), 4 * UNIT)
    loads = data.traction[kind][outer]
    weights = hats[None, :, :, None] * loads[:, None]
    weights = weights.sum(axis=2)
    on_facet = values[owner[:, None], of_facet(cells, owner, place, degree)]
    by_area = (on_facet * weights).sum(axis=2).sum(axis=1) * outline.measures()[outer]
    terms = np.concatenate([by_volume.middle, by_area.middle])
    radius = by_volume.radius.sum() + by_area.radius.sum()
    radius += 4 * UNIT * np.abs(terms).sum()
    return Enclosed(math.fsum(terms), radius * LARGER)


def of_facet(
    cells: Simplices, owner: np.ndarray, place: np.ndarray, degree: int
) -> np.ndarray:
    """Places of the coefficients of facets, in their order, among those of these cells, (k, m)."""
    N = cells.N
    own = multi_indices(N - 1, degree)
    numbers = {tuple(a): k for k, a in enumerate(multi_indices(N, degree))}
    vertices = np.array(FACETS[N])[place]
    order = np.take_along_axis(vertices, np.argsort(cells.place[owner, place]), axis=1)
    result = np.empty((len(owner), len(own)), dtype=int)
    ways, kinds = np.unique(order, axis=0, return_inverse=True)
    for k, way in enumerate(ways):
        found = []
        for a in own:
            whole = np.zeros(N + 1, dtype=int)
            whole[way] = a
            found.append(numbers[tuple(whole)])
        result[kinds.ravel() == k] = found
    return result


@dataclass(frozen=True, eq=False)
class Proved:
    """An upper bound with rounding enclosed.

    Parameters
    ----------
    factor
        The bound of the load factor.
    power
        No more than the power of the loads that grow.
    dissipated
        The dissipation of each cell, with that of what removes divergences.
    """

    factor: float
    power: float
    dissipated: np.ndarray


def proved(
    data: LimitData,
    powers: tuple[Enclosed, Enclosed],
    removed: Removal,
    dissipated: np.ndarray,
    others: float,
) -> Proved:
    """The upper bound for what cells, and others, dissipate.

    Parameters
    ----------
    data
        Loads, supports, obstacles, strength.
    powers
        Of the loads that grow and of those that stay.
    removed
        What removes the divergence.
    dissipated, others
        Dissipation of each cell, (nc,), and of facets.
    """
    dissipated = (dissipated + removed.dissipated) * LARGER
    total = (math.fsum(dissipated) + others) * LARGER
    stays = powers[STAYS]
    total += removed.power[STAYS] + float(stays.radius) - float(stays.middle)
    total += 4 * UNIT * (abs(total) + float(stays.size))
    power = 1.0
    most = 1.0
    if not data.moves:
        unsure = (float(powers[GROWS].radius) + removed.power[GROWS]) * LARGER
        power = float(powers[GROWS].middle) - unsure
        most = float(powers[GROWS].middle) + unsure
    if power <= 0:
        return Proved(math.inf, 1.0, dissipated)
    factor = total / (power if total > 0 else most)
    return Proved(factor + 4 * UNIT * abs(factor), power, dissipated)


NOTHING = Removal(np.zeros(1), (0.0, 0.0))
"""Where the divergence is free."""
