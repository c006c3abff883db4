"""Integrals of the supremum of a goal over the cells: quadrature, and bounds from above.

For displacements of order one strains are constant on a cell, and the supremum is convex in the
stresses, which are affine on the parts of the cell: on each part the mean is at most the mean of
the values at its vertices.  Where the supremum is quadratic on a part, a rule of degree two is
exact.  Parts are cut where bound and quadrature differ most.

For order two strains are affine too: ``ngepc.bounds.varying``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ngepc.bounds.adjoint import Adjoint
from ngepc.bounds.bound import ErrorBound
from ngepc.bounds.conjugate import R6
from ngepc.bounds.data import BoundData
from ngepc.bounds.parts import NODES, RULE, SPLIT, TO_NODES, WEIGHTS, coefficients
from ngepc.bounds.supremum import PointData, Stresses, kept_part, suprema
from ngepc.bounds.varying import VaryingData, estimated_integrals, integrals
from ngepc.discretisation.law import Law
from ngepc.local.system import State

SPLITS = {3: 3, 4: 2}
"""Largest number of levels of cutting, by the number of vertices of a part."""
WORTH = 0.05
"""Parts are cut until the possible gain is this fraction of the integrals."""


MIDDLE = {}
CHILDREN = {}
"""Edge midpoints of a part (barycentric), and the nodes that are corners of its children."""
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

    ``tau`` and ``sigma`` (parts, k, 1 + d) are the coefficients of the stresses on the parts: mean,
    then deviator.  ``data`` and ``strain`` are constant on each part.  ``cell`` and ``volume``
    (parts,) are the cell and the volume of each part.  ``opened`` is int P^ gap_h, ``residual`` is
    minus the integral of s(eps_h) : eps(z).
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
        """Suprema at points of parts (parts, points), and whether they are smooth there."""
        count = len(table)
        where = np.repeat(row, count)
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

    def estimate(self, factor: float) -> float:
        """About the width for a factor, by a rule."""
        row = np.arange(len(self.tau))
        total = 2 * factor * self.opened
        for sign in (1.0, -1.0):
            found, _ = self._at(RULE[self.k], self.tau, self.sigma, row, sign, factor)
            total += float(self.volume @ (found @ WEIGHTS[self.k]))
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells for tau and for -tau, from above."""
        return self._bounds(1.0, factor), self._bounds(-1.0, factor)

    def _bounds(self, sign: float, factor: float) -> np.ndarray:
        result = np.zeros(int(self.cell.max()) + 1)
        count = len(result)
        k = self.k
        tau = self.tau
        sigma = self.sigma
        row = np.arange(len(tau))
        volume = self.volume
        corners, inside = self._at(np.eye(k), tau, sigma, row, sign, factor)
        for level in range(SPLITS[k] + 1):
            middles, _ = self._at(MIDDLE[k], tau, sigma, row, sign, factor)
            estimate = volume * (
                middles @ MIDDLE_WEIGHTS[k] + corners @ CORNER_WEIGHTS[k]
            )
            bound = volume * corners.mean(axis=1)
            smooth = inside.all(axis=1)
            bound = np.maximum(np.where(smooth, estimate, bound), 0.0)
            gain = np.maximum(bound - estimate, 0.0)
            allowed = WORTH * max(result.sum() + estimate.sum(), 0.0)
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
        return result


