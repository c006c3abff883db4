"""The setting of the bound for displacements of order two in the plane.

Strains are affine on each triangle, as are the stresses of Johnson and Mercier on its parts.  The
discrete energy sums over three points, which is exact but for the plastic term: what the bound
takes is no less than its integral.
"""

from __future__ import annotations

import numpy as np
from ngsolve import ET, IntegrationRule

from ngepc.bounds.equilibration import moments_of
from ngepc.bounds.parts import MIDDLES, SIX, SPLIT
from ngepc.bounds.plane import PlaneSetting, tensors
from ngepc.bounds.quartic import QuarticSpace
from ngepc.bounds.setting import LEVEL
from ngepc.bounds.tightening import Effort
from ngepc.bounds.triangles import PAIRS
from ngepc.local.system import DiscreteProblem, State

BUBBLE = -0.5
"""NGSolve's function of an edge is this times the product of the hat functions of its ends."""

AT_CORNERS = 2 * np.eye(3)[[1, 2, 0]] - 1 / 3
"""Values of affine functions at the vertices from those at the three points."""


_UNIT = np.eye(3)
_PARTS = [np.array([_UNIT[i], _UNIT[j], _UNIT.mean(axis=0)]) for i, j in PAIRS]
AT_POINTS, TO_NODES = (
    np.concatenate([shares @ part for part in _PARTS]) for shares in (SIX, MIDDLES)
)
"""Values at points and nodes of the sub-triangles from those at the vertices, (18, 3)."""

_SIX = IntegrationRule(ET.TRIG, 6)
RULE_POINTS = np.array([(x, y, 1 - x - y) for x, y, *_ in _SIX.points])
RULE_WEIGHTS = 2 * np.array(_SIX.weights)
"""A rule of degree six, its weights add up to one."""

NARROW = 0.1
"""Parts are split where |s|^2 varies by more than this share."""

SPLIT_LEVELS = 3
"""How often at most."""


