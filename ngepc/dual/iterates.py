"""Newton iterates on the set D y = Lambda* v - l, and the energy along a Newton direction.

The first row of (7.1) is linear: once it holds it holds along the whole step, so that
J*_gamma(v + alpha dv) is a parabola plus the nonsmooth terms and no trial needs a solve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from ngsolve import InnerProduct
from ngsolve.la import BaseVector

from ngepc.dual.blocks import CONTACT, PLASTIC
from ngepc.dual.functional import DualFunctional, ResidualNorms
from ngepc.dual.penalty import ActiveTerms
from ngepc.linalg.linesearch import Descent, Step
from ngepc.results.outcome import IterationRecord

START = Step(length=1.0, energy=math.nan, halvings=0)


@dataclass(frozen=True, eq=False)
class Iterate:
    """(y, v) with D y = Lambda* v - l, M^1 and M^2 at v, and which Newton step led here."""

    functional: DualFunctional
    y: BaseVector
    v: BaseVector
    terms: ActiveTerms
    number: int = 0
    step: Step = START

    @classmethod
    def at(cls, functional: DualFunctional, v: BaseVector) -> Iterate:
        """The iterate with dual part ``v``; solves D y = Lambda* v - l."""
        return cls(functional, functional.blocks.primal_of(v), v, functional.terms(v))

    def afresh(self, dv: BaseVector | None = None) -> Iterate:
        """The same iterate, or that at v + dv, with y solved for again."""
        v = self.v if dv is None else (self.v + dv).Evaluate()
        return replace(Iterate.at(self.functional, v), number=self.number, step=self.step)

    @cached_property
    def residual(self) -> BaseVector:
        """Psi_gamma = Lambda y - [psi, 0] + M(v) + B v / gamma_T as a functional on H."""
        smooth = self.functional.linear_residual(self.y, self.v)
        return (smooth + self.terms.gradient).Evaluate()

    @cached_property
    def norms(self) -> ResidualNorms:
        """||Psi_gamma||_{H*}."""
        return self.functional.residual_norms(self.residual)

    @cached_property
    def smooth_energy(self) -> float:
        """The quadratic part of J*_gamma."""
        return self.functional.smooth_energy(self.y, self.v)

    @property
    def energy(self) -> float:
        """J*_gamma(v)."""
        return self.smooth_energy + self.terms.energy

    @property
    def magnitude(self) -> float:
        """Size of the terms that the energy is summed from."""
        return abs(self.smooth_energy) + abs(self.terms.energy)

    def record(self) -> IterationRecord:
        """What monitors and histories get."""
        active, norms = self.terms.measures, self.norms
        return IterationRecord(
            iteration=self.number,
            residual_norm=norms.total,
            contact_residual_norm=norms.get(CONTACT, 0.0),
            plastic_residual_norm=norms[PLASTIC],
            energy=self.energy,
            step_length=self.step.length,
            halvings=self.step.halvings,
            back_substitutions=int(self.number > 0),
            contact_active=active.get(CONTACT, 0.0),
            plastic_active=active[PLASTIC],
        )


class DualLine:
    """J*_gamma along (y + alpha dy, v + alpha dv); ``slope`` is its derivative at alpha = 0."""

    def __init__(self, here: Iterate, dy: BaseVector, dv: BaseVector) -> None:
        self.here, self.dy, self.dv, functional = here, dy, dv, here.functional
        self.slope = InnerProduct(here.residual, dv)
        image = (functional.blocks.Lambda * dy).Evaluate()
        self._smooth_slope = InnerProduct(functional.linear_residual(here.y, here.v), dv)
        self._curvature = InnerProduct(image, dv) + functional.tichonov(dv, dv)
        self._trial: tuple[float, BaseVector, ActiveTerms] = (0.0, here.v, here.terms)

    @property
    def descent(self) -> Descent:
        """The function of alpha as line searches take it."""
        start = {"energy_0": self.here.energy, "slope_0": self.slope}
        phi = {"energy": self.energy, "derivative": self.derivative}
        return Descent(**phi, **start, magnitude=self.here.magnitude)

    def _at(self, alpha: float) -> tuple[BaseVector, ActiveTerms]:
        """v + alpha dv with its active sets; the last trial is kept for the next iterate."""
        if self._trial[0] != alpha:
            v = (self.here.v + alpha * self.dv).Evaluate()
            self._trial = alpha, v, self.here.functional.terms(v)
        return self._trial[1:]

    def energy(self, alpha: float) -> float:
        """J*_gamma(v + alpha dv)."""
        parabola = alpha * self._smooth_slope + alpha**2 / 2 * self._curvature
        return self.here.smooth_energy + parabola + self._at(alpha)[1].energy

    def derivative(self, alpha: float) -> float:
        """d/d alpha J*_gamma(v + alpha dv)."""
        smooth = self._smooth_slope + alpha * self._curvature
        return smooth + InnerProduct(self._at(alpha)[1].gradient, self.dv)

    def iterate(self, step: Step) -> Iterate:
        """The iterate at an accepted step length."""
        v, terms = self._at(step.length)
        y = (self.here.y + step.length * self.dy).Evaluate()
        return Iterate(self.here.functional, y, v, terms, self.here.number + 1, step)
