"""Von Mises material with hardening, kinematic, isotropic or both (section 2; docs/hardening.md).

Elasticity is C e = mu_1 tr(e) I + 2 mu_2 e.  The yield function is

    phi(sigma, alpha) = |dev sigma - dev alpha_2|_F - sigma_y (1 + H alpha_1),

with the back stress alpha_2 = k p (kinematic) and the scalar alpha_1 (isotropic).  Eliminating
alpha from one time step leaves two numbers:

    effective_hardening   h    = k + (H sigma_y)^2 k_1     in  H~ p : p = h |p|^2,
    yield_bound           beta = sigma_y (1 + H alpha_1,0) in  int beta |p|.

A ``HardeningLaw`` R adds (2/3)^(1/2) (R(PEEQ) - R(0)) to the bound: then int beta |p| becomes the
integral of a convex function of |p|.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ngsolve import CoefficientFunction

from ngepc.checks.arguments import Coefficient, require_number
from ngepc.checks.declared import (
    Check,
    Datum,
    Declared,
    NotNegativeDatum,
    PositiveDatum,
)
from ngepc.checks.kinds import require_instance
from ngepc.model.hardening import HardeningLaw

PEEQ = math.sqrt(2 / 3)
"""|p|_F times it is the equivalent plastic strain of engineers: the axial one of a bar."""

LAW = {"kind": HardeningLaw, "needed": "a HardeningLaw such as Voce(...)"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Material(Declared):
    """Material data; numbers or scalar CoefficientFunctions, all stresses in one unit.

    Parameters
    ----------
    lame_lambda, lame_mu
        Lamé parameters mu_1 and mu_2 (stress); elliptic means lame_mu > 0 and
        N lame_lambda + 2 lame_mu > 0 in N dimensions.
    yield_stress
        sigma_y > 0 (stress), compared with the Frobenius norm |dev sigma|_F.
    hardening
        Kinematic modulus k >= 0 (stress), H = k I in the paper.
    hardening_modulus, hardening_stiffness
        Isotropic data H >= 0 (1) and k_1 >= 0 (stress): h gains (H sigma_y)^2 k_1.
    law
        Isotropic hardening beyond that, by what its flow stress gains; None for none.

    Raises
    ------
    TypeError, ValueError
        For anything that is not a finite number or scalar coefficient in its legal range.
    """

    lame_lambda: Datum
    lame_mu: PositiveDatum
    yield_stress: PositiveDatum
    hardening: NotNegativeDatum = 0.0
    hardening_modulus: NotNegativeDatum = 0.0
    hardening_stiffness: NotNegativeDatum = 0.0
    law: Annotated[HardeningLaw, Check(require_instance, **LAW)] | None = None

    @classmethod
    def kinematic(
        cls,
        *,
        lame_lambda: Datum,
        lame_mu: Datum,
        yield_stress: Datum,
        hardening: Datum,
    ) -> Material:
        """Linear kinematic hardening: back stress ``hardening`` times p, see (2.16)."""
        elastic = {"lame_lambda": lame_lambda, "lame_mu": lame_mu}
        return cls(**elastic, yield_stress=yield_stress, hardening=hardening)

    @classmethod
    def isotropic(
        cls,
        *,
        lame_lambda: Datum,
        lame_mu: Datum,
        yield_stress: Datum,
        hardening_modulus: Datum,
        hardening_stiffness: Datum,
    ) -> Material:
        """Linear isotropic hardening with the paper's H and k_1, see (2.15)."""
        elastic = {
            "lame_lambda": lame_lambda,
            "lame_mu": lame_mu,
            "yield_stress": yield_stress,
        }
        H = hardening_modulus
        k_1 = hardening_stiffness
        return cls(**elastic, hardening_modulus=H, hardening_stiffness=k_1)

    @classmethod
    def with_law(
        cls,
        *,
        lame_lambda: Datum,
        lame_mu: Datum,
        law: HardeningLaw,
        hardening: Datum = 0.0,
    ) -> Material:
        """Isotropic hardening by the flow stress of a bar, and linear kinematic hardening."""
        yield_stress = PEEQ * require_instance("law", law, **LAW).stress(0.0)
        elastic = {"lame_lambda": lame_lambda, "lame_mu": lame_mu}
        return cls(**elastic, yield_stress=yield_stress, hardening=hardening, law=law)

    @property
    def isotropic_hardening(self) -> Coefficient:
        """(H sigma_y)^2 k_1, the isotropic part of the effective hardening (stress)."""
        H = self.hardening_modulus
        k1 = self.hardening_stiffness
        return (H * self.yield_stress) * (H * self.yield_stress) * k1

    @property
    def scalar_growth(self) -> Coefficient:
        """k_1 H sigma_y, by which alpha_1 grows with |p| (stress)."""
        return self.hardening_stiffness * self.hardening_modulus * self.yield_stress

    @property
    def effective_hardening(self) -> Coefficient:
        """The scalar h of H~ p : p = h |p|^2 in (2.14) (stress)."""
        return self.hardening + self.isotropic_hardening

    def yield_bound(
        self, hardening_variable: Coefficient = 0.0, accumulated: Coefficient = 0.0
    ) -> Coefficient:
        """Beta = sigma_y (1 + H alpha_1,0) and what the law gains up to a PEEQ (stress)."""
        bound = self.yield_stress * (1 + self.hardening_modulus * hardening_variable)
        if self.law is None:
            return bound
        return bound + PEEQ * (self.law.stress(accumulated) - self.law.stress(0.0))


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """(lambda, mu) from Young's modulus > 0 and Poisson's ratio in (-1, 1/2), in three dimensions.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    E = require_number("young", young, 0, strict=True)
    nu = require_number("poisson", poisson, -1, strict=True, below=0.5)
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def split_hardening(value: object) -> tuple:
    """(alpha_1, alpha_2) from ``initial_hardening``; None for what is not given."""
    if isinstance(value, tuple):
        return value
    tensor = isinstance(value, CoefficientFunction) and len(value.dims) == 2
    return (None, value) if tensor else (value, None)
