"""Upper bounds of int phi(eps(u)) over triangles of a body of revolution."""

from __future__ import annotations

import math

import numpy as np

from ngepc.bounds.coverage import BUBBLE
from ngepc.bounds.flow_potentials import linear_below
from ngepc.bounds.polynomials import (
    MIDDLES,
    SPLIT,
    portions,
    quadratics,
    root_above,
    triangle_rule,
    worth_keeping,
)
from ngepc.bounds.ring_integrals import OverRadius
from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.discretisation.law import Law, Return
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.kinematics import AXISYMMETRIC

PAIRS = np.array(FACETS[2])
LEVELS = 5
BELOW = triangle_rule(12)


def coefficients_of(
    u: np.ndarray, discrete: DiscreteProblem, cells: Simplices
) -> np.ndarray:
    """Bernstein coefficients of a displacement (nodes, 2) on the triangles, (triangles, 6, 2)."""
    corners = u[cells.nodes]
    middles = corners[:, PAIRS].mean(axis=2)
    if discrete.problem.order == 2:
        nodes = discrete.points.blocks[0].nodes
        turned = nodes[:, 1] != cells.nodes[:, 1]
        edges = np.where(turned[:, None], nodes[:, [4, 5, 3]], nodes[:, [4, 3, 5]])
        middles = middles + BUBBLE / 2 * u[edges]
    return np.concatenate([corners, middles], axis=1)


def quadratics_at(places: np.ndarray) -> np.ndarray:
    """The polynomials of ``quadratics`` at points (..., 3)."""
    return quadratics(places.reshape(-1, 3)).reshape(*places.shape[:-1], 6)


