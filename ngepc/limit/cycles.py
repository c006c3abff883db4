"""Both bounds of loads that vary: residual stresses (Melan) and cycles of strain (Koiter).

The elastic stresses sigma_j of the vertices of a set of loads are given on each cell, affine.  A
factor alpha is safe if a residual stress rho, the same for all vertices, keeps

    |dev(alpha sigma_j + rho)| <= beta        at each point and for each vertex j.

Strain increments e_j, one for each vertex, whose sum is the strain of an admissible velocity, bound
alpha from above:

    alpha sum_j int sigma_j : e_j <= sum_j int beta |e_j| - (power of the constant loads).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, eye, hstack, kron, vstack

from ngepc.limit.bracket import (
    UNBOUNDED,
    Found,
    MeshBracket,
    centre_of,
    locked,
    lower_on,
    none_holds,
    upper_on,
)
from ngepc.limit.continuous import ContinuousVelocities, sampling
from ngepc.limit.data import STAYS, LimitData
from ngepc.limit.enclosed import Enclosed
from ngepc.limit.flow import AffineRows, DissipatedPart, Flow
from ngepc.limit.flow_proof import (
    ROUNDED,
    Removal,
    dissipation,
    power_of,
    proved,
    strain_rates,
)
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.outline import Outline
from ngepc.limit.static import AdmissibleStress, Statics
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.bernstein import bernstein_values, times_hats
from ngepc.linalg.conic import ConicAccuracy

DEGREE = 2
"""Degree of the velocities."""

BALL_STEPS = 300
"""Steps of the search for the smallest balls around the stresses of a point."""

ROUNDING = 1e-12
"""Relative amount by which the bound of alternating plasticity is enlarged for rounding."""


class ResidualStatics(Statics):
    """Residual stresses and the load factor, x = (coordinates of rho, alpha).

    Parameters
    ----------
    data
        Constant loads, supports, strength.
    shape
        The yield condition.
    elastic
        Coordinates of the elastic stresses of the vertices, (J, nc, N + 1, s).
    """

    def __init__(self, data: LimitData, shape: YieldShape, elastic: np.ndarray) -> None:
        self.elastic = elastic
        super().__init__(data, shape)

    def yield_rows(self) -> csr_matrix:
        """Zero and the capped coordinates of alpha sigma_j + rho, vertex after vertex of loads."""
        of_residual = super().yield_rows()[:, :-1]
        result = []
        for stress in self.elastic:
            capped = stress[:, :, self.shape.free :].reshape(-1, self.shape.capped)
            column = np.pad(capped, ((0, 0), (1, 0))).reshape(-1, 1)
            result.append(hstack([of_residual, csr_matrix(column)]))
        return csr_matrix(vstack(result))

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values of cells at each of their vertices, for each vertex of loads."""
        return np.tile(super().at_vertices(values), len(self.elastic))

    def capped(self, x: np.ndarray) -> np.ndarray:
        """|dev(alpha sigma_j + rho)| at each vertex of each cell."""
        residual = x[:-1].reshape(self.elastic.shape[1:])
        whole = x[-1] * self.elastic + residual
        return np.linalg.norm(whole[..., self.shape.free :], axis=3).ravel()


@dataclass(frozen=True, eq=False)
class CycleMechanism(Mechanism):
    """Strain increments of the vertices of loads, and the velocity that their sum belongs to.

    ``strain`` has the capped coordinates for each vertex of loads, (J, nc, m, s - free).

    Parameters
    ----------
    power
        Of the elastic stresses on each cell; they add up to one.
    """

    power: np.ndarray


