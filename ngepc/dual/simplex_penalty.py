"""M^2 on straight simplices with constant data: the same integrals, in vectorised arithmetic.

There q is affine on each element, so that its values at the points of a rule are the vertex
values times barycentric coordinates, and the element matrices of Lemma 6.3 are moments of a few
scalars.  Which rule an element needs is what ``PlasticPenalty`` asks too; elements below the
threshold are never looked at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import ET, BilinearForm, FESpace, InnerProduct, Integrate, IntegrationRule, dx
from ngsolve.la import BaseMatrix, BaseVector

from ngepc.checks.arguments import is_number
from ngepc.discretisation.quadrature import (
    KINKED,
    SMOOTH,
    classify,
    fine_rules,
    smooth_rules,
)
from ngepc.dual.parameters import Weights
from ngepc.dual.radial import RadialLaw
from ngepc.model.elements import element_vertices
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.rules import has_straight_simplices

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
    def of(cls, rule: IntegrationRule) -> Barycentric:
        """An NGSolve rule."""
        x, w = np.array(rule.points), np.array(rule.weights)
        return cls(np.column_stack([x, 1 - x.sum(axis=1)]), w / w.sum())

    @cached_property
    def first_moments(self) -> np.ndarray:
        """Weights times each coordinate, shape (n, N+1)."""
        return self.weights[:, None] * self.points

    @cached_property
    def second_moments(self) -> np.ndarray:
        """Weights times the products of two coordinates, shape (n, (N+1)^2)."""
        pairs = self.points[:, :, None] * self.points[:, None, :]
        return self.weights[:, None] * pairs.reshape(len(self.weights), -1)


def takes(problem: Problem, weights: Weights) -> bool:
    """Whether ``SimplexPenalty`` can integrate M^2: straight simplices and a constant threshold."""
    return is_number(weights.threshold) and has_straight_simplices(problem.mesh)


class SimplexPenalty:
    """M^2 of ``PlasticPenalty`` for a constant threshold on straight simplices.

    Parameters
    ----------
    problem, weights, R, quadrature_points
        As for ``PlasticPenalty``.
    """

    def __init__(
        self, problem: Problem, weights: Weights, R: FESpace, quadrature_points: int
    ) -> None:
        mesh, N = problem.mesh, problem.N
        self.gamma, self.threshold = weights.plastic, float(weights.threshold)
        (self.nodes,) = element_vertices(mesh)
        self.volumes = np.array(Integrate(as_scalar(1.0), mesh, element_wise=True))
        self.components, self.R = problem.kinematics.d, R
        shape = ET.TRIG if N == 2 else ET.TET
        rules = {SMOOTH: smooth_rules(N), KINKED: fine_rules(N, quadrature_points)}
        self.rules = {kind: Barycentric.of(rule[shape]) for kind, rule in rules.items()}

    def at(self, q: BaseVector) -> SimplexState:
        """The term at q, with its active set."""
        values = np.array(q.FV()).reshape(self.components, -1)
        kind = classify(values, self.nodes, self.threshold, self.threshold)
        return SimplexState(self, values, kind)

    @cached_property
    def _matrix(self) -> BaseMatrix:
        """The matrix that ``write`` overwrites, with its whole pattern."""
        q, r = self.R.TnT()
        shape = ET.TRIG if self.nodes.shape[1] == 3 else ET.TET
        form = BilinearForm(self.R, symmetric=True, symmetric_storage=True)
        form += InnerProduct(q, r) * dx(intrules={shape: IntegrationRule(shape, 0)})
        return form.Assemble().mat

    def pattern(self) -> BaseMatrix:
        """A matrix with all entries that a Newton derivative may ever have."""
        return self._matrix

    @property
    def blocks(self) -> list[tuple[int, int]]:
        """The pairs of components (a, b), b <= a, of the lower triangle."""
        return [(a, b) for a in range(self.components) for b in range(a + 1)]

    @cached_property
    def places(self) -> dict[tuple[int, int], np.ndarray]:
        """Block -> the entry for each two vertices of an element, shape (elements, (N+1)^2).

        NGSolve numbers component by component; -1 stands for entries above the diagonal.
        """
        _, columns, starts = (np.asarray(a).astype(np.int64) for a in self._matrix.CSR())
        size, n = len(starts) - 1, self.R.ndof // self.components
        keys = np.repeat(np.arange(size) * size, np.diff(starts)) + columns
        row, column = self.nodes[:, :, None], self.nodes[:, None, :]
        found = {}
        for a, b in self.blocks:
            wanted = ((a * n + row) * size + b * n + column).reshape(len(self.nodes), -1)
            place = np.searchsorted(keys, wanted).astype(np.int32)
            above = np.broadcast_to((a == b) & (column > row), (*row.shape[:2], row.shape[1]))
            found[a, b] = np.where(above.reshape(place.shape), -1, place)
        return found

    def write(self, values: np.ndarray) -> BaseMatrix:
        """The matrix with these entries."""
        np.asarray(self._matrix.AsVector().FV())[:] = values
        return self._matrix


class SimplexState:
    """M^2 at one q: the active elements by the rule they need, and what follows from them.

    Parameters
    ----------
    term
        The term.
    values
        q at the vertices, shape (d, vertices).
    kind
        The kind of each element, ``ngepc.discretisation.quadrature.classify``.
    """

    def __init__(self, term: SimplexPenalty, values: np.ndarray, kind: np.ndarray) -> None:
        self._term, self._values = term, values
        self.elements = {number: np.flatnonzero(kind == number) for number in term.rules}

    def _pieces(self, low: bool = False) -> Iterator[Piece]:
        """The elements beyond the threshold in pieces, by the rule they need or a low one."""
        for kind, elements in self.elements.items():
            rule = self._term.rules[SMOOTH if low else kind]
            size = max(1, CHUNK_POINTS // len(rule.weights))
            for first in range(0, len(elements), size):
                yield Piece(self._term, self._values, elements[first : first + size], rule)

    @cached_property
    def energy(self) -> float:
        """M^2(q)."""
        density = (p.volumes @ (p.law.density @ p.rule.weights) for p in self._pieces())
        return float(self._term.gamma * sum(density))

    @cached_property
    def active(self) -> float:
        """Measure of the set beyond the threshold, by a low order: for records."""
        inside = (p.volumes @ (p.law.inside @ p.rule.weights) for p in self._pieces(low=True))
        return float(sum(inside))

    @cached_property
    def gradient(self) -> BaseVector:
        """([nu^ + gamma (|q| - beta_gamma)]^+ q/|q|, .) as a functional on R."""
        forces = np.zeros_like(self._values)
        for p in self._pieces():
            slope, moments = self._term.gamma * p.law.slope, p.rule.first_moments
            for a, component in enumerate(p.q):
                local = p.volumes[:, None] * ((slope * component) @ moments)
                np.add.at(forces[a], p.nodes.ravel(), local.ravel())
        g = BaseVector(forces.size)
        g.FV().NumPy()[:] = forces.ravel()
        return g

    def hessian(self) -> BaseMatrix:
        """gamma (chi_Q M(q) ., .) with M(q) of (6.1); the next one overwrites it."""
        term = self._term
        values = np.zeros(len(term.pattern().AsVector()))
        for p in self._pieces():
            for (a, b), M in p.newton_derivative(term.blocks):
                local = (term.gamma * p.volumes)[:, None] * (M @ p.rule.second_moments)
                place = term.places[a, b][p.elements]
                below = place >= 0
                np.add.at(values, place[below], local[below])
        return term.write(values)


class Piece:
    """Some elements that one rule integrates.

    Parameters
    ----------
    term
        Its mesh and threshold.
    values
        q at all vertices, shape (d, vertices).
    elements
        Their numbers.
    rule
        The rule.
    """

    def __init__(
        self, term: SimplexPenalty, values: np.ndarray, elements: np.ndarray, rule: Barycentric
    ) -> None:
        self.elements, self.rule = elements, rule
        self.nodes, self.volumes = term.nodes[elements], term.volumes[elements]
        self.q = [component[self.nodes] @ rule.points.T for component in values]
        size = np.sqrt(sum(component * component for component in self.q))
        self.law = RadialLaw(size, term.threshold, lambda s: s > 0)

    def newton_derivative(
        self, blocks: list[tuple[int, int]]
    ) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
        """The components (a, b) of chi_Q M(q) at the points, shape (elements, n)."""
        slope, across = self.law.slope, self.law.across
        direction = [component / self.law.size for component in self.q]
        for a, b in blocks:
            M = across * direction[a] * direction[b]
            yield (a, b), M + slope if a == b else M
