"""The data of bounds of bodies of revolution, and the bound of a state (docs/error_bound.md).

A body of revolution has the measure 2 pi r dr dz.  Stresses are those of ``ring_element``, found by
``ring_search``; ``ring_density`` integrates phi* from above, ``ring_energy`` phi.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from ngsolve import CF, ET, VOL, IntegrationRule, x, y

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.contact import ContactFacets, nodes_of_facets
from ngepc.bounds.coverage import BUBBLE, CONSTANT, varies_inside
from ngepc.bounds.polynomials import quadratics, triangle_rule
from ngepc.bounds.ring_density import RingConjugate
from ngepc.bounds.ring_element import RingElement
from ngepc.bounds.ring_energy import RingEnergy, coefficients_of
from ngepc.bounds.ring_search import RingContact, RingSearch, stresses_at
from ngepc.bounds.ring_stress import CutTriangles, RingStresses
from ngepc.bounds.simplices import Simplices
from ngepc.discretisation.factors import Factors
from ngepc.linalg.bernstein import bernstein_values, from_lattice, lattice_points
from ngepc.local.system import DiscreteProblem, State

ON_AXIS = 1e-12
"""Radii below this fraction of the largest one are zero."""
MISSED = 0.005
"""Part of the bound by which the upper bound of the energy may exceed a rule."""


class RingBound(NamedTuple):
    """The numbers of an error bound, see ``ErrorBound``."""

    energy: float
    per_cell: np.ndarray
    admissible: np.ndarray
    pressure: np.ndarray


class RevolutionData:
    """The data shared by the bounds of all states of a body of revolution on one mesh.

    ValueError for loads and obstacles that are not polynomials of low degree.
    """

    def __init__(self, discrete: DiscreteProblem) -> None:
        self.discrete = discrete
        self.problem = discrete.problem
        c = self.cells = Simplices.of(self.problem.mesh)
        self.boundary = Boundary(self.problem, c)
        self.contact = ContactFacets(discrete, self.boundary)
        self._force = self._read_force()
        varies = np.ptp(self._force, axis=1).max(initial=0.0)
        steep = varies > CONSTANT * np.abs(self._force).max(initial=0.0)
        self.degree = max(self.problem.order + 1, 3 if steep else 2)
        each = len(discrete.points) // len(c.nodes)
        self.cut = CutTriangles(c)
        law = discrete.law.of(each * self.cut.parents)
        self.conjugate = RingConjugate(law, self.degree)
        self._set_facets()
        corners = self.cut.cells.points[self.cut.cells.nodes]
        force = np.matmul(self.cut.places, self._force[self.cut.parents])
        element = RingElement(corners, force, self.degree)
        self.stresses = RingStresses(self.cut.cells, element, self._frame)

    def _read_force(self) -> np.ndarray:
        """The body force at the corners of the triangles, (triangles, 3, 2)."""
        c = self.cells
        corners = c.points[c.nodes]
        f = self.problem.f
        if f is None:
            return np.zeros_like(corners)
        if varies_inside(self.problem, f, affine=True):
            raise ValueError(
                "body_force is not affine on elements, as bounds of bodies of revolution need it"
            )
        points = self.problem.mesh.MapToAllElements(IntegrationRule(ET.TRIG, 2), VOL)
        count = len(corners)
        places = np.asarray(CF((x, y))(points)).reshape(count, -1, 2)
        away = places - corners.mean(axis=1, keepdims=True)
        shares = 1 / 3 + np.matmul(away, c.gradients.transpose(0, 2, 1))
        values = np.asarray(f(points)).reshape(count, -1, 2)
        return np.matmul(np.linalg.pinv(shares), values)

    def _set_facets(self) -> None:
        """Frames, conditions and given tractions on the facets of the triangles of stresses."""
        c = self.cut.cells
        own = self.cells
        b = self.boundary
        if not b.given[b.contact].all():
            raise ValueError(
                "contact: bounds of bodies of revolution need it on boundaries without supports"
            )
        outer = np.flatnonzero(own.outer)
        there = c.facets_between(own.facets[outer])
        radii = c.points[:, 0]
        on_axis = (radii <= ON_AXIS * radii.max())[c.facets].all(axis=1)
        fixed = np.repeat(~c.outer[:, None], 2, axis=1)
        fixed[there] = b.given[outer]
        fixed[on_axis] = False
        self._fixed = np.repeat(fixed, self.degree + 1, axis=1)
        self._given = np.zeros(self._fixed.shape)
        facets, coefficients = self._tractions()
        self._given[c.facets_between(own.facets[facets])] = coefficients
        self._touching = c.facets_between(own.facets[b.contact])
        n = own.normal[b.contact]
        across = np.stack([-n[:, 1], n[:, 0]], axis=1)
        self._frame = np.broadcast_to(np.eye(2), (len(c.facets), 2, 2)).copy()
        self._frame[self._touching] = np.stack([n, across], axis=1)

    def _shares(self, on: np.ndarray) -> np.ndarray:
        """Barycentric coordinates of the rule's points on some boundary elements, (., q, 2)."""
        rule = self.boundary.rule
        given = np.broadcast_to(rule.shares.T, (int(on.sum()), *rule.shares.T.shape))
        return self.boundary.at_vertices(given, on).swapaxes(1, 2)

    def _tractions(self) -> tuple[np.ndarray, np.ndarray]:
        """The facets with tractions, and Bernstein coefficients of these, (facets, 2 (k + 1))."""
        b = self.boundary
        tractions = self.problem.tractions
        on = b.on(tuple(tractions), "traction")
        g = self.problem.mesh.BoundaryCF(tractions, default=CF((0.0, 0.0)))
        values = b.values(g, on)
        shares = self._shares(on)
        ends = self.cells.points[self.cells.facets[b.facet[on]]]
        scaled = np.matmul(shares, ends[..., :1]) * values
        polynomials = bernstein_values(self.degree, shares)
        found = np.matmul(np.linalg.pinv(polynomials), scaled)
        defect = np.abs(np.matmul(polynomials, found) - scaled).max(initial=0.0)
        hidden = any(
            len(b.scan(g, b.on((n,), "traction")).hidden) for n, g in tractions.items()
        )
        if hidden or defect > CONSTANT * np.abs(scaled).max(initial=1e-300):
            raise ValueError(
                f"traction is not a polynomial of degree {self.degree - 1} on the boundary "
                "elements, as bounds of bodies of revolution need it"
            )
        self._loaded = (on, values)
        each = self._fixed.shape[1]
        return b.facet[on], found.swapaxes(1, 2).reshape(-1, each)

    def _on_facets(
        self, u: np.ndarray, facets: np.ndarray, on: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Displacements (., q, 2) at the rule's points of facets, weights of 2 pi, and radii."""
        c = self.cells
        shares = self._shares(on)
        numbers = nodes_of_facets(self.discrete, c, c.facets[facets])
        values = np.matmul(shares, u[numbers[:, :2]])
        if self.problem.order == 2:
            bubbles = BUBBLE * shares.prod(axis=2)
            values += bubbles[..., None] * u[numbers[:, 2:]]
        radii = np.matmul(shares, c.points[c.facets[facets]][..., :1])[..., 0]
        weights = 2 * math.pi * c.measure[facets][:, None] * self.boundary.rule.weights
        return values, weights, radii

    def _work(self, u: np.ndarray) -> float:
        """The work of body forces and tractions in a displacement."""
        c = self.cells
        shares, weights = triangle_rule(4)
        moved = np.matmul(quadratics(shares), coefficients_of(u, self.discrete, c))
        force = np.matmul(shares, self._force)
        radii = c.points[c.nodes][:, :, 0] @ shares.T
        power = (radii * np.einsum("tqi,tqi->tq", force, moved)) @ weights
        work = 2 * math.pi * float(c.volume @ power)
        on, values = self._loaded
        facets = self.boundary.facet[on]
        moved, weights, radii = self._on_facets(u, facets, on)
        weights = (weights * radii)[..., None]
        return work + float((weights * values * moved).sum())

    def _contact_of(self, state: State) -> RingContact:
        """The contact facets, with the gaps that a displacement leaves."""
        b = self.boundary
        on = b.on(self.problem.contact_names, "contact")
        for name, gap in self.problem.gaps.items():
            if len(b.scan(gap, b.on((name,), "contact")).hidden):
                raise ValueError(
                    "gap varies between quadrature points: bounds of bodies of revolution need "
                    "a polynomial"
                )
        moved, weights, _ = self._on_facets(state.u, b.contact, on)
        along = np.einsum("eqi,ei->eq", moved, self.cells.normal[b.contact])
        slack = b.values(self.problem.psi, on)[:, :, 0] - along
        polynomials = bernstein_values(self.degree, self._shares(on))
        opened = np.einsum("eq,eqi->ei", weights * slack, polynomials)
        return RingContact(self._touching, opened, self._hats(self._pressed(state)))

    def _pressed(self, state: State) -> np.ndarray:
        """The vertices of the contact facets with a contact force at one of their ends."""
        pressed = np.append(state.multipliers > 0, False)[self.contact.from_rows.row_of]
        return np.unique(self.contact.nodes[pressed.any(axis=1), :2])

    def _hats(self, vertices: np.ndarray) -> np.ndarray:
        """Coefficients of r times the hat functions of some vertices, (facets, k + 1, vertices)."""
        ends = self.contact.nodes[:, :2]
        result = np.zeros((len(ends), self.degree + 1, len(vertices)))
        places = lattice_points(1, self.degree)
        r = (
            places
            @ self.cells.points[self.cells.facets[self.boundary.contact]][..., 0].T
        )
        for end in range(2):
            values = from_lattice(1, self.degree) @ (places[:, end, None] * r)
            there = np.isin(ends[:, end], vertices)
            column = np.searchsorted(vertices, ends[there, end])
            result[there, :, column] = values[:, there].T
        return result

    def search(self, state: State, energy: RingEnergy) -> RingSearch:
        """The search for the best stress beside a state."""
        shares, weights = triangle_rule(2 * self.degree + 1)
        c = self.cut.cells
        radii = c.points[c.nodes][:, :, 0] @ shares.T
        places = np.matmul(shares, self.cut.places)
        own = energy.strain[self.cut.parents]
        strain = np.matmul(
            quadratics(places.reshape(-1, 3)).reshape(*places.shape[:2], 6), own
        )
        strain /= radii[..., None]
        weights = 2 * math.pi * radii * weights * c.volume[:, None]
        stress, density = energy.at(strain, self.cut.parents)
        stored = float((weights * density).sum())
        return RingSearch(
            self.stresses,
            self.conjugate,
            shares,
            radii,
            weights,
            strain,
            stress,
            stored,
            self._fixed,
            self._given,
            self._contact_of(state),
        )

    def bound(self, state: State) -> RingBound:
        """The bound of an admissible state."""
        energy = RingEnergy(state, self.cells)
        search = self.search(state, energy)
        y, values = search.best()
        estimate = abs(search.value(y))
        density = energy.elastic() - energy.flow(MISSED * estimate)
        work = search.weights * np.einsum(
            "tqc,tqc->tq", search.stress(y), search.strain
        )
        k = self.degree
        c = self.cut.cells
        nodal = stresses_at(self.stresses, lattice_points(2, k), y)
        rest = -work.sum(axis=1)
        dual = self.conjugate.ring_integrals(
            np.matmul(from_lattice(2, k), nodal),
            c.points[c.nodes][:, :, 0],
            c.volume,
            estimate,
        )
        count = len(self.cells.nodes)
        per_cell = density + self.cut.sums(dual + rest, count)
        pressed = ((search.contact.hats @ values) * search.contact.opened).sum(axis=1)
        owners = self.cells.owners[self.boundary.contact, 0]
        per_cell += np.bincount(owners, pressed, minlength=count)
        energy_of_state = float(density.sum()) - self._work(state.u)
        P = np.zeros(len(self.cells.points))
        P[self._pressed(state)] = values
        P = P[self.contact.nodes[:, :2]]
        return RingBound(energy_of_state, per_cell, nodal, P)


def discrete_gap(state: State, tangent: Factors) -> float:
    """Upper bound of J(u) - J_h in the discrete problem, by a stress in discrete equilibrium."""
    discrete = state.discrete
    law = discrete.law
    points = discrete.points
    forces = discrete.contact.forces(state.contact)
    missing = discrete.load - forces - state.internal_forces
    if tangent.moduli is None:
        tangent.update(state.moduli)
    change = tangent.solve(np.where(discrete.free, missing, 0.0))
    mean, deviator = law.stress(state.at)
    more, across = tangent.moduli.stress(*points.strain(change))
    mean = mean + more
    deviator = deviator + across
    volume, e = points.strain(state.u)
    density = law.energy_density(state.at) + law.complementary_density(mean, deviator)
    density -= mean * volume + np.einsum("pd,pd->p", deviator, e)
    return points.integral(density) + float(state.contact @ state.gaps)
