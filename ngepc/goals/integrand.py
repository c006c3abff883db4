"""Integrals of the supremum of a goal over the cells: quadrature, and bounds from above.

Stresses are affine on the parts of a cell for displacements of order one, quadratic for order two.
Strains are constant on a cell, or affine: then see ``ngepc.goals.varying``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ngepc.bounds.conjugate import R6, THIN
from ngepc.bounds.data import BoundData
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.polynomials import TO_NODES
from ngepc.bounds.simplices import stored_by_cells
from ngepc.discretisation.hill_law import HillLaw
from ngepc.discretisation.law import Law
from ngepc.discretisation.overlay_law import OverlayLaw
from ngepc.goals.adjoint import Adjoint
from ngepc.goals.goal_boundary import BoundaryTerms, FrictionTerms, SpringSquares
from ngepc.goals.pieces import applied, cell_coefficients, dots
from ngepc.goals.sides import LawOnCells, ResultOnCells, Sides
from ngepc.goals.sub_elements import SubElements
from ngepc.goals.varying import VaryingData, half_root, sides_of
from ngepc.local.system import State

SAMPLED = 9000
"""Points of the rule for the choice of lambda, so many in all cells that are taken."""


@dataclass(frozen=True, eq=False)
class Integrand:
    """The supremum over the ``cells``.

    ``opened`` is int P^ gap_h, ``residual`` minus the integral of s(eps_h) : eps(z); ``sample`` are
    cells for the choice of lambda and how many each stands for; ``on_boundary`` are the parts of
    foundations and friction.
    """

    sides: Sides
    cells: int
    residual: float
    opened: float
    sample: tuple[np.ndarray, np.ndarray]
    on_boundary: BoundaryTerms

    @cached_property
    def _sampled(self) -> Sides:
        """The supremum on some of the cells."""
        return self.sides.of(self.sample[0])

    def estimate(self, factor: float) -> float:
        """About the width for a factor, from some of the cells."""
        weights = self.sample[1]
        total = 2 * factor * self.opened + self.on_boundary.width(factor)
        for sign in (1.0, -1.0):
            total += float(self._sampled.estimate(sign, factor) @ weights)
        return total

    def bounds(self, factor: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells for tau and for -tau, from above."""
        above, below = self.on_boundary.parts(factor, self.cells)
        above = above + self.sides.integrals(1.0, factor)
        below = below + self.sides.integrals(-1.0, factor)
        return above, below