def affine_products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Bernstein coefficients of products of affine functions (cells, 3), (cells, 3, ...)."""
    extra = (1,) * (second.ndim - 2)
    first = first.reshape(*first.shape, *extra)
    a = PAIRS[:, 0]
    b = PAIRS[:, 1]
    middle = (first[:, a] * second[:, b] + first[:, b] * second[:, a]) / 2
    return np.concatenate([first * second, middle], axis=1)


def strain_rows(coefficients: np.ndarray, cells: Simplices) -> np.ndarray:
    """Bernstein coefficients (triangles, 6, 4) of r times trace and deviator of the strain."""
    c = coefficients
    of_pair = np.zeros((3, 3), dtype=int)
    of_pair[np.arange(3), np.arange(3)] = np.arange(3)
    for k, (i, j) in enumerate(PAIRS):
        of_pair[i, j] = of_pair[j, i] = 3 + k
    # the derivative of a quadratic function at the vertices
    slopes = 2 * np.einsum("tia,tjib->tjba", cells.gradients, c[:, of_pair])
    r = cells.points[cells.nodes][:, :, 0]
    in_plane = affine_products(r, slopes)
    tensor = np.zeros((*in_plane.shape[:2], 3, 3))
    tensor[..., :2, :2] = (in_plane + in_plane.swapaxes(2, 3)) / 2
    tensor[..., 2, 2] = c[..., 0]
    trace = np.einsum("tkii->tk", tensor)
    deviator = np.einsum("dij,tkij->tkd", AXISYMMETRIC.basis, tensor)
    return np.concatenate([trace[..., None], deviator], axis=2)


def elastic_part(law: Law, at: Return) -> np.ndarray:
    """phi where nothing more yields."""
    total = at.trial + law.back
    history = law.two_mu * np.einsum("pd,pd->p", law.initial, law.initial)
    square = np.einsum("pd,pd->p", total, total)
    return (law.bulk * at.volume**2 + square / law.two_mu - history) / 2


class RingEnergy:
    """int 2 pi r phi(eps(u)) over the triangles, from above.

    ``strain`` (triangles, 6, 4) are Bernstein coefficients of r times the strain beyond the initial
    one, ``radii`` (triangles, 3) those of r.
    """

    def __init__(self, state: State, cells: Simplices) -> None:
        discrete = state.discrete
        self.cells = cells
        self.each = len(discrete.points) // len(cells.nodes)
        self.law = discrete.law.of(np.s_[:: self.each])
        self.radii = cells.points[cells.nodes][:, :, 0]
        flat = np.ones_like(self.radii)
        strain = strain_rows(coefficients_of(state.u, discrete, cells), cells)
        free = np.zeros((len(flat), 4))
        free[:, 0] = self.law.swelling
        free[:, 1:] = self.law.distortion
        self.strain = (
            strain - affine_products(self.radii, flat)[..., None] * free[:, None]
        )

    def elastic(self) -> np.ndarray:
        """Upper bounds of the elastic energy, (triangles,)."""
        R = affine_products(self.radii, np.ones_like(self.radii))
        Y = self.strain.copy()
        Y[..., 1:] -= R[..., None] * self.law.initial[:, None]
        area = self.cells.volume
        found = OverRadius(quadratics_at, self._form, 2, Y, self.radii, area).bound()
        history = self.law.two_mu * np.einsum(
            "td,td->t", self.law.initial, self.law.initial
        )
        return math.pi * (found - history * area * self.radii.mean(axis=1))

    def _form(self, Y: np.ndarray, cell: np.ndarray) -> np.ndarray:
        """Twice the elastic energy of strains Y (n, q, 4) in some triangles."""
        square = np.einsum("nqd,nqd->nq", Y[..., 1:], Y[..., 1:])
        bulk = self.law.bulk[cell, None]
        return bulk * Y[..., 0] ** 2 + self.law.two_mu[cell, None] * square

    def flow(self, allowed: float) -> np.ndarray:
        """Lower bounds of int 2 pi r G, where phi is the elastic energy less the convex G.

        Parts are cut until the sum of the differences from a rule is at most ``allowed``.
        """
        count = len(self.radii)
        result = np.zeros(count)
        cell = np.flatnonzero(self.may_yield())
        radii = self.radii[cell]
        strain = self.strain[cell]
        area = self.cells.volume[cell]
        for level in range(LEVELS + 1):
            lower, rule = self._flow_on_parts(strain, radii, cell)
            weight = 2 * math.pi * area
            gain = weight * np.maximum(rule - lower, 0.0)
            kept = worth_keeping(gain, allowed) | (level == LEVELS)
            found = (weight * lower)[kept]
            result += np.bincount(cell[kept], found, minlength=count)
            allowed -= float(gain[kept].sum())
            if kept.all():
                break
            strain = np.matmul(SPLIT[6], strain[~kept][:, None]).reshape(-1, 6, 4)
            radii = np.matmul(SPLIT[3], radii[~kept][:, None, :, None]).reshape(-1, 3)
            area = np.repeat(area[~kept] / 4, 4)
            cell = np.repeat(cell[~kept], 4)
        return result

    def trial(self, Y: np.ndarray, r: np.ndarray, of: np.ndarray) -> np.ndarray:
        """r times the trial stress s from r times the strain, (n, q, d)."""
        own = self.law.of(of)
        two_mu = own.two_mu[:, None, None]
        fixed = two_mu * own.initial[:, None] + own.back[:, None]
        return two_mu * Y[..., 1:] - r[..., None] * fixed

    def may_yield(self) -> np.ndarray:
        """Whether |s| exceeds beta somewhere in a triangle, (triangles,)."""
        R = affine_products(self.radii, np.ones_like(self.radii))
        S = self.trial(self.strain, R, np.arange(len(R)))
        return (np.linalg.norm(S, axis=2) > self.law.beta[:, None] * R).any(axis=1)

    def _flow_on_parts(
        self, Y: np.ndarray, radii: np.ndarray, cell: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The mean of r G over parts from below, and by a rule."""
        middles = np.matmul(quadratics(MIDDLES[3:]), Y)
        r = radii @ MIDDLES[3:].T
        mean_r = r.mean(axis=1)
        mean = middles.mean(axis=1) / mean_r[:, None]
        lower = mean_r * self.potential(mean[:, None], cell)[:, 0]
        inside = r[..., None] > 0  # an edge may lie on the axis
        at = np.divide(middles, r[..., None], out=np.zeros_like(middles), where=inside)
        at_middles = self.potential(at, cell)
        rule = (r * at_middles).mean(axis=1)
        sharper = self._where_all_yields(Y, radii, mean, cell)
        return np.maximum(lower, sharper), rule

    def _where_all_yields(
        self, Y: np.ndarray, radii: np.ndarray, mean: np.ndarray, cell: np.ndarray
    ) -> np.ndarray:
        """The mean of r G from below for parts that yield everywhere, zero for others.

        With S = r s and linear hardening it is that of |S|^2/r - 2 beta |S| + beta^2 r.
        """
        law = self.law.of(cell)
        R = affine_products(radii, np.ones_like(radii))
        S = self.trial(Y, R, cell)
        s = np.divide(S, R[..., None], out=np.zeros_like(S), where=R[..., None] > 0)
        inside = R > 0
        middle = self.trial(mean[:, None], np.ones((len(mean), 1)), cell)[:, 0]
        away = np.where(inside, np.linalg.norm(s - middle[:, None], axis=2), 0.0)
        size = np.linalg.norm(middle, axis=1)
        least = np.maximum(size - away.max(axis=1), 0.0)
        most = np.linalg.norm(s, axis=2).max(axis=1)
        g = law.gained_at(middle, law.modulus)
        found = linear_below(law.resistance, law.modulus, g, least, most)
        usable, beta, stiff, given = found
        usable &= (radii.min(axis=1) > 0) & np.isfinite(g)
        result = np.zeros(len(Y))
        for some in portions(int(usable.sum())):
            own = np.flatnonzero(usable)[some]
            square = squares_below(S[own], radii[own], beta[own])
            constant = radii[own].mean(axis=1) * given[own]
            result[own] = constant + square / (2 * stiff[own])
        return result

    def at(self, strain: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stress (n, q, 4) and density (n, q) at strains (n, q, 4) of some triangles."""
        law = self.law.of(np.repeat(of, strain.shape[1]))
        flat = strain.reshape(-1, 4)
        at = law.returned(flat[:, 0], flat[:, 1:])
        mean, deviator = law.stress(at)
        stress = np.concatenate([mean[:, None], deviator], axis=1)
        density = law.energy_density(at).reshape(strain.shape[:2])
        return stress.reshape(strain.shape), density

    def potential(self, strain: np.ndarray, of: np.ndarray) -> np.ndarray:
        """G at strains (n, q, 4) of some triangles, (n, q)."""
        q = strain.shape[1]
        law = self.law.of(np.repeat(of, q))
        flat = strain.reshape(-1, 4)
        at = law.returned(flat[:, 0], flat[:, 1:])
        found = elastic_part(law, at) - law.energy_density(at)
        return found.reshape(-1, q)


def squares_below(S: np.ndarray, radii: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """The mean of r (|S|/r - beta)^2 over parts from below, from coefficients (n, 6, d).

    1/r is at least c^-1 times the sum of (1 - r/c)^j for j < 8, and |S| at most ``root_above``.
    """
    shares, weights = BELOW
    values = np.matmul(quadratics(shares), S)
    square = np.einsum("nqd,nqd->nq", values, values)
    r = radii @ shares.T
    c = (radii.min(axis=1) + radii.max(axis=1))[:, None] / 2
    t = 1 - r / c
    inverse = (1 + t) * (1 + t**2) * (1 + t**4) / c
    size = root_above(square, (square @ weights)[:, None])
    b = beta[:, None]
    return (square * inverse - 2 * b * size + b**2 * r) @ weights
