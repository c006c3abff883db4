"""The best stress in two dimensions: equilibrated, then optimised by Airy functions.

For displacements of order two stresses are quadratic; those of Johnson and Mercier are affine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc._deprecated import old_names
from ngepc.bounds.airy import AirySpace
from ngepc.bounds.conjugate import Completed, Conjugate
from ngepc.bounds.data import (
    AdjointStress,
    BestStress,
    BoundData,
    Displaced,
    Effort,
    stress_coordinates,
)
from ngepc.bounds.element import ELEMENTS, PAIRS
from ngepc.bounds.levels import RINGS, TwoLevels
from ngepc.bounds.polynomials import portions
from ngepc.bounds.simplices import Simplices, marked, of_cells, sliced, stored_by_cells
from ngepc.discretisation.factors import Factors
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.elements import solutions

ADJOINT_GAIN = 0.07
"""A step of the search of the adjoint must lower its bound by this fraction."""

ADJOINT_SHARE = 0.6
"""The direct solver of this search takes the triangles with this share of what is missed."""

ADJOINT_RINGS = 6
"""... and so many rings of triangles around them."""

MOST_STEPS = 40
"""Largest number of steps of the adjoint's search."""

SHORTEST = 1e-3
"""Shortest step length."""

TRUST = 0.03
"""Newton steps are made if the bound exceeds the tangent's prediction by a larger fraction."""

LOCALLY = 0.3
"""Newton steps use this fraction of ``gain``: they are cheap where little yields."""

MOST = 0.7
"""Where more than this part of the triangles yields, their remainders are computed on all."""

BROKEN = 0.9
"""Newton steps are restricted to the triangles with this share of the tangent's remainder, and to
rings of triangles around them."""


@dataclass(frozen=True, eq=False)
class StressFunctional:
    """int [phi*(sigma) - sigma : eps(u)] for stresses at the points of the Airy functions' space.

    ``strain`` is eps(u) in in-plane coordinates at one point or all of them, shape (nt, ., 3).
    """

    space: AirySpace
    conjugate: Conjugate
    strain: np.ndarray

    def of(self, chosen: np.ndarray | slice) -> StressFunctional:
        """The integral over some of the triangles."""
        return StressFunctional(
            self.space.of(chosen),
            self.conjugate.of(chosen),
            of_cells(self.strain, chosen),
        )

    def alone(self, chosen: np.ndarray) -> StressFunctional:
        """The same for stresses that are known on all other triangles."""
        return replace(self.of(chosen), space=self.space.alone(chosen))

    def values(self, z: np.ndarray, at: Completed) -> np.ndarray:
        """The integral over each triangle by quadrature, for stresses at all points or one."""
        work = np.einsum("tqc,tqc->tq", z, np.broadcast_to(self.strain, z.shape))
        weights = self.space.rule.weights if z.shape[1] > 1 else np.ones(1)
        return self.space.area * ((self.conjugate.sought(at) - work) @ weights)


