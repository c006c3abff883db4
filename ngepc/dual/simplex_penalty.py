"""M^2 on straight simplices with constant data: the same integrals, in vectorised arithmetic.

There q is affine on each element, so that its values at the points of a rule are the vertex
values times barycentric coordinates, and the element matrices of Lemma 6.3 are moments of a few
scalars.  Elements below the threshold are never looked at; where a kink crosses, the rule is the
one of ``PlasticPenalty``, point by point.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import ET, FESpace, Integrate, IntegrationRule
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.checks.arguments import is_number
from ngepc.discretisation.elements import element_vertices
from ngepc.discretisation.quadrature import (
    HIGHEST_ORDER,
    SMOOTH_ORDER,
    SMOOTH_VARIATION,
    order_with_points,
)
from ngepc.dual.penalty import TINY
from ngepc.dual.regularisation import Regularisation
from ngepc.dual.simplex_pattern import SimplexPattern
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.tensors import coordinates_count
from ngepc.parallel import total

GENTLE = ((SMOOTH_VARIATION, SMOOTH_ORDER), (0.25, 15), (0.5, 21))
"""(variation of q, order): what integrates a function of |q| without a kink to rounding."""

CHUNK_POINTS = 1 << 15
"""Points that are looked at together: their arrays fit into the cache."""


@dataclass(frozen=True)
class Barycentric:
    """A rule on the simplex.

    Parameters
    ----------
    points
        Barycentric coordinates in the order of the vertices, shape (n, N+1).
    weights
        Weights with sum 1, shape (n,).
    """

    points: np.ndarray
    weights: np.ndarray

    @classmethod
    def of_order(cls, dim: int, order: int) -> Barycentric:
        """NGSolve's rule of that order."""
        rule = IntegrationRule(ET.TRIG if dim == 2 else ET.TET, order)
        x, w = np.array(rule.points), np.array(rule.weights)
        return cls(np.column_stack([x, 1 - x.sum(axis=1)]), w / w.sum())

    @cached_property
    def first_moments(self) -> np.ndarray:
        """Weights times each coordinate, shape (n, N+1)."""
        return self.weights[:, None] * self.points

    @cached_property
    def second_moments(self) -> np.ndarray:
        """Weights times the products of coordinates i <= j, shape (n, (N+1)(N+2)/2)."""
        i, j = np.triu_indices(self.points.shape[1])
        return self.first_moments[:, i] * self.points[:, j]


@dataclass(frozen=True)
class Batch:
    """Elements that one rule integrates.

    Parameters
    ----------
    elements
        Their numbers.
    rule
        The rule.
    values
        q at their vertices, shape (d, elements, N+1).
    volumes
        Their volumes.
    """

    elements: np.ndarray
    rule: Barycentric
    values: np.ndarray
    volumes: np.ndarray

    def at_points(self) -> list[np.ndarray]:
        """Each component of q at the points, shape (elements, n)."""
        return [component @ self.rule.points.T for component in self.values]


