"""An independent look at results: residuals and error bounds assembled the plain way by NGSolve.

Nothing here uses the solvers' own assembly.  The residual Psi_gamma of regularised results is
integrated with all the quadrature points on every element, no element is sorted out, D is neither
condensed nor shared.
"""

import math
from dataclasses import dataclass

import numpy as np
from ngsolve import (
    BilinearForm,
    GridFunction,
    IfPos,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    Trace,
    ds,
    dx,
)

from ngepc.discretisation.quadrature import boundary_rules, fine_rules
from ngepc.discretisation.supports import prescribed_displacement
from ngepc.dual.saddle import load_terms
from ngepc.model.data import as_scalar

POINTS = 400


def elastic_product(problem, h, u, p, v, r):
    """The integrand of <D (u, p), (v, r)>: C (eps(u) - p) : (eps(v) - r) + h p . r."""
    m = problem.material
    strain, tensor = problem.kinematics.strain, problem.kinematics.tensor
    e, d = strain(u) - tensor(p), strain(v) - tensor(r)
    return (
        m.lame_lambda * Trace(e) * Trace(d)
        + 2 * m.lame_mu * InnerProduct(e, d)
        + h * p * r
    )


def energy(problem, u, p):
    """J(u, p) of (2.14) without friction (force times length)."""
    h = problem.effective_hardening
    stored = elastic_product(problem, h, u, p, u, p) / 2 + as_scalar(
        problem.beta
    ) * Norm(p)
    work = sum(Integrate(term, problem.mesh) for term in load_terms(problem, u, p))
    return Integrate(stored, problem.mesh) - work


def balance_residual(result):
    """Nodal forces out of balance over the larger of applied and internal ones.

    Internal forces are integrated from the stress field, contact forces are those reported.
    """
    problem, u = result.problem, result.displacement
    V = u.space
    v = V.TestFunction()
    internal, applied = LinearForm(V), LinearForm(V)
    internal += InnerProduct(result.stress, problem.kinematics.strain(v)) * dx(
        bonus_intorder=2
    )
    for name, g in problem.tractions.items():
        applied += g * v * ds(name, bonus_intorder=3)
    if problem.f is not None:
        applied += problem.f * v * dx(bonus_intorder=3)
    inside, outside = (f.Assemble().vec.FV().NumPy() for f in (internal, applied))
    push = (
        (result.rows.normal.T @ result.nodal_contact_forces)
        .reshape(-1, problem.N)
        .T.ravel()
    )
    free = np.array(list(V.FreeDofs()), dtype=bool)
    balance = np.linalg.norm((inside - outside + push)[free])
    return float(balance / max(np.linalg.norm(inside), np.linalg.norm(outside), 1e-300))


def feasible_bound(primal, other):
    """1/2 |y - y'|_D^2 and J(y') - J(y), which it cannot exceed.

    y' is the solution of the other method with nodes that penetrate moved back to the obstacle:
    it is admissible for the primal problem, whose minimum is J(y).
    """
    problem, contact = primal.problem, primal.rows
    u, p = GridFunction(other.displacement.space), other.plastic_increment
    u.vec.data = other.displacement.vec
    values = u.vec.FV().NumPy().reshape(problem.N, -1)
    overlap = np.maximum(-(contact.gaps - contact.normal @ values.T.ravel()), 0.0)
    for depth, vertex, normal in zip(
        overlap, contact.nodes, contact.normals, strict=True
    ):
        values[:, vertex] -= depth * normal
    du, dp = primal.displacement - u, primal.plastic_increment - p
    h = problem.effective_hardening
    distance = Integrate(elastic_product(problem, h, du, dp, du, dp), problem.mesh) / 2
    own = energy(problem, primal.displacement, primal.plastic_increment)
    return distance, energy(problem, u, p) - own


@dataclass(frozen=True)
class WitnessedResidual:
    """A residual norm and the size of what rounding may leave of it.

    Parameters
    ----------
    norm
        ||Psi_gamma(v)||_{H*}.
    rounding
        The norm of the difference that another direct solver for y makes.
    """

    norm: float
    rounding: float


def dual_residual(result, points=POINTS):
    """The residual of the dual variable v alone.

    Parameters
    ----------
    result
        A result without friction; only ``v`` and the spaces are taken from it.
    points
        Quadrature points for M^2 on each element.
    """
    blocks, w, problem = (
        result.functional.blocks,
        result.functional.weights,
        result.problem,
    )
    parts = [GridFunction(space) for space in blocks.H.components]
    for part, values in zip(parts, blocks.parts(result.v), strict=True):
        part.vec.data = values
    y, other = (
        _primal_of(problem, blocks.Y, parts, solver)
        for solver in ("umfpack", "sparsecholesky")
    )
    total, rounding = 0.0, 0.0
    for number, part in enumerate(parts):
        B = _product(blocks, number)
        inverse = B.Inverse(part.space.FreeDofs(), inverse="umfpack")
        linear, penalty = (_contact_terms, _plastic_terms)[number]
        r, twin = linear(problem, y, part), linear(problem, other, part)
        twin -= r
        rounding += _norm_squared(twin, inverse)
        r.data += 1 / w.tichonov * (B * part.vec)
        r += penalty(problem, w, part, points)
        total += _norm_squared(r, inverse)
    return WitnessedResidual(math.sqrt(total), math.sqrt(rounding))


