"""Loads, supports and obstacles on the boundary facets of a body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from ngsolve import BND, CF, CoefficientFunction, Mesh

from ngepc.bounds.coverage import CONSTANT, FACET_RULES, edge_functions
from ngepc.bounds.enclosure import GapEnclosure, enclosed_gap
from ngepc.bounds.matching import Interface
from ngepc.bounds.simplices import Simplices
from ngepc.checks.arguments import Coefficient
from ngepc.checks.sentences import in_words
from ngepc.discretisation.enclosed_gaps import OF_OBSTACLES
from ngepc.discretisation.formulas import formula_of
from ngepc.discretisation.operations import FacetCorners
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.sampling import HiddenRule, Scan
from ngepc.linalg.intervals import Intervals
from ngepc.model.data import as_scalar
from ngepc.model.elements import cells_of
from ngepc.model.problem import Problem


class OuterFacets:
    """Values of data on the boundary elements, each assigned to the facet of its cell."""

    def __init__(self, mesh: Mesh, cells: Simplices) -> None:
        N = cells.N
        self.mesh = mesh
        self.cells = cells
        self.rule = FACET_RULES[N]
        vertices, region = cells_of(mesh, N - 1)
        self._vertices = vertices[:, :N]
        self._order = self._vertices.argsort(axis=1)
        self.facet = cells.facets_between(self._vertices)
        self._name = np.array(mesh.GetBoundaries())[region]

    def on(self, names: tuple[str, ...], argument: str) -> np.ndarray:
        """Which boundary elements have one of these names; they lie on the outer boundary."""
        chosen = np.isin(self._name, list(names))
        if not self.cells.outer[self.facet[chosen]].all():
            raise ValueError(
                f"{argument}: bounds need it on the outer boundary of the body"
            )
        return chosen

    def values(self, value: Coefficient, on: np.ndarray) -> np.ndarray:
        """A coefficient at the rule's points of some boundary elements, (elements, points, k)."""
        value = as_scalar(value)
        points = self.mesh.MapToAllElements({self.rule.shape: self.rule.rule}, BND)
        found = np.asarray(value(points))
        return found.reshape(-1, len(self.rule.weights), value.dim)[on]

    def affine(self, name: str, value: Coefficient, on: np.ndarray) -> np.ndarray:
        """The same for data that must be affine on each element; ValueError if they are not."""
        values = self.values(value, on)
        if len(self.scan(value, on).hidden):
            raise ValueError(
                f"{name} varies between quadrature points: bounds need a function that is "
                "affine on the boundary elements"
            )
        defect = np.abs(self.rule.affine_defect(values)).max(initial=0.0)
        if defect > CONSTANT * np.abs(values).max(initial=1e-300):
            order = ", or order=1" if name == "traction" else ""
            raise ValueError(
                f"{name} is not affine on the boundary elements, as bounds need it{order}"
            )
        return values

    def constant(self, name: str, value: Coefficient, on: np.ndarray) -> np.ndarray:
        """The value (elements,) of a scalar on each element; ValueError if it varies there."""
        values = self.values(value, on)[:, :, 0]
        varies = np.ptp(values, axis=1).max(initial=0.0)
        hidden = len(self.scan(value, on).hidden) > 0
        if hidden or varies > CONSTANT * np.abs(values).max(initial=1e-300):
            raise ValueError(
                f"{name} varies inside boundary elements: bounds need one value on each"
            )
        return values[:, 0]

    def scan(self, value: Coefficient, on: np.ndarray) -> Scan:
        """The scan of a coefficient on some boundary elements."""
        return Scan(self.mesh, value, BND, on)

    def corners(self, on: np.ndarray) -> FacetCorners:
        """Some boundary elements, for enclosures of coefficients on them."""
        places = Intervals.exactly(self.cells.points[self._vertices[on]])
        return FacetCorners(places, lambda value: self.values(value, on))

    def at_vertices(self, values: np.ndarray, on: np.ndarray) -> np.ndarray:
        """Vertex values of boundary elements, reordered as the vertices of their facets."""
        return values[np.arange(len(values))[:, None], self._order[on]]


