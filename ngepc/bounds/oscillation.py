"""Loads that vary inside elements: the part in equilibrium with the stress, a bound for the rest.

The stress is in equilibrium with body forces f_h that are constant on the N + 1 parts of a cell and
do the same work as f on rigid motions, and with affine tractions g_h that have the moments of g.
The differences are orthogonal to rigid motions, so that on each cell

    int (f - f_h) . w + int_boundary (g - g_h) . w  <=  rho |eps(w)|_L2.

Displacements map as w(x) = M^-T w'(x'), from a reference cell with x = M x': then eps(w) = M^-T
eps' M^-1, rigid motions remain ones, and with the largest singular value s of M

    rho = C s^2 |M^-1 (f - f_h)|_T + C' s^2 (|E| / (|E'| det M))^(1/2) |M^-1 (g - g_h)|_E.

The constants of the reference cells are computed upper bounds, from stresses of Johnson and Mercier
on the cell cut into similar ones: ``tests/campaigns/constants.py`` has the argument.
"""

from __future__ import annotations

import math
from functools import cached_property
from itertools import combinations

import numpy as np
from ngsolve import ET, VOL, CoefficientFunction, IntegrationRule

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.coverage import CONSTANT
from ngepc.bounds.simplices import Simplices
from ngepc.discretisation.polynomials import HIGHEST
from ngepc.discretisation.sampling import HiddenRule, Scan
from ngepc.model.elements import element_nodes

REFERENCE = {
    2: np.array([[1.0, 0.0], [0.5, math.sqrt(3) / 2]]).T,
    3: np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5]]).T,
}
"""Edges from the first vertex, as columns: an equilateral triangle, and the tetrahedron with edges
1, 1 and four of 3^(1/2)/2, whose bisected edges cut it into eight similar ones."""

INSIDE = {2: 0.441, 3: 0.651}
OUTSIDE = {2: 1.003, 3: 1.685}  # C and C' by dimension
FACET = {2: 1.0, 3: math.sqrt(2) / 4}  # |E'|


def rotations(N: int) -> np.ndarray:
    """The matrices of rotations, shape (N (N - 1)/2, N, N)."""
    pairs = list(combinations(range(N), 2))
    result = np.zeros((len(pairs), N, N))
    for k, (i, j) in enumerate(pairs):
        result[k, i, j], result[k, j, i] = 1.0, -1.0
    return result


def rotating_loads(N: int) -> np.ndarray:
    """The loads of rotations on the parts of the reference cell, (N (N - 1)/2, parts, N)."""
    corners = np.vstack([np.zeros(N), np.eye(N)])
    # of the parts, from the centre
    middles = -(corners - corners.mean(axis=0)) / (N + 1)
    return np.einsum("aij,kj->aki", rotations(N), middles)


