"""The upper bound for solids: velocities of degree two that may slip along the facets of cells.

Normal components are continuous, tangential ones may jump: a slip s dissipates beta |s| / 2^(1/2),
with the smaller beta of both sides, also along a support.  The velocity of a cell has Bernstein
coefficients at its vertices and its edges.  The unknowns are those of the normal component on each
facet, and one for each edge of each cell: the component along the edge.  At a vertex the N facets
of the cell around it determine the coefficient, at an edge the N - 1 facets around it and the
component along it.  Strain rates are affine on cells and slips are of degree two on facets: the
lengths of their coefficients on small parts bound the dissipation.
"""

from __future__ import annotations

import numpy as np
from ngsolve import SEGM, TET, TRIG, IntegrationRule
from scipy.sparse import csr_matrix, diags, eye, kron, vstack

from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.enclosed import Enclosed, joined_enclosures
from ngepc.limit.flow import AffineRows, DissipatedPart, Flow
from ngepc.limit.flow_proof import (
    ROUNDED,
    dissipation,
    of_facet,
    power_of,
    proved,
    rubbed,
    strain_rates,
)
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.outline import Outline
from ngepc.limit.reading import completed_frame
from ngepc.limit.static import sparse_rows
from ngepc.limit.yielding import SLIP, YieldShape
from ngepc.linalg.bernstein import (
    bernstein_values,
    chains,
    integral,
    multi_indices,
    parts_of,
    raised,
    times_hats,
)

DEGREE = 2
"""Degree of the velocities."""

CUTS = 8
"""Each edge is cut into so many parts to integrate the dissipation of slips."""

ELEMENTS = {1: SEGM, 2: TRIG, 3: TET}
"""The simplices by dimension."""

ALONG = 1e-9
"""Components of unit vectors below this number count as zero."""


