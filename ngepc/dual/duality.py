"""Duality at a regularised solution: J(y_gamma) + J*_gamma(v_gamma), (3.8), (3.9), (2.10)-(2.13).

Where D y = Lambda* v - l, F(y) + F*(Lambda* v) = <Lambda y, v>, so that

    J(y) + J*_gamma(v) = (z, u.n - psi) + [int beta |p| + (q, p)] + M^1(z) + M^2(q) + T(v).

As gamma grows the penalties, T and both brackets vanish: (z, u.n - psi) = 0 is (2.12), and the
second bracket is zero where p points against q with |q| = beta, or p = 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ngsolve import (
    CF,
    L2,
    BoundaryFromVolumeCF,
    GridFunction,
    IfPos,
    InnerProduct,
    Integrate,
    Norm,
    VectorValued,
    ds,
    dx,
)

from ngepc.checks.sentences import in_words
from ngepc.discretisation.quadrature import boundary_rules, fine_rules
from ngepc.dual.functional import DualIterate
from ngepc.dual.result import DualResult
from ngepc.linalg.blas import one_blas_thread
from ngepc.model.data import as_scalar

POINTS = 400


@dataclass(frozen=True, kw_only=True)
class DualityReport:
    """The numbers of ``duality_report``: energies (force times length), then L2 norms."""

    primal_energy: float  # J(y)
    dual_energy: float  # J*_gamma(v)
    gap: float  # their sum, and the five terms that make it up
    contact_term: float  # (z, u.n - psi), zero at a solution of (EPC) and (D)
    plastic_term: float  # int beta |p| + (q, p), zero there, too
    contact_penalty: float  # M^1(z)
    plastic_penalty: float  # M^2(q)
    tichonov: float  # T(v)
    complementarity: float  # int |z (u.n - psi)| on Gamma_c, (2.12)
    tension: float  # on Gamma_c: of [z]^+ (2.11),
    penetration: float  # of [u.n - psi]^+ (2.13),
    shear: float  # of the tangential part of sigma n (2.10),
    normal_stress: float  # of (sigma n).n,
    normal_stress_deviation: float  # and of z - (sigma n).n
    overshoot: float  # in the body: of [|q| - beta]^+,
    deviatoric_stress: float  # of dev sigma,
    stress_deviation: float  # of q - (h p + dev (alpha_0 - sigma)) (3.8),
    mean_stress_deviation: float  # of its element means,
    yield_deviation: float
    """... and of |q| - beta minus the yield function of (sigma, alpha) (3.9)."""

    @property
    def parts(self) -> dict[str, float]:
        """The terms that add up to the gap."""
        terms = (
            "contact_term",
            "plastic_term",
            "contact_penalty",
            "plastic_penalty",
            "tichonov",
        )
        return {name: getattr(self, name) for name in terms}


@one_blas_thread
def duality_report(result: DualResult) -> DualityReport:
    """Measure the duality gap, its parts, and how well (2.10)-(2.13), (3.8), (3.9) hold.

    Parameters
    ----------
    result
        A result of the regularised dual method, or the path that ends with it.

    Raises
    ------
    TypeError
        If ``result`` is not such a result.
    """
    result = getattr(result, "last", result)
    if not isinstance(result, DualResult):
        raise TypeError(
            f"result={in_words(result)}: a result of the dual method is needed"
        )
    f = result.functional
    problem = result.problem
    v = result.v
    overlap = (f.blocks.Lambda * result.y - f.blocks.psi).Evaluate()
    pairs = zip(f.blocks.parts(overlap), f.blocks.parts(v), strict=True)
    contact, plastic = (InnerProduct(*pair) for pair in pairs)
    penalties = DualIterate(f, v, result.y).penalties
    size = Norm(result.plastic_increment)
    return DualityReport(
        primal_energy=result.primal_energy,
        dual_energy=result.dual_energy,
        gap=result.primal_energy + result.dual_energy,
        contact_term=contact,
        plastic_term=Integrate(as_scalar(problem.beta) * size, problem.mesh) + plastic,
        contact_penalty=penalties[0],
        plastic_penalty=penalties[1],
        tichonov=f.tichonov(v, v) / 2,
        **_contact(result),
        **_plasticity(result),
    )


def _contact(result: DualResult) -> dict[str, float]:
    problem = result.problem
    z = result.normal_stress
    n = problem.normal
    rules = boundary_rules(problem.N, POINTS)
    measure = ds(definedon=result.functional.blocks.contact, intrules=rules)
    overlap = result.displacement * n - problem.psi
    across = [0.0] * (problem.kinematics.size - problem.N)
    normal_of_tensors = CF((*n, *across))
    traction = BoundaryFromVolumeCF(result.stress) * normal_of_tensors
    normal = InnerProduct(traction, normal_of_tensors)
    product = z * overlap
    fields = {
        "tension": IfPos(z, z, 0),
        "penetration": IfPos(overlap, overlap, 0),
        "shear": traction - normal * normal_of_tensors,
        "normal_stress": normal,
        "normal_stress_deviation": z - normal,
    }
    complementarity = Integrate(
        IfPos(product, product, -product) * measure, problem.mesh
    )
    return {"complementarity": complementarity, **_sizes(fields, measure, result)}


def _plasticity(result: DualResult) -> dict[str, float]:
    problem = result.problem
    q = result.plastic_dual
    excess = result.yield_function
    dev_stress = result.fields.deviatoric_stress
    residual_stress = problem.kinematics.coordinates(problem.alpha_0[1] - dev_stress)
    deviation = q - (
        problem.effective_hardening * result.plastic_increment + residual_stress
    )
    means = GridFunction(VectorValued(L2(problem.mesh, order=0), q.dim))
    means.Set(deviation)
    fields = {
        "overshoot": IfPos(excess, excess, 0),
        "deviatoric_stress": dev_stress,
        "stress_deviation": deviation,
        "mean_stress_deviation": means,
        "yield_deviation": excess - result.fields.yield_function,
    }
    return _sizes(fields, dx(intrules=fine_rules(problem.N, POINTS)), result)


def _sizes(
    fields: dict[str, CF], measure: object, result: DualResult
) -> dict[str, float]:
    """The L2 norms."""
    mesh = result.problem.mesh
    return {
        name: math.sqrt(Integrate(InnerProduct(field, field) * measure, mesh))
        for name, field in fields.items()
    }
