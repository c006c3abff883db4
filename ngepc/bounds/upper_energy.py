"""Upper bounds of int phi(eps(u)) on quadrilaterals and hexahedra.

With reference coordinates xi in the unit square or cube, D the gradient of u by xi, F that of the
position and J = det F > 0, eps(u) = e/J with a polynomial e = sym(D adj F), and dx = J dxi.  For
displacements of order k the degree of e in each coordinate is k on quadrilaterals and
parallelepipeds, k + 1 on other hexahedra; that of J is 1, 0 or 2.  The density is

    phi(eps) = bulk/2 (tr eps)^2 + |s + alpha|^2/(4 mu_2) - mu_2 |p_0|^2 - G(|s|).

- The first two terms are N/J^2 for a polynomial N >= 0, twice the degree of e.  J lies between
  c (1 - tau) and c (1 + tau), the least and the largest of its Bernstein coefficients.  With
  t = (J - c)/c and an even m

      1/J  <=  1/c [1 - t + t^2 - ... - t^(m-1) + t^m/(1 - tau)],

  as 1/(1 + t) is the sum of the powers with t^m/(1 + t) in place of the last term.  The product
  with N is a polynomial, which a Gauss rule integrates exactly.  tau = 0 on parallelograms and
  parallelepipeds.
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

import numpy as np
from ngsolve import InnerProduct, Integrate, IntegrationRule

from ngepc.bounds.balance import spring_energy
from ngepc.bounds.least_flow import least_flow
from ngepc.bounds.mapped import SHAPES, MappedElements
from ngepc.discretisation.law import Law, Return
from ngepc.local.system import State

REMAINDER = 1e-8
"""Part of the elastic energy that the expansion of 1/J may add."""
MOST_TERMS = 30
MISSED = 0.01
"""Part of the error bound that the lower bound of G may miss."""
EXPANDED = 1e-3
"""Part of the error bound that the expansion of 1/J may add."""
NUMBERS = 2_000_000
"""Numbers that are held in memory at once."""
WORK_ORDER = 8
"""Of the rule for the work of body forces: polynomials of degree three times u times J."""


def in_groups(chosen: np.ndarray, places: int) -> Iterator[np.ndarray]:
    """Elements in groups that fit into memory."""
    each = max(1, NUMBERS // (places * 20))
    for start in range(0, len(chosen), each):
        yield chosen[start : start + each]


def upper_energies(state: State, bound: float) -> tuple[np.ndarray, np.ndarray]:
    """Upper bounds of int phi(eps(u)) over quadrilaterals or hexahedra, and their numbers.

    ``bound`` is the size of the error bound that they are used in.
    """
    count = sum(len(those.numbers) for those in MappedElements.of(state))
    stored = elastic_density(state.discrete.law, state.with_radial_return().at)
    whole = state.discrete.points.integral(stored)
    remainder = max(REMAINDER, EXPANDED * bound / max(whole, np.finfo(float).tiny))
    energies = []
    numbers = []
    for those in MappedElements.of(state):
        elastic, area = elastic_energies(those, remainder)
        law = those.law(np.arange(len(area)), 1)
        history = 0.5 * law.two_mu * (law.initial**2).sum(axis=1) * area
        flow = least_flow(those, MISSED * bound * len(area) / count)
        energies.append(elastic - history - flow)
        numbers.append(those.numbers)
    return np.concatenate(energies), np.concatenate(numbers)


def changes(
    own: State, made: State, phi: np.ndarray, parents: np.ndarray, bound: float
) -> np.ndarray:
    """Upper bounds of what each element adds to J(u_h) - J(v), (elements,).

    ``own`` is the state of u_h on quadrilaterals or hexahedra, ``made`` that of v on simplices,
    ``phi`` upper bounds of int phi(eps(v)) over these.  On edges of the plane u_h is v, so that
    contact, friction, springs and tractions do the same work there; on faces loads and springs do
    not.  That difference is shared by all elements.
    """
    problem = own.discrete.problem
    energy, numbers = upper_energies(own, bound)
    count = problem.mesh.ne
    by_element = np.bincount(parents, phi, minlength=count)[numbers]
    change = np.zeros(count)
    change[numbers] = energy - by_element
    work = np.zeros(count)
    if problem.f is not None:
        other = np.bincount(parents, work_by_element(made), minlength=count)
        work = work_by_element(own) - other
    whole = np.vdot(own.discrete.load, own.u) - np.vdot(made.discrete.load, made.u)
    sprung = spring_energy(own.discrete, own.u) - spring_energy(made.discrete, made.u)
    rest = (whole - sprung - work.sum()) / count
    return change - work - rest


def work_by_element(state: State) -> np.ndarray:
    """The work of the body force in the displacement of a state, by element."""
    problem = state.discrete.problem
    u = state.discrete.supports.function(state.u)
    density = InnerProduct(problem.f, u)
    work = Integrate(density, problem.mesh, order=WORK_ORDER, element_wise=True)
    return np.array(work)


def elastic_energies(
    those: MappedElements, remainder: float = REMAINDER
) -> tuple[np.ndarray, np.ndarray]:
    """Upper bounds of the integrals of the first two terms, and the areas."""
    c, tau = those.extremes()
    energy = np.empty(len(c))
    area = np.empty(len(c))
    terms = terms_needed(tau, remainder)
    for m in np.unique(terms).tolist():
        rule = IntegrationRule(SHAPES[those.N], 2 * those.degree + m * those.bend + 1)
        places = np.array(rule.points)[:, : those.N]
        weights = np.array(rule.weights)
        for chosen in in_groups(np.flatnonzero(terms == m), len(places)):
            e, J = those.polynomials(places, chosen)
            law, at = those.returned(e / J[..., None], chosen)
            N = elastic_density(law, at).reshape(J.shape) * J**2
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


def terms_needed(tau: np.ndarray, remainder: float) -> np.ndarray:
    """The smallest even m for which the last term is small, for each element."""
    terms = np.zeros(len(tau), dtype=int)
    for m in range(0, MOST_TERMS, 2):
        added = tau / (1 - tau) if m == 0 else tau**m / (1 - tau)
        terms[added > remainder] = m + 2
    return terms
