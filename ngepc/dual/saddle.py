"""The regularised dual problem (D_gamma) on one page: spaces, coupling, nonsmooth terms.

With y = (u, p) and v = (z, q) the problem is a saddle point of

    S(y, v) = -1/2 <D y, y> - l(y) + <Lambda y - [psi, 0], v> + M^1(z) + M^2(q) + T(v),

    M^1(z) = gamma/2 |[z]^+|^2          on Gamma_c,  the penalty of z <= 0 in (OC2),
    M^2(q) = gamma/2 |[|q| - beta]^+|^2 in Omega,    the penalty of |q| <= beta in (OC2),
    T(v)   = b(v, v) / (2 gamma),                    the Tichonov term, ``ngepc.dual.spaces``.

S is concave in y and convex in v.  Its maximum over y is J*_gamma(v) = F*(Lambda* v) - <z, psi> +
M^1(z) + M^2(q) + T(v), the functional of (D_gamma), and is attained where D y = Lambda* v - l.
The paper's shifts mu^, nu^ are zero, and so beta_gamma = beta.

This module has integrands only.  ``blocks`` assembles those of the linear terms, ``functional``
those of the nonsmooth ones, ``algorithm`` has the Newton system (7.1) of the whole.
"""

from __future__ import annotations

from ngsolve import (
    CF,
    FESpace,
    Id,
    IfPos,
    InnerProduct,
    Norm,
    OuterProduct,
    Trace,
    ds,
    dx,
)
from ngsolve.comp import SumOfIntegrals

from ngepc.discretisation.loads import work_of
from ngepc.discretisation.spaces import (
    contact_space,
    displacement_space,
    plastic_dual_space,
    plastic_space,
)
from ngepc.model.data import as_scalar
from ngepc.model.problem import Problem

TINY = 1e-290  # is added to |q|: q / |q| is zero at q = 0


class SaddleSpaces:
    """The compound spaces of Section 7: Y of y = (u, p), H of v = (z, q), X of (y, v).

    Parameters
    ----------
    problem
        The problem.
    ends_fixed
        Whether z is zero at the ends of Gamma_c and q on the boundary of the body, as in (R2).
    """

    def __init__(self, problem: Problem, ends_fixed: bool) -> None:
        V = displacement_space(problem)
        Q = plastic_space(problem)
        Z = contact_space(problem, ends_fixed=ends_fixed)
        R = plastic_dual_space(problem, boundary_fixed=ends_fixed)
        self.Y = FESpace([V, Q])
        self.H = FESpace([Z, R])
        self.X = FESpace([V, Q, Z, R])


def elastic_terms(problem: Problem, u: CF, p: CF, v: CF, r: CF) -> list[CF]:
    """The integrand of <D (u, p), (v, r)>, C (eps(u) - p) : (eps(v) - r) + h p . r, in parts.

    Each part has one trial and one test function: that is several times cheaper to assemble.
    """
    material = problem.material
    kinematics = problem.kinematics
    e = kinematics.strain(u)
    d = kinematics.strain(v)
    lam = material.lame_lambda
    mu = as_scalar(material.lame_mu)
    h = problem.effective_hardening
    return [
        lam * Trace(e) * Trace(d) + 2 * mu * InnerProduct(e, d),
        -2 * mu * (kinematics.coordinates(e) * r),
        -2 * mu * (kinematics.coordinates(d) * p),
        (2 * mu + h) * (p * r),
    ]


def load_terms(problem: Problem, v: CF, r: CF) -> list[SumOfIntegrals]:
    """The integrals of -l(v, r) in (2.15) and (2.16): loads, back stress, initial strain."""
    kinematics = problem.kinematics
    terms = work_of(problem, v)
    if problem.initial_hardening is not None:
        _, back_stress = problem.alpha_0
        terms.append(-kinematics.coordinates(back_stress) * r * dx)
    if problem.initial_plastic_strain is not None:
        two_mu = 2 * as_scalar(problem.material.lame_mu)
        elastic_strain = kinematics.strain(v) - kinematics.tensor(r)
        terms.append(two_mu * InnerProduct(elastic_strain, problem.p_0) * dx)
    return terms


def coupling(problem: Problem, y: tuple[CF, CF], v: tuple[CF, CF]) -> SumOfIntegrals:
    """<Lambda (u, p), (z, q)> = (tau_n u, z) on Gamma_c + (p, q) in Omega, Section 3."""
    u, p = y
    z, q = v
    on_contact = ds(definedon=problem.mesh.Boundaries("|".join(problem.contact_names)))
    normal_trace = u * problem.normal
    return normal_trace * z * on_contact + p * q * dx


class ContactPenalty:
    """M^1 and its derivatives: mu = [gamma z]^+ of (OC2_gamma), and Lemma 6.2.

    ``density`` is that of M^1, ``gradient`` mu, ``curvature`` its Newton derivative gamma
    on the set Z_gamma = {z > 0}, zero elsewhere; ``pressed`` is 1 where z < 0.
    """

    def __init__(self, z: CF, gamma: float) -> None:
        mu = gamma * z
        self.density = IfPos(mu, mu * mu, 0) / (2 * gamma)
        self.gradient = IfPos(mu, mu, 0)
        self.curvature = IfPos(mu, gamma, 0.0)
        self.pressed = IfPos(-mu, 1.0, 0.0)


class RadialLaw:
    """([s]^+)^2 / 2, s = |q| - beta, beta > 0, and its derivatives: M^2, Lemma 6.3, (6.1).

    ``density`` is that of M^2 without gamma, ``gradient`` rho q = [s]^+ q / |q|,
    ``curvature`` the Newton derivative rho I + (1 - rho) q q' / |q|^2 on the set
    Q_gamma = {|q| > beta}, zero elsewhere; ``inside`` is 1 on it.  NaN where the data are.
    """

    def __init__(self, q: CF, beta: CF | float) -> None:
        size = Norm(q) + TINY
        excess = Norm(q) - beta
        self.inside = IfPos(excess, 1.0, 0.0)
        rho = self.inside * excess / size
        across = self.inside * beta / size  # 1 - rho, without cancellation
        direction = q / size
        self.density = self.inside * excess * excess / 2
        self.gradient = rho * q
        self.curvature = rho * Id(q.dim) + across * OuterProduct(direction, direction)