class Boundary(OuterFacets):
    """Loads, supports and obstacles on each facet of the outer boundary.

    ``given`` (nf, N) marks the components of the traction that are known, on contact facets too.
    Facets on rollers along no axis are ``slanted``: of their tractions all is known but the part
    along the unit vectors ``directions`` (slanted facets, N); ``given`` marks all components.
    ``moments`` (nf, N, N) are the moments of g with the hat functions of each facet's vertices
    (force), zero elsewhere.  ``uneven`` has the facets with tractions, and for each the mean of
    r r' (., N, N), where r is g less the affine function with these moments.  ``contact`` are the
    numbers of the contact facets.  At their vertices (contact facets, N), ``gap`` is an affine
    function that is nowhere above psi, ``excess`` at least the integral of psi - gap times the
    hat functions, and ``friction`` is F (stress) or zero.  For displacements of order two in three
    dimensions ``gap`` is quadratic: its further columns are the coefficients of NGSolve's edge
    functions, of the edges opposite to the vertices.  ``elastic`` are the numbers of the facets
    with springs, ``stiffness`` (elastic facets, N, N) their matrices K: the traction is -K u.

    The first facets of pairs of bodies are the last contact facets.  The facets that they face have
    the vertices ``opposite`` (pairs, N), each facing the vertex of the first facet in its place.

    ValueError for friction or displacements that are not affine on facets (displacements at the
    start of the step: quadratic for order two), for springs that are not constant
    there, and for boundaries inside the body.
    """

    def __init__(self, problem: Problem, cells: Simplices) -> None:
        super().__init__(problem.mesh, cells)
        self.problem = problem
        N = cells.N
        self.given = np.repeat(cells.outer[:, None], N, axis=1)
        self.given[self.facet] &= ~self._held()
        self._read_rollers()
        self.moments = np.zeros((len(cells.facets), N, N))
        self._read_tractions()
        self._read_springs()
        self._read_contact()
        self._read_pairs()

    def contact_of(self, names: Sequence[str]) -> np.ndarray:
        """The contact facets on some boundaries, as booleans; in pairs on one of both sides."""
        chosen = np.zeros(len(self.cells.facets), dtype=bool)
        chosen[self.facet] = np.isin(self._name, list(names))
        on = chosen[self.contact]
        facing = self.cells.facets_between(self.opposite)
        on[len(on) - len(facing) :] |= chosen[facing]
        return on

    def _held(self) -> np.ndarray:
        """Components that are prescribed by a support, shape (boundary elements, N)."""
        problem = self.problem
        held = np.zeros((len(self.facet), problem.N), dtype=bool)
        for argument, name, component, value in problem.held:
            on = self.on((name,), argument)
            held[on, component] = True
            self.affine(argument, value, on)
        return held

    def _read_rollers(self) -> None:
        directions = np.zeros((len(self.cells.facets), self.problem.N))
        for name, roller in self.problem.rollers.items():
            argument = f"prescribed[{name!r}]"
            on = self.on((name,), argument)
            self.affine(argument, roller.value, on)
            facets = self.facet[on]
            if not self.given[facets].all() or directions[facets].any():
                raise ValueError(
                    f"{argument}: bounds need rollers on sides without other supports"
                )
            d = self.cells.normal[facets]
            if roller.direction is not None:
                d = np.array(roller.direction, dtype=float)
                d = d / np.linalg.norm(d)
            directions[facets] = d
        self.slanted = np.flatnonzero(directions.any(axis=1))
        self.directions = directions[self.slanted]

    def known(self, facets: np.ndarray) -> np.ndarray:
        """Projections (facets, N, N) of tractions on the parts that no support takes."""
        N = self.problem.N
        d = np.zeros((len(self.given), N))
        d[self.slanted] = self.directions
        d = d[facets]
        return self.given[facets][:, None] * np.eye(N) - d[:, :, None] * d[:, None]

    def _read_tractions(self) -> None:
        tractions = self.problem.tractions
        rule = self.rule
        N = self.problem.N
        on = self.on(tuple(tractions), "traction")
        g = self.problem.mesh.BoundaryCF(tractions, default=CF((0.0,) * N))
        values = self.values(g, on)
        moments = np.einsum("q,qa,eqi->eai", rule.weights, rule.shares, values)
        affine = N * (N + 1) * (moments - moments.sum(axis=1, keepdims=True) / (N + 1))
        facets = self.facet[on]
        known = self.known(facets)
        rest = np.matmul(values - rule.shares @ affine, known)
        rest[
            :,
            np.abs(rest).max(initial=0.0) <= CONSTANT * np.abs(values).max(initial=0.0),
        ] = 0.0
        squares = np.einsum("q,eqi,eqj->eij", rule.weights, rest, rest)
        moments *= self.cells.measure[facets][:, None, None]
        row = np.cumsum(on) - 1
        for name, traction in tractions.items():
            scan = self.scan(traction, self._name == name)
            for number in scan.hidden.tolist():
                place = row[number]
                found = hidden_traction(scan.rule(number), known[place])
                moments[place], squares[place] = found
        self.moments[facets] = self.at_vertices(moments, on)
        self.uneven = (facets, squares)

    def _read_springs(self) -> None:
        N = self.problem.N
        stiffness = np.zeros((len(self.cells.facets), N, N))
        for name, springs in self.problem.spring_constants.items():
            argument = f"springs[{name!r}]"
            on = self.on((name,), argument)
            facets = self.facet[on]
            for axis, k in springs:
                d = self.cells.normal[facets]
                if axis is not None:
                    d = np.broadcast_to(axis, d.shape)
                values = self.constant(argument, k, on)
                stiffness[facets] += values[:, None, None] * d[:, :, None] * d[:, None]
        self.elastic = np.flatnonzero(stiffness.any(axis=(1, 2)))
        self.stiffness = stiffness[self.elastic]

    def _read_contact(self) -> None:
        on = self.on(
            self.problem.contact_names, f"contact={in_words(self.problem.contact)}"
        )
        self.contact = self.facet[on]
        found = GapEnclosure.zero(len(self.contact), self.cells.N, self._quadratic)
        for name, gap in self.problem.gaps.items():
            chosen = on & (self._name == name)
            found = found.with_rows(chosen[on], self._enclosed(gap, chosen))
        size = self.cells.measure[self.contact][:, None]
        self.gap = self.at_vertices(found.below, on)
        if found.bent.shape[1]:
            bent = self.at_vertices(found.bent, on)
            self.gap = np.concatenate([self.gap, bent], axis=1)
        self.excess = size * self.at_vertices(found.excess, on)
        bound = 0.0 if self.problem.friction is None else self.problem.friction
        self.friction = self.at_vertices(
            self.affine("friction", bound, on)[:, :, 0], on
        )
        if self.problem.initial_displacement is not None:
            self._check_start(on)

    @property
    def _quadratic(self) -> bool:
        """Whether displacements are quadratic on facets with edge functions of their own."""
        return self.cells.N == 3 and self.problem.order == 2

    def _enclosed(self, gap: CoefficientFunction, on: np.ndarray) -> GapEnclosure:
        """Enclosures of a gap on some contact facets, by its formula where it has one."""
        if is_polynomial(gap, self.mesh, OF_OBSTACLES):
            return self._by_values(gap, on)
        formula = formula_of(gap)
        if formula is None:
            return self._by_values(gap, on)
        found = enclosed_gap(formula, self.corners(on), self._quadratic)
        known = found.finite & self._is_above(gap, found, on)
        if known.all():
            return found
        return self._by_values(gap, on).with_rows(known, found.rows(known))

    def _is_above(
        self, gap: CoefficientFunction, found: GapEnclosure, on: np.ndarray
    ) -> np.ndarray:
        """Where values of a gap confirm that its polynomials are below, but for rounding."""
        values = self.values(gap, on)[:, :, 0]
        above = values - found.values() + CONSTANT * np.abs(values).max(initial=0.0)
        return (above >= 0).all(axis=1)

    def _by_values(self, gap: CoefficientFunction, on: np.ndarray) -> GapEnclosure:
        """Enclosures of a gap by its values at points; proved for quadratic functions."""
        rule = self.rule
        psi = self.values(gap, on)[:, :, 0]
        N = self.cells.N
        bent = rule.bubbles(psi) if self._quadratic else np.zeros((len(psi), 0))
        flat = psi - rule.bent(bent)
        below = flat[:, :N] + rule.lowest_defect(flat)[:, None]
        excess = (rule.weights * (flat - below @ rule.shares.T)) @ rule.shares
        row = np.cumsum(on) - 1
        scan = self.scan(gap, on)
        for number in scan.hidden.tolist():
            place = row[number]
            ends = flat[place, :N]
            found = hidden_obstacle(scan.rule(number), ends, bent[place])
            below[place] = found[0]
            excess[place] = found[1] / self.cells.measure[self.facet[number]]
        return GapEnclosure(below, bent, excess)

    def _check_start(self, on: np.ndarray) -> None:
        """Refuse displacements at the start of the step that are not known at the nodes."""
        name = "initial_displacement"
        if self.problem.order == 1:
            self.affine(name, self.problem.u_0, on)
            return
        values = self.values(self.problem.u_0, on)
        defect = np.abs(self.rule.quadratic_defect(values)).max(initial=0.0)
        hidden = len(self.scan(self.problem.u_0, on).hidden) > 0
        if hidden or defect > CONSTANT * np.abs(values).max(initial=1e-300):
            raise ValueError(
                f"{name} is not quadratic on the boundary elements, as bounds of order 2 "
                "need it"
            )

    def _read_pairs(self) -> None:
        c = self.cells
        none = np.zeros((0, c.N), dtype=int)
        self.opposite = none
        for pair in self.problem.contact_pairs:
            found = Interface(c, pair).facing()
            order = np.argsort(found.first, axis=1)
            second = np.take_along_axis(found.second, order, axis=1)
            gap = np.take_along_axis(found.gap, order, axis=1)
            facets = c.facets_between(found.first)
            self.contact = np.append(self.contact, facets)
            self.opposite = np.concatenate([self.opposite, second])
            self.gap = np.concatenate([self.gap, gap])
            self.excess = np.concatenate([self.excess, np.zeros(gap.shape)])
            self.friction = np.concatenate([self.friction, np.zeros(gap.shape)])


