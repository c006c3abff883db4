"""The integral of phi over cells where strains are affine, from above.

phi is an elastic density, a quadratic that the points of a cell integrate exactly, less a convex
function G of the trial stress s.  s is affine, and G has a lower bound.  Sub-elements are a sum of
such laws.

In plane stress phi is the least of the densities of all eps_zz, and s is not affine.  But any
eps_zz gives an upper bound of phi.  The one that is affine on a part of a cell, and the best one at
the points of the part, makes s affine there.

With Hill's ellipsoid phi is the least over the plastic strain p of a quadratic q of e and p and a
convex H(p).  Any p gives an upper bound.  The p that is affine on a part, and the best one at its k
vertices, leaves the mean of H, which is at most the mean of its values there.  The mean of the
quadratic is that of its values at the vertices less k/(k + 1) of its mean at the differences from
the centre.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.bounds.flow_potentials import flow_potential, least_potential
from ngepc.bounds.polynomials import RULE, SPLIT, exceeding
from ngepc.discretisation.hill_law import HillLaw
from ngepc.discretisation.law import Law, Return
from ngepc.discretisation.overlay_law import OverlayLaw

PARTED_BY_FLOW = 2  # how often the parts of cells are split again with Hill's ellipsoid
PARTED = 2  # how often cells are split for lower bounds of integrals of a hardening law

AT_CORNERS = {3: 2 * np.eye(3)[[1, 2, 0]] - 1 / 3, 4: np.linalg.inv(RULE[4])}
"""Values of affine functions at the vertices from those at the three or four points."""

ToCorners = Callable[[np.ndarray], np.ndarray]
"""Maps values at the k points of cells, (points, c), to those at vertices, (cells, k, c)."""


def missed(law: Law, at: Return, area: np.ndarray, at_corners: ToCorners) -> np.ndarray:
    """Upper bounds of int phi over cells, less the values of the points, (cells,).

    ``law`` and ``at`` are those at the points of all cells, ``area`` (cells,) their sizes.
    """
    by_flow = isinstance(law, HillLaw)
    if law.across is None and not by_flow:
        return _missed(law, at, area, at_corners)
    k = len(at.size) // len(area)
    cells = np.flatnonzero(_may_yield(law, at, at_corners).reshape(-1, k).any(axis=1))
    result = np.zeros(len(area))
    if len(cells):
        means = _means_by_flow if by_flow else _means_across
        found = means(law, at, at_corners, cells).reshape(len(cells), -1).mean(axis=1)
        own = law.energy_density(at).reshape(-1, k).mean(axis=1)
        result[cells] = area[cells] * (found - own[cells])
    return result


def _may_yield(law: Law, at: Return, at_corners: ToCorners) -> np.ndarray:
    """Whether affine trial stresses are beyond the yield surface at the vertices, (points,)."""
    if isinstance(law, OverlayLaw):
        both = zip(law.parts, at.parts, strict=True)
        return np.any([_may_yield(one, there, at_corners) for one, there in both], 0)
    s = at_corners(at.trial)
    return law.measured(s.reshape(at.trial.shape)) > law.beta


def _law_at(
    law: Law, at: Return, at_corners: ToCorners, cells: np.ndarray, places: np.ndarray
) -> tuple[Law, Return]:
    """The law at places in some cells, which are barycentric coordinates (places, k)."""
    k = places.shape[1]
    inner = law.of(np.repeat(k * cells, len(places)))
    functions = (law.back, law.initial, at.volume[:, None], at.deviator)
    there = (
        np.matmul(places, at_corners(values)[cells]).reshape(-1, values.shape[1])
        for values in functions
    )
    inner.back, inner.initial, volume, deviator = there
    return inner, inner.returned(volume[:, 0], deviator)


def _means_across(
    law: Law, at: Return, at_corners: ToCorners, cells: np.ndarray
) -> np.ndarray:
    """Upper bounds of the means of phi over the parts of some cells, in plane stress."""
    shares = SPLIT[3]
    points = np.matmul(np.linalg.inv(AT_CORNERS[3]), shares).reshape(-1, 3)
    inner, inside = _law_at(law, at, at_corners, cells, points)

    def to_corners(values: np.ndarray) -> np.ndarray:
        """Values at the vertices of the parts."""
        return np.matmul(AT_CORNERS[3], values.reshape(-1, 3, values.shape[1]))

    means = inner.energy_density(inside).reshape(-1, 3).mean(axis=1)
    return means + _missed(inner, inside, np.ones(len(means)), to_corners)


def _means_by_flow(
    law: Law, at: Return, at_corners: ToCorners, cells: np.ndarray
) -> np.ndarray:
    """The same with Hill's ellipsoid, where the history is constant on cells."""
    k = len(at.size) // len(at_corners(at.trial))
    places = SPLIT[k]
    for _ in range(PARTED_BY_FLOW):
        places = np.matmul(SPLIT[k][:, None], places).reshape(-1, k, k)
    inner, inside = _law_at(law, at, at_corners, cells, places.reshape(-1, k))

    def deviations(values: np.ndarray) -> np.ndarray:
        """Values less their means over the vertices of the parts."""
        values = values.reshape(-1, k, values.shape[1])
        return values - values.mean(axis=1, keepdims=True)

    def squares(values: np.ndarray) -> np.ndarray:
        """Squared sizes of vectors at the vertices of the parts."""
        return np.einsum("tvd,tvd->tv", values, values)

    p = deviations(inside.plastic_strain)
    elastic = squares(deviations(inside.deviator) - p)
    volume = squares(deviations(inside.volume[:, None]))
    quadratic = inner.bulk.reshape(-1, k) * volume
    quadratic += inner.two_mu.reshape(-1, k) * elastic
    quadratic += inner.hardening.reshape(-1, k) * squares(p)
    at_vertices = inner.energy_density(inside).reshape(-1, k)
    return (at_vertices - k / (k + 1) * quadratic / 2).mean(axis=1)


