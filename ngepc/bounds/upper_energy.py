"""Upper bounds of int phi(eps(u)) on quadrilaterals.

With reference coordinates xi in the unit square, D the gradient of u by xi, F that of the position
and J = det F > 0, eps(u) = e/J with a polynomial e = sym(D adj F), and dx = J dxi.  The density is

    phi(eps) = bulk/2 (tr eps)^2 + |s + alpha|^2/(4 mu_2) - mu_2 |p_0|^2 - G(|s|).

- The first two terms are N/J for a polynomial N >= 0 of degree 2 k, k the order of u.  J is affine,
  between c (1 - tau) and c (1 + tau).  With t = (J - c)/c and an even m

      1/J  <=  1/c [1 - t + t^2 - ... - t^(m-1) + t^m/(1 - tau)],

  as 1/(1 + t) is the sum of the powers with t^m/(1 + t) in place of the last term.  The product
  with N is a polynomial, which a Gauss rule integrates exactly.  tau = 0 on parallelograms.
- G is convex in s.  So the integral of G over a part of the element is no less than the area of the
  part times G at the mean of s over it.  This mean is exact: J cancels in int eps dx = int e dxi.
- With linear hardening G = [|s| - beta]_+^2 / (2 M).  For a unit vector d let a = d . s >= m > beta
  on a part.  As the derivative of (|s| - beta)^2 by |s|^2 is 1 - beta/|s|,

      (|s| - beta)^2  >=  (a - beta)^2 + (1 - beta/m) (|s|^2 - a^2).

  J^2 times this is a polynomial, which is integrated with 1/J >= (1 - t)(1 + t^2)/c, t = J/c - 1.
  m is the least quotient of Bernstein coefficients of the polynomials a J and J.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from ngsolve import ET, VOL, ElementId, InnerProduct, Integrate, IntegrationRule

from ngepc.bounds.conjugate import flow_potential
from ngepc.discretisation.law import Law, Return
from ngepc.discretisation.points import Elements
from ngepc.local.system import State
from ngepc.model.elements import elements_by_shape, vertex_coordinates

REMAINDER = 1e-8
"""Part of the elastic energy that the expansion of 1/J may add."""
MOST_TERMS = 30
PARTED = (2, 4, 8, 16)
"""Into how many parts each side of an element is divided, in turn."""
MISSED = 0.01
"""Part of the error bound that the lower bound of G may miss."""
FLAT = 1e-6
"""Smallest ratio of J at corners."""
NUMBERS = 2_000_000
"""Numbers that are held in memory at once."""
ON_PART = IntegrationRule(ET.QUAD, 7)
LATTICE = np.indices((3, 3)).reshape(2, -1).T / 2
"""Places in a part."""
_ALONG = np.array([(1.0, 0.0, 0.0), (-0.5, 2.0, -0.5), (0.0, 0.0, 1.0)])
TO_BERNSTEIN = np.kron(_ALONG, _ALONG)
"""Bernstein coefficients of a function of degree two in both coordinates from ``LATTICE``."""
WORK_ORDER = 8
"""Of the rule for the work of body forces: polynomials of degree three times u times J."""


@dataclass(frozen=True, eq=False)
class Quadrilaterals:
    """The quadrilaterals of a state, and the law there, which is constant on each.

    Parameters
    ----------
    state
        A state on a plane mesh.
    block
        Its quadrilaterals.
    numbers, corners
        Their numbers among the elements, and their corners (quadrilaterals, 4, 2).
    """

    state: State
    block: Elements
    numbers: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, state: State) -> Quadrilaterals:
        """The quadrilaterals of a state."""
        mesh = state.discrete.problem.mesh
        blocks = state.discrete.points.blocks
        pairs = zip(elements_by_shape(mesh), blocks, strict=True)
        found = next(pair for pair in pairs if pair[0][1].shape[1] == 4)
        (numbers, vertices), block = found
        return cls(state, block, numbers, vertex_coordinates(mesh)[vertices])

    def slopes(self, places: np.ndarray) -> np.ndarray:
        """Derivatives of the shape functions of u by xi, (places, functions, 2)."""
        scalar = self.state.discrete.points.scalar
        element = scalar.GetFE(ElementId(VOL, int(self.numbers[0])))
        return np.array([np.array(element.CalcDShape(*place)) for place in places])

    def at(self, places: np.ndarray, chosen: np.ndarray) -> tuple[Return, np.ndarray]:
        """The law at places (p, 2) of some elements, and J (chosen, p); points by element."""
        F = np.einsum("pkj,qki->qpij", corner_slopes(places), self.corners[chosen])
        u = self.state.u[self.block.nodes[chosen]]
        D = np.einsum("pkj,qki->qpij", self.slopes(places), u)
        J = determinants_of(F)
        adjugate = np.trace(F, axis1=2, axis2=3)[..., None, None] * np.eye(2) - F
        gradient = np.matmul(D, adjugate) / J[..., None, None]
        basis = self.block.basis
        strain = gradient.reshape(-1, 4) @ basis.reshape(len(basis), -1).T
        return self.returned(strain, chosen), np.abs(J)

    def returned(self, strain: np.ndarray, chosen: np.ndarray) -> Return:
        """The law at strains (trace and deviator) of points by element."""
        law = self.law(chosen, len(strain) // len(chosen))
        beyond = law.beyond_initial(strain[:, 0], strain[:, 1:])
        return law.returned(*beyond)

    def law(self, chosen: np.ndarray, each: int) -> Law:
        """The law at so many points of each of some elements."""
        first = self.block.points[chosen, 0]
        return self.state.discrete.law.of(np.repeat(first, each))

    def extremes(self) -> tuple[np.ndarray, np.ndarray]:
        """c and tau of each element: J is affine, its extremes are at corners.

        ValueError where J vanishes at a corner.
        """
        slopes = corner_slopes(np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float))
        J = np.abs(determinants_of(np.einsum("pkj,qki->qpij", slopes, self.corners)))
        least = J.min(axis=1)
        most = J.max(axis=1)
        if (least < FLAT * most).any():
            raise ValueError(
                "mesh has quadrilaterals with an angle of 180 degrees: a bound needs less"
            )
        return (most + least) / 2, (most - least) / (most + least)


def determinants_of(F: np.ndarray) -> np.ndarray:
    """The determinants of matrices (..., 2, 2)."""
    return F[..., 0, 0] * F[..., 1, 1] - F[..., 0, 1] * F[..., 1, 0]


def corner_slopes(places: np.ndarray) -> np.ndarray:
    """Derivatives of the bilinear functions of the corners by xi, (places, 4, 2)."""
    x = places[:, 0]
    y = places[:, 1]
    by_x = np.stack([y - 1, 1 - y, y, -y], axis=1)
    by_y = np.stack([x - 1, -x, x, 1 - x], axis=1)
    return np.stack([by_x, by_y], axis=2)


def in_groups(chosen: np.ndarray, places: int) -> Iterator[np.ndarray]:
    """Elements in groups that fit into memory."""
    each = max(1, NUMBERS // (places * 20))
    for start in range(0, len(chosen), each):
        yield chosen[start : start + each]


def upper_energies(state: State, bound: float) -> tuple[np.ndarray, np.ndarray]:
    """Upper bounds of int phi(eps(u)) over the quadrilaterals, and their numbers.

    ``bound`` is the size of the error bound that they are used in.
    """
    those = Quadrilaterals.of(state)
    elastic, area = elastic_energies(those)
    law = those.law(np.arange(len(area)), 1)
    history = 0.5 * law.two_mu * (law.initial**2).sum(axis=1) * area
    return elastic - history - least_flow(those, MISSED * bound), those.numbers


def changes(
    own: State, made: State, phi: np.ndarray, parents: np.ndarray, bound: float
) -> np.ndarray:
    """Upper bounds of what each element adds to J(u_h) - J(v), (elements,).

    ``own`` is the state of u_h on quadrilaterals, ``made`` that of v on triangles, ``phi`` upper
    bounds of int phi(eps(v)) over the triangles.  On the edges of the elements u_h is v, so that
    contact, friction, springs and tractions do the same work.
    """
    problem = own.discrete.problem
    energy, numbers = upper_energies(own, bound)
    count = problem.mesh.ne
    by_element = np.bincount(parents, phi, minlength=count)[numbers]
    change = np.zeros(count)
    change[numbers] = energy - by_element
    if problem.f is None:
        return change
    mine = work_by_element(own)
    other = np.bincount(parents, work_by_element(made), minlength=count)
    work = mine - other
    whole = np.vdot(own.discrete.load, own.u) - np.vdot(made.discrete.load, made.u)
    rest = (whole - work.sum()) / count
    return change - work - rest


def work_by_element(state: State) -> np.ndarray:
    """The work of the body force in the displacement of a state, by element."""
    problem = state.discrete.problem
    u = state.discrete.supports.function(state.u)
    density = InnerProduct(problem.f, u)
    work = Integrate(density, problem.mesh, order=WORK_ORDER, element_wise=True)
    return np.array(work)


def elastic_energies(those: Quadrilaterals) -> tuple[np.ndarray, np.ndarray]:
    """Upper bounds of the integrals of the first two terms, and the areas."""
    c, tau = those.extremes()
    energy = np.empty(len(c))
    area = np.empty(len(c))
    terms = terms_needed(tau)
    for m in np.unique(terms).tolist():
        order = those.state.discrete.problem.order
        rule = IntegrationRule(ET.QUAD, 2 * order + m + 1)
        places = np.array(rule.points)[:, :2]
        weights = np.array(rule.weights)
        for chosen in in_groups(np.flatnonzero(terms == m), len(places)):
            at, J = those.at(places, chosen)
            N = elastic_density(those.law(chosen, len(places)), at).reshape(J.shape)
            N *= J**2
            t = J / c[chosen, None] - 1
            powers = (-t[:, :, None]) ** np.arange(m + 1)
            powers[:, :, -1] /= 1 - tau[chosen, None]
            inverse = powers.sum(axis=2) / c[chosen, None]
            energy[chosen] = (N * inverse) @ weights
            area[chosen] = J @ weights
    return energy, area


def elastic_density(law: Law, at: Return) -> np.ndarray:
    """The first two terms of phi."""
    total = at.trial + law.back
    return law.bulk * at.volume**2 / 2 + (total**2).sum(axis=1) / (2 * law.two_mu)


def terms_needed(tau: np.ndarray) -> np.ndarray:
    """The smallest even m for which the last term is small, for each element."""
    terms = np.zeros(len(tau), dtype=int)
    for m in range(0, MOST_TERMS, 2):
        added = tau / (1 - tau) if m == 0 else tau**m / (1 - tau)
        terms[added > REMAINDER] = m + 2
    return terms


def least_flow(those: Quadrilaterals, allowed: float) -> np.ndarray:
    """Lower bounds of the integrals of G over the elements.

    Elements are divided until quadrature rules exceed the bounds by less than ``allowed`` in all.
    """
    count = len(those.numbers)
    least = np.zeros(count)
    missed = np.full(count, np.inf)
    limit = allowed / count
    for parts in PARTED:
        for rough in in_groups(np.flatnonzero(missed > limit), 25 * parts**2):
            low, near = flow_on_parts(those, rough, parts)
            least[rough] = low
            missed[rough] = near - low
    return least


def flow_on_parts(
    those: Quadrilaterals, chosen: np.ndarray, parts: int
) -> tuple[np.ndarray, np.ndarray]:
    """A lower bound of the integral of G over some elements, and its value by quadrature."""
    origins = np.indices((parts, parts)).reshape(2, -1).T / parts
    inside = np.concatenate([np.array(ON_PART.points)[:, :2], LATTICE]) / parts
    places = (origins[:, None] + inside).reshape(-1, 2)
    at, J = those.at(places, chosen)
    shape = (len(chosen), parts**2, len(inside))
    J = J.reshape(shape)
    size = np.array(ON_PART.weights) / parts**2
    count = len(size)
    law = those.law(chosen, len(places))
    near = flow_potential(law.resistance, law.modulus, at.size, at.gained)

    weights = J[..., :count] * size
    area = weights.sum(axis=2)
    strain = np.column_stack([at.volume + law.swelling, at.deviator + law.distortion])
    strain = strain.reshape(*shape, -1)[:, :, :count]
    mean = np.einsum("qpi,qpis->qps", weights / area[..., None], strain)
    mean_at = those.returned(mean.reshape(-1, mean.shape[2]), chosen)
    law = those.law(chosen, parts**2)
    low = flow_potential(law.resistance, law.modulus, mean_at.size, mean_at.gained)
    low = low.reshape(area.shape) * area
    if law.resistance.is_constant:
        s = at.trial.reshape(*shape, -1)
        middle = mean_at.trial.reshape(*area.shape, -1)
        beta = law.beta.reshape(area.shape)
        found = linear_flow(s, J, middle, beta, size)
        low = np.maximum(low, found / (2 * law.modulus.reshape(area.shape)))
    near = near.reshape(shape)[..., :count] * weights
    return low.sum(axis=1), near.sum(axis=(1, 2))


def linear_flow(
    s: np.ndarray, J: np.ndarray, middle: np.ndarray, beta: np.ndarray, size: np.ndarray
) -> np.ndarray:
    """Lower bounds of int [|s| - beta]_+^2 over parts, (elements, parts).

    ``s`` (elements, parts, places, d) and J are values at the points of the rule with weights
    ``size`` and on the lattice, ``middle`` (elements, parts, d) are means of s.  Zero for parts on
    which s may be below beta.
    """
    count = len(size)
    length = np.linalg.norm(middle, axis=2, keepdims=True)
    d = middle / np.where(length > 0, length, 1.0)
    a = np.einsum("qpid,qpd->qpi", s, d)
    across = np.einsum("qpid,qpid->qpi", s, s) - a**2

    on_lattice = J[..., count:]
    numerators = (a[..., count:] * on_lattice) @ TO_BERNSTEIN.T
    least = (numerators / (on_lattice @ TO_BERNSTEIN.T)).min(axis=2)
    yields = least > beta
    share = 1 - beta / np.where(yields, least, np.inf)

    c = (on_lattice.max(axis=2) + on_lattice.min(axis=2)) / 2
    t = J[..., :count] / c[..., None] - 1
    inverse = (1 - t) * (1 + t**2) / c[..., None]
    weights = size * J[..., :count] ** 2 * inverse
    squares = (a[..., :count] - beta[..., None]) ** 2
    squares += share[..., None] * np.maximum(across[..., :count], 0.0)
    return np.where(yields, (weights * squares).sum(axis=2), 0.0)
