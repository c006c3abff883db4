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
    Mesh,
    Norm,
    VectorValued,
    ds,
    dx,
)
from ngsolve.comp import DifferentialSymbol

from ngepc.discretisation.quadrature import boundary_rules, fine_rules
from ngepc.dual.functional import Iterate
from ngepc.dual.result import DualResult
from ngepc.model.problem import as_scalar

POINTS = 400


@dataclass(frozen=True, kw_only=True)
class DualityReport:
    """What ``duality_report`` measures; energies are force times length.

    Parameters
    ----------
    primal_energy, dual_energy, gap
        J(y), J*_gamma(v) and their sum.
    contact_term, plastic_term
        (z, u.n - psi), and int beta |p| + (q, p); zero at a solution of (EPC) and (D).
    contact_penalty, plastic_penalty, tichonov
        M^1(z), M^2(q), T(v).
    tension, penetration, shear, normal_stress, normal_stress_deviation
        L2 norms on Gamma_c: of [z]^+ (2.11), of [u.n - psi]^+ (2.13), of the tangential part of
        sigma n (2.10), of (sigma n).n and of z - (sigma n).n.
    complementarity
        int |z (u.n - psi)| on Gamma_c, (2.12).
    overshoot, deviatoric_stress, stress_deviation, mean_stress_deviation, yield_deviation
        L2 norms in the body: of [|q| - beta]^+, of dev sigma, of q - (h p + dev (alpha_0 - sigma))
        (3.8) and its element means, of |q| - beta minus the yield function of (sigma, alpha) (3.9).
    """

    primal_energy: float
    dual_energy: float
    gap: float
    contact_term: float
    plastic_term: float
    contact_penalty: float
    plastic_penalty: float
    tichonov: float
    tension: float = 0.0
    overshoot: float
    penetration: float = 0.0
    complementarity: float = 0.0
    shear: float = 0.0
    normal_stress: float = 0.0
    normal_stress_deviation: float = 0.0
    deviatoric_stress: float
    stress_deviation: float
    mean_stress_deviation: float
    yield_deviation: float

    @property
    def parts(self) -> dict[str, float]:
        """The terms that add up to the gap."""
        terms = ("contact_term", "plastic_term", "contact_penalty", "plastic_penalty", "tichonov")
        return {name: getattr(self, name) for name in terms}


def duality_report(result: DualResult) -> DualityReport:
    """Measure the duality gap, its parts, and how well (2.10)-(2.13), (3.8), (3.9) hold.

    Parameters
    ----------
    result
        A result of the regularised dual method, or the path that ends with it.

    Raises
    ------
    TypeError
        If ``result`` is no such result.
    """
    result = getattr(result, "last", result)
    if not isinstance(result, DualResult):
        raise TypeError(f"result={result!r}: a result of the dual method is needed")
    return DualityReport(**_energies(result), **_contact(result), **_plasticity(result))


def _energies(result: DualResult) -> dict[str, float]:
    f, problem, v = result.functional, result.problem, result.v
    overlap = (f.blocks.Lambda * result.y - f.blocks.psi).Evaluate()
    pairs = zip(f.blocks.parts(overlap), f.blocks.parts(v), strict=True)
    contact, plastic = (InnerProduct(*pair) for pair in pairs)
    penalties, size = Iterate(f, v, result.y).penalties, Norm(result.plastic_increment)
    return {
        "primal_energy": result.primal_energy,
        "dual_energy": result.dual_energy,
        "gap": result.primal_energy + result.dual_energy,
        "contact_term": contact,
        "plastic_term": Integrate(as_scalar(problem.beta) * size, problem.mesh) + plastic,
        "contact_penalty": penalties[0],
        "plastic_penalty": penalties[1],
        "tichonov": f.tichonov(v, v) / 2,
    }


def _contact(result: DualResult) -> dict[str, float]:
    problem, z = result.problem, result.normal_stress
    if not problem.contact_names:
        return {}
    rules = boundary_rules(problem.N, POINTS)
    measure, n = ds("|".join(problem.contact_names), intrules=rules), problem.normal
    overlap = result.displacement * n - problem.psi
    traction = BoundaryFromVolumeCF(result.stress) * n
    normal, product = InnerProduct(traction, n), z * overlap
    fields = {
        "tension": IfPos(z, z, 0),
        "penetration": IfPos(overlap, overlap, 0),
        "shear": traction - normal * n,
        "normal_stress": normal,
        "normal_stress_deviation": z - normal,
    }
    sizes = {name: _size(field, measure, problem.mesh) for name, field in fields.items()}
    complementarity = Integrate(IfPos(product, product, -product) * measure, problem.mesh)
    return {**sizes, "complementarity": complementarity}


def _plasticity(result: DualResult) -> dict[str, float]:
    problem, mesh = result.problem, result.problem.mesh
    q, p = result.plastic_dual, result.plastic_increment
    dev_stress, hardening = result.fields.deviatoric_stress, problem.effective_hardening
    residual_stress = problem.kinematics.coordinates(problem.alpha_0[1] - dev_stress)
    deviation, excess = q - (hardening * p + residual_stress), result.yield_function
    means = GridFunction(VectorValued(L2(mesh, order=0), q.dim))
    means.Set(deviation)
    fields = {
        "overshoot": IfPos(excess, excess, 0),
        "deviatoric_stress": dev_stress,
        "stress_deviation": deviation,
        "mean_stress_deviation": means,
        "yield_deviation": excess - result.fields.yield_function,
    }
    measure = dx(intrules=fine_rules(problem.N, POINTS))
    return {name: _size(field, measure, mesh) for name, field in fields.items()}


def _size(field: CF, measure: DifferentialSymbol, mesh: Mesh) -> float:
    """The L2 norm."""
    return math.sqrt(Integrate(InnerProduct(field, field) * measure, mesh))