def _missed(
    law: Law, at: Return, area: np.ndarray, at_corners: ToCorners
) -> np.ndarray:
    """The same for the strains that are affine and agree with the given ones at the points."""
    if isinstance(law, OverlayLaw):
        both = zip(law.parts, at.parts, strict=True)
        return sum(_missed(one, there, area, at_corners) for one, there in both)
    corners = at_corners(at.trial)
    if not law.resistance.is_constant:
        return _missed_by_any_law(law, at, corners, area)
    k = corners.shape[1]
    over = np.maximum(at.size - law.beta, 0.0).reshape(-1, k)
    summed = area * np.einsum("tq,tq->t", over, over) / k
    least = exceeding(corners, law.beta[::k], area)
    return (summed - least) / (2 * law.modulus[::k])


def _missed_by_any_law(
    law: Law, at: Return, corners: np.ndarray, area: np.ndarray
) -> np.ndarray:
    """The same for a nonlinear hardening law.

    G is the F of ``Conjugate`` with M = 2 mu_2 + h in place of h.
    """
    k = corners.shape[1]
    density = flow_potential(law.resistance, law.modulus, at.size, at.gained)
    summed = area * density.reshape(-1, k).mean(axis=1)
    cells = np.flatnonzero(at.yields.reshape(-1, k).any(axis=1))
    s = corners[cells]
    area = area[cells]
    for _ in range(PARTED):
        parts = len(SPLIT[k])
        s = np.matmul(SPLIT[k].reshape(-1, k), s).reshape(-1, k, s.shape[2])
        area, cells = (np.repeat(v, parts) for v in (area / parts, cells))
    first = k * cells
    resistance = law.resistance.of(first)
    found = least_potential(resistance, law.modulus[first], s, area)
    return summed - np.bincount(cells, found, minlength=len(summed))
