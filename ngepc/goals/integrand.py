"""Integrals of the supremum of a goal over the cells: quadrature, and bounds from above.

For displacements of order one strains are constant on a cell, and the Phi of ``supremum`` is convex
in the stresses, which are affine on the parts of the cell: on each part its mean is at most the
mean of its values at the vertices.  Where it is a quadratic on a part it is integrated exactly.
Parts are cut where bounds differ most from a rule of degree two.  The rest of the supremum is
affine, or a quadratic.

For order two strains are affine too: ``ngepc.goals.varying``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ngepc.bounds.bound import ErrorBound
from ngepc.bounds.conjugate import R6, THIN
from ngepc.bounds.data import BoundData
from ngepc.bounds.polynomials import (
    NODES,
    RULE,
    TO_NODES,
    WEIGHTS,
    coefficients,
    portions,
    square_integrals,
)
from ngepc.discretisation.law import Law
from ngepc.discretisation.overlay_law import OverlayLaw
from ngepc.goals.adjoint import Adjoint
from ngepc.goals.cutting import potential_integrals
from ngepc.goals.goal_boundary import BoundaryTerms, FrictionTerms, SpringSquares
from ngepc.goals.sub_elements import SubElements
from ngepc.goals.supremum import PointData, ScaledLaw, Stresses, dots
from ngepc.goals.supremum_of_laws import NonlinearLaw
from ngepc.goals.varying import VaryingData, estimated_integrals, integrals
from ngepc.goals.whole_cells import close_enough, whole_integrals
from ngepc.goals.yielding import mean_of
from ngepc.local.system import State

AT_ONCE = 2000
"""Cells that are treated at once."""
SAMPLED = 1000
"""Cells on which integrals for the choice of lambda are computed; the rest is known from others."""


@dataclass(frozen=True, eq=False)
class Side:
    """What the supremum of one sign and one lambda is made of, on parts of cells.

    ``pulled`` (parts, k, d) are q/(2 mu_2), ``w`` (parts, 1, d) and ``law`` those of ``supremum``;
    ``rest`` (parts,) is the integral of all but Phi over each part.
    """

    pulled: np.ndarray
    w: np.ndarray
    law: ScaledLaw | NonlinearLaw
    rest: np.ndarray
    volume: np.ndarray
    cell: np.ndarray

    def estimate(self) -> np.ndarray:
        """Integrals over the parts by a rule, (parts,)."""
        k = self.pulled.shape[1]
        found = self.law.potential(np.matmul(RULE[k], self.pulled), self.w)
        return self.volume * (found @ WEIGHTS[k]) + self.rest

    def of_whole_cells(self, parts: int) -> tuple[np.ndarray, np.ndarray]:
        """Integrals of Phi over the cells from above, and estimates, see ``whole_cells``.

        All ``parts`` of a cell stand together.
        """
        first = np.s_[::parts]
        pulled = self.pulled.reshape(-1, parts, *self.pulled.shape[1:])
        law = self.law.of_points(first)
        return whole_integrals(
            law, pulled, self.w[first, 0], parts * self.volume[first]
        )


@dataclass(frozen=True, eq=False)
class Integrand:
    """The supremum over the parts of the cells.

    ``tau`` and ``sigma`` (parts, k, 1 + d) are coefficients of stresses on the parts: mean, then
    deviator; ``data`` and ``strain`` are constant on each part; ``cell`` and ``volume``
    (parts,) say where a part is; ``opened`` is int P^ gap_h, ``residual`` minus the integral of
    s(eps_h) : eps(z); ``sample`` are parts for the choice of lambda and how many each stands for;
    ``on_boundary`` are the parts of foundations and friction.
    """

    tau: np.ndarray
    sigma: np.ndarray
    data: PointData
    strain: Stresses
    cell: np.ndarray
    volume: np.ndarray
    residual: float
    opened: float
    sample: tuple[np.ndarray, np.ndarray]
    on_boundary: BoundaryTerms

    def side(
        self, sign: float, factor: float, chosen: slice | np.ndarray = slice(None)
    ) -> Side:
        """What the supremum is made of for a sign and lambda, on some of the parts."""
        data = self.data.of(chosen)
        strain = self.strain.of(chosen)
        tau = sign * self.tau[chosen]
        sigma = self.sigma[chosen]
        volume = self.volume[chosen]
        two_mu = data.two_mu[:, None]
        e = sign * strain.deviator
        pulled = tau[..., 1:] + factor * (sigma[..., 1:] - data.back[:, None])
        pulled /= two_mu[:, None]
        w = factor / two_mu * data.trial - e

        # the part by mean stresses is a square
        own = data.bulk * (sign * strain.mean + factor * data.volume)
        mean = tau[..., 0] + factor * sigma[..., 0] - own[:, None]
        rest = square_integrals(mean[..., None], volume) / (4 * factor * data.bulk)
        middle = mean_of(pulled.swapaxes(0, 1))
        affine = dots(data.stress - data.back, e) - dots(middle, data.trial)
        rest += volume * affine
        law = law_at(data, factor)
        return Side(pulled, w[:, None], law, rest, volume, self.cell[chosen])

    def estimate(self, factor: float) -> float:
        """About the width for a factor, by a rule on some of the cells."""
        rows, weights = self.sample
        total = 2 * factor * self.opened + self.on_boundary.width(factor)
        for sign in (1.0, -1.0):
            total += float(self.side(sign, factor, rows).estimate() @ weights)
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells for tau and for -tau, from above."""
        count = int(self.cell.max()) + 1
        above, below = self.on_boundary.parts(factor, count)
        above = above + self._integrals(1.0, factor, count)
        below = below + self._integrals(-1.0, factor, count)
        return above, below

    def _integrals(self, sign: float, factor: float, count: int) -> np.ndarray:
        """Integrals over the cells for one sign, those of whole cells where they are close."""
        parts = len(self.cell) // count
        rest = np.empty(count)
        whole = np.empty(count)
        estimate = np.empty(count)
        for cells in portions(count, AT_ONCE):
            side = self.side(
                sign, factor, slice(parts * cells.start, parts * cells.stop)
            )
            rest[cells] = side.rest.reshape(-1, parts).sum(axis=1)
            whole[cells], estimate[cells] = side.of_whole_cells(parts)
        close = close_enough(whole, estimate, rest)
        result = np.where(close, rest + whole, rest)
        left = np.flatnonzero(~close[self.cell])
        side = self.side(sign, factor, left)
        of_parts = side.volume, side.cell
        found = potential_integrals(side.law, side.pulled, side.w, of_parts, result)
        return np.maximum(found, 0.0)