class SimplexPenalty:
    """M^2 of ``PlasticPenalty`` for constant gamma_q and threshold on straight simplices.

    Parameters
    ----------
    problem, regularisation, R, quadrature_points
        As for ``PlasticPenalty``.
    """

    def __init__(
        self, problem: Problem, regularisation: Regularisation, R: FESpace, quadrature_points: int
    ) -> None:
        self._gamma, self._threshold = constants(problem, regularisation)
        mesh, N = problem.mesh, problem.N
        nodes = element_vertices(mesh)
        self._nodes = nodes[0] if nodes else np.zeros((0, N + 1), int)
        self._volumes = np.array(Integrate(as_scalar(1.0), mesh, element_wise=True))
        self._vertices = mesh.nv
        shape = ET.TRIG if N == 2 else ET.TET
        fine = min(order_with_points(shape, quadrature_points), HIGHEST_ORDER)
        gentle = [g for g in GENTLE if g[1] in (SMOOTH_ORDER, min(g[1], fine))]
        self._variations = np.array([variation for variation, _ in gentle])
        orders = [*(order for _, order in gentle), fine]
        self._rules = [Barycentric.of_order(N, order) for order in orders]
        self._mesh, self._q = mesh, BaseVector(R.ndof)
        self._components = coordinates_count(N)
        self._pattern = SimplexPattern(R, self._nodes, self._components)
        self._sorted_at: np.ndarray | None = None

    def _batches(self, q: BaseVector, rules: list[Barycentric] | None = None) -> Iterator[Batch]:
        """The elements beyond the threshold, by the rule they need, in pieces."""
        values = np.asarray(q.FV()).reshape(self._components, -1)
        if self._sorted_at is None or not np.array_equal(values, self._sorted_at):
            self._classes = self._sort(values)
            self._sorted_at = values.copy()
        for rule, elements in zip(rules or self._rules, self._classes, strict=True):
            size = max(1, CHUNK_POINTS // len(rule.weights))
            for first in range(0, len(elements), size):
                piece = elements[first : first + size]
                yield Batch(piece, rule, values[:, self._nodes[piece]], self._volumes[piece])

    def _sort(self, values: np.ndarray) -> list[np.ndarray]:
        """Element numbers for each rule; those below the threshold are in none.

        |q| is convex, so that vertex values bound it from above; along the mean direction q is
        affine, so that they bound it from below.
        """
        beyond = np.sqrt((values * values).sum(axis=0)) > self._threshold
        if not beyond.any():
            return [np.zeros(0, int) for _ in self._rules]
        touched = np.flatnonzero(beyond[self._nodes].any(axis=1))
        corner = values[:, self._nodes[touched].T]  # components, vertices, elements
        mean = corner.mean(axis=1)
        mean /= np.sqrt((mean * mean).sum(axis=0)) + 1e-300
        along = (corner * mean[:, None]).sum(axis=0).min(axis=0)
        corner -= corner.mean(axis=1, keepdims=True)
        spread = np.sqrt((corner * corner).sum(axis=0).max(axis=0))
        rank = sum((spread >= variation * along).astype(int) for variation in self._variations)
        rank[along <= self._threshold] = len(self._variations)
        return [touched[rank == k] for k in range(len(self._rules))]

    def _overshoot(self, batch: Batch) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
        """q, |q| and [|q| - threshold]^+ at the points."""
        q = batch.at_points()
        size = q[0] * q[0]
        for component in q[1:]:
            size += component * component
        np.sqrt(size, out=size)
        return q, size, np.maximum(size - self._threshold, 0.0)

    def energy(self, q: BaseVector) -> float:
        """M^2(q)."""
        energy = 0.0
        for batch in self._batches(q):
            s = self._overshoot(batch)[2]
            s *= s
            energy += batch.volumes @ (s @ batch.rule.weights)
        return float(self._gamma / 2 * total(energy, self._mesh))

    def active(self, q: BaseVector) -> float:
        """Measure of the set where |q| + nu^/gamma > beta_gamma, by a low order: for records."""
        low = [self._rules[0]] * len(self._rules)
        measure = sum(
            batch.volumes @ ((self._overshoot(batch)[2] > 0) @ batch.rule.weights)
            for batch in self._batches(q, low)
        )
        return total(float(measure), self._mesh)

    def gradient(self, q: BaseVector) -> BaseVector:
        """([nu^ + gamma (|q| - beta_gamma)]^+ q/|q|, .) as a functional on R."""
        forces = np.zeros((self._components, self._vertices))
        for batch in self._batches(q):
            components, size, s = self._overshoot(batch)
            s *= self._gamma / (size + TINY)
            nodes, moments = self._nodes[batch.elements].ravel(), batch.rule.first_moments
            for a, component in enumerate(components):
                local = batch.volumes[:, None] * ((s * component) @ moments)
                np.add.at(forces[a], nodes, local.ravel())
        g = self._q.CreateVector()
        g.FV().NumPy()[:] = forces.ravel()
        return g

    def pattern(self) -> SparseMatrixd:
        """A matrix with all entries that ``hessian`` may ever have."""
        return self._pattern.matrix

    def hessian(self, q: BaseVector) -> SparseMatrixd:
        """gamma (chi_Q M(q) ., .) with M(q) of (6.1)."""
        values = self._pattern.zeros()
        for batch in self._batches(q):
            moments = batch.rule.second_moments
            for block, M in self._newton_derivative(batch):
                local = batch.volumes[:, None] * (M @ moments)
                self._pattern.add(values[block], batch.elements, local)
        return self._pattern.write(values)

    def _newton_derivative(self, batch: Batch) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
        """The components b <= a of gamma chi_Q M(q) at the points.

        With t = threshold / |q| it is gamma ((1 - t) I + t q q^T / |q|^2) where t < 1, else 0.
        """
        q, size, s = self._overshoot(batch)
        size += TINY
        beyond = s > 0
        s /= size
        s *= self._gamma  # gamma (1 - t), zero where t > 1
        across = (self._gamma * beyond - s) / (size * size)  # gamma t / |q|^2
        for a, b in self._pattern.blocks():
            M = across * q[a]
            M *= q[b]
            if a == b:
                M += s
            yield (a, b), M


def constants(problem: Problem, regularisation: Regularisation) -> tuple[float, float] | None:
    """gamma_q and the threshold beta_gamma - nu^/gamma_q if they are numbers, else None."""
    gamma, nu_hat = regularisation.gamma_plastic(problem), regularisation.plastic_shift
    bound = regularisation.yield_bound(problem)
    if all(is_number(value) for value in (gamma, nu_hat, bound)):
        return float(gamma), float(bound - nu_hat / gamma)
    return None
