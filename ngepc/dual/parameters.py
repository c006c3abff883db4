"""The numbers of (D_gamma) that move along a path: gamma, the shifts, the yield bound.

    M^1(z) = 1/(2 gamma_z) |[mu^ + gamma_z z]^+|^2,
    M^2(q) = int 1/(2 gamma_q) ([nu^ + gamma_q (|q| - beta_gamma)]^+)^2,
    T(z, q) = 1/(2 gamma_T) b([z, q], [z, q]).

The paper takes one gamma for all three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import Integrate, Mesh

from ngepc.checks.arguments import (
    Coefficient,
    is_number,
    require_coefficient,
    require_finite,
    require_number,
)
from ngepc.dual.spaces import Units
from ngepc.model.problem import Problem, as_scalar


@dataclass(frozen=True)
class DualParameters:
    """gamma with what may accompany it; nothing here changes a space.

    Parameters
    ----------
    gamma
        gamma > 0, a number in reference units.
    contact_shift, plastic_shift
        mu^ >= 0 (length) and nu^ >= 0 (1), section 4; numbers or coefficients.
    beta_gamma
        Replacement of the yield bound with sigma_y <= beta_gamma <= beta and
        ||beta_gamma - beta|| <= 1/gamma; None for beta itself.
    gamma_tichonov
        gamma_T > 0, a number in reference units; None for gamma, as in the paper.

    Raises
    ------
    TypeError, ValueError
        If gamma, a shift or beta_gamma is out of range or of the wrong kind.
    """

    gamma: float
    contact_shift: Coefficient = 0.0
    plastic_shift: Coefficient = 0.0
    beta_gamma: Coefficient | None = None
    gamma_tichonov: float | None = None

    def __post_init__(self) -> None:
        require_number("gamma", self.gamma, 0, strict=True)
        for name in ("contact_shift", "plastic_shift"):
            require_coefficient(name, getattr(self, name))
            if is_number(getattr(self, name)):
                require_number(name, getattr(self, name), 0)
        if self.beta_gamma is not None:
            require_coefficient("beta_gamma", self.beta_gamma)
            if is_number(self.beta_gamma):
                require_number("beta_gamma", self.beta_gamma, 0, strict=True)
        if self.gamma_tichonov is not None:
            require_number("gamma_tichonov", self.gamma_tichonov, 0, strict=True)

    def weights(self, problem: Problem, units: Units) -> Weights:
        """The factors of the terms in the units of a problem.

        Raises
        ------
        ValueError
            If a shift or beta_gamma violates the conditions of section 4 on its mesh.
        """
        gamma_T = self.gamma if self.gamma_tichonov is None else self.gamma_tichonov
        if self.beta_gamma is not None:
            check_beta_gamma(problem, self.beta_gamma, units.stress / self.gamma)
        weights = Weights(
            contact=self.gamma * units.length / units.stress,
            plastic=self.gamma / units.stress,
            tichonov=gamma_T * units.stress / units.length**2,
            contact_shift=self.contact_shift,
            plastic_shift=self.plastic_shift,
            yield_bound=problem.beta if self.beta_gamma is None else self.beta_gamma,
        )
        check_shifts(problem, weights)
        return weights


@dataclass(frozen=True, kw_only=True)
class Weights:
    """The factors of the terms of J*_gamma in the units of a problem.

    Parameters
    ----------
    contact, plastic, tichonov
        gamma_z (length / stress), gamma_q (1 / stress) and gamma_T (stress / length^2).
    contact_shift, plastic_shift
        mu^ (length) and nu^ (1).
    yield_bound
        beta_gamma (stress).
    """

    contact: float
    plastic: float
    tichonov: float
    contact_shift: Coefficient
    plastic_shift: Coefficient
    yield_bound: Coefficient

    @property
    def threshold(self) -> Coefficient:
        """beta_gamma - nu^ / gamma_q (stress): M^2 is active where |q| exceeds it."""
        return self.yield_bound - self.plastic_shift / self.plastic


def check_beta_gamma(problem: Problem, beta_gamma: Coefficient, most: float) -> None:
    """sigma_y <= beta_gamma <= beta, and at most ``most`` away from beta in L2.

    Raises
    ------
    ValueError
        If that is violated somewhere.
    """
    bound, beta = as_scalar(beta_gamma), as_scalar(problem.beta)
    above = require_finite("beta_gamma", bound - problem.material.yield_stress, problem.mesh)
    below = require_finite("beta_gamma", beta - bound, problem.mesh)
    if min(above.min(), below.min()) < -1e-12:
        raise ValueError("beta_gamma leaves [yield_stress, beta]: section 4 asks for it")
    distance = np.sqrt(Integrate((beta - bound) ** 2, problem.mesh))
    if distance > most:
        raise ValueError(
            f"beta_gamma is {distance:g} away from beta in L2: section 4 asks for at most "
            f"1/gamma = {most:g}"
        )


def check_shifts(problem: Problem, weights: Weights) -> None:
    """Shifts that are >= 0, and beta_gamma - nu^/gamma > 0 as Lemma 6.3 asks for.

    Raises
    ------
    ValueError
        If that is violated somewhere.
    """
    mesh = problem.mesh
    if problem.contact_names:
        _require_nonnegative("contact_shift", weights.contact_shift, mesh, problem.contact_names)
    _require_nonnegative("plastic_shift", weights.plastic_shift, mesh)
    name = "beta_gamma - plastic_shift / gamma"
    least = require_finite(name, weights.threshold, mesh).min()
    if least <= 0:
        raise ValueError(f"{name} falls to {least:g}: > 0 is needed, a smaller shift")


def _require_nonnegative(
    name: str, value: Coefficient, mesh: Mesh, boundaries: Sequence[str] | None = None
) -> None:
    values = require_finite(name, value, mesh, boundaries)
    if values.min() < -1e-12 * np.abs(values).max():
        raise ValueError(f"{name} falls to {values.min():g}: values >= 0 are needed")