def sampled(shares: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """About ``count`` cells for means, and how many each stands for.

    Half of them are taken evenly, half by their ``shares`` (cells,).
    """
    if count >= len(shares):
        return np.arange(len(shares)), np.ones(len(shares))
    often = count / 2 * (shares / shares.sum() + 1 / len(shares))
    passed = np.floor(np.cumsum(often) + 0.5)
    cells = np.flatnonzero(np.diff(passed, prepend=0.0) > 0)
    return cells, np.maximum(1 / often[cells], 1.0)


def parts_of_sum(values: np.ndarray) -> np.ndarray:
    """Values >= 0 over their sum (n,); the same for all if all are zero."""
    total = values.sum()
    return values / total if total > 0 else np.full(len(values), 1 / len(values))


class BoundPart:
    """What the suprema of all goals of one error bound share."""

    def __init__(self, bound_data: BoundData, bound: ErrorBound) -> None:
        self._bound_data = bound_data
        self._state = state = bound.state
        self._cells = len(bound_data.cells.nodes)
        own = state.with_radial_return()
        self._closed = bound_data.discrete.law.closed_moduli(own.at, own.yielding)
        at = bound_data.at_nodes.completed(bound.admissible)
        sigma = np.concatenate([at.mean[..., None], at.deviator], axis=-1)
        self._sigma = cell_coefficients(sigma)
        opened = bound_data.contact.opening(state.u, bound.pressure)
        self._opened = float(opened.sum())
        self._shares = parts_of_sum(bound.per_cell)
        self._sprung = bound_data.foundation.apart(state.u, bound.sprung)
        overlay = isinstance(bound_data.discrete.law, OverlayLaw)
        self._constant = bound_data.each == 1 and not overlay
        if self._constant:
            self._result = constant_result(bound_data, state, self._sigma)
        else:
            self._own = own_coefficients(bound_data, state, self._sigma.shape[1])

    @cached_property
    def _discrete_stress(self) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviator of the stress s(eps_h) at the points."""
        return self._bound_data.discrete.law.stress(self._state.at)

    def strain(self, adjoint: Adjoint) -> tuple[np.ndarray, np.ndarray]:
        """Trace and deviator of the strain of an adjoint at the points.

        In plane stress eps_zz is free: it is that for which the tangent has no sigma_zz.
        """
        discrete = self._bound_data.discrete
        displaced = adjoint.displaced
        strain = displaced.trace, displaced.deviator
        return discrete.law.with_free_component(self._closed, *strain)

    def stress(self, adjoint: Adjoint) -> np.ndarray:
        """Mean and deviator of the stress of an adjoint, (cells, nodes, 1 + d)."""
        return self._stress(adjoint, self.strain(adjoint))

    def _stress(
        self, adjoint: Adjoint, strain: tuple[np.ndarray, np.ndarray]
    ) -> np.ndarray:
        """The same from the strain of the adjoint."""
        if adjoint.stress.shape[2] == 1 + strain[1].shape[1]:
            return adjoint.stress  # nothing is free
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

    def integrand(self, adjoint: Adjoint) -> Integrand | SubElements:
        """The supremum for an adjoint."""
        bound_data = self._bound_data
        volume = bound_data.cells.volume
        trace, deviator = self.strain(adjoint)
        tau = cell_coefficients(self._stress(adjoint, (trace, deviator)))
        on_boundary = self._on_boundary(adjoint)
        if self._constant:
            sides = self._constant_sides(tau, trace, deviator)
            residual = -float(self._works(trace, deviator) @ volume)
            return self._of_sides(sides, residual, on_boundary)
        law = bound_data.discrete.law
        stresses = tau, self._sigma
        strain = trace[:, None], deviator
        if isinstance(law, OverlayLaw):
            elements = sub_elements(
                bound_data, self._state, self._own, stresses, strain
            )
            residual = -float(sum(one.work() @ volume for one in elements))
            of_cells = law.of(np.s_[:: bound_data.each])
            rest = residual, self._opened, self._sample(tau.shape[1]), on_boundary
            return SubElements(elements, of_cells, self._cells, *rest)
        data = varying_data(bound_data, self._own, stresses, strain)
        residual = -float(data.work() @ volume)
        return self._of_sides(sides_of(data), residual, on_boundary)

    def _of_sides(
        self, sides: Sides, residual: float, on_boundary: BoundaryTerms
    ) -> Integrand:
        """The supremum where one law rules each cell."""
        sample = self._sample(sides.tau.shape[1], sides.energies())
        rest = residual, self._opened, sample, on_boundary
        return Integrand(sides, self._cells, *rest)

    def _sample(
        self, k: int, energies: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cells by their parts of the error bound and of the ``energies`` of an adjoint."""
        shares = self._shares
        if energies is not None and energies.any():
            shares = shares + parts_of_sum(energies)
        return sampled(shares, SAMPLED // k)

    def _constant_sides(
        self, tau: np.ndarray, trace: np.ndarray, deviator: np.ndarray
    ) -> Sides:
        """The supremum for strains that are constant on the cells."""
        law = self._bound_data.discrete.law
        _, stress = self._discrete_stress
        kept = dots(stress - law.back, deviator)
        two_mu = self._result.law.two_mu[:, None, None]
        own_mean = (law.bulk * trace)[:, None]
        mean = (tau[..., 0] - own_mean) * half_root(law.bulk)[:, None]
        T = stored_by_cells(tau[..., 1:])
        T /= two_mu
        strain = stored_by_cells(deviator[:, None])
        return Sides.of_adjoint(self._result, T, strain, mean, kept)

    def _works(self, trace: np.ndarray, deviator: np.ndarray) -> np.ndarray:
        """s(eps_h) : eps(z) on the cells, (cells,)."""
        mean, stress = self._discrete_stress
        return mean * trace + dots(stress, deviator)


def constant_result(
    bound_data: BoundData, state: State, sigma: np.ndarray
) -> ResultOnCells:
    """What goals share for strains that are constant on the cells, order one.

    ``sigma`` (cells, k, 1 + d) are coefficients of sigma^.
    """
    law = bound_data.discrete.law
    own = None if law.resistance.is_constant else law.resistance
    numbers = law.two_mu, law.hardening, law.beta
    own_mean = (law.bulk * state.volume)[:, None]
    S = stored_by_cells(sigma[..., 1:] - law.back[:, None])
    return ResultOnCells(
        sigma=S / law.two_mu[:, None, None],
        trial=(state.at.trial / law.two_mu[:, None])[:, None],
        mean=(sigma[..., 0] - own_mean) * half_root(law.bulk)[:, None],
        law=LawOnCells(*numbers, own, form_of(law, slice(None))),
        size=bound_data.cells.volume,
    )


def form_of(law: Law, points: slice) -> np.ndarray | None:
    """The form of Hill's ellipsoid at some points, (., d, d); None for von Mises."""
    return law.form[points] if isinstance(law, HillLaw) else None


def given_coefficients(bound_data: BoundData, values: np.ndarray, k: int) -> np.ndarray:
    """Coefficients (cells, k, c) of functions that are given at the points (., c)."""
    each = bound_data.each
    if each == 1:
        return np.repeat(values[:, None], k, axis=1)
    table = TO_NODES[each]
    return cell_coefficients(applied(table, bound_data.at_corners(values)))


def own_coefficients(
    bound_data: BoundData, state: State, k: int
) -> dict[str, np.ndarray]:
    """Coefficients of tr eps_h, s and dev alpha_0, for all goals."""
    values = {
        "volume": state.volume[:, None],
        "trial": state.at.trial,
        "back": np.ascontiguousarray(bound_data.discrete.law.back),
    }
    return {name: given_coefficients(bound_data, v, k) for name, v in values.items()}


def varying_data(
    bound_data: BoundData,
    own: dict[str, np.ndarray],
    stresses: tuple[np.ndarray, np.ndarray],
    strain: tuple[np.ndarray, np.ndarray],
) -> VaryingData:
    """The data for order two: coefficients of tau and sigma^ (``stresses``), and eps(z).

    ``own`` are ``own_coefficients``.
    """
    law = bound_data.discrete.law
    each = bound_data.each
    tau, sigma = stresses
    k = tau.shape[1]
    names = ("bulk", "two_mu", "hardening", "beta")
    first = slice(None, None, each)
    resistance = law.resistance
    numbers = {name: np.asarray(getattr(law, name))[first] for name in names}
    form = form_of(law, first)
    if form is not None:
        numbers["form"] = form
    return VaryingData(
        tau=tau,
        sigma=sigma,
        trace=given_coefficients(bound_data, strain[0], k),
        strain=given_coefficients(bound_data, strain[1], k),
        **own,
        law=numbers,
        size=bound_data.cells.volume,
        resistance=None if resistance.is_constant else resistance.of(first),
    )


def sub_elements(
    bound_data: BoundData,
    state: State,
    own: dict[str, np.ndarray],
    stresses: tuple[np.ndarray, np.ndarray],
    strain: tuple[np.ndarray, np.ndarray],
) -> tuple[VaryingData, ...]:
    """The data of each sub-element, with tau and sigma^ of the whole, for both orders."""
    whole = varying_data(bound_data, own, stresses, strain)
    law = bound_data.discrete.law
    found = []
    for share, part, one in zip(law.shares, law.parts, state.at.parts, strict=True):
        numbers = {"bulk": share * whole.law["bulk"]}
        for name in ("two_mu", "hardening", "beta"):
            numbers[name] = np.asarray(getattr(part, name))[:: bound_data.each]
        trial = given_coefficients(bound_data, one.trial, whole.k)
        back = np.zeros_like(trial)
        other = {"trial": trial, "back": back, "law": numbers}
        found.append(replace(whole, **other, resistance=None))
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