def strain_of(compliance: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Compliances (cells, 1 or points, c, c) times stresses (cells, points, c)."""
    if compliance.shape[1] == 1:
        return np.einsum("tcd,tqd->tqc", compliance[:, 0], z)
    return np.einsum("tqcd,tqd->tqc", compliance, z)


OF_MODEL = ("centre", "at_centre", "_gradient", "compliance", "_yields")


class SecondOrderModel:
    """Second-order expansion of the dual functional around stresses (nt, ., 3)."""

    def __init__(self, functional: StressFunctional, centre: np.ndarray) -> None:
        centre = stored_by_cells(centre)
        at = functional.conjugate.completed(centre)
        self.space = functional.space
        self.centre = centre
        self.at_centre = functional.values(centre, at)
        self._gradient = functional.conjugate.gradient(at) - functional.strain
        self.compliance = functional.conjugate.compliance(at)
        self._yields = (at.over > 0).any(axis=1)

    def of(self, chosen: np.ndarray | slice) -> SecondOrderModel:
        """The expansion on some of the triangles."""
        result = sliced(self, chosen, OF_MODEL)
        result.space = self.space.of(chosen)
        return result

    def at(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the triangles by the rule, and the derivative, a strain, (nt, points, 3).

        ``z`` (nt, points, 3) are the stresses.
        """
        change = z - self.centre
        gradient = strain_of(self.compliance, change) + self._gradient
        work = np.einsum("tqc,tqc->tq", change, gradient + self._gradient)
        values = self.at_centre + self.space.area * (work @ self.space.rule.weights) / 2
        return values, gradient

    def linearised(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the triangles for stresses, and minus the derivative by the unknowns."""
        values = np.empty(len(z))
        forces = np.empty(self.space.unknowns.shape)
        for cells in portions(len(z)):
            part = self.of(cells)
            values[cells], slope = part.at(z[cells])
            forces[:, cells] = part.space.forces(slope)
        return values, -self.space.gathered(forces)

    def remainder(self, functional: StressFunctional, z: np.ndarray) -> np.ndarray:
        """The functional less its expansion on each triangle: zero where no point yields."""
        result = np.zeros(len(z))
        yields = self._yields.copy()
        for cells in portions(len(z)):
            yields[cells] |= functional.conjugate.of(cells).yields(z[cells])
        there = np.flatnonzero(yields)
        chosen = [there[some] for some in portions(len(there))]
        if len(there) > MOST * len(z):
            chosen = portions(len(z))
        for cells in chosen:
            part = functional.of(cells)
            trial = of_cells(z, cells)
            exact = part.values(trial, part.conjugate.completed(trial))
            result[cells] = exact - self.of(cells).at(trial)[0]
        result[~yields] = 0.0
        return result


@dataclass(frozen=True, eq=False)
class AirySearch:
    """The solver for Airy functions at one tangent, and its compliance (nt, 1 or points, 3, 3)."""

    system: TwoLevels
    compliance: np.ndarray


def tightened(
    functional: StressFunctional,
    system: TwoLevels,
    cells: Simplices,
    z: np.ndarray,
    centre: np.ndarray,
    rest: np.ndarray,
    effort: Effort,
) -> tuple[np.ndarray, AirySearch]:
    """In-plane stresses at the points, shape (nt, points, 3), with a smaller dual functional.

    The search starts at the admissible stress ``z`` (nt, points, 3).  The first tangent is that at
    the stress ``centre`` of the discrete solution, at one point or all (nt, ., 3).  ``rest`` is the
    bound without the functional on each triangle.  The second result solves with the first tangent.
    """
    there = slice(None)
    part = functional
    gain = effort.gain
    search = None
    for step in range(effort.newton + 1):
        model = SecondOrderModel(part, centre)
        system.update(part.space.stiffness(model.compliance))
        values, right = model.linearised(of_cells(z, there))
        if step == 0:
            search = AirySearch(system, model.compliance)
            bound = float((rest + values).sum())
        solver = system.focused(rest + values if step == 0 else None)
        x, promised = solver.solve(right, bound, gain, effort.steps)
        if step == 0:
            part.space.add_stress(x, z)
        else:
            change = part.space.stress(x)
            z[there] = descended(part, model.centre, change, model.at_centre.sum())
        if step == effort.newton:
            break
        remainder = model.remainder(part, of_cells(z, there))
        bound = promised + remainder.sum()
        gain = LOCALLY * effort.gain
        if np.abs(remainder).sum() <= TRUST * bound:
            break
        worst = np.arange(len(z))[there][marked(np.abs(remainder), BROKEN)]
        there = cells.around(worst, RINGS)
        part = functional.alone(there)
        centre = of_cells(z, there)
        system = TwoLevels(part.space)
    return z, search


def descended(
    functional: StressFunctional, z: np.ndarray, step: np.ndarray, value: float
) -> np.ndarray:
    """z plus the longest of 1, 1/2, 1/4, ... times the step that lowers the ``value`` at z."""
    length = 1.0
    while length > SHORTEST:
        trial = z + length * step
        at = functional.conjugate.completed(trial)
        if functional.values(trial, at).sum() <= value:
            return trial
        length /= 2
    return z


# moments of affine functions with the hat functions of edges, over half the length
ON_SIDES = (
    np.array([2 * np.eye(3)[[i, j]] + np.eye(3)[[j, i]] for i, j in PAIRS]).reshape(
        6, 3
    )
    / 3
)


def missed_energy(
    space: AirySpace, compliance: np.ndarray, wanted: np.ndarray, tau: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Half the square of what stresses at the points miss of those of the ``wanted`` strain.

    With d = tau - H^-1 eps it is 1/2 d : H d, integrated over each triangle.  The second result is
    minus the derivative of its sum by the unknowns of the Airy functions.
    """
    energy = np.empty(len(tau))
    forces = np.empty(space.unknowns.shape)
    for cells in portions(len(tau)):
        H = compliance[cells]
        off = tau[cells] - solutions(H, wanted[cells])
        strain = strain_of(H, off)
        square = np.einsum("tqc,tqc->tq", off, strain) @ space.rule.weights
        energy[cells] = space.area[cells] * square / 2
        forces[:, cells] = space.of(cells).forces(strain)
    return energy, -space.gathered(forces)


class PlaneBoundData(BoundData):
    """``BoundData`` on triangles."""

    def __init__(self, discrete: DiscreteProblem) -> None:
        super().__init__(discrete)
        order = self.problem.order
        self.effort = {1: Effort(), 2: Effort(gain=0.01, steps=40)}[order]
        self.space = AirySpace(self.boundary, order + 2, self.piola)
        self._unsolved = TwoLevels(self.space, self.cells)
        if order == 2:
            self.weights = self.space.rule.weights

    def best_stress(self, state: State, tangent: Factors, P: np.ndarray) -> BestStress:
        """An admissible stress with a small bound, at points, and its pressure P."""
        moments, forces = self.loads(state, P)
        stress, moved = self.balanced(state, tangent, forces)
        sprung = self.foundation.affine(state.u + moved)
        moments = self.foundation.added(moments, sprung)
        strain = stored_by_cells(self.strain(state))
        functional = StressFunctional(self.space, self.conjugate, strain)
        on_boundary = self.boundary_gaps(state, P, sprung)
        rest = self.phi(state) + on_boundary
        z = self.admissible(stress, moments)
        system = self._unsolved.another()
        centre = self.on_parts(stress)
        z, search = tightened(
            functional, system, self.cells, z, centre, rest, self.effort
        )
        quadratic = self.problem.order == 2
        at_points = z.copy() if quadratic else z.mean(axis=1, keepdims=True)
        self.space.to_nodes(z)
        return BestStress(z, at_points, P, search, sprung)

    def search(self, state: State) -> AirySearch:
        """The solver for Airy functions at the tangent of a state."""
        at = self.conjugate.completed(self.on_parts(self.stress(state)))
        compliance = self.conjugate.compliance(at)
        system = self._unsolved.another()
        system.update(self.space.stiffness(compliance))
        return AirySearch(system, compliance)

    def adjoint_stress(
        self,
        state: State,
        tangent: Factors,
        search: AirySearch,
        near: Displaced,
        z: Displaced,
        moments: np.ndarray,
    ) -> AdjointStress:
        """An admissible stress near the tangent's stress of z, at nodes, and its error.

        ``near`` are displacements whose stress is in equilibrium with the facet
        ``moments``, tested with hat functions; springs are added to these.  The error is half the
        squared difference of the stresses in the tangent's compliance.
        """
        stress = near.stress_change(tangent)
        at_points = stress_coordinates(z.trace, z.deviator, 0.0)
        wanted = stored_by_cells(self.on_parts(at_points))
        w = self.foundation.affine(near.u)
        tau = self.admissible(stress, self.foundation.added(moments, w))
        missed, right = missed_energy(self.space, search.compliance, wanted, tau)
        system = search.system.focused(missed, ADJOINT_SHARE, ADJOINT_RINGS)
        bound = float(missed.sum() + self.foundation.gaps(z.u, w).sum())
        x, energy = system.solve(right, bound, ADJOINT_GAIN, MOST_STEPS)
        self.space.add_stress(x, tau)
        self.space.to_nodes(tau)
        return AdjointStress(tau, w, energy)

    def admissible(self, stress: np.ndarray, given: np.ndarray) -> np.ndarray:
        """The stress of Johnson and Mercier at the points of ``space``, shape (nt, points, 3).

        It is built from a stress (points, 3) that is in equilibrium when tested with hat functions:
        from the mean tractions of both triangles, and the moments of given tractions (ne, 2, 2).
        """
        element = ELEMENTS[2]
        size = self.cells.volume[:, None, None]
        slopes = self.cells.gradients * size
        mean = element.tensors(stress.reshape(len(slopes), self.each, -1).mean(axis=1))
        needed = np.matmul(slopes, mean)
        own = needed[:, :, None]  # moments inward, the same at both ends of an edge
        if self.each == 3:
            sigma = element.tensors(np.matmul(ON_SIDES, self.at_corners(stress)))
            own = np.einsum("tka,tkvab->tkvb", slopes, sigma.reshape(-1, 3, 2, 2, 2))
        table = np.matmul(self.space.rule.shares, element.of_data.reshape(3, 3, -1))
        return self.built(
            -own, needed - self.carried.nodal, given, table.reshape(-1, 15)
        )


__getattr__ = old_names(__name__)