def sampled(per_cell: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Parts of the cells with the largest indicators and of a few others, and their weights.

    Of the others, in the order of their indicators, every so many are taken.
    """
    order = np.argsort(-per_cell, kind="stable")
    first = order[: SAMPLED // 2]
    rest = order[SAMPLED // 2 :]
    stride = max(1, -(-len(rest) // (SAMPLED // 2)))
    few = rest[stride // 2 :: stride]
    cells = np.append(first, few)
    share = len(rest) / max(len(few), 1)
    weights = np.append(np.ones(len(first)), np.full(len(few), share))
    rows = (parts * cells[:, None] + np.arange(parts)).ravel()
    return rows, np.repeat(weights, parts)


@dataclass(frozen=True, eq=False)
class VaryingIntegrand:
    """``Integrand`` for displacements of order two, whose strains vary on the cells."""

    data: VaryingData
    cells: int
    residual: float
    opened: float
    sample: tuple[np.ndarray, np.ndarray]
    on_boundary: BoundaryTerms

    def estimate(self, factor: float) -> float:
        """About the width for a factor, by a rule on some of the cells."""
        rows, weights = self.sample
        some = self.data.of(rows)
        total = 2 * factor * self.opened + self.on_boundary.width(factor)
        for data in (some, some.turned()):
            total += float(estimated_integrals(data, factor) @ weights)
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells for tau and for -tau, from above."""
        above, below = self.on_boundary.parts(factor, self.cells)
        above = above + integrals(self.data, factor, self.cells)
        below = below + integrals(self.data.turned(), factor, self.cells)
        return above, below


class BoundPart:
    """What the suprema of all goals of one error bound share."""

    def __init__(self, bound_data: BoundData, bound: ErrorBound) -> None:
        self._bound_data = bound_data
        self._state = state = bound.state
        self._cells = len(bound_data.cells.nodes)
        self._k = NODES[bound.admissible.shape[1]]
        parts = bound.admissible.shape[1] // self._k
        own = state.with_radial_return()
        self._closed = bound_data.discrete.law.closed_moduli(own.at, own.yielding)
        at = bound_data.at_nodes.completed(bound.admissible)
        sigma = np.concatenate([at.mean[..., None], at.deviator], axis=-1)
        self._sigma = self._on_parts(sigma)
        opened = bound_data.contact.opening(state.u, bound.pressure)
        self._opened = float(opened.sum())
        owner = np.repeat(np.arange(self._cells), parts)
        volume = np.repeat(bound_data.cells.volume / parts, parts)
        self._parts = volume, owner
        self._sample = sampled(bound.per_cell, parts)
        self._sprung = bound_data.foundation.apart(state.u, bound.sprung)
        self._data: Any = None
        overlay = isinstance(bound_data.discrete.law, OverlayLaw)
        if bound_data.each == 1 and not overlay:
            self._data = point_data(bound_data, state, parts)

    def _on_parts(self, stress: np.ndarray) -> np.ndarray:
        """Coefficients on the parts of stresses at the nodes, (parts, k, 1 + d)."""
        k = self._k
        stress = stress.reshape(-1, k, stress.shape[-1])
        return coefficients(stress)

    def strain(self, adjoint: Adjoint) -> tuple[np.ndarray, np.ndarray]:
        """Trace and deviator of the strain of an adjoint at the points.

        In plane stress eps_zz is free: it is that for which the tangent has no sigma_zz.
        """
        discrete = self._bound_data.discrete
        strain = discrete.points.strain(adjoint.z)
        return discrete.law.with_free_component(self._closed, *strain)

    def stress(self, adjoint: Adjoint) -> np.ndarray:
        """Mean and deviator of the stress of an adjoint, (cells, nodes, 1 + d)."""
        return self._stress(adjoint, self.strain(adjoint))

    def _stress(
        self, adjoint: Adjoint, strain: tuple[np.ndarray, np.ndarray]
    ) -> np.ndarray:
        """The same from the strain of the adjoint."""
        bound_data = self._bound_data
        wanted = np.column_stack(self._closed.stress(*strain))
        wanted = bound_data.on_parts(wanted, TO_NODES)
        law = bound_data.discrete.law
        return completed_near(adjoint.stress, wanted, law, bound_data.each)

    def _on_boundary(self, adjoint: Adjoint) -> BoundaryTerms:
        """What foundations and friction add for an adjoint."""
        contact = self._bound_data.contact
        foundation = self._bound_data.foundation
        apart = foundation.apart(adjoint.z, adjoint.sprung)
        springs = SpringSquares.of(foundation, self._sprung, apart)
        if not self._bound_data.boundary.friction.any():
            return BoundaryTerms(springs, None)
        friction = FrictionTerms(
            contact,
            contact.slip(self._state.u),
            contact.tangential(adjoint.z),
            self._bound_data.tangential(self._state),
            adjoint.friction,
        )
        return BoundaryTerms(springs, friction)

    def integrand(self, adjoint: Adjoint) -> Integrand | VaryingIntegrand | SubElements:
        """The supremum for an adjoint."""
        bound_data = self._bound_data
        volume, owner = self._parts
        trace, deviator = self.strain(adjoint)
        tau = self._on_parts(self._stress(adjoint, (trace, deviator)))
        rest = self._opened, self._sample, self._on_boundary(adjoint)
        law = bound_data.discrete.law
        if isinstance(law, OverlayLaw):
            stresses = tau, self._sigma
            strain = trace[:, None], deviator
            elements = sub_elements(
                bound_data, self._state, stresses, strain, self._parts
            )
            residual = -float(sum(one.work() @ volume for one in elements))
            of_cells = law.of(np.s_[:: bound_data.each])
            return SubElements(elements, of_cells, self._cells, residual, *rest)
        if bound_data.each > 1:
            stresses = tau, self._sigma
            strain = trace[:, None], deviator
            data = varying_data(bound_data, self._state, stresses, strain, self._parts)
            residual = -float(data.work() @ volume)
            return VaryingIntegrand(data, self._cells, residual, *rest)
        count = len(volume) // self._cells
        strain = Stresses(np.repeat(trace, count), np.repeat(deviator, count, axis=0))
        residual = -float(_work(self._data, strain) @ volume)
        fields = tau, self._sigma, self._data, strain, owner, volume
        return Integrand(*fields, residual, *rest)


def _work(data: PointData, strain: Stresses) -> np.ndarray:
    """s(eps_h) : eps(z) at points."""
    work = data.bulk * data.volume * strain.mean
    return work + np.einsum("nd,nd->n", data.stress, strain.deviator)


def point_data(bound_data: BoundData, state: State, parts: int) -> PointData:
    """Law and state for each part of each cell, order one."""
    law = bound_data.discrete.law

    def spread(values: np.ndarray) -> np.ndarray:
        """The same for all parts of a cell."""
        return np.repeat(np.asarray(values), parts, axis=0)

    _, stress = law.stress(state.at)
    values = law.bulk, law.two_mu, law.hardening, law.beta, state.volume, state.at.trial
    arrays = map(spread, (*values, law.back, stress))
    if law.resistance.is_constant:
        return PointData(*arrays)
    every = np.repeat(np.arange(len(state.volume)), parts)
    return PointData(*arrays, resistance=law.resistance.of(every))


def law_at(data: PointData, factor: float) -> ScaledLaw | NonlinearLaw:
    """What Phi depends on at points, for lambda."""
    if data.resistance is None:
        return ScaledLaw.of(data.two_mu, data.hardening, data.beta, factor)
    return NonlinearLaw(data.resistance, data.two_mu, data.hardening, factor)


def coefficients_on_parts(
    bound_data: BoundData, values: np.ndarray, owner: np.ndarray, k: int
) -> np.ndarray:
    """Coefficients on the parts (parts, k, c) of functions that are given at the points (., c)."""
    each = bound_data.each
    if each == 1:
        return np.repeat(values[owner][:, None], k, axis=1)
    at_nodes = np.matmul(TO_NODES[each], bound_data.at_corners(values))
    return coefficients(at_nodes.reshape(len(owner), k, -1))


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
    size, owner = parts

    def on_parts(values: np.ndarray) -> np.ndarray:
        """Coefficients of functions that are given at the points."""
        return coefficients_on_parts(bound_data, values, owner, tau.shape[1])

    names = ("bulk", "two_mu", "hardening", "beta")
    resistance = None
    if not law.resistance.is_constant:
        resistance = law.resistance.of(each * owner)
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
        resistance=resistance,
    )