def rule_on_parts(shape: ET, N: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points of a rule on each of the N + 1 parts of a cell, and their weights.

    The weights add up to one.
    """
    rule = IntegrationRule(shape, 2 * HIGHEST)
    points = np.array(rule.points)[:, :N]
    inside = np.column_stack([points, 1 - points.sum(axis=1)])

    # the corners of part k are those of the cell, with its centre in place of corner k
    corners = N + 1
    part = np.arange(corners)
    parts = np.repeat(np.eye(corners)[None], corners, axis=0)
    parts[part, part] = 1 / corners

    places = np.matmul(inside, parts).reshape(-1, corners)
    weights = np.tile(rule.weights, corners)
    return places, weights / weights.sum()


class CarriedLoads:
    """The body force and the tractions of a problem on the cells of its mesh.

    ``nodal`` (nt, N + 1, N) is int f phi_i over each cell for its vertices i, ``inner`` (nt, .) the
    coefficients of constant and of rotating loads on the reference cell, ``left`` (nt,) rho.
    """

    def __init__(self, boundary: Boundary) -> None:
        self._clear(boundary.cells)
        if boundary.problem.f is not None:
            self._carry(boundary.problem.f)
        self._leave_tractions(boundary)

    @classmethod
    def none(cls, cells: Simplices) -> CarriedLoads:
        """No loads at all."""
        made = cls.__new__(cls)
        made._clear(cells)
        return made

    def _clear(self, cells: Simplices) -> None:
        self.cells = cells
        N = cells.N
        count = len(cells.nodes)
        self.nodal = np.zeros((count, N + 1, N))
        self.left = np.zeros(count)
        self.inner = np.zeros((count, N * (N + 1) // 2))

    def _carry(self, force: CoefficientFunction) -> None:
        """The loads of a body force, by a rule on the parts that is exact for squares of cubics.

        Elements inside which the force jumps or peaks are integrated by the adaptive rules of
        ``Scan``.
        """
        c = self.cells
        f, share, weights = self._sampled(force)
        weighted = c.volume[:, None, None] * weights[:, None] * f
        self.nodal = np.matmul(share.transpose(0, 2, 1), weighted)

        scan = Scan(c.mesh, force, VOL)
        rules = {number: scan.rule(number) for number in scan.hidden.tolist()}
        shares = {n: self._ordered(n, rule.shares) for n, rule in rules.items()}
        for number, rule in rules.items():
            work = rule.weights[:, None] * rule.values
            self.nodal[number] = shares[number].T @ work
        self.inner = self._inner_loads()

        rest = f - self._carried(share.argmin(axis=2))
        if rules or np.abs(rest).max() > CONSTANT * np.abs(f).max():
            inverse, square, _ = from_reference(c, slice(None))
            turned = np.matmul(rest, inverse.transpose(0, 2, 1))
            squares = c.volume * ((turned**2).sum(axis=2) @ weights)
            for number, rule in rules.items():
                part = shares[number].argmin(axis=1)
                squares[number] = self._square_left(number, rule, part, inverse[number])
            self.left += INSIDE[c.N] * square * np.sqrt(squares)

    def _sampled(
        self, force: CoefficientFunction
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A force at the points of the parts of all cells, with coordinates and weights of these.

        Shapes (nt, points, N), (nt, points, N + 1), barycentric, and (points,), with the sum one.
        """
        c = self.cells
        N = c.N
        shape = ET.TRIG if N == 2 else ET.TET
        places, weights = rule_on_parts(shape, N)
        reference = [tuple(place[:N]) for place in places.tolist()]
        rule = IntegrationRule(reference, [1.0] * len(places))
        points = c.mesh.MapToAllElements({shape: rule}, VOL)
        f = np.asarray(force(points)).reshape(len(c.nodes), -1, N)
        inside = places[:, :N]
        share = np.column_stack([inside, 1 - inside.sum(axis=1)])
        return f, share[:, self._vertex_of].transpose(1, 0, 2), weights

    def _inner_loads(self) -> np.ndarray:
        """Coefficients of constant and rotating loads with the work of f on rigid motions."""
        c = self.cells
        N = c.N
        work = np.matmul(self.nodal, c.inverse.transpose(0, 2, 1))
        loads = rotating_loads(N)
        corners = np.vstack([np.zeros(N), np.eye(N)]) - 1 / (N + 1)
        gram = np.einsum("aki,bki->ab", loads, loads) / (math.factorial(N) * (N + 1))
        torque = np.einsum("tvi,aij,vj->ta", work, rotations(N), corners)
        mean = work.sum(axis=1) * math.factorial(N)
        return np.concatenate([mean, torque @ np.linalg.inv(gram)], axis=1)

    def _carried(self, part: np.ndarray) -> np.ndarray:
        """The force f_h that the stress carries at points on given parts (nt, points)."""
        c = self.cells
        mean = self.inner[:, : c.N]
        turning = self.inner[:, c.N :]
        loads = rotating_loads(c.N)[:, part]
        carried = mean[:, None] + np.einsum("ta,atqi->tqi", turning, loads)
        mapped = np.matmul(carried, c.jacobian.transpose(0, 2, 1))
        return mapped / c.det[:, None, None]

    def _square_left(
        self, number: int, rule: HiddenRule, part: np.ndarray, inverse: np.ndarray
    ) -> float:
        """|M^-1 (f - f_h)|_T^2 on one cell by its adaptive rule, from above."""
        c = self.cells
        mean = self.inner[number, : c.N]
        turning = np.einsum("a,aki->ki", self.inner[number, c.N :], rotating_loads(c.N))
        constant = (mean + turning) @ c.jacobian[number].T
        rest = rule.values - constant[part] / c.det[number]
        found = rule.weights @ ((rest @ inverse.T) ** 2).sum(axis=1)
        return found + (inverse**2).sum(axis=0) @ rule.unresolved

    def _ordered(self, number: int, shares: np.ndarray) -> np.ndarray:
        """Barycentric coordinates in the order of the vertices of a cell here."""
        return shares[:, self._vertex_of[number]]

    @cached_property
    def _vertex_of(self) -> np.ndarray:
        """Which vertices of the elements of the mesh those of the cells are, (nt, N + 1)."""
        c = self.cells
        nodes = element_nodes(c.mesh)[:, : c.N + 1]
        place = np.empty_like(c.nodes)
        np.put_along_axis(place, c.nodes.argsort(axis=1), nodes.argsort(axis=1), axis=1)
        return place

    def _leave_tractions(self, boundary: Boundary) -> None:
        """The contribution of tractions to ``left``."""
        c = self.cells
        facets, squares = boundary.uneven
        cell = c.owners[facets, 0]
        inverse, square, det = from_reference(c, cell)
        turned = np.matmul(np.matmul(inverse, squares), inverse.transpose(0, 2, 1))
        area = c.measure[facets]
        trace = np.einsum("eii->e", turned)
        size = np.sqrt(area * np.maximum(trace, 0.0))
        scale = square * np.sqrt(area / (FACET[c.N] * det))
        np.add.at(self.left, cell, OUTSIDE[c.N] * scale * size)


def from_reference(
    cells: Simplices, chosen: np.ndarray | slice
) -> tuple[np.ndarray, ...]:
    """Of the maps M of the reference to some cells M^-1, |M|^2 and det M."""
    E = REFERENCE[cells.N]
    size = np.linalg.norm(
        np.matmul(cells.jacobian[chosen], np.linalg.inv(E)), 2, axis=(1, 2)
    )
    return (
        np.matmul(E, cells.inverse[chosen]),
        size**2,
        cells.det[chosen] / np.linalg.det(E),
    )
