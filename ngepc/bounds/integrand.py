"""Integrals of the supremum of a goal over the cells, by a rule and bounded from above.

For displacements of order one strains are constant on a cell, and the supremum is convex in the
stresses, which are affine on the parts of the cell: on each part the integral is at most the mean
of the values at its vertices.  Where it is a quadratic on a part a rule of degree two is exact.
Parts are cut where the two differ most.

For order two strains are affine and stresses quadratic.  Where the supremum is a quadratic of them
a rule of degree four is exact; elsewhere it is a rule and no bound, which ``bounds`` says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.adjoint import Adjoint
from ngepc.bounds.bound import ErrorBound
from ngepc.bounds.conjugate import R6
from ngepc.bounds.data import BoundData
from ngepc.bounds.parts import (
    AT_NODES,
    AT_POINTS,
    NODES,
    RULE,
    SPLIT,
    TO_NODES,
    WEIGHTS,
)
from ngepc.bounds.supremum import PointData, Stresses, suprema
from ngepc.discretisation.law import Law

SPLITS = {3: 3, 4: 2}
"""Most levels of cutting, by the number of vertices of a part."""
WORTH = 0.05
"""Parts are cut until the possible gain is this part of the integrals."""


MIDDLE = {}
CHILDREN = {}
"""Middles of the edges of a part, barycentric, and which node is which corner of its parts."""
for _k in (3, 4):
    _first, _second = np.triu_indices(_k, 1)
    MIDDLE[_k] = (np.eye(_k)[_first] + np.eye(_k)[_second]) / 2
    _nodes = np.concatenate([np.eye(_k), MIDDLE[_k]])
    _apart = np.abs(SPLIT[_k][:, :, None] - _nodes).sum(axis=3)
    CHILDREN[_k] = _apart.argmin(axis=2)
MIDDLE_WEIGHTS = {3: np.full(3, 1 / 3), 4: np.full(6, 1 / 5)}
CORNER_WEIGHTS = {3: np.zeros(3), 4: np.full(4, -1 / 20)}
"""Weights of rules of degree two at the middles of the edges and at the corners."""


@dataclass(frozen=True, eq=False)
class Integrand:
    """The supremum over the parts of the cells.

    ``tau`` and ``sigma`` (parts, k, 1 + d) are coefficients of stresses on the parts: mean, then
    deviator; ``data`` and ``strain`` are those at the k points of a rule on each part (constant on
    cells for order one, one row for each part); ``cell`` and ``volume`` (parts,) say where a part
    is; ``opened`` is int P^ gap_h, ``residual`` minus int s(eps_h) : eps(z).
    """

    tau: np.ndarray
    sigma: np.ndarray
    data: PointData
    strain: Stresses
    cell: np.ndarray
    volume: np.ndarray
    opened: float
    residual: float

    @property
    def k(self) -> int:
        """Coefficients on each part."""
        return self.tau.shape[1]

    def _at(
        self,
        table: np.ndarray,
        tau: np.ndarray,
        sigma: np.ndarray,
        row: np.ndarray,
        sign: float,
        factor: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Suprema at points of parts with these coefficients, (parts, points), and if smooth."""
        count = len(table)
        where = np.repeat(row, count) if self.k < 6 else _points_of(row, count)
        tau = sign * np.matmul(table, tau).reshape(len(where), -1)
        sigma = np.matmul(table, sigma).reshape(len(where), -1)
        strain = self.strain.of(where)
        strain = strain if sign > 0 else -strain
        values, smooth = suprema(
            self.data.of(where),
            Stresses(tau[:, 0], tau[:, 1:]),
            Stresses(sigma[:, 0], sigma[:, 1:]),
            strain,
            factor,
        )
        return values.reshape(-1, count), smooth.reshape(-1, count)

    def likely(self, factor: float) -> float:
        """About the width for a factor, by a rule."""
        row = np.arange(len(self.tau))
        total = 2 * factor * self.opened
        for sign in (1.0, -1.0):
            found, _ = self._at(RULE[self.k], self.tau, self.sigma, row, sign, factor)
            total += float(self.volume @ (found @ WEIGHTS[self.k]))
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray, bool]:
        """Integrals over the cells for tau and for -tau, and whether they are bounds."""
        above, first = self._bounds(1.0, factor)
        below, second = self._bounds(-1.0, factor)
        return above, below, first and second

    def _bounds(self, sign: float, factor: float) -> tuple[np.ndarray, bool]:
        count = int(self.cell.max()) + 1
        if self.k == 6:
            return self._by_rule(sign, factor, count)
        result = np.zeros(count)
        k = self.k
        tau = self.tau
        sigma = self.sigma
        row = np.arange(len(tau))
        volume = self.volume
        corners, inside = self._at(np.eye(k), tau, sigma, row, sign, factor)
        for level in range(SPLITS[k] + 1):
            middles, _ = self._at(MIDDLE[k], tau, sigma, row, sign, factor)
            likely = volume * (
                middles @ MIDDLE_WEIGHTS[k] + corners @ CORNER_WEIGHTS[k]
            )
            bound = volume * corners.mean(axis=1)
            smooth = inside.all(axis=1)
            bound = np.maximum(np.where(smooth, likely, bound), 0.0)
            gain = np.maximum(bound - likely, 0.0)
            allowed = WORTH * max(result.sum() + likely.sum(), 0.0)
            order = np.argsort(gain)
            kept = np.full(len(gain), level == SPLITS[k])
            kept[order[np.cumsum(gain[order]) <= allowed / 2]] = True
            result += np.bincount(self.cell[row[kept]], bound[kept], minlength=count)
            if kept.all():
                break
            cut = ~kept
            parts = len(SPLIT[k])
            table = SPLIT[k].reshape(-1, k)
            nodes = np.concatenate([corners[cut], middles[cut]], axis=1)
            corners = nodes[:, CHILDREN[k]].reshape(-1, k)
            tau = np.matmul(table, tau[cut]).reshape(-1, k, tau.shape[2])
            sigma = np.matmul(table, sigma[cut]).reshape(-1, k, sigma.shape[2])
            row = np.repeat(row[cut], parts)
            volume = np.repeat(volume[cut] / parts, parts)
            inside = np.zeros((len(row), 1), dtype=bool)
        return result, True

    def _by_rule(
        self, sign: float, factor: float, count: int
    ) -> tuple[np.ndarray, bool]:
        """Integrals by the rule of degree four, and whether they are exact."""
        row = np.arange(len(self.tau))
        values, smooth = self._at(RULE[6], self.tau, self.sigma, row, sign, factor)
        integrals = self.volume * (values @ WEIGHTS[6])
        return np.bincount(self.cell, integrals, minlength=count), bool(smooth.all())


