"""The upper bound in the plane: continuous velocities without volume change.

Velocities are polynomials on each cell, given by Bernstein coefficients; strain rates are
polynomials of one degree less.  If the coefficients of a free coordinate (the divergence) vanish,
it vanishes everywhere.  The norms of the coefficients bound the dissipation, the more closely the
finer the cell is cut for this purpose.
"""

from __future__ import annotations

import numpy as np
from ngsolve import TRIG, IntegrationRule
from scipy.sparse import csr_matrix, diags, kron

from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.enclosed import Enclosed
from ngepc.limit.flow import AffineRows, DissipatedPart, Flow
from ngepc.limit.flow_proof import dissipation, power_of, proved, rubbed, strain_rates
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.outline import Outline
from ngepc.limit.static import sparse_rows
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.bernstein import (
    bernstein_values,
    chains,
    integral,
    multi_indices,
    raised,
    times_hats,
)

MIDDLES = (1 - np.eye(3)) / 2
"""Barycentric coordinates of the middles of edges."""


def sampling(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Points at which the program evaluates strain rates, and their weights.

    The rule is exact for squares of strain rates; with vertices alone the program would avoid
    varying strain rates.  The guarantee does not depend on the points: the dissipation of the
    solution is bounded afterwards.
    """
    if degree == 2:
        return MIDDLES, np.full(3, 1 / 3)
    rule = IntegrationRule(TRIG, 2 * (degree - 1))
    x, y = np.array(rule.points)[:, :2].T
    weights = np.array(rule.weights)
    return np.column_stack([1 - x - y, x, y]), weights / weights.sum()


class ContinuousVelocities:
    """Velocities with the coefficients motion + directions @ y for unknowns y.

    Parameters
    ----------
    data
        Loads, supports, strength.
    shape
        The yield condition.
    degree
        Degree of the polynomials, 2 or more.
    """

    def __init__(self, data: LimitData, shape: YieldShape, degree: int) -> None:
        self.data = data
        self.shape = shape
        self.degree = degree
        cells = data.cells
        self._number_coefficients()
        self.directions, self.motion = self._supported()
        self.strain = self._strain_rows()
        # the strain rates of the programs are multiplied by the size of the cell
        size = np.sqrt(cells.volume)
        points, weights = sampling(degree)
        scaled = self._weighted(size, np.eye(self.strains))
        free = np.arange(scaled.shape[0]) % shape.size < shape.free
        sampled = self._weighted(size, bernstein_values(degree - 1, points))
        capped = np.arange(sampled.shape[0]) % shape.size >= shape.free
        cost = np.outer(data.bound * cells.volume / size, weights).ravel()
        vectors = self._applied(sampled[capped])
        push, rubbing = self._obstacle_rows()
        self.flow = Flow(
            none=self._applied(scaled[free]),
            push=push,
            power=(self._power(GROWS), self._power(STAYS)),
            parts=[DissipatedPart(vectors, shape.capped, cost), *rubbing],
            moves=data.moves,
        )

    def _number_coefficients(self) -> None:
        """Numbers of the coefficients of cells, (nc, n), and of those on facets, (nf, m)."""
        cells = self.data.cells
        degree = self.degree
        of_cells = np.sort(cells.nodes[:, chains(2, degree)], axis=2)
        of_facets = cells.facets[:, chains(1, degree)]
        base = len(cells.points) ** np.arange(degree)
        keys, numbers = np.unique(of_cells @ base, return_inverse=True)
        self.numbers = numbers.reshape(of_cells.shape[:2])
        self.facet_numbers = np.searchsorted(keys, np.sort(of_facets, axis=2) @ base)
        self.count = 2 * len(keys)

    @property
    def strains(self) -> int:
        """Number of coefficients of a strain rate on a cell."""
        return len(multi_indices(2, self.degree - 1))

    def _weighted(self, size: np.ndarray, rule: np.ndarray) -> csr_matrix:
        """Combinations of the coefficients of strain rates on each cell, times its size."""
        blocks = kron(diags(size), kron(rule, np.eye(self.shape.size)))
        return csr_matrix(csr_matrix(blocks) @ self.strain)

    def _applied(self, matrix: csr_matrix) -> AffineRows:
        """A matrix times the velocities."""
        return AffineRows(csr_matrix(matrix @ self.directions), matrix @ self.motion)

    def _supported(self) -> tuple[csr_matrix, np.ndarray]:
        """Free directions (N nodes, unknowns), and the velocity that supports prescribe."""
        data = self.data
        N = data.cells.N
        held = np.flatnonzero(data.held)
        given: dict[int, list] = {}
        places = multi_indices(1, self.degree) / self.degree
        for f in held:
            rows = data.frame[f, : data.held[f]]
            speeds = places @ data.motion[f]
            for node, speed in zip(self.facet_numbers[f], speeds, strict=True):
                given.setdefault(int(node), []).append((rows, rows @ speed))
        touched = np.zeros(self.count // N, dtype=bool)
        touched[list(given)] = True
        blocks = []
        motion = np.zeros(self.count)
        for node, pairs in given.items():
            rows = np.concatenate([rows for rows, _ in pairs])
            speeds = np.concatenate([speed for _, speed in pairs])
            _, size, directions = np.linalg.svd(rows)
            rank = int((size > 1e-10).sum())
            velocity = np.linalg.pinv(rows) @ speeds
            if np.abs(rows @ velocity - speeds).max() > 1e-10 * np.abs(speeds).max():
                raise ValueError(
                    "prescribed: supports that meet move apart; in the plane they need one velocity"
                    " where they meet, for example one that falls to zero there"
                )
            motion[N * node : N * (node + 1)] = velocity
            free = directions[rank:].T
            place = N * node + np.arange(N)
            blocks.append((place, free))
        return self._assembled(touched, blocks), motion

    def _assembled(
        self, touched: np.ndarray, blocks: list[tuple[np.ndarray, np.ndarray]]
    ) -> csr_matrix:
        """The free directions: the identity at unsupported nodes, ``blocks`` at others."""
        N = self.data.cells.N
        alone = np.flatnonzero(np.repeat(~touched, N))
        rows = [alone]
        columns = [np.arange(len(alone))]
        values = [np.ones(len(alone))]
        width = len(alone)
        for place, free in blocks:
            k = free.shape[1]
            rows.append(np.repeat(place, k))
            columns.append(np.tile(width + np.arange(k), N))
            values.append(free.ravel())
            width += k
        entries = np.concatenate(values)
        where = (np.concatenate(rows), np.concatenate(columns))
        return csr_matrix((entries, where), shape=(self.count, width))

    def _strain_rows(self) -> csr_matrix:
        """Coefficients of the strain rate's coordinates, rows (cell, coefficient, c)."""
        cells = self.data.cells
        shape = self.shape
        steps = self.degree * cells.gradients
        values = np.einsum("cpq,tiq->ticp", shape.basis, steps)
        count = len(cells.nodes)
        full = (count, self.strains, 3, shape.size, 2)
        values = np.broadcast_to(values[:, None], full)
        rows = np.arange(count * self.strains * shape.size)
        rows = rows.reshape(count, self.strains, 1, shape.size, 1)
        numbers = self.numbers[:, raised(2, self.degree - 1)]
        columns = (2 * numbers[..., None] + np.arange(2))[:, :, :, None]
        return sparse_rows(values, rows, columns, (rows.size, self.count))

    def _power(self, kind: int) -> AffineRows:
        """Power of the loads that grow or stay."""
        data = self.data
        cells = data.cells
        degree = self.degree
        result = np.zeros((self.count // 2, 2))
        by_volume = integral(2, degree) * cells.volume[:, None] * data.force[kind]
        np.add.at(result, self.numbers, by_volume[:, None])
        loads = np.where(cells.outer[:, None, None], data.traction[kind], 0.0)
        hats = times_hats(1, degree)
        by_area = np.einsum("f,ni,fip->fnp", cells.measure, hats, loads)
        np.add.at(result, self.facet_numbers, by_area)
        return self._applied(csr_matrix(result.ravel()))

    def _obstacle_rows(self) -> tuple[AffineRows, list[DissipatedPart]]:
        """Rows of the normal speeds at obstacles, and the dissipation by friction along them."""
        data = self.data
        facets = np.flatnonzero(data.contact)
        numbers = self.facet_numbers[facets]
        # (facet, coefficient, row of the frame, component)
        values = np.broadcast_to(data.frame[facets][:, None], (*numbers.shape, 2, 2))
        rows = np.arange(2 * numbers.size).reshape(*numbers.shape, 2, 1)
        columns = 2 * numbers[..., None, None] + np.arange(2)
        matrix = sparse_rows(values, rows, columns, (rows.size, self.count))
        normal = np.arange(rows.size) % 2 == 0
        cost = np.einsum(
            "f,bi,fi->fb",
            data.cells.measure[facets],
            times_hats(1, self.degree),
            data.friction[facets],
        ).ravel()
        push = self._applied(matrix[normal])
        with_friction = cost > 0
        if not with_friction.any():
            return push, []
        along = self._applied(matrix[~normal][with_friction])
        return push, [DissipatedPart(along, 1, cost[with_friction])]

    def velocity(self, y: np.ndarray) -> np.ndarray:
        """Coefficients (n, 2) that supports along the axes hold exactly, and clear obstacles.

        Directions oblique to the axes are rounded numbers.
        """
        data = self.data
        v = (self.motion + self.directions @ y).reshape(-1, 2)
        places = multi_indices(1, self.degree) / self.degree
        for f in np.flatnonzero(data.held):
            speeds = places @ data.motion[f]
            for row in data.frame[f, : data.held[f]]:
                axis = np.flatnonzero(row)
                if len(axis) == 1:
                    v[self.facet_numbers[f], axis[0]] = speeds[:, axis[0]]
        for f in np.flatnonzero(data.contact):
            numbers = self.facet_numbers[f]
            normal = data.frame[f, 0]
            v[numbers] -= np.maximum(v[numbers] @ normal, 0.0)[:, None] * normal
        return v

    def mechanism(self, solution: np.ndarray) -> Mechanism:
        """The admissible mechanism nearest to a solution, with its dissipation enclosed."""
        data = self.data
        cells = data.cells
        shape = self.shape
        y = self.flow.admissible(solution)
        v = self.velocity(y)
        values = v[self.numbers]
        outline = Outline(cells)
        exact = Enclosed(values)
        strain, error, removed = strain_rates(data, shape, outline, exact, self.degree)
        dissipated = data.bound * dissipation(2, strain[:, :, shape.free :], error)
        powers = tuple(
            power_of(data, outline, exact, self.degree, kind) for kind in (GROWS, STAYS)
        )
        others = rubbed(self.flow.parts[1:], y, float(np.abs(v).max()))
        found = proved(data, powers, removed, dissipated, others)
        power = found.power
        return Mechanism(
            values / power,
            self.degree,
            strain / cells.volume[:, None, None] / power,
            found.dissipated / power,
            np.zeros((len(cells.facets), 2, 2)),
            np.zeros(len(cells.facets)),
            found.factor,
        )
