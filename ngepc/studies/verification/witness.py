"""An independent look at results: residuals and error bounds assembled the plain way by NGSolve."""

from __future__ import annotations

import numpy as np
from ngsolve import (
    CoefficientFunction,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    Trace,
    ds,
    dx,
)
from ngsolve.comp import ProxyFunction

from ngepc.checks.arguments import Coefficient
from ngepc.dual.blocks import load_terms
from ngepc.model.problem import Problem, as_scalar
from ngepc.primal.result import PrimalResult
from ngepc.results.exact import DiscreteSolution

Field = ProxyFunction | GridFunction
"""A displacement or a plastic strain."""


def elastic_product(
    problem: Problem, h: Coefficient, u: Field, p: Field, v: Field, r: Field
) -> CoefficientFunction:
    """The integrand of <D (u, p), (v, r)>: C (eps(u) - p) : (eps(v) - r) + h p . r."""
    m = problem.material
    strain, tensor = problem.kinematics.strain, problem.kinematics.tensor
    e, d = strain(u) - tensor(p), strain(v) - tensor(r)
    return m.lame_lambda * Trace(e) * Trace(d) + 2 * m.lame_mu * InnerProduct(e, d) + h * p * r


def energy(problem: Problem, u: GridFunction, p: GridFunction) -> float:
    """J(u, p) of (2.14) without friction (force times length)."""
    h = problem.effective_hardening
    stored = elastic_product(problem, h, u, p, u, p) / 2 + as_scalar(problem.beta) * Norm(p)
    work = sum(Integrate(term, problem.mesh) for term in load_terms(problem, u, p))
    return Integrate(stored, problem.mesh) - work


def balance_residual(result: DiscreteSolution) -> float:
    """Nodal forces out of balance over the larger of applied and internal ones.

    Internal forces are integrated from the stress field, contact forces are those reported.
    """
    problem, u = result.problem, result.displacement
    V = u.space
    v = V.TestFunction()
    internal, applied = LinearForm(V), LinearForm(V)
    internal += InnerProduct(result.stress, problem.kinematics.strain(v)) * dx(bonus_intorder=2)
    for name, g in problem.tractions.items():
        applied += g * v * ds(name, bonus_intorder=3)
    if problem.f is not None:
        applied += problem.f * v * dx(bonus_intorder=3)
    inside, outside = (f.Assemble().vec.FV().NumPy() for f in (internal, applied))
    push = result.rows.forces(result.nodal_contact_forces).T.ravel()
    free = np.array(list(V.FreeDofs()), dtype=bool)
    balance = np.linalg.norm((inside - outside + push)[free])
    return float(balance / max(np.linalg.norm(inside), np.linalg.norm(outside), 1e-300))


def feasible_bound(primal: PrimalResult, other: DiscreteSolution) -> tuple[float, float]:
    """1/2 |y - y'|_D^2 and J(y') - J(y), which it cannot exceed.

    y' is the solution of the other method with nodes that penetrate moved back to the obstacle:
    it is admissible for the primal problem, whose minimum is J(y).
    """
    problem, contact = primal.problem, primal.rows
    u, p = GridFunction(other.displacement.space), other.plastic_increment
    u.vec.data = other.displacement.vec
    values = u.vec.FV().NumPy().reshape(problem.N, -1)
    overlap = np.maximum(-contact.open_gap(values.T), 0.0)
    for depth, vertex, normal in zip(overlap, contact.vertices, contact.normals, strict=True):
        values[:, vertex] -= depth * normal
    du, dp = primal.displacement - u, primal.plastic_increment - p
    h = problem.effective_hardening
    distance = Integrate(elastic_product(problem, h, du, dp, du, dp), problem.mesh) / 2
    own = energy(problem, primal.displacement, primal.plastic_increment)
    return distance, energy(problem, u, p) - own