@dataclass(frozen=True, eq=False)
class VaryingIntegrand:
    """``Integrand`` for displacements of order two, whose strains vary on the cells."""

    data: VaryingData
    cells: int
    opened: float
    residual: float

    def estimate(self, factor: float) -> float:
        """About the width for a factor, by a rule."""
        total = 2 * factor * self.opened
        for data in (self.data, self.data.turned()):
            total += float(estimated_integrals(data, factor).sum())
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells for tau and for -tau, from above."""
        above = integrals(self.data, factor, self.cells)
        below = integrals(self.data.turned(), factor, self.cells)
        return above, below


def integrand_of(
    bound_data: BoundData, bound: ErrorBound, adjoint: Adjoint
) -> Integrand | VaryingIntegrand:
    """The integrand for an error bound and an adjoint."""
    state = bound.state
    discrete = bound_data.discrete
    law = discrete.law
    points = discrete.points
    cells = len(bound_data.cells.nodes)
    k = NODES[bound.admissible.shape[1]]
    parts = bound.admissible.shape[1] // k
    trace, deviator = points.strain(adjoint.z)
    moduli = state.with_radial_return().moduli
    at = bound_data.at_nodes.completed(bound.admissible)
    sigma = np.concatenate([at.mean[..., None], at.deviator], axis=-1)
    wanted = np.column_stack(moduli.stress(trace, deviator))
    wanted = on_nodes(bound_data, wanted)
    tau = completed_near(adjoint.stress, wanted, law, bound_data.each)
    if k == 6:
        tau, sigma = (coefficients(v.reshape(cells, 3, 6, -1)) for v in (tau, sigma))
    opened = float(bound_data.contact.opening(state.u, bound.pressure).sum())
    owner = np.repeat(np.arange(cells), parts)
    volume = np.repeat(bound_data.cells.volume / parts, parts)
    tau = tau.reshape(cells * parts, k, -1)
    sigma = sigma.reshape(cells * parts, k, -1)
    if bound_data.each > 1:
        strain = trace[:, None], deviator
        data = varying_data(bound_data, state, (tau, sigma), strain, (volume, owner))
        residual = -float(data.work() @ volume)
        return VaryingIntegrand(data, cells, opened, residual)
    data, strain = point_data(bound_data, state, trace, deviator, parts)
    residual = -float(_work(data, strain) @ volume)
    return Integrand(tau, sigma, data, strain, owner, volume, opened, residual)


def on_nodes(bound_data: BoundData, values: np.ndarray) -> np.ndarray:
    """Values at the nodes of the parts, or one for each cell, of functions given at points."""
    if bound_data.each == 1:
        return values[:, None]
    return np.matmul(TO_NODES[bound_data.each], bound_data.at_corners(values))


def _work(data: PointData, strain: Stresses) -> np.ndarray:
    """s(eps_h) : eps(z) at points."""
    work = data.bulk * data.volume * strain.mean
    return work + np.einsum("nd,nd->n", data.stress, strain.deviator)


def point_data(
    bound_data: BoundData,
    state: State,
    trace: np.ndarray,
    deviator: np.ndarray,
    parts: int,
) -> tuple[PointData, Stresses]:
    """Law, state and eps(z) for each part of each cell, order one."""
    law = bound_data.discrete.law

    def spread(values: np.ndarray) -> np.ndarray:
        """The same for all parts of a cell."""
        return np.repeat(values, parts, axis=0)

    bulk, two_mu, hardening, beta = (
        spread(np.asarray(v)) for v in (law.bulk, law.two_mu, law.hardening, law.beta)
    )
    trial = spread(state.at.trial)
    back = spread(np.ascontiguousarray(law.back))
    stress = kept_part(trial, two_mu, hardening, beta)[:, None] * trial + back
    volume = spread(state.volume)
    data = PointData(bulk, two_mu, hardening, beta, volume, trial, back, stress)
    return data, Stresses(spread(trace), spread(deviator))


def varying_data(
    bound_data: BoundData,
    state: State,
    stresses: tuple[np.ndarray, np.ndarray],
    strain: tuple[np.ndarray, np.ndarray],
    parts: tuple[np.ndarray, np.ndarray],
) -> VaryingData:
    """The same for order two: ``stresses`` tau and sigma^, eps(z), size and cell of the parts."""
    law = bound_data.discrete.law
    each = bound_data.each
    tau, sigma = stresses
    k = tau.shape[1]
    size, owner = parts

    def on_parts(values: np.ndarray) -> np.ndarray:
        """Coefficients of affine functions, which are given at the points."""
        at_nodes = np.matmul(TO_NODES[each], bound_data.at_corners(values))
        return coefficients(at_nodes.reshape(len(size), k, -1))

    names = ("bulk", "two_mu", "hardening", "beta")
    return VaryingData(
        tau=tau,
        sigma=sigma,
        volume=on_parts(state.volume[:, None]),
        trial=on_parts(state.at.trial),
        back=on_parts(np.ascontiguousarray(law.back)),
        trace=on_parts(strain[0]),
        strain=on_parts(strain[1]),
        law={name: np.asarray(getattr(law, name))[::each][owner] for name in names},
        size=size,
        owner=owner,
    )


def completed_near(
    stress: np.ndarray, wanted: np.ndarray, law: Law, each: int
) -> np.ndarray:
    """Mean and deviator of stresses (cells, nodes, c), near the ``wanted`` (cells, ., 1 + d).

    In plane strain sigma_zz is free: it is the wanted one plus the elastic response to the
    difference of the traces.
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