class QuadraticSetting(PlaneSetting):
    """``PlaneSetting`` for order two, with quadratic stresses."""

    airy, effort = QuarticSpace, Effort(gain=0.01, steps=40)

    def __init__(self, discrete: DiscreteProblem) -> None:
        super().__init__(discrete)
        c, nodes = self.cells, discrete.points.blocks[0].nodes
        self._turned = nodes[:, 1] != c.nodes[:, 1]
        self._bubble = np.empty(len(c.facets), dtype=int)
        for k, ends in enumerate(((2, 0), (1, 2), (0, 1))):
            self._bubble[c.facets_between(nodes[:, ends])] = nodes[:, 3 + k]
        history = discrete.law.back, discrete.law.initial
        if any(np.ptp(values.reshape(len(c.nodes), 3, -1), axis=1).any() for values in history):
            corners = [self.at_corners(values) for values in history]
            self.conjugate, self.at_nodes = (
                self.conjugate.with_history(*(np.matmul(shares, values) for values in corners))
                for shares in (AT_POINTS, TO_NODES)
            )

    def at_corners(self, values: np.ndarray) -> np.ndarray:
        """Values at the vertices (nt, 3, c) of affine functions given at the points (., c)."""
        result = np.matmul(AT_CORNERS, values.reshape(len(self.cells.nodes), 3, -1))
        result[self._turned, 1:] = result[self._turned, :0:-1]
        return result

    def strain(self, state: State) -> np.ndarray:
        """Strain coordinates at the points of the sub-triangles, shape (nt, 18, 3)."""
        return np.matmul(AT_POINTS, self.at_corners(self.point_strain(state)))

    def gaps(self, state: State, z: np.ndarray) -> np.ndarray:
        """int [phi(eps) - sigma : eps] over each triangle for stresses at the points."""
        work = np.einsum("tqc,tqc->tq", z, self.strain(state)) @ self.space.weights
        return self.phi(state) - self.cells.volume * work

    def phi(self, state: State) -> np.ndarray:
        """No less than int phi(eps(u)) over each triangle."""
        return super().phi(state) + self._missed(state)

    def energy(self, state: State) -> float:
        """No less than J(u)."""
        return super().energy(state) + float(self._missed(state).sum())

    def _missed(self, state: State) -> np.ndarray:
        """By how much the sum over the points may be below the integral, for each triangle."""
        law, area = self.conjugate, self.cells.volume
        over = np.maximum(state.at.size - self.discrete.law.beta, 0.0).reshape(-1, 3)
        summed = area * np.einsum("tq,tq->t", over, over) / 3
        least = exceeding(self.at_corners(state.at.trial), law.beta, area)
        return (summed - least) / (2 * (law.two_mu + law.hardening))

    def feasible(self, u: np.ndarray) -> np.ndarray:
        """As for order one; a parabola below zero at its ends must not rise above between them."""
        u, on = super().feasible(u), self.boundary.contact
        room = np.sqrt(np.maximum(self.boundary.gap - self.normal_displacement(u), 0.0))
        most = room.sum(axis=1) ** 2
        bubble = self._bubble[on]
        n = np.where(self.discrete.supports.free[bubble], self.cells.normal[on], 0.0)
        square = np.einsum("ec,ec->e", n, n)
        above = BUBBLE * self._rise(u) - most
        deep = above > 0
        if (square[deep] <= LEVEL).any():
            raise RuntimeError("the displacement could not be moved clear of the obstacle")
        u[bubble[deep]] -= n[deep] * (above[deep] / square[deep] / BUBBLE)[:, None]
        return u

    def _rise(self, u: np.ndarray) -> np.ndarray:
        """The normal component of the unknowns of the contact edges."""
        on = self.boundary.contact
        return np.einsum("ec,ec->e", u[self._bubble[on]], self.cells.normal[on])

    def loads(self, state: State, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As for order one; the forces are those on all nodes."""
        moments, forces = super().loads(state, P)
        result = np.zeros_like(state.u)
        result[: len(forces)] = forces
        result[self._bubble[self.boundary.contact]] = self._moment(self.pushed(state, P))
        return moments, result

    def _moment(self, traction: np.ndarray) -> np.ndarray:
        """The integral of tractions (n, 2, 2) times the functions of the contact edges, (n, 2)."""
        measure = self.cells.measure[self.boundary.contact]
        return BUBBLE / 12 * measure[:, None] * traction.sum(axis=1)

    def contact_gaps(self, state: State, P: np.ndarray) -> np.ndarray:
        """As for order one, with the parts of u that vanish at the vertices."""
        bubble = self._bubble[self.boundary.contact]
        pushed = self._moment(self.pushed(state, P)) * state.u[bubble]
        dragged = self._moment(self.friction(state)) * self.start[bubble]
        return super().contact_gaps(state, P) - (pushed - dragged).sum(axis=1)

    def friction_works(self, state: State) -> np.ndarray:
        """No less than int F |slip| over each contact edge, from Bernstein coefficients of slip."""
        F, on = self.boundary.friction, self.boundary.contact
        ends, bent = self.slip(state.u), (state.u - self.start)[self._bubble[on]]
        middle = ends.mean(axis=1) + BUBBLE / 2 * self.across(bent[:, None])[:, 0]
        total = F.sum(axis=1, keepdims=True)
        works = (F / 6 + total / 12) * np.linalg.norm(ends, axis=2)
        works = works.sum(axis=1) + total[:, 0] / 6 * np.linalg.norm(middle, axis=1)
        return self.cells.measure[on] * works

    def means(self, stress: np.ndarray) -> np.ndarray:
        """The means on the triangles, shape (nt, 3), of stresses at the points."""
        return stress.reshape(len(self.cells.nodes), 3, -1).mean(axis=1)

    def centre(self, stress: np.ndarray) -> np.ndarray:
        """Stresses at the points as those at the points of the sub-triangles, (nt, 18, 3)."""
        return np.matmul(AT_POINTS, self.at_corners(stress))

    def wished(self, stress: np.ndarray) -> np.ndarray:
        """Moments (ne, 2, 2) of the mean tractions of both triangles."""
        t, sigma = self.cells, tensors(self.at_corners(stress))
        n, total = t.normal[t.facet_of], np.zeros((2 * len(t.facets), 2))
        for k, pair in enumerate(PAIRS):
            for end, v in enumerate(pair):
                traction = np.matmul(sigma[:, v], n[:, k, :, None])[:, :, 0]
                slot = 2 * t.facet_of[:, k] + t.place[:, k, end]
                total += np.stack(
                    [np.bincount(slot, w, minlength=len(total)) for w in traction.T], axis=1
                )
        count = np.where(t.outer, 1.0, 2.0)[:, None, None]
        return moments_of(total.reshape(-1, 2, 2) / count, t.measure)


def exceeding(s: np.ndarray, beta: np.ndarray, area: np.ndarray) -> np.ndarray:
    """No more than int ([|s| - beta]_+)^2, exact up to the fourth power of the variation of s.

    Where |s| > beta everywhere that is |s|^2 - 2 beta |s| + beta^2, and with r = |s|^2/c - 1

        |s| <= c^(1/2) (1 + r/2 - r^2/8 + r^3/16),

    a polynomial of degree six.  Elsewhere |s| >= d : s for a unit vector d, and the square is at
    least 2 theta (d : s - beta) - theta^2 for affine theta >= 0.

    Parameters
    ----------
    s
        Values of an affine function at the vertices of the triangles, shape (n, 3, d).
    beta, area
        Shapes (n,).
    """
    result, cell = np.zeros(len(s)), np.arange(len(s))
    for level in range(SPLIT_LEVELS + 1):
        out = (np.einsum("tvd,tvd->tv", s, s) > beta[:, None] ** 2).any(axis=1)
        s, beta, area, cell = s[out], beta[out], area[out], cell[out]
        found, narrow = _exceeding(s, beta)
        done = narrow if level < SPLIT_LEVELS else np.ones(len(s), dtype=bool)
        result += np.bincount(cell[done], (area * found)[done], minlength=len(result))
        parts = len(SPLIT[3])
        s = np.matmul(SPLIT[3].reshape(-1, 3), s[~done]).reshape(-1, 3, s.shape[2])
        beta, area, cell = (np.repeat(v[~done], parts) for v in (beta, area / parts, cell))
    return result


def _exceeding(s: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bound over the area without splitting, and where that is accurate."""
    values, mean = np.matmul(RULE_POINTS, s), s.mean(axis=1)
    square = np.einsum("tqd,tqd->tq", values, values)
    middle = (square @ RULE_WEIGHTS)[:, None]
    r, beta = square / middle - 1, beta[:, None]
    size = np.sqrt(middle) * (1 + r * (1 / 2 - r * (1 / 8 - r / 16)))
    whole = (square - 2 * beta * size + beta**2) @ RULE_WEIGHTS
    length = np.linalg.norm(mean, axis=1)
    direction = mean / np.where(length > 0, length, 1.0)[:, None]
    along = np.einsum("tvd,td->tv", s, direction) - beta
    theta = np.maximum(along, 0.0)
    twice = 2 * along - theta
    part = (theta.sum(axis=1) * twice.sum(axis=1) + np.einsum("tv,tv->t", theta, twice)) / 12
    outside = (along >= 0).all(axis=1)
    narrow = outside & (np.abs(r).max(axis=1, initial=0.0) <= NARROW)
    return np.maximum(np.where(outside, np.maximum(whole, part), part), 0.0), narrow
