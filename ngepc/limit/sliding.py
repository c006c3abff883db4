"""The upper bound for solids: velocities of degree one that may slip along the facets of cells.

Normal components are continuous, tangential ones may jump: a slip s dissipates beta |s| / 2^(1/2),
with the smaller beta of both sides, also along a support.  The unknowns are the normal components
at the vertices of facets: those of the N facets around a vertex of a cell determine its velocity
there.  Strain rates are constant on cells and slips are affine on facets, so that the mean of |s|
over the vertices of the parts of a facet is at least the mean over the facet.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, eye, kron, vstack

from ngepc.bounds.simplices import FACETS
from ngepc.limit.bernstein import chains, parts_of
from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.enclosed import Enclosed, joined_enclosures
from ngepc.limit.flow import AffineRows, DissipatedPart, Flow
from ngepc.limit.flow_proof import (
    NOTHING,
    ROUNDED,
    coordinates,
    divergences,
    gradients,
    power_of,
    proved,
    removal,
)
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.outline import Outline
from ngepc.limit.reading import completed_frame
from ngepc.limit.static import sparse_rows
from ngepc.limit.yielding import SLIP, YieldShape

CUTS = 8
"""Each edge is cut into so many parts to integrate the dissipation of slips."""

INSIDE = {2: np.array([[0.79, 0.21], [0.21, 0.79]]), 3: (1 + 3 * np.eye(3)) / 6}
"""Points of a facet at which the program evaluates slips, see ``sampling``."""

ALONG = 1e-9
"""Components of unit vectors below this number count as zero."""


class SlidingVelocities:
    """Velocities that are affine on cells and may slip along facets.

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
        N = cells.N
        self.through = self._through()
        fluxes = self._flux_speeds()
        given = np.repeat(self.through, N)
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
        """The normal velocities of supports at the vertices of facets, flat."""
        return np.einsum("fip,fp->fi", self.data.motion, self.data.cells.normal).ravel()

    def _velocity(self, fluxes: np.ndarray, given: np.ndarray) -> AffineRows:
        """Components at the vertices of cells, rows (cell, vertex, component)."""
        cells = self.data.cells
        N = cells.N
        x = cells.points[cells.nodes]
        count = len(cells.nodes)
        slope = np.linalg.norm(cells.gradients, axis=2)
        values = []
        rows = []
        columns = []
        own = np.arange(count)[:, None]
        for k, vertices in enumerate(FACETS[N]):
            for m, i in enumerate(vertices):
                # the velocity with this flux through facet k and none through the others at i
                along = -(x[:, k] - x[:, i]) * slope[:, k, None]
                values.append(along * cells.sign[:, k, None])
                rows.append(N * ((N + 1) * own + i) + np.arange(N))
                columns.append(np.broadcast_to(cells.slot[:, k, m, None], (count, N)))
        size = (count * (N + 1) * N, len(fluxes))
        whole = sparse_rows(
            np.concatenate(values), np.concatenate(rows), np.concatenate(columns), size
        )
        return AffineRows(whole[:, ~given], whole @ np.where(given, fluxes, 0.0))

    def _applied(self, matrix: csr_matrix) -> AffineRows:
        """A matrix times the velocities."""
        velocity = self.velocity
        return AffineRows(csr_matrix(matrix @ velocity.rows), matrix @ velocity.offset)

    def _strain(self) -> csr_matrix:
        """Coordinates of the strain rate times the size of the cell, rows (cell, c)."""
        cells = self.data.cells
        N = cells.N
        size = cells.volume ** (1 / N)
        values = np.einsum("t,cpq,tiq->tcip", size, self.shape.basis, cells.gradients)
        count = len(size)
        rows = np.arange(count * self.shape.size).reshape(count, -1, 1, 1)
        columns = np.arange(count * (N + 1) * N).reshape(count, 1, N + 1, N)
        return sparse_rows(values, rows, columns, (rows.size, columns.size))

    def _at_facets(self, vectors: np.ndarray, both: bool) -> csr_matrix:
        """Products of vectors (nf, r, N) with velocities at the vertices of facets.

        The velocity of the first cell of each facet; with ``both``, less that of the second cell.
        """
        cells = self.data.cells
        N = cells.N
        local = np.array(FACETS[N])
        kept = cells.sign > 0
        kept = kept | both
        values = np.where(kept, cells.sign, 0.0)[..., None, None]
        values = values * vectors[cells.facet_of]
        count = vectors.shape[1]
        shape = (*cells.place.shape, count, N)
        values = np.broadcast_to(values[:, :, None], shape)
        row = count * cells.slot[..., None] + np.arange(count)
        vertex = (N + 1) * np.arange(len(cells.nodes))[:, None, None] + local
        column = N * vertex[..., None] + np.arange(N)
        size = (cells.facets.size * count, len(cells.nodes) * (N + 1) * N)
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
            chosen = np.repeat((held & oblique[:, None])[:, None], N, axis=1).ravel()
            speeds = np.einsum("frp,fip->fir", data.frame, data.motion).ravel()
            found = self._applied(self._at_facets(data.frame, both=False)[chosen])
            rows.append(AffineRows(found.rows, found.offset - speeds[chosen]))
        return AffineRows(
            vstack([part.rows for part in rows], format="csr"),
            np.concatenate([part.offset for part in rows]),
        )

    def _push(self) -> AffineRows:
        """Normal components on facets that obstacles touch."""
        touched = np.repeat(self.data.contact, self.data.cells.N)
        return AffineRows(self.fluxes.rows[touched], self.fluxes.offset[touched])

    def _power(self, kind: int) -> AffineRows:
        """Power of the loads that grow or stay."""
        data = self.data
        cells = data.cells
        N = cells.N
        mass = (np.ones((N, N)) + np.eye(N)) / (N * (N + 1))
        loads = np.where(cells.outer[:, None, None], data.traction[kind], 0.0)
        moments = np.einsum("f,ij,fjp->fip", cells.measure, mass, loads)
        axes = np.tile(np.eye(N), (len(cells.facets), 1, 1))
        by_area = moments.ravel() @ self._at_facets(axes, both=False)
        by_volume = cells.volume[:, None] / (N + 1) * data.force[kind]
        by_volume = np.repeat(by_volume[:, None], N + 1, axis=1).ravel()
        return self._applied(csr_matrix(by_area + by_volume))

    def _parts(self) -> list[DissipatedPart]:
        """Dissipation in cells, by slips between them and at supports, and by friction."""
        data = self.data
        cells = data.cells
        shape = self.shape
        N = cells.N
        capped = np.arange(self.strain.shape[0]) % shape.size >= shape.free
        size = cells.volume ** (1 / N)
        strained = DissipatedPart(
            self._applied(self.strain[capped]),
            shape.capped,
            data.bound * cells.volume / size,
        )
        return [strained, self._sampled(), *self.rubbing]

    def _sampled(self) -> DissipatedPart:
        """Slips at points inside facets."""
        slips = self.slips
        N = self.data.cells.N
        rule = kron(INSIDE[N], np.eye(N - 1))
        at_points = csr_matrix(kron(eye(len(slips.weights) // N), rule))
        vectors = slips.vectors
        rows = csr_matrix(at_points @ vectors.rows)
        offset = at_points @ vectors.offset
        return DissipatedPart(AffineRows(rows, offset), slips.size, slips.weights)

    def _slips(self) -> tuple[DissipatedPart, DissipatedPart]:
        """Slips at the vertices of facets, inside and at supports, then along obstacles."""
        data = self.data
        cells = data.cells
        N = cells.N
        tangents = completed_frame(cells.normal[:, None])[:, 1:]
        bound = data.bound[cells.owners[:, 0]]
        inside = ~cells.outer
        bound[inside] = np.minimum(bound, data.bound[cells.owners[:, 1]])[inside]
        held = np.where(inside[:, None, None], tangents, self._held_part(tangents))
        self.slides = np.abs(held).max(axis=(1, 2)) > ALONG
        weights = cells.measure[:, None] / N * (SLIP * bound)[:, None] * np.ones(N)
        mass = (np.ones((N, N)) + np.eye(N)) / (N * (N + 1))
        rubbed = cells.measure[:, None] * np.einsum("ij,fj->fi", mass, data.friction)
        result = []
        for vectors, cost, chosen in (
            (held, weights, np.repeat(self.slides[:, None], N, axis=1)),
            (tangents, rubbed, data.contact[:, None] & (rubbed > 0)),
        ):
            speeds = np.einsum("frp,fip->fir", vectors, data.motion).ravel()
            rows = np.repeat(chosen.ravel(), N - 1)
            found = self._applied(self._at_facets(vectors, both=True)[rows])
            part = AffineRows(found.rows, found.offset - speeds[rows])
            result.append(DissipatedPart(part, N - 1, cost[chosen]))
        return tuple(result)

    def _exact_velocity(self, fluxes: np.ndarray) -> Enclosed:
        """The velocity at the vertices of cells whose normal components are these numbers."""
        cells = self.data.cells
        N = cells.N
        areas = self.outline.areas
        slope = (areas * areas).sum(axis=2).root() / (self.outline.volumes * N)[:, None]
        x = Enclosed(cells.points)[cells.nodes]
        terms: list[list[Enclosed]] = [[] for _ in range(N + 1)]
        for k, vertices in enumerate(FACETS[N]):
            for m, i in enumerate(vertices):
                along = (x[:, i] - x[:, k]) * slope[:, k, None]
                flux = fluxes[cells.slot[:, k, m]] * cells.sign[:, k]
                terms[i].append(along * flux[:, None])
        result = []
        for parts in terms:
            whole = parts[0]
            for part in parts[1:]:
                whole = whole + part
            result.append(whole)
        return joined_enclosures(result)

    def _jumps(self, velocity: Enclosed) -> Enclosed:
        """Velocities of the first cell less those of the second one at facets, (nf, N, N)."""
        cells = self.data.cells
        N = cells.N
        sides = []
        at_facets = velocity[:, np.array(FACETS[N])]
        for sign in (1, -1):
            chosen = np.broadcast_to(cells.sign[:, :, None] == sign, cells.slot.shape)
            places = cells.slot[chosen]
            middle = np.zeros((cells.facets.size, N))
            radius = np.zeros((cells.facets.size, N))
            middle[places] = at_facets.middle[chosen]
            radius[places] = at_facets.radius[chosen]
            sides.append(Enclosed(middle, radius).reshape(-1, N, N))
        return sides[0] - sides[1]

    def mechanism(self, solution: np.ndarray) -> Mechanism:
        """The admissible mechanism nearest to a solution, with its dissipation enclosed."""
        data = self.data
        cells = data.cells
        shape = self.shape
        N = cells.N
        y = self.flow.admissible(solution)
        fluxes = self.fluxes.at(y)
        touched = np.repeat(data.contact, N)
        fluxes[touched] = np.minimum(fluxes[touched], 0.0)
        velocity = self._exact_velocity(fluxes)
        coefficients = velocity[:, chains(N, 1)[:, 0]]
        gradient = gradients(self.outline, coefficients, 1)
        strain, error = coordinates(shape, gradient)
        removed = NOTHING
        if shape.free:
            removed = removal(data, self.outline, divergences(gradient), 0)
        lengths = np.linalg.norm(strain[:, 0, shape.free :], axis=1)
        dissipated = data.bound * (lengths * (1 + ROUNDED) + error[:, 0])
        jumps = self._jumps(velocity) - data.motion
        slips = jumps.middle.copy()
        slips[cells.outer] = self._held_part(slips)[cells.outer]
        slipped = self._slipped(slips, jumps.length().max(axis=1), jumps)
        powers = tuple(
            power_of(data, self.outline, coefficients, 1, kind)
            for kind in (GROWS, STAYS)
        )
        others = float(slipped.sum()) * (1 + ROUNDED) + self._rubbed(y, velocity)
        found = proved(data, powers, removed, dissipated, others)
        power = found.power
        return Mechanism(
            coefficients.middle / power,
            1,
            strain / cells.volume[:, None, None] / power,
            found.dissipated / power,
            slips / power,
            slipped / power,
            found.factor,
        )

    def _slipped(
        self, slips: np.ndarray, sizes: np.ndarray, jumps: Enclosed
    ) -> np.ndarray:
        """What slips (nf, N, N) at the vertices of facets dissipate on them at most."""
        N = self.data.cells.N
        costs = self.slips.weights.reshape(-1, N).sum(axis=1)
        error = np.linalg.norm(jumps.radius, axis=2).max(axis=1) + ROUNDED * sizes
        parts = parts_of(N - 1, 1, CUTS) @ slips[self.slides]
        lengths = np.linalg.norm(parts, axis=2).mean(axis=1)
        result = np.zeros(len(slips))
        result[self.slides] = costs * (lengths + error[self.slides])
        return result

    def _rubbed(self, y: np.ndarray, velocity: Enclosed) -> float:
        """What friction dissipates at most."""
        total = 0.0
        fastest = float(velocity.size.max())
        for part in self.rubbing:
            lengths = part.lengths(y) + ROUNDED * fastest
            total += float(part.weights @ lengths) * (1 + ROUNDED)
        return total