def simplex_rule(N: int, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points of a rule of this order on a simplex, and their weights of sum one."""
    rule = IntegrationRule(ELEMENTS[N], order)
    x = np.array(rule.points)[:, :N]
    weights = np.array(rule.weights)
    points = np.column_stack([1 - x.sum(axis=1), x])
    return points, weights / weights.sum()


class SlidingVelocities:
    """Velocities of degree two on cells that may slip along facets.

    ``places`` (nc, N + 1, m) are the coefficients of the facets of cells, in the order of the
    facet, among the n coefficients of the cell; ``unknown`` (nc, N + 1, n) is the number of the
    normal component of a facet that belongs to a coefficient of the cell, -1 where none does.

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
        self.outline = Outline(cells)
        self._number_coefficients()
        self.through = self._through()
        fluxes = np.zeros(self.count)
        fluxes[: self.inner] = self._flux_speeds()
        given = np.zeros(self.count, dtype=bool)
        given[: self.inner] = np.repeat(self.through, self.of_facets)
        self.velocity = self._velocity(fluxes, given)
        self.fluxes = AffineRows(
            csr_matrix(diags(np.ones(len(given))))[:, ~given],
            np.where(given, fluxes, 0),
        )
        self.strain = self._strain()
        self.slips, friction = self._slips()
        self.rubbing = [friction] if len(friction.weights) else []
        self.flow = Flow(
            none=self._none(),
            push=self._push(),
            power=(self._power(GROWS), self._power(STAYS)),
            parts=self._parts(),
            moves=data.moves,
        )

    def _number_coefficients(self) -> None:
        """Numbers of the coefficients of cells and facets, and of the unknowns."""
        cells = self.data.cells
        N = cells.N
        own = np.arange(len(cells.nodes))
        self.indices = multi_indices(N, DEGREE)
        self.of_cells = len(self.indices)
        self.of_facets = len(multi_indices(N - 1, DEGREE))
        self.along = np.flatnonzero((self.indices > 0).sum(axis=1) == 2)
        found = [
            of_facet(cells, own, np.full(len(own), k), DEGREE) for k in range(N + 1)
        ]
        self.places = np.stack(found, axis=1)
        self.slot = self.of_facets * cells.facet_of[..., None] + np.arange(
            self.of_facets
        )
        self.unknown = np.full((len(own), N + 1, self.of_cells), -1)
        np.put_along_axis(self.unknown, self.places, self.slot, axis=2)
        self.inner = self.of_facets * len(cells.facets)
        self.count = self.inner + len(own) * len(self.along)

    def _motions(self) -> Enclosed:
        """Coefficients of the velocities of supports on facets, (nf, m, N)."""
        first, second = chains(self.data.cells.N - 1, DEGREE).T
        motion = Enclosed(self.data.motion)
        return (motion[:, first] + motion[:, second]) * 0.5

    def _held_part(self, vectors: np.ndarray) -> np.ndarray:
        """Projections of vectors (nf, k, N) onto the directions that supports hold on facets."""
        data = self.data
        N = data.cells.N
        held = np.where(np.arange(N) < data.held[:, None], 1.0, 0.0)
        return np.einsum("fkp,frp,fr,frq->fkq", vectors, data.frame, held, data.frame)

    def _through(self) -> np.ndarray:
        """Whether a support holds the normal component on a facet."""
        normal = self.data.cells.normal[:, None]
        return np.linalg.norm(self._held_part(normal), axis=2)[:, 0] > 1 - ALONG

    def _flux_speeds(self) -> np.ndarray:
        """Coefficients of the normal velocities of supports on facets, flat."""
        motion = self._motions().middle
        return np.einsum("fap,fp->fa", motion, self.data.cells.normal).ravel()

    def _velocity(self, fluxes: np.ndarray, given: np.ndarray) -> AffineRows:
        """Components of the coefficients, rows (cell, coefficient, component)."""
        cells = self.data.cells
        N = cells.N
        x = cells.points[cells.nodes]
        count = len(cells.nodes)
        slope = np.linalg.norm(cells.gradients, axis=2)
        values = []
        rows = []
        columns = []
        own = np.arange(count)[:, None]
        for place, index in enumerate(self.indices):
            row = N * (self.of_cells * own + place) + np.arange(N)
            middle = index @ x / DEGREE
            for k in np.flatnonzero(index == 0):
                # this normal component on facet k, none on the others around
                along = (middle - x[:, k]) * slope[:, k, None]
                values.append(along * cells.sign[:, k, None])
                rows.append(row)
                column = self.unknown[:, k, place, None]
                columns.append(np.broadcast_to(column, row.shape))
        for e, place in enumerate(self.along):
            i, j = np.flatnonzero(self.indices[place])
            edge = x[:, j] - x[:, i]
            values.append(edge / self._lengths(i, j)[:, None])
            rows.append(N * (self.of_cells * own + place) + np.arange(N))
            column = self.inner + len(self.along) * own + e
            columns.append(np.broadcast_to(column, edge.shape))
        size = (count * self.of_cells * N, len(fluxes))
        whole = sparse_rows(
            np.concatenate(values), np.concatenate(rows), np.concatenate(columns), size
        )
        return AffineRows(whole[:, ~given], whole @ np.where(given, fluxes, 0.0))

    def _lengths(self, i: int, j: int) -> np.ndarray:
        """The lengths of an edge of all cells."""
        cells = self.data.cells
        x = cells.points[cells.nodes]
        return np.linalg.norm(x[:, j] - x[:, i], axis=1)

    def _applied(self, matrix: csr_matrix) -> AffineRows:
        """A matrix times the velocities."""
        velocity = self.velocity
        return AffineRows(csr_matrix(matrix @ velocity.rows), matrix @ velocity.offset)

    def _strain(self) -> csr_matrix:
        """Coordinates of strain rates times the size of the cell, rows (cell, coefficient, c)."""
        cells = self.data.cells
        shape = self.shape
        N = cells.N
        size = cells.volume ** (1 / N)
        steps = DEGREE * size[:, None, None] * cells.gradients
        values = np.einsum("cpq,tiq->ticp", shape.basis, steps)
        above = raised(N, DEGREE - 1)
        count = len(size)
        full = (count, len(above), N + 1, shape.size, N)
        values = np.broadcast_to(values[:, None], full)
        rows = np.arange(count * len(above) * shape.size)
        rows = rows.reshape(count, len(above), 1, shape.size, 1)
        numbers = self.of_cells * np.arange(count)[:, None, None] + above
        columns = (N * numbers[..., None] + np.arange(N))[:, :, :, None]
        height = count * self.of_cells * N
        return sparse_rows(values, rows, columns, (rows.size, height))

    def _at_facets(self, vectors: np.ndarray, both: bool) -> csr_matrix:
        """Products of vectors (nf, r, N) with the coefficients of velocities on facets.

        The velocity of the first cell of each facet; with ``both``, less that of the second cell.
        """
        cells = self.data.cells
        N = cells.N
        kept = cells.sign > 0
        kept = kept | both
        values = np.where(kept, cells.sign, 0.0)[..., None, None]
        values = values * vectors[cells.facet_of]
        count = vectors.shape[1]
        shape = (*self.places.shape, count, N)
        values = np.broadcast_to(values[:, :, None], shape)
        row = count * self.slot[..., None] + np.arange(count)
        first = self.of_cells * np.arange(len(cells.nodes))[:, None, None]
        column = N * (first + self.places)[..., None] + np.arange(N)
        width = len(cells.nodes) * self.of_cells * N
        size = (self.inner * count, width)
        return sparse_rows(values, row[..., None], column[:, :, :, None, :], size)

    def _none(self) -> AffineRows:
        """Free strain rates, and held components that are neither normal nor tangential."""
        data = self.data
        shape = self.shape
        N = data.cells.N
        free = np.arange(self.strain.shape[0]) % shape.size < shape.free
        rows = [self._applied(self.strain[free])]
        normal = np.linalg.norm(self._held_part(data.cells.normal[:, None]), axis=2)
        oblique = ~self.through & (normal[:, 0] > ALONG)
        if oblique.any():
            held = np.arange(N) < data.held[:, None]
            chosen = (held & oblique[:, None])[:, None]
            chosen = np.repeat(chosen, self.of_facets, axis=1).ravel()
            motion = self._motions().middle
            speeds = np.einsum("frp,fap->far", data.frame, motion).ravel()
            found = self._applied(self._at_facets(data.frame, both=False)[chosen])
            rows.append(AffineRows(found.rows, found.offset - speeds[chosen]))
        return AffineRows(
            vstack([part.rows for part in rows], format="csr"),
            np.concatenate([part.offset for part in rows]),
        )

    def _push(self) -> AffineRows:
        """Normal components on facets that obstacles touch."""
        touched = self._touched()
        return AffineRows(self.fluxes.rows[touched], self.fluxes.offset[touched])

    def _touched(self) -> np.ndarray:
        """Which unknowns are normal components on facets that obstacles touch."""
        result = np.zeros(self.count, dtype=bool)
        result[: self.inner] = np.repeat(self.data.contact, self.of_facets)
        return result

    def _power(self, kind: int) -> AffineRows:
        """Power of the loads that grow or stay."""
        data = self.data
        cells = data.cells
        N = cells.N
        hats = times_hats(N - 1, DEGREE)
        loads = np.where(cells.outer[:, None, None], data.traction[kind], 0.0)
        moments = np.einsum("f,ai,fip->fap", cells.measure, hats, loads)
        axes = np.tile(np.eye(N), (len(cells.facets), 1, 1))
        by_area = moments.ravel() @ self._at_facets(axes, both=False)
        share = integral(N, DEGREE)
        by_volume = share * cells.volume[:, None] * data.force[kind]
        by_volume = np.repeat(by_volume[:, None], self.of_cells, axis=1).ravel()
        return self._applied(csr_matrix(by_area + by_volume))

    def _parts(self) -> list[DissipatedPart]:
        """Dissipation in cells, by slips between them and at supports, and by friction."""
        data = self.data
        cells = data.cells
        shape = self.shape
        N = cells.N
        points, weights = simplex_rule(N, 2 * (DEGREE - 1))
        values = bernstein_values(DEGREE - 1, points)
        rule = kron(eye(len(data.bound)), kron(values, np.eye(shape.size)))
        sampled = csr_matrix(rule) @ self.strain
        capped = np.arange(sampled.shape[0]) % shape.size >= shape.free
        size = cells.volume ** (1 / N)
        cost = np.outer(data.bound * cells.volume / size, weights).ravel()
        strained = DissipatedPart(self._applied(sampled[capped]), shape.capped, cost)
        return [strained, self._sampled(), *self.rubbing]

    def _sampled(self) -> DissipatedPart:
        """Slips at points inside facets."""
        slips = self.slips
        N = self.data.cells.N
        points, weights = simplex_rule(N - 1, 2 * DEGREE)
        rule = kron(bernstein_values(DEGREE, points), np.eye(N - 1))
        costs = slips.weights.reshape(-1, self.of_facets).sum(axis=1)
        at_points = csr_matrix(kron(eye(len(costs)), rule))
        vectors = slips.vectors
        rows = csr_matrix(at_points @ vectors.rows)
        offset = at_points @ vectors.offset
        cost = np.outer(costs, weights).ravel()
        return DissipatedPart(AffineRows(rows, offset), slips.size, cost)

    def _slips(self) -> tuple[DissipatedPart, DissipatedPart]:
        """Coefficients of slips on facets, inside and at supports, then along obstacles."""
        data = self.data
        cells = data.cells
        N = cells.N
        tangents = completed_frame(cells.normal[:, None])[:, 1:]
        bound = data.bound[cells.owners[:, 0]]
        inside = ~cells.outer
        bound[inside] = np.minimum(bound, data.bound[cells.owners[:, 1]])[inside]
        held = np.where(inside[:, None, None], tangents, self._held_part(tangents))
        self.slides = np.abs(held).max(axis=(1, 2)) > ALONG
        each = cells.measure * SLIP * bound / self.of_facets
        weights = np.repeat(each[:, None], self.of_facets, axis=1)
        hats = times_hats(N - 1, DEGREE)
        rubbed = cells.measure[:, None] * (data.friction @ hats.T)
        motion = self._motions().middle
        result = []
        for vectors, cost, chosen in (
            (held, weights, np.repeat(self.slides[:, None], self.of_facets, axis=1)),
            (tangents, rubbed, data.contact[:, None] & (rubbed > 0)),
        ):
            speeds = np.einsum("frp,fap->far", vectors, motion).ravel()
            rows = np.repeat(chosen.ravel(), N - 1)
            found = self._applied(self._at_facets(vectors, both=True)[rows])
            part = AffineRows(found.rows, found.offset - speeds[rows])
            result.append(DissipatedPart(part, N - 1, cost[chosen]))
        return tuple(result)

    def _exact_velocity(self, fluxes: np.ndarray) -> Enclosed:
        """The coefficients of the velocity with these unknowns, (nc, n, N)."""
        cells = self.data.cells
        N = cells.N
        areas = self.outline.areas
        slope = (areas * areas).sum(axis=2).root() / (self.outline.volumes * N)[:, None]
        x = Enclosed(cells.points)[cells.nodes]
        inner = fluxes[self.inner :].reshape(len(cells.nodes), -1)
        result = []
        for place, index in enumerate(self.indices):
            first, second = np.repeat(np.arange(N + 1), index)
            middle = (x[:, first] + x[:, second]) * 0.5
            whole = Enclosed(np.zeros(middle.middle.shape))
            for k in np.flatnonzero(index == 0):
                along = (middle - x[:, k]) * slope[:, k, None]
                flux = fluxes[self.unknown[:, k, place]] * cells.sign[:, k]
                whole = whole + along * flux[:, None]
            if first != second:
                own = inner[:, np.searchsorted(self.along, place)]
                speed = own / self._lengths(first, second)
                whole = whole + (x[:, second] - x[:, first]) * speed[:, None]
            result.append(whole)
        return joined_enclosures(result)

    def _jumps(self, velocity: Enclosed) -> Enclosed:
        """Velocities of the first cell less those of the second one on facets, (nf, m, N)."""
        cells = self.data.cells
        N = cells.N
        sides = []
        own = np.arange(len(cells.nodes))[:, None, None]
        at_facets = velocity[own, self.places]
        for sign in (1, -1):
            chosen = np.broadcast_to(cells.sign[:, :, None] == sign, self.slot.shape)
            places = self.slot[chosen]
            middle = np.zeros((self.inner, N))
            radius = np.zeros((self.inner, N))
            middle[places] = at_facets.middle[chosen]
            radius[places] = at_facets.radius[chosen]
            sides.append(Enclosed(middle, radius).reshape(-1, self.of_facets, N))
        return sides[0] - sides[1]

    def mechanism(self, solution: np.ndarray) -> Mechanism:
        """The admissible mechanism nearest to a solution, with its dissipation enclosed."""
        data = self.data
        cells = data.cells
        shape = self.shape
        y = self.flow.admissible(solution)
        fluxes = self.fluxes.at(y)
        touched = self._touched()
        fluxes[touched] = np.minimum(fluxes[touched], 0.0)
        velocity = self._exact_velocity(fluxes)
        strain, error, removed = strain_rates(
            data, shape, self.outline, velocity, DEGREE
        )
        rates = strain[:, :, shape.free :]
        dissipated = data.bound * dissipation(cells.N, rates, error)
        jumps = self._jumps(velocity) - self._motions()
        slips = jumps.middle.copy()
        slips[cells.outer] = self._held_part(slips)[cells.outer]
        slipped = self._slipped(slips, jumps.length().max(axis=1), jumps)
        powers = tuple(
            power_of(data, self.outline, velocity, DEGREE, kind)
            for kind in (GROWS, STAYS)
        )
        others = float(slipped.sum()) * (1 + ROUNDED)
        others += rubbed(self.rubbing, y, float(velocity.size.max()))
        found = proved(data, powers, removed, dissipated, others)
        power = found.power
        return Mechanism(
            velocity.middle / power,
            DEGREE,
            strain / cells.volume[:, None, None] / power,
            found.dissipated / power,
            slips / power,
            slipped / power,
            found.factor,
        )

    def _slipped(
        self, slips: np.ndarray, sizes: np.ndarray, jumps: Enclosed
    ) -> np.ndarray:
        """What slips with these coefficients (nf, m, N) dissipate on facets at most."""
        N = self.data.cells.N
        costs = self.slips.weights.reshape(-1, self.of_facets).sum(axis=1)
        error = np.linalg.norm(jumps.radius, axis=2).max(axis=1) + ROUNDED * sizes
        parts = parts_of(N - 1, DEGREE, CUTS) @ slips[self.slides]
        lengths = np.linalg.norm(parts, axis=2).mean(axis=1)
        result = np.zeros(len(slips))
        result[self.slides] = costs * (lengths + error[self.slides])
        return result