def sub_elements(
    bound_data: BoundData,
    state: State,
    stresses: tuple[np.ndarray, np.ndarray],
    strain: tuple[np.ndarray, np.ndarray],
    parts: tuple[np.ndarray, np.ndarray],
) -> tuple[VaryingData, ...]:
    """The data of each sub-element, with tau and sigma^ of the whole, for both orders."""
    whole = varying_data(bound_data, state, stresses, strain, parts)
    law = bound_data.discrete.law
    owner = parts[1]
    found = []
    for share, part, one in zip(law.shares, law.parts, state.at.parts, strict=True):
        own = {"bulk": share * whole.law["bulk"]}
        for name in ("two_mu", "hardening", "beta"):
            own[name] = np.asarray(getattr(part, name))[:: bound_data.each][owner]
        trial = coefficients_on_parts(bound_data, one.trial, owner, whole.k)
        back = np.zeros_like(trial)
        found.append(replace(whole, trial=trial, back=back, law=own, resistance=None))
    return tuple(found)


def completed_near(
    stress: np.ndarray, wanted: np.ndarray, law: Law, each: int
) -> np.ndarray:
    """Mean and deviator of stresses (cells, nodes, c), near the ``wanted`` (cells, ., 1 + d).

    In plane strain sigma_zz is free: it is the wanted one plus the elastic response to the
    difference of the traces.  In plane stress it is zero.
    """
    if law.across is not None:
        return np.matmul(stress, THIN.T)
    if wanted.shape[2] == stress.shape[2]:
        return stress
    bulk = law.bulk[::each, None]
    two_mu = law.two_mu[::each, None]
    trace = wanted[..., 0] + wanted[..., 2] / R6
    ratio = 1 / (R6 * bulk) / (1 / (6 * bulk) + 1 / two_mu)
    zeta = wanted[..., 2] + ratio * (stress[..., 0] - trace)
    mean = stress[..., 0] - zeta / R6
    return np.stack([mean, stress[..., 1], zeta, stress[..., 2]], axis=-1)