def _contact(problem):
    """Gamma_c, empty without contact."""
    return problem.mesh.Boundaries("|".join(problem.contact_names))


def _product(blocks, number):
    """The block of B that z or q has."""
    tichonov, length = blocks.choice.tichonov, blocks.choice.units.length
    v, w = blocks.H.components[number].TnT()
    if number == 0:
        on_contact = ds(definedon=blocks.contact)
        return BilinearForm(tichonov.contact(v, w, length) * on_contact).Assemble().mat
    return BilinearForm(tichonov.plastic(v, w, length) * dx).Assemble().mat


def _norm_squared(r, inverse):
    riesz = r.CreateVector()
    riesz.data = inverse * r
    return max(0.0, InnerProduct(riesz, r))


def _primal_of(problem, Y, parts, solver):
    """(u, p) with D (u, p) = Lambda* v - l, by an uncondensed solve."""
    (u, p), (du, dp) = Y.TnT()
    h = problem.effective_hardening
    D = BilinearForm(elastic_product(problem, h, u, p, du, dp) * dx).Assemble().mat
    right = LinearForm(Y)
    for term in load_terms(problem, du, dp):
        right += term
    right += parts[1] * dp * dx
    right += parts[0] * (du * problem.normal) * ds(definedon=_contact(problem))
    right.Assemble()
    y = GridFunction(Y)
    V = Y.components[0]
    y.components[0].vec.data = prescribed_displacement(problem, V).vec
    rest = right.vec.CreateVector()
    rest.data = right.vec - D * y.vec
    y.vec.data += D.Inverse(Y.FreeDofs(), inverse=solver) * rest
    return y


def _overlap(problem, y, z):
    """(u.n - psi, w)."""
    w, on_contact = z.space.TestFunction(), ds(definedon=_contact(problem))
    overlap = y.components[0] * problem.normal - problem.psi
    return LinearForm(overlap * w * on_contact).Assemble().vec


def _pull(problem, w, z, points):
    """(M^1)'(z)."""
    rules = boundary_rules(problem.N, points)
    on_contact = ds(definedon=_contact(problem), intrules=rules)
    tension = w.contact * z
    pull = IfPos(tension, tension, 0.0) * z.space.TestFunction()
    return LinearForm(pull * on_contact).Assemble().vec


def _increment(problem, y, q):
    """(p, r)."""
    return LinearForm(y.components[1] * q.space.TestFunction() * dx).Assemble().vec


def _flow(problem, w, q, points):
    """(M^2)'(q)."""
    size = Norm(q) + 1e-300
    excess = w.plastic * (size - as_scalar(problem.beta))
    gradient = IfPos(excess, excess / size, 0.0) * (q * q.space.TestFunction())
    return (
        LinearForm(gradient * dx(intrules=fine_rules(problem.N, points))).Assemble().vec
    )


_contact_terms, _plastic_terms = (_overlap, _pull), (_increment, _flow)


def distance_bound(primal, dual):
    """1/2 |y - y_gamma|_D^2 and what it cannot exceed, for the same problem on one mesh.

    y solves the discrete (2.14) and y_gamma the problem that J*_gamma is the dual of, which
    differs by hardening 1/gamma_q more, an adhesion (psi - u.n)^2 / (2 gamma_z) and a
    supremum over fewer dual variables.  Hence what y is worth there is at most

        J(y) + int |p|^2 / (2 gamma_q) + int (psi - u.n)^2 / (2 gamma_z),

    the minimum there is -J*_gamma, and the problem is convex with modulus D.  It holds to
    round-off on simplices with flat contact, a gap that is linear on each, and no friction.
    """
    problem, w = primal.problem, dual.functional.weights
    mesh, h = problem.mesh, problem.effective_hardening
    u, p = primal.displacement, primal.plastic_increment
    worth = energy(problem, u, p) + Integrate(p * p / (2 * w.plastic), mesh)
    if problem.contact_names:
        gap = problem.psi - u * problem.normal
        on_contact = ds("|".join(problem.contact_names))
        worth += Integrate(gap * gap / (2 * w.contact) * on_contact, mesh)
    du, dp = u - dual.displacement, p - dual.plastic_increment
    distance = Integrate(elastic_product(problem, h, du, dp, du, dp), mesh) / 2
    return distance, worth + dual.dual_energy
