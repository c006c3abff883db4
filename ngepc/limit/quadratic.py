"""The upper bound in the plane: continuous velocities of degree two that flow without resistance.

Strain rates are affine on each cell: where free coordinates (the divergence) vanish at the vertices
they vanish everywhere.  A convex function of an affine one is nowhere above the interpolation of
its values at vertices: that bounds the dissipation, the closer the finer the cell is cut for it.
Velocities on facets are bounded by their Bernstein coefficients.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from ngepc.bounds.simplices import FACETS
from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.flow import AffineRows, DissipatedPart, Flow
from ngepc.limit.mechanism import ENCLOSED, Mechanism
from ngepc.limit.static import sparse_rows
from ngepc.limit.yielding import YieldShape

CUTS = 8
"""Number of parts of an edge in the integral of the dissipation of a solution."""

BERNSTEIN = np.array([[1.0, 0, 0], [0, 1.0, 0], [-0.5, -0.5, 2.0]])
"""Coefficients on an edge from the values at its ends and in the middle."""

PRESSED = np.array([[1 / 4, 1 / 12], [1 / 12, 1 / 4], [1 / 6, 1 / 6]])
"""Integrals of Bernstein polynomials times hat functions of the ends, over the length."""

WORK = np.array([[1 / 6, 0], [0, 1 / 6], [1 / 3, 1 / 3]])
"""Integrals of the basis (ends, middle) times hat functions of the ends, over the length."""


class QuadraticVelocities:
    """Velocities v = motion + directions @ y with unknowns y, and their ``Flow``.

    Parameters
    ----------
    data
        Loads, supports, strength.
    shape
        The yield condition.
    """

    def __init__(self, data: LimitData, shape: YieldShape) -> None:
        self.data = data
        self.shape = shape
        cells = data.cells
        self.nodes = np.hstack([cells.nodes, len(cells.points) + cells.facet_of])
        self.facet_nodes = np.column_stack(
            [cells.facets, len(cells.points) + np.arange(len(cells.facets))]
        )
        self.count = cells.N * (len(cells.points) + len(cells.facets))
        self.directions, self.motion = self._supported()
        self.strain = self._strain_rows()
        # the strain rates of the programs are multiplied by the size of the cell
        self.size = np.sqrt(cells.volume)
        scaled = diags(np.repeat(self.size, 3 * shape.size)) @ self.strain
        free = np.arange(self.strain.shape[0]) % shape.size < shape.free
        weights = np.repeat(data.bound * cells.volume / (3 * self.size), 3)
        capped = self._applied(scaled.tocsr()[~free])
        push, rubbing = self._obstacle_rows()
        self.flow = Flow(
            none=self._applied(scaled.tocsr()[free]),
            push=push,
            power=(self._power(GROWS), self._power(STAYS)),
            parts=[DissipatedPart(capped, shape.capped, weights), *rubbing],
            moves=data.moves,
        )

    def _applied(self, matrix: csr_matrix) -> AffineRows:
        """A matrix times the velocities."""
        return AffineRows(csr_matrix(matrix @ self.directions), matrix @ self.motion)

    def _supported(self) -> tuple[csr_matrix, np.ndarray]:
        """Directions that supports leave free, (N nodes, unknowns), and their own velocity."""
        data = self.data
        N = data.cells.N
        held = np.flatnonzero(data.held)
        given: dict[int, list] = {}
        middle = data.motion.mean(axis=1)
        for f in held:
            rows = data.frame[f, : data.held[f]]
            speeds = [*data.motion[f], middle[f]]
            for node, speed in zip(self.facet_nodes[f], speeds, strict=True):
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
        """The unit matrix at free nodes, and blocks of columns at the others."""
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
        """Coordinates of the strain rate at the vertices of cells, rows (cell, vertex, c)."""
        cells = self.data.cells
        shape = self.shape
        corner = np.eye(3)
        slopes = np.zeros((len(cells.nodes), 3, 6, 2))
        for k, (a, b) in enumerate(FACETS[2]):
            own = 4 * corner[:, k] - 1
            slopes[:, :, k] = own[:, None] * cells.gradients[:, None, k]
            along_b = corner[:, a, None] * cells.gradients[:, None, b]
            along_a = corner[:, b, None] * cells.gradients[:, None, a]
            slopes[:, :, 3 + k] = 4 * (along_a + along_b)
        values = np.einsum("cpq,tinq->ticnp", shape.basis, slopes)
        count = len(cells.nodes) * 3 * shape.size
        rows = np.arange(count).reshape(-1, 3, shape.size, 1, 1)
        columns = (2 * self.nodes[..., None] + np.arange(2))[:, None, None]
        return sparse_rows(values, rows, columns, (count, self.count))

    def _power(self, kind: int) -> AffineRows:
        """Power of the loads that grow or stay."""
        data = self.data
        cells = data.cells
        N = cells.N
        result = np.zeros((self.count // N, N))
        by_volume = cells.volume[:, None] / 3 * data.force[kind]
        np.add.at(result, self.nodes[:, 3:], by_volume[:, None])
        loads = np.where(cells.outer[:, None, None], data.traction[kind], 0.0)
        by_area = np.einsum("f,ni,fip->fnp", cells.measure, WORK, loads)
        np.add.at(result, self.facet_nodes, by_area)
        return self._applied(csr_matrix(result.ravel()))

    def _obstacle_rows(self) -> tuple[AffineRows, list[DissipatedPart]]:
        """Speeds into obstacles by Bernstein coefficients, and friction by those along them."""
        data = self.data
        cells = data.cells
        N = cells.N
        facets = np.flatnonzero(data.contact)
        frame = data.frame[facets]
        values = np.einsum("bn,frp->fbrnp", BERNSTEIN, frame)
        rows = np.arange(values[:, :, :, 0, 0].size).reshape(*values.shape[:3], 1, 1)
        columns = N * self.facet_nodes[facets][..., None] + np.arange(N)
        size = (rows.size, self.count)
        matrix = sparse_rows(values, rows, columns[:, None, None], size)
        normal = np.arange(rows.size) % N == 0
        cost = np.einsum(
            "f,bi,fi->fb", cells.measure[facets], PRESSED, data.friction[facets]
        )
        rubs = cost.ravel() > 0
        dragged = np.zeros((len(rubs), N), dtype=bool)
        dragged[rubs, 1:] = True
        push = self._applied(matrix[normal])
        if not rubs.any():
            return push, []
        along = self._applied(matrix[dragged.ravel()])
        return push, [DissipatedPart(along, N - 1, cost.ravel()[rubs])]

    def mechanism(self, solution: np.ndarray) -> Mechanism:
        """The admissible mechanism nearest to a solution, with its dissipation enclosed."""
        data = self.data
        cells = data.cells
        shape = self.shape
        y, left = self.flow.admissible(solution)
        v = self.motion + self.directions @ y
        strain = (self.strain @ v).reshape(len(cells.nodes), 3, shape.size)
        rounding = ENCLOSED * np.abs(self.directions @ left)
        unsure = (abs(self.strain) @ rounding).reshape(strain.shape)
        unsure = np.linalg.norm(unsure, axis=2).max(axis=1)
        points, weights = cut_triangle(CUTS)
        sizes = np.linalg.norm(points @ strain[:, :, shape.free :], axis=2)
        dissipated = data.bound * cells.volume * (sizes @ weights + unsure)
        total = float(dissipated.sum())
        for part in self.flow.parts[1:]:
            total += float(part.weights @ part.lengths(y))
        grows = self.flow.power[GROWS]
        power = 1.0
        if not data.moves:
            power = float(grows.at(y)[0] - (abs(grows.rows) @ (ENCLOSED * left))[0])
        factor = (total - float(self.flow.power[STAYS].at(y)[0])) / power
        values = v.reshape(-1, cells.N)[self.nodes] / power
        return Mechanism(
            values,
            strain / power,
            dissipated / power,
            np.zeros((len(cells.facets), cells.N, cells.N)),
            np.zeros(len(cells.facets)),
            factor,
        )


def cut_triangle(cuts: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points of a triangle cut into cuts^2 equal ones, and weights of their vertices.

    The sum of weights times values is the integral of the interpolation over the area.
    """
    places = [(i, j) for i in range(cuts + 1) for j in range(cuts + 1 - i)]
    weights = dict.fromkeys(places, 0.0)
    part = 1 / (3 * cuts**2)
    for i, j in places:
        if i + j < cuts:
            for corner in ((i, j), (i + 1, j), (i, j + 1)):
                weights[corner] += part
        if i + j < cuts - 1:
            for corner in ((i + 1, j + 1), (i + 1, j), (i, j + 1)):
                weights[corner] += part
    points = np.array([(i, j, cuts - i - j) for i, j in places]) / cuts
    return points, np.array([weights[place] for place in places])
