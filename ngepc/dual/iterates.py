"""Newton iterates on the set D y = Lambda* v - l, and the energy along a Newton direction.

The first row of (7.1) is linear: once it holds it holds along the whole step, so that
J*_gamma(v + alpha dv) is a parabola plus the nonsmooth terms and no trial needs a solve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ngsolve import InnerProduct
from ngsolve.la import BaseVector

from ngepc.dual.blocks import REFINEMENTS
from ngepc.dual.functional import ActiveTerms, DualFunctional
from ngepc.dual.parts import CONTACT, PLASTIC
from ngepc.linalg.linesearch import Step
from ngepc.results.outcome import IterationRecord


@dataclass
class Iterate:
    """(y, v) with the active sets, the residual and the energy J*_gamma(v) there.

    Parameters
    ----------
    y, v
        Primal and dual variables.
    terms
        M^1 and M^2 at v: the active sets.
    residual
        Psi_gamma as a functional on H.
    smooth_energy
        The quadratic part of J*_gamma.
    number, step
        How many Newton steps led here, and the last of them; None at a start.
    """

    y: BaseVector
    v: BaseVector
    terms: ActiveTerms
    residual: BaseVector
    smooth_energy: float
    number: int = 0
    step: Step | None = None

    @classmethod
    def at(cls, functional: DualFunctional, v: BaseVector) -> Iterate:
        """The iterate with dual part ``v``; solves D y = Lambda* v - l."""
        y, terms = functional.blocks.Y_vector(), functional.terms(v)
        functional.blocks.primal_of(v, y)
        return cls(y, v, terms, _residual(functional, y, v, terms), functional.smooth_energy(y, v))

    @property
    def energy(self) -> float:
        """J*_gamma(v)."""
        return self.smooth_energy + self.terms.energy

    @property
    def magnitude(self) -> float:
        """Size of the terms that the energy is summed from."""
        return abs(self.smooth_energy) + abs(self.terms.energy)

    def refresh(self, functional: DualFunctional, refinements: int = REFINEMENTS) -> float:
        """Solve for y and the residual afresh; returns the norm of the new residual."""
        functional.blocks.primal_of(self.v, self.y, refinements)
        self.residual = _residual(functional, self.y, self.v, self.terms)
        return functional.residual_norms(self.residual).total

    def record(self, functional: DualFunctional) -> IterationRecord:
        """What monitors and histories get."""
        norms, active = functional.residual_norms(self.residual), self.terms.measures
        step = Step(length=1.0, energy=math.nan, halvings=0) if self.step is None else self.step
        return IterationRecord(
            iteration=self.number,
            residual_norm=norms.total,
            contact_residual_norm=norms.by_part.get(CONTACT, 0.0),
            plastic_residual_norm=norms.by_part[PLASTIC],
            energy=self.energy,
            step_length=step.length,
            halvings=step.halvings,
            back_substitutions=0 if self.step is None else 1,
            contact_active=active.get(CONTACT, 0.0),
            plastic_active=active[PLASTIC],
        )


def _residual(
    functional: DualFunctional, y: BaseVector, v: BaseVector, terms: ActiveTerms
) -> BaseVector:
    residual = functional.linear_residual(y, v)
    residual += terms.gradient
    return residual


class DualLine:
    """J*_gamma along v + alpha dv, with y + alpha dy.

    Parameters
    ----------
    functional
        The functional.
    here
        The iterate at alpha = 0.
    dy, dv
        The solution of (7.1).
    """

    def __init__(
        self, functional: DualFunctional, here: Iterate, dy: BaseVector, dv: BaseVector
    ) -> None:
        self._functional, self._here, self._dy, self._dv = functional, here, dy, dv
        image = (functional.blocks.Lambda * dy).Evaluate()
        self._slope = InnerProduct(functional.linear_residual(here.y, here.v), dv)
        self._curvature = InnerProduct(image, dv) + functional.tichonov(dv, dv)
        self._trial: tuple[float, BaseVector, ActiveTerms] = (0.0, here.v, here.terms)

    def _at(self, alpha: float) -> tuple[BaseVector, ActiveTerms]:
        """v + alpha dv with its active sets; the last trial is kept for the next iterate."""
        if self._trial[0] != alpha:
            v = self._dv.CreateVector()
            v.data = self._here.v + alpha * self._dv
            self._trial = alpha, v, self._functional.terms(v)
        return self._trial[1:]

    def energy(self, alpha: float) -> float:
        """J*_gamma(v + alpha dv)."""
        parabola = alpha * self._slope + alpha**2 / 2 * self._curvature
        return self._here.smooth_energy + parabola + self._at(alpha)[1].energy

    def derivative(self, alpha: float) -> float:
        """d/d alpha J*_gamma(v + alpha dv)."""
        smooth = self._slope + alpha * self._curvature
        return smooth + InnerProduct(self._at(alpha)[1].gradient, self._dv)

    def iterate(self, step: Step) -> Iterate:
        """The iterate at an accepted step length."""
        v, terms = self._at(step.length)
        y = self._dy.CreateVector()
        y.data = self._here.y + step.length * self._dy
        smooth, residual = (
            self._functional.smooth_energy(y, v),
            _residual(self._functional, y, v, terms),
        )
        return Iterate(y, v, terms, residual, smooth, self._here.number + 1, step)