def hidden_traction(
    rule: HiddenRule, known: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Moments with the hat functions (N, N), and the mean square of the non-affine part (N, N).

    ``known`` (N, N) projects on what no support takes.  Of vectors r whose components have the
    squares s the matrix r r' is at most N diag(s).
    """
    N = rule.shares.shape[1]
    size = rule.weights.sum()
    moments = rule.shares.T @ (rule.weights[:, None] * rule.values)
    affine = N * (N + 1) * (moments - moments.sum(axis=0) / (N + 1)) / size
    rest = (rule.values - rule.shares @ affine) @ known
    squares = (rule.weights[:, None] * rest).T @ rest
    mixed = (known != np.diag(np.diag(known))).any()
    squares += known @ np.diag(rule.unresolved) @ known * (N if mixed else 1)
    return moments, squares / size


def hidden_obstacle(
    rule: HiddenRule, ends: np.ndarray, bent: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Vertex values (N,) of an affine function below psi, and the moments of psi less it (N,).

    ``ends`` are the values of psi at the vertices; ``bent`` (0 or 3,) are coefficients of edge
    functions that are subtracted from psi first.  Between the points the difference is assumed to
    decrease by at most its variation on a part.
    """
    at_corners = rule.at_corners[:, :, 0]
    values = rule.values[:, 0]
    if len(bent):
        at_corners = at_corners - edge_functions(rule.corners) @ bent
        values = values - edge_functions(rule.shares) @ bent
    defect = at_corners - rule.corners @ ends
    lowest = (defect.min(axis=1) - np.ptp(at_corners, axis=1)).min()
    above = ends + min(lowest, 0.0)
    left = rule.weights * (values - rule.shares @ above)
    return above, left @ rule.shares
