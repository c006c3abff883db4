"""An upper bound of the contact force of the solution, which is not known.

Let w vanish on supports.  Equilibrium of the solution's stress sigma and of sigma^, with contact
pressures P and P^ and springs K, says

    int (P - P^) [w . n] = int (sigma^ - sigma) : eps(w) + work of the springs' difference.

The dual functional is strongly convex: the difference of the stresses has at most the size
(2 B)^(1/2) with the error bound B, in the norm of the elastic energy.  So with m <= [w . n] <= 1

    m int P  <=  int P^ + (2 B |w|^2)^(1/2),   |w|^2 = int C eps(w) : eps(w) + int K w . w.
"""

from __future__ import annotations

import math

import numpy as np

from ngepc.bounds.balance import spring_energy
from ngepc.bounds.data import BoundData
from ngepc.bounds.outcome import ErrorBound
from ngepc.local.system import DiscreteProblem

LEAST = 0.1
"""Smallest m that is used."""


def elastic_square(discrete: DiscreteProblem, w: np.ndarray) -> float:
    """int C eps(w) : eps(w), from the elements whose nodes w (nodes, N) moves."""
    law = discrete.law
    moved = w.any(axis=1)
    total = 0.0
    for block in discrete.points.blocks:
        strained = np.flatnonzero(moved[block.nodes].any(axis=1))
        if not len(strained):
            continue
        part = block.of(strained)
        trace, *deviator = np.moveaxis(part.strain(w), 2, 0)
        density = law.bulk[part.points] * trace**2
        density += law.two_mu[part.points] * sum(s**2 for s in deviator)
        total += float(np.vdot(part.weights, density))
    return total


def largest_resultant(bound_data: BoundData, bound: ErrorBound) -> float:
    """No less than int P of the solution; infinite where it is not known.

    w has the mean normal at the vertices on contact.  It is not known with friction, nor where
    supports hold such vertices along the normal.
    """
    contact = bound_data.contact
    discrete = bound_data.discrete
    N = bound_data.cells.N
    vertices = contact.nodes[:, :N]
    w = np.zeros_like(bound.state.u)
    weighted = contact.measure[:, None] * contact.normal
    np.add.at(w, vertices, weighted[:, None])
    size = np.linalg.norm(w, axis=1, keepdims=True)
    w = discrete.supports.kept(w / np.where(size > 0, size, 1.0))

    along = contact.along(w)[:, :N]
    least = along.min(initial=1.0)
    if least < LEAST or bound_data.boundary.friction.any():
        return math.inf

    square = elastic_square(discrete, w) + 2 * spring_energy(discrete, w)
    difference = math.sqrt(2 * max(bound.total, 0.0) * square)

    moments = contact.moments(bound.pressure[:, :, None])[:, :N]
    force = moments.sum() * max(along.max(initial=1.0), 1.0)
    return float((force + difference) / least)