def _points_of(row: np.ndarray, count: int) -> np.ndarray:
    """Numbers of the points of parts that have ``count`` points each."""
    return (row[:, None] * count + np.arange(count)).ravel()


def integrand_of(setting: BoundData, bound: ErrorBound, adjoint: Adjoint) -> Integrand:
    """The supremum for a bound and an adjoint."""
    state = bound.state
    discrete = setting.discrete
    law = discrete.law
    points = discrete.points
    cells = len(setting.cells.nodes)
    k = NODES[bound.admissible.shape[1]]
    parts = bound.admissible.shape[1] // k
    trace, deviator = points.strain(adjoint.z)
    moduli = state.with_radial_return().moduli
    at = setting.at_nodes.completed(bound.admissible)
    sigma = np.concatenate([at.mean[..., None], at.deviator], axis=-1)
    wanted = np.column_stack(moduli.stress(trace, deviator))
    wanted = on_nodes(setting, wanted)
    tau = completed_near(adjoint.stress, wanted, law, setting.each)
    if k == 6:
        inverse = np.linalg.inv(AT_NODES)
        tau, sigma = (
            np.matmul(inverse, v.reshape(cells, 3, 6, -1)) for v in (tau, sigma)
        )
    data, strain = point_data(setting, state, trace, deviator, parts)
    residual = -float(_work(data, strain) @ _weights(setting, k, parts))
    opened = setting.contact.opening(state.u, bound.pressure).sum()
    return Integrand(
        tau.reshape(cells * parts, k, -1),
        sigma.reshape(cells * parts, k, -1),
        data,
        strain,
        np.repeat(np.arange(cells), parts),
        np.repeat(setting.cells.volume / parts, parts),
        float(opened),
        residual,
    )


