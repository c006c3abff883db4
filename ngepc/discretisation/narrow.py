"""Obstacles that stand nearer between the nodes of a facet: spikes, ribs and tips of a gap.

The gap of a row comes from the polynomial P through the gap at the nodes of its facets, and a
narrow spike between them is missed.  The gap is therefore looked at on the lattice of ``Scan``.  It
is smooth on a facet if a cubic function misses little of what an affine one misses: gaps of discs,
spheres and planes are what they are at the nodes.  Elsewhere, where the obstacle stands nearer than
at all corners, the coefficients of P are at least the least gap seen, and are lowered until P is
nowhere above the gap on the lattice: rows without penetration mean no overlap at its points.  A
gap that jumps once stands no nearer than at the corners; it has a limiter (``gap_records``).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from ngsolve import ET

from ngepc.discretisation.facets import FacetNodes, hats
from ngepc.discretisation.lattices import Piece, cubics, lattice
from ngepc.discretisation.sampling import AT_ONCE, Scan

SMOOTH = 0.05
"""Part of what an affine function misses that a cubic one may miss of a smooth gap."""
DEEPER = 0.25
"""Part of the largest P - gap, at least, by which obstacles stand nearer than at the corners."""
PASSES = 100
"""Largest number of points at which a polynomial is lowered one after the other."""
EXACT = 1e-13
"""Overlap that counts as rounding, relative to the largest."""


def clear_of(
    scan: Scan,
    facet: FacetNodes,
    numbers: np.ndarray,
    gap: np.ndarray,
    least: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The least coefficient of the gap of each node, and by how much it is lowered, (facets, k).

    Parameters
    ----------
    scan
        The gap of a boundary.
    facet, numbers
        The nodes of its facets of one shape, and their numbers.
    gap, least
        The gap at the nodes and the least coefficients of gaps that jump, (facets, k).
    """
    least = least.copy()
    lowered = np.zeros(gap.shape)
    varies = np.flatnonzero(np.isin(numbers, scan.hidden))
    if not len(varies):
        return least, lowered
    places = lattice_of(facet.shape, scan.count)
    basis = facet.basis(places)
    affine = hats(facet.shape, places)
    corner = gap[:, : affine.shape[1]]
    together = max(AT_ONCE // len(places), 1)
    for first in range(0, len(varies), together):
        some = varies[first : first + together]
        seen, missed = _looked_at(scan, facet.shape, numbers[some])
        bent = np.abs(seen - corner[some] @ affine.T).max(axis=1)
        nearest = seen.min(axis=1)
        limit = np.maximum(least[some], nearest[:, None])
        polynomials = np.maximum(gap[some] @ facet.coefficients.T, limit)
        above = (polynomials @ basis.T - seen).max(axis=1)
        depth = corner[some].min(axis=1) - nearest
        narrow = (missed > SMOOTH * bent) & (depth > DEEPER * np.maximum(above, 0.0))
        for k in np.flatnonzero(narrow & np.isfinite(above)).tolist():
            one = some[k]
            least[one] = limit[k]
            lowered[one] = polynomials[k] - cleared(polynomials[k], basis, seen[k])
    return least, lowered


def cleared(coefficients: np.ndarray, basis: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """Coefficients (k,) of a polynomial that is nowhere above the gap, at most the given ones.

    All fall by the same until the polynomial clears the gap where it was most above it; those that
    have reached the least gap stay there.  ``basis`` (points, k) >= 0 has the sum 1 at each point.
    """
    least = gap.min()
    found = coefficients.copy()
    excess = basis @ found - gap
    rounding = EXACT * excess.max()
    for _ in range(PASSES):
        worst = int(excess.argmax())
        if excess[worst] <= rounding:
            return found
        above = found > least
        fall = excess[worst] / basis[worst, above].sum()
        found[above] = np.maximum(found[above] - fall, least)
        excess = basis @ found - gap
    return np.minimum(coefficients, least)


@cache
def lattice_of(shape: ET, count: int) -> np.ndarray:
    """The points of the lattice in a reference facet, (points, dimension)."""
    pieces = Piece.all(shape)
    shares = [lattice(one.dim, count)[1] @ one.corners for one in pieces]
    return np.concatenate(shares)[:, :-1]


def _looked_at(
    scan: Scan, shape: ET, numbers: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The gap on the lattice of facets, (facets, points), and what cubic functions miss of it."""
    basis = cubics(scan.dim, scan.count)
    values = [scan.on_lattice(numbers, piece)[:, :, 0] for piece in Piece.all(shape)]
    missed = [np.abs(v - v @ basis @ basis.T).max(axis=1) for v in values]
    return np.concatenate(values, axis=1), np.max(missed, axis=0)
