"""The data shared by the bounds of all states on one mesh.

Strains of displacements of order two are affine on each cell; their values at the integration
points determine them.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ngepc.bounds.balance import balanced_stress
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.contact import ContactFacets
from ngepc.bounds.convex import conjugate_of
from ngepc.bounds.coordinates import Displaced, strain_coordinates, stress_coordinates
from ngepc.bounds.coverage import CONSTANT
from ngepc.bounds.densities import AT_CORNERS, missed
from ngepc.bounds.element import ELEMENTS
from ngepc.bounds.equilibration import Patches
from ngepc.bounds.foundation import Foundation
from ngepc.bounds.oscillation import CarriedLoads
from ngepc.bounds.polynomials import AT_POINTS, TO_NODES, portions
from ngepc.bounds.simplices import Simplices, by_cells
from ngepc.bounds.thickness import is_of_thickness_one
from ngepc.checks.sentences import in_words
from ngepc.discretisation.factors import Factors
from ngepc.local.system import DiscreteProblem, State

UNSTRAINED = 1e-8
"""Strain whose forces are the smallest scale for residuals of equilibrium."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Limits of the search for the best stress.

    The first solve uses the tangent at the discrete stress.  At most ``newton`` Newton steps
    follow.  Conjugate gradients stop at a step that lowers the bound by less than the fraction
    ``gain``, and after at most ``steps`` steps.
    """

    newton: int = 2
    gain: float = 0.1
    steps: int = 12


class BestStress(NamedTuple):
    """An admissible stress for which the bound is small.

    ``nodal`` are coordinates at the vertices of the N + 1 parts of each cell, (nt, (N + 1)^2, c),
    ``at_points`` those at the points of ``BoundData.strain``, ``pressure`` (contact facets, N) is
    the P that goes with it.  ``search`` is the solver that found it, for stresses of adjoints.
    ``sprung`` is the w of ``foundation``, at the vertices of the elastic facets.
    """

    nodal: np.ndarray
    at_points: np.ndarray
    pressure: np.ndarray
    search: Any
    sprung: np.ndarray


class AdjointStress(NamedTuple):
    """The stress of an adjoint.

    ``nodal`` and ``sprung`` as in ``BestStress``; ``energy`` is half the squared difference from
    the stress of the displacement of the adjoint, in the tangent's compliance, with springs.
    """

    nodal: np.ndarray
    sprung: np.ndarray
    energy: float


class BoundData:
    """Geometry, data and spaces of a discrete problem.

    ``conjugate`` and ``at_nodes`` are phi* at the points and at the nodes of the parts of each
    cell, ``weights`` those of the points at which stresses are integrated.  The problem is one that
    bounds cover, see ``check_covered``.  Subclasses have ``best_stress(state, tangent, P)``: a
    ``BestStress`` near a state, by a tangent of a state near it (or without factors), from the
    contact pressure P (contact facets, N).
    """

    weights = np.ones(1)
    lower: BoundData | None = None
    lower_state: State | None = None
    """The data of order one on the same mesh, which stresses of order two are computed with, and
    the solution of order one, which ``best_stress`` sets."""
    energy_is_replaced = False
    """Whether the energy of a state is only subtracted again, and a rule is enough for it."""
    _missed_of: tuple[State | None, np.ndarray] = None, np.empty(0)

    def __init__(self, discrete: DiscreteProblem) -> None:
        self.discrete = discrete
        self.problem = discrete.problem
        if not is_of_thickness_one(self.problem):
            raise ValueError(
                f"thickness={in_words(self.problem.thickness)}: data of bounds need thickness=None"
            )
        c = self.cells = Simplices.of(self.problem.mesh)
        self.boundary = Boundary(self.problem, c)
        self.each = len(discrete.points) // len(c.nodes)
        self.conjugate = self.at_nodes = conjugate_of(discrete.law, self.each)
        self.carried = CarriedLoads(self.boundary)
        smallest = UNSTRAINED * discrete.law.bulk.max() * c.measure.max()
        self.patches = Patches(self.boundary, smallest)
        self.piola = ELEMENTS[c.N].piola(c)
        self.contact = ContactFacets(discrete, self.boundary)
        self.foundation = Foundation(discrete, self.boundary)
        if self.problem.order == 2:
            self._turned = discrete.points.blocks[0].nodes[:, 1] != c.nodes[:, 1]
            history = discrete.law.back, discrete.law.initial
            k = self.each
            if any(varies_on_cells(values, k) for values in history):
                corners = [self.at_corners(values) for values in history]
                self.conjugate, self.at_nodes = (
                    copy(self.conjugate),
                    copy(self.conjugate),
                )
                for part, shares in (
                    (self.conjugate, AT_POINTS[k]),
                    (self.at_nodes, TO_NODES[k]),
                ):
                    part.back, part.initial = (
                        np.matmul(shares, values) for values in corners
                    )

    def built(
        self, own: np.ndarray, needed: np.ndarray, given: np.ndarray, table: np.ndarray
    ) -> np.ndarray:
        """An equilibrated stress whose facet moments are near the means of both sides.

        ``own`` (nt, N + 1, N or 1, N) are the outward facet moments of each cell; ``needed`` and
        ``given`` are arguments of ``Patches.repaired``; ``table``, as ``Element.of_data``, maps the
        moments to stresses (nt, places, c).
        """
        c = self.cells
        N = self.cells.N
        mean = c.means_of_sides(own)
        repaired = self.patches.repaired(mean, needed, given).reshape(-1, N)
        components = len(self.piola[0])
        stress = by_cells(len(own), len(table) // components, components)
        columns = [column.copy() for column in repaired.T]
        slots = c.slot.reshape(len(own), -1).T.copy()
        facets = np.repeat(c.sign.T, N, axis=0)
        for cells in portions(len(own)):
            places = slots[:, cells]
            around = [column.take(places) * facets[:, cells] for column in columns]
            inverse = c.inverse[cells].transpose(1, 2, 0)
            moments = np.einsum("ckt,dct->kdt", np.stack(around), inverse)
            moments = moments.reshape(-1, moments.shape[2])
            data = np.concatenate([moments, self.carried.inner[cells].T])
            reference = (table @ data).reshape(-1, components, moments.shape[1])
            piola = self.piola[cells].transpose(1, 2, 0)
            np.einsum("pbt,bct->tpc", reference, piola, out=stress[cells])
        return stress

    def at_corners(self, values: np.ndarray) -> np.ndarray:
        """Values at the vertices of each cell of affine functions given at its points (., c)."""
        k = self.each
        values = values.reshape(len(self.cells.nodes), k, -1)
        result = np.matmul(AT_CORNERS[k], values)
        result[self._turned, 1:] = result[self._turned, :0:-1]
        return result

    def on_parts(
        self, values: np.ndarray, tables: Mapping[int, np.ndarray] = AT_POINTS
    ) -> np.ndarray:
        """Values at the points of the parts (nt, ., c); one value for each cell if constant.

        With ``TO_NODES`` they are values at the nodes of the parts.
        """
        if self.each == 1:
            return values[:, None]
        return np.matmul(tables[self.each], self.at_corners(values))

    def energy(self, state: State) -> float:
        """Upper bound of J(u), with the friction of ``contact``."""
        more = float(
            self.contact.friction_works(state.u).sum() + self._missed(state).sum()
        )
        return state.energy - state.friction_work + more

    def loads(self, state: State, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facet moments of given tractions (nf, N, N), and the nodal forces to be balanced.

        The nodal forces (nodes, N) are those of contact and of the part of the loads that the
        stress represents exactly.  Both are without springs.
        """
        c = self.cells
        outer = self.cells.outer
        contact = self.contact
        moments = self.boundary.moments.copy()
        forces = self.discrete.load.copy()
        carried = c.at_nodes(self.carried.nodal, c.nodes)
        carried += c.at_nodes(moments[outer], c.facets[outer])
        forces[: len(carried)] = carried
        contact.subtract(contact.pushed(state, P), moments, forces)
        return moments, forces

    def boundary_gaps(
        self, state: State, P: np.ndarray, sprung: np.ndarray
    ) -> np.ndarray:
        """What contact and springs add to the bound, for each cell."""
        pressed = self.contact.gaps(state, P, self.tangential(state))
        pulled = self.foundation.gaps(state.u, sprung)
        owners = np.append(self.contact.owner, self.foundation.owner)
        count = len(self.cells.nodes)
        return np.bincount(owners, np.append(pressed, pulled), minlength=count)

    def tangential(self, state: State) -> np.ndarray:
        """Minus the tangential tractions of the admissible stress on contact, at vertices."""
        return self.contact.friction(state)

    def gaps(self, state: State, z: np.ndarray) -> np.ndarray:
        """int [phi(eps) - sigma : eps] over each cell for stresses at the points of ``strain``."""
        work = np.einsum("tqc,tqc->tq", z, self.strain(state)) @ self.weights
        return self.phi(state) - self.cells.volume * work

    def phi(self, state: State) -> np.ndarray:
        """Upper bound of int phi(eps(u)) over each cell."""
        points = self.discrete.points
        density = points.weights * self.discrete.law.energy_density(state.at)
        return density.reshape(-1, self.each).sum(axis=1) + self._missed(state)

    def _missed(self, state: State) -> np.ndarray:
        """Upper bound of the quadrature error of phi, for each cell; kept for the last state."""
        area = self.cells.volume
        if self.each == 1 or self.energy_is_replaced:
            return np.zeros(len(area))
        if self._missed_of[0] is not state:
            found = missed(self.discrete.law, state.at, area, self.at_corners)
            self._missed_of = state, found
        return self._missed_of[1]

    def strain(self, state: State) -> np.ndarray:
        """Strain coordinates whose product with a stress is sigma : eps, shape of ``on_parts``."""
        return self.on_parts(strain_coordinates(state))

    def balanced(
        self, state: State, tangent: Factors, load: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Stresses (points, c) in equilibrium with nodal forces, see ``balanced_stress``."""
        return balanced_stress(state, tangent, load)

    def stress(self, state: State) -> np.ndarray:
        """The discrete stress of a state at the points, (points, c)."""
        return stress_coordinates(*self.discrete.law.stress(state.at))

    def answer(self, tangent: Factors, change: np.ndarray) -> np.ndarray:
        """The change of stress (points, c) for a change of displacements (nodes, N)."""
        return Displaced.of(self.discrete, change).stress_change(tangent)


def varies_on_cells(values: np.ndarray, each: int) -> bool:
    """Whether values at points (., d) vary on a cell by more than rounding errors.

    Those of functions that were carried to other meshes do.
    """
    by_cell = values.reshape(-1, each, values.shape[1])
    most = np.ptp(by_cell, axis=1).max(initial=0.0)
    return bool(most > CONSTANT * np.abs(values).max(initial=0.0))


def feasible_state(bound_data: BoundData, given: State) -> tuple[State, float]:
    """The state without penetration of the obstacle, and the largest change of displacement.

    The plastic strain is computed again, by radial return.
    """
    u = bound_data.contact.cleared(given.u)
    moved = float(np.abs(u - given.u).max(initial=0.0))
    if moved <= given.touching_distance:
        return given.with_radial_return(), moved
    return bound_data.discrete.state(u, contact=given.contact), moved