class StrainCycles(ContinuousVelocities):
    """Velocities and strain increments; unknowns are those of velocities, then all e_j but one.

    The increments are polynomials on each cell like the strain of the velocity, times the size of
    the cell; the last one is that strain less all others.

    Parameters
    ----------
    data, shape, elastic
        As for ``ResidualStatics``.
    """

    def __init__(self, data: LimitData, shape: YieldShape, elastic: np.ndarray) -> None:
        super().__init__(data, shape, DEGREE)
        self.elastic = elastic
        self.size = np.sqrt(data.cells.volume)
        self.coefficients = self._increments()
        limit = self.flow
        self.flow = Flow(
            none=self._widened(limit.none),
            push=self._widened(limit.push),
            power=(self._elastic_power(), self._widened(limit.power[STAYS])),
            parts=self._parts(),
            moves=False,
        )

    @property
    def increments(self) -> int:
        """Number of the unknowns of one increment."""
        return len(self.size) * self.strains * self.shape.capped

    def _widened(self, part: AffineRows) -> AffineRows:
        """Append zero columns for the increments to rows for velocities."""
        width = (len(self.elastic) - 1) * self.increments
        zero = csr_matrix((part.rows.shape[0], width))
        return AffineRows(csr_matrix(hstack([part.rows, zero])), part.offset)

    def _increments(self) -> list[AffineRows]:
        """Capped Bernstein coefficients of each increment times the size of the cell."""
        own = len(self.elastic) - 1
        whole = self._weighted(self.size, np.eye(self.strains))
        capped = np.arange(whole.shape[0]) % self.shape.size >= self.shape.free
        strain = self._widened(self._applied(whole[capped]))
        width = strain.rows.shape[1] - own * self.increments
        result = []
        rest = strain.rows
        for k in range(own):
            before = csr_matrix((self.increments, width + k * self.increments))
            after = csr_matrix((self.increments, (own - 1 - k) * self.increments))
            rows = csr_matrix(hstack([before, eye(self.increments), after]))
            result.append(AffineRows(rows, np.zeros(self.increments)))
            rest = rest - rows
        return [*result, AffineRows(csr_matrix(rest), strain.offset)]

    def _moments(self) -> np.ndarray:
        """The power of the coefficients above, (J, nc, m, capped)."""
        cells = self.data.cells
        hats = times_hats(2, self.degree - 1)
        capped = self.elastic[..., self.shape.free :]
        mean = np.einsum("ai,jtic->jtac", hats, capped)
        return (cells.volume / self.size)[:, None, None] * mean

    def _elastic_power(self) -> AffineRows:
        """The power of the elastic stresses."""
        rows = 0.0
        offset = 0.0
        for moments, part in zip(self._moments(), self.coefficients, strict=True):
            weights = csr_matrix(moments.reshape(1, -1))
            rows = rows + weights @ part.rows
            offset = offset + weights @ part.offset
        return AffineRows(csr_matrix(rows), offset)

    def _parts(self) -> list[DissipatedPart]:
        """Lengths of the increments at sampling points."""
        points, weights = sampling(self.degree)
        data = self.data
        cost = np.outer(data.bound * data.cells.volume / self.size, weights).ravel()
        values = kron(bernstein_values(self.degree - 1, points), eye(self.shape.capped))
        at_points = csr_matrix(kron(eye(len(self.size)), values))
        result = []
        for part in self.coefficients:
            sampled = AffineRows(
                csr_matrix(at_points @ part.rows), at_points @ part.offset
            )
            result.append(DissipatedPart(sampled, self.shape.capped, cost))
        return result

    def mechanism(self, solution: np.ndarray) -> CycleMechanism:
        """The admissible cycle nearest to a solution, with its dissipation enclosed."""
        data = self.data
        cells = data.cells
        shape = self.shape
        y = self.flow.admissible(solution)
        velocity = self.velocity(y[: self.directions.shape[1]])
        values = velocity[self.numbers]
        outline = Outline(cells)
        exact = Enclosed(values)
        rest, error, removed = strain_rates(data, shape, outline, exact, self.degree)
        rest = rest[:, :, shape.free :]
        strains = []
        size = cells.volume / self.size
        for part in self.coefficients[:-1]:
            strain = part.at(y).reshape(rest.shape) * size[:, None, None]
            strains.append(strain)
            error = error + ROUNDED * np.linalg.norm(strain, axis=2)
            rest = rest - strain
        strains.append(rest)
        lengths = sum(dissipation(2, strain, error) for strain in strains)
        grows = self._elastic_power_of(strains, error, removed)
        stays = power_of(data, outline, exact, self.degree, STAYS)
        found = proved(data, (grows, stays), removed, data.bound * lengths, 0.0)
        power = found.power
        strain = np.stack(strains) / (cells.volume[:, None, None] * power)
        scaled = strain * self.size[:, None, None]
        return CycleMechanism(
            values / power,
            self.degree,
            strain,
            found.dissipated / power,
            np.zeros((len(cells.facets), 2, 2)),
            np.zeros(len(cells.facets)),
            found.factor,
            np.einsum("jtac,jtac->t", self._moments(), scaled),
        )

    def _elastic_power_of(
        self, strains: list[np.ndarray], error: np.ndarray, removed: Removal
    ) -> Enclosed:
        """The power of the elastic stresses on increments times the volume, with its error."""
        hats = times_hats(2, self.degree - 1)
        capped = self.elastic[..., self.shape.free :]
        mean = np.einsum("ai,jtic->jtac", hats, capped)
        terms = mean * np.stack(strains)
        largest = np.linalg.norm(self.elastic, axis=3).max(axis=(0, 2))
        unsure = len(strains) * largest * error.sum(axis=1)
        unsure = unsure + largest / self.data.bound * removed.dissipated
        radius = unsure.sum() + ROUNDED * np.abs(terms).sum()
        return Enclosed(math.fsum(terms.ravel()), radius)


