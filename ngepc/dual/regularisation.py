"""How the dual is regularised: the parameters of the terms M^1, M^2 and T in (D_gamma).

    M^1(z) = 1/(2 gamma_z) |[mu^ + gamma_z z]^+|^2,
    M^2(q) = int 1/(2 gamma_q) ([nu^ + gamma_q (|q| - beta_gamma)]^+)^2,
    T(z, q) = 1/(2 gamma_T) b([z, q], [z, q]).

The paper takes one gamma for all three (``Coupled``).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from ngsolve import Integrate

from ngepc.checks.arguments import (
    Coefficient,
    is_number,
    require_coefficient,
    require_finite,
    require_number,
)
from ngepc.checks.kinds import require_attributes, require_instance
from ngepc.dual.plastic_strain import (
    ElementwisePlasticStrain,
    PlasticStrain,
    require_plastic_strain,
)
from ngepc.dual.tichonov import SurfaceGradient, Tichonov, require_tichonov
from ngepc.linalg.linesearch import Armijo, LineSearch
from ngepc.model.problem import Problem, as_scalar

if TYPE_CHECKING:
    from ngsolve.la import BaseVector

    from ngepc.dual.functional import DualFunctional
    from ngepc.dual.iterates import Iterate, Line
    from ngepc.linalg.direct import LinearSolver


@dataclass(frozen=True, kw_only=True)
class Units:
    """Reference units in which gamma and the tolerance are plain numbers, docs/units.md.

    Parameters
    ----------
    stress, length
        The stress and the length that count as one, in the units of the problem.  A steel part
        in Pa and m whose scaled twin has lame_mu = 1e3 and size 1 has stress = mu / 1e3 and
        length = its size.
    """

    stress: float = 1.0
    length: float = 1.0

    def __post_init__(self) -> None:
        require_number("units.stress", self.stress, 0, strict=True)
        require_number("units.length", self.length, 0, strict=True)


class Predictor(Protocol):
    """A guess that competes with the iterate which the line search has chosen."""

    def improved(
        self,
        functional: DualFunctional,
        line: Line,
        following: Iterate,
        inverse: str | LinearSolver,
    ) -> Iterate:
        """``following``, or an iterate of lower energy."""
        ...

    def start(
        self, functional: DualFunctional, v: BaseVector, u: np.ndarray, inverse: str | LinearSolver
    ) -> BaseVector:
        """v of an earlier result, or a start of lower energy for its nodal displacements u."""
        ...


class Regularisation(Protocol):
    """What the dual functional asks of a regularisation."""

    tichonov: Tichonov
    plastic_strain: PlasticStrain
    units: Units
    hardening_share: float
    contact_shift: Coefficient
    plastic_shift: Coefficient
    exact_contact: bool
    nodal_contact: bool
    linesearch: LineSearch
    predictor: Predictor | None

    def resolved(self, problem: Problem) -> Regularisation:
        """Itself, or a copy in which the problem has set what was left open."""
        ...

    @property
    def gamma_tichonov(self) -> float:
        """gamma_T (stress / length^2)."""
        ...

    @property
    def gamma_contact(self) -> float:
        """gamma_z (length / stress)."""
        ...

    def gamma_plastic(self, problem: Problem) -> Coefficient:
        """gamma_q (1 / stress)."""
        ...

    def yield_bound(self, problem: Problem) -> Coefficient:
        """beta_gamma (stress)."""
        ...


@dataclass(frozen=True)
class Coupled:
    """The paper's regularisation: one gamma for contact, yield bound and Tichonov term.

    Parameters
    ----------
    gamma
        gamma > 0, a number in ``units``.
    tichonov
        The space H and its product, by default (R2).
    contact_shift, plastic_shift
        mu^ >= 0 (length) and nu^ >= 0 (1), section 4; numbers or coefficients.
    beta_gamma
        Replacement of the yield bound with sigma_y <= beta_gamma <= beta and
        ||beta_gamma - beta|| <= 1/gamma; None for beta itself.
    plastic_strain
        ``ElementwisePlasticStrain()`` as in the paper, or ``PointwisePlasticStrain()``.
    units
        Reference units of gamma.

    Raises
    ------
    TypeError, ValueError
        If gamma, a shift or beta_gamma is out of range, or another argument of the wrong kind.
    """

    gamma: float
    tichonov: Tichonov = field(default_factory=SurfaceGradient)
    contact_shift: Coefficient = 0.0
    plastic_shift: Coefficient = 0.0
    beta_gamma: Coefficient | None = None
    plastic_strain: PlasticStrain = field(default_factory=ElementwisePlasticStrain)
    units: Units = field(default_factory=Units)

    hardening_share = 1.0
    exact_contact = False
    nodal_contact = False
    linesearch = Armijo()
    predictor = None

    def __post_init__(self) -> None:
        require_number("gamma", self.gamma, 0, strict=True)
        for name in ("contact_shift", "plastic_shift"):
            require_coefficient(name, getattr(self, name))
            if is_number(getattr(self, name)):
                require_number(name, getattr(self, name), 0)
        require_tichonov(self.tichonov)
        require_plastic_strain(self.plastic_strain)
        if self.beta_gamma is not None:
            require_coefficient("beta_gamma", self.beta_gamma)
            if is_number(self.beta_gamma):
                require_number("beta_gamma", self.beta_gamma, 0, strict=True)
        require_instance("units", self.units, Units, "Units(...)")

    def resolved(self, problem: Problem) -> Coupled:
        """Itself."""
        return self

    @property
    def gamma_tichonov(self) -> float:
        """gamma_T = gamma (stress / length^2)."""
        return self.gamma * self.units.stress / self.units.length**2

    @property
    def gamma_contact(self) -> float:
        """gamma_z = gamma (length / stress)."""
        return self.gamma * self.units.length / self.units.stress

    def gamma_plastic(self, problem: Problem) -> Coefficient:
        """gamma_q = gamma (1 / stress)."""
        return self.gamma / self.units.stress

    def yield_bound(self, problem: Problem) -> Coefficient:
        """beta_gamma, checked against its conditions in section 4 (stress)."""
        if self.beta_gamma is None:
            return problem.beta
        bound = as_scalar(self.beta_gamma)
        above = require_finite("beta_gamma", bound - problem.material.yield_stress, problem.mesh)
        below = require_finite("beta_gamma", as_scalar(problem.beta) - bound, problem.mesh)
        if min(above.min(), below.min()) < -1e-12:
            raise ValueError("beta_gamma leaves [yield_stress, beta]: section 4 asks for it")
        distance = np.sqrt(Integrate((as_scalar(problem.beta) - bound) ** 2, problem.mesh))
        if distance > self.units.stress / self.gamma:
            raise ValueError(
                f"beta_gamma is {distance:g} away from beta in L2: section 4 asks for at most "
                f"1/gamma = {self.units.stress / self.gamma:g}"
            )
        return self.beta_gamma


def plastic_threshold(problem: Problem, regularisation: Regularisation) -> Coefficient:
    """beta_gamma - nu^ / gamma_q (stress): the plastic term is active where |q| exceeds it."""
    nu_hat, gamma = regularisation.plastic_shift, regularisation.gamma_plastic(problem)
    return regularisation.yield_bound(problem) - nu_hat / gamma


def require_regularisation(value: object) -> None:
    """Accept a regularisation.

    Raises
    ------
    TypeError
        If it is none.
    """
    needed = "Coupled(...) or Balanced(...)"
    require_attributes("regularisation", value, ("resolved", "tichonov"), needed)


def check_shifts(problem: Problem, regularisation: Regularisation) -> None:
    """Shifts that are >= 0, and beta_gamma - nu^/gamma > 0 as Lemma 6.3 asks for.

    Raises
    ------
    ValueError
        If that is violated somewhere.
    """
    mu_hat, nu_hat = regularisation.contact_shift, regularisation.plastic_shift
    if problem.contact_names:
        values = require_finite("contact_shift", mu_hat, problem.mesh, problem.contact_names)
        _require_nonnegative("contact_shift", values)
    _require_nonnegative("plastic_shift", require_finite("plastic_shift", nu_hat, problem.mesh))
    name = "beta_gamma - plastic_shift / gamma"
    least = require_finite(name, plastic_threshold(problem, regularisation), problem.mesh).min()
    if least <= 0:
        raise ValueError(f"{name} falls to {least:g}: > 0 is needed, a smaller shift")


def _require_nonnegative(name: str, values: np.ndarray) -> None:
    if values.min() < -1e-12 * np.abs(values).max():
        raise ValueError(f"{name} falls to {values.min():g}: values >= 0 are needed")