def on_nodes(setting: BoundData, values: np.ndarray) -> np.ndarray:
    """Of functions given at the points: at the nodes of the parts, or once for each cell."""
    if setting.each == 1:
        return values[:, None]
    return np.matmul(TO_NODES, setting.at_corners(values))


def _weights(setting: BoundData, k: int, parts: int) -> np.ndarray:
    """The volume that belongs to each row of ``point_data``."""
    part = np.repeat(setting.cells.volume / parts, parts)
    return part if k < 6 else (part[:, None] * WEIGHTS[6]).ravel()


def _work(data: PointData, strain: Stresses) -> np.ndarray:
    """s(eps_h) : eps(z) at points."""
    work = data.bulk * data.volume * strain.mean
    return work + np.einsum("nd,nd->n", data.stress, strain.deviator)


def point_data(
    setting: BoundData,
    state: object,
    trace: np.ndarray,
    deviator: np.ndarray,
    parts: int,
) -> tuple[PointData, Stresses]:
    """Law, state and eps(z) for each part of each cell, with order two at its points."""
    law = setting.discrete.law
    each = setting.each
    if each == 1:

        def spread(values: np.ndarray) -> np.ndarray:
            """The same for all parts of a cell."""
            return np.repeat(values, parts, axis=0)

    else:

        def spread(values: np.ndarray) -> np.ndarray:
            """Of affine functions at the points of the parts."""
            columns = values.reshape(len(values), -1)
            found = np.matmul(AT_POINTS, setting.at_corners(columns))
            return found.reshape(-1, *values.shape[1:])

    bulk, two_mu, hardening, beta = (
        spread(np.asarray(v)) for v in (law.bulk, law.two_mu, law.hardening, law.beta)
    )
    trial = spread(state.at.trial)
    back = spread(np.ascontiguousarray(law.back))
    size = np.linalg.norm(trial, axis=1)
    share = np.minimum(beta / np.maximum(size, np.finfo(float).tiny), 1.0)
    kept = (hardening + two_mu * share) / (two_mu + hardening)
    stress = kept[:, None] * trial + back
    volume = spread(state.volume)
    data = PointData(bulk, two_mu, hardening, beta, volume, trial, back, stress)
    return data, Stresses(spread(trace), spread(deviator))


def completed_near(
    stress: np.ndarray, wanted: np.ndarray, law: Law, each: int
) -> np.ndarray:
    """Mean and deviator of stresses (cells, nodes, c), near the ``wanted`` (cells, ., 1 + d).

    In plane strain every stress along the third direction will do: that of the wanted one and
    what answers the difference of the traces elastically.
    """
    if wanted.shape[2] == stress.shape[2]:
        return stress
    bulk = law.bulk[::each, None]
    two_mu = law.two_mu[::each, None]
    trace = wanted[..., 0] + wanted[..., 2] / R6
    ratio = 1 / (R6 * bulk) / (1 / (6 * bulk) + 1 / two_mu)
    zeta = wanted[..., 2] + ratio * (stress[..., 0] - trace)
    mean = stress[..., 0] - zeta / R6
    return np.stack([mean, stress[..., 1], zeta, stress[..., 2]], axis=-1)