def cycle_gaps(
    statics: ResidualStatics,
    stress: AdmissibleStress | None,
    cycle: CycleMechanism | None,
) -> np.ndarray:
    """Dissipation minus power of alpha sigma_j + rho on each cell."""
    cells = statics.data.cells
    if cycle is None:
        return cells.volume
    if stress is None:
        return cycle.dissipated
    hats = times_hats(2, cycle.degree - 1)
    capped = stress.coordinates[..., statics.shape.free :]
    total = cycle.strain.sum(axis=0)
    mean = np.einsum("tac,ai,tic->t", total, hats, capped, optimize=True)
    return cycle.dissipated - stress.factor * cycle.power - cells.volume * mean


@dataclass(frozen=True, eq=False)
class CycleBracket(MeshBracket):
    """The result of one mesh for loads that vary; its gaps are taken for its marks."""

    @property
    def gaps(self) -> np.ndarray:
        """Dissipation minus power of the stresses on each cell."""
        return self.marks


def cycle_bracket_on(
    data: LimitData,
    shape: YieldShape,
    elastic: np.ndarray,
    centre: np.ndarray | None,
    accuracy: ConicAccuracy,
) -> tuple[CycleBracket, np.ndarray | None]:
    """Both bounds on a mesh, and the admissible point that the lower one starts from."""
    statics = ResidualStatics(data, shape, elastic)
    if centre is None:
        centre = centre_of(statics)
    below = lower_on(statics, centre, accuracy)
    above = upper_on(StrainCycles(data, shape, elastic), accuracy)

    def back() -> Found:
        """The best cycle of the loads that act the other way."""
        return upper_on(StrainCycles(data, shape, -elastic), accuracy)

    bracket = CycleBracket(
        data,
        shape,
        below.field,
        above.field,
        cycle_gaps(statics, below.field, above.field) + locked(data, below, above),
        below.word in UNBOUNDED,
        below.field is None and none_holds(above, back),
        (below.unknowns, above.unknowns),
        (below.steps, above.steps),
        (below.word, above.word),
    )
    return bracket, centre


def alternating_bound(data: LimitData, shape: YieldShape, elastic: np.ndarray) -> float:
    """The factor above which plastic strains alternate at some point, an upper bound.

    There no residual stress keeps the stresses of all vertices within the yield condition: the
    smallest ball around the dev sigma_j has a radius r with alpha r > beta.  The radius is convex
    where the stresses are affine, so that the vertices of cells have the largest one.  For any
    weights w_j >= 0 with the sum one, r^2 >= sum_j w_j |s_j|^2 - |sum_j w_j s_j|^2.
    """
    points = elastic[..., shape.free :].reshape(len(elastic), -1, shape.capped)
    squares = largest_spread(points)
    strengths = np.repeat(data.bound, elastic.shape[2])
    with np.errstate(divide="ignore"):
        factors = strengths / np.sqrt(squares)
    return float(factors.min()) * (1 + ROUNDING)


def largest_spread(points: np.ndarray) -> np.ndarray:
    """Lower bounds of squared radii of the smallest balls around points (J, n, d), shape (n,).

    The largest sum_j w_j |s_j - c|^2 with c = sum_j w_j s_j, by the method of Frank and Wolfe.
    """
    centre = points.mean(axis=0)
    spread = ((points - centre) ** 2).sum(axis=2).mean(axis=0)
    own = np.arange(points.shape[1])
    for _ in range(BALL_STEPS):
        distances = ((points - centre) ** 2).sum(axis=2)
        farthest = distances.argmax(axis=0)
        square = distances[farthest, own]
        step = np.maximum(square - spread, 0.0) / np.maximum(2 * square, 1e-300)
        centre = centre + step[:, None] * (points[farthest, own] - centre)
        spread = (1 - step) * (spread + step * square)
    return spread
