"""Newton iterates on the set D y = Lambda* v - l, and the energy along a Newton direction.

The first row of (7.1) is linear: once it holds it holds along the whole step, so that
J*_gamma(v + alpha dv) is a parabola plus the nonsmooth terms and no trial needs a solve.
"""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve import InnerProduct
from ngsolve.la import BaseVector

from ngepc.dual.blocks import REFINEMENTS
from ngepc.dual.functional import DualFunctional
from ngepc.linalg.linesearch import Step
from ngepc.results.outcome import IterationRecord


@dataclass
class Iterate:
    """(y, v) with the residual and the energy J*_gamma(v) there.

    Parameters
    ----------
    y, v
        Primal and dual variables.
    residual
        Psi_gamma as a functional on H.
    smooth_energy, penalty
        The quadratic part of J*_gamma, and M^1 + M^2.
    step
        The step that led here.
    """

    y: BaseVector
    v: BaseVector
    residual: BaseVector
    smooth_energy: float
    penalty: float
    step: Step

    @classmethod
    def at(cls, functional: DualFunctional, v: BaseVector) -> Iterate:
        """The iterate with dual part ``v``; solves D y = Lambda* v - l."""
        y = functional.blocks.load.CreateVector()
        functional.blocks.primal_of(v, y)
        smooth, penalty = functional.smooth_energy(y, v), functional.penalty(v)
        step = Step(length=1.0, energy=smooth + penalty, halvings=0)
        return cls(y, v, functional.residual(y, v), smooth, penalty, step)

    @property
    def is_start(self) -> bool:
        """Whether no Newton step has led here."""
        return self.step.back_substitutions == 0

    @property
    def energy(self) -> float:
        """J*_gamma(v)."""
        return self.smooth_energy + self.penalty

    @property
    def magnitude(self) -> float:
        """Size of the terms that the energy is summed from."""
        return abs(self.smooth_energy) + abs(self.penalty)

    def refresh(self, functional: DualFunctional, refinements: int = REFINEMENTS) -> float:
        """Solve for y and the residual afresh; returns the norm of the new residual."""
        functional.blocks.primal_of(self.v, self.y, refinements)
        self.residual = functional.residual(self.y, self.v)
        return functional.stationarity_norms(self.v, self.residual).total

    def record(self, functional: DualFunctional, iteration: int) -> IterationRecord:
        """What monitors and histories get."""
        norms = functional.stationarity_norms(self.v, self.residual)
        active = functional.active(self.v)
        return IterationRecord(
            iteration=iteration,
            residual_norm=norms.total,
            contact_residual_norm=norms.by_part.get("contact", 0.0),
            plastic_residual_norm=norms.by_part["plastic"],
            friction_residual_norm=norms.by_part.get("friction", 0.0),
            energy=self.energy,
            step_length=self.step.length,
            halvings=self.step.halvings,
            back_substitutions=self.step.back_substitutions,
            linear_iterations=self.step.linear_iterations,
            contact_active=active.get("contact", 0.0),
            plastic_active=active["plastic"],
            friction_active=active.get("friction", 0.0),
        )


class Line:
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
        self.functional, self.here, self.dy, self.dv = functional, here, dy, dv
        image = functional.blocks.conjugate_gradient(dy, dv)
        self.slope = InnerProduct(functional.linear_residual(here.y, here.v), dv)
        self.curvature = InnerProduct(image, dv) + functional.tichonov(dv, dv)
        self._penalties: dict[float, float] = {}
        self._gradient: tuple[float, BaseVector] | None = None

    def dual(self, alpha: float) -> BaseVector:
        """v + alpha dv."""
        v = self.dv.CreateVector()
        v.data = self.here.v + alpha * self.dv
        return v

    def energy(self, alpha: float) -> float:
        """J*_gamma(v + alpha dv)."""
        parabola = self.here.smooth_energy + alpha * self.slope + alpha**2 / 2 * self.curvature
        return parabola + self.penalty(alpha)

    def penalty(self, alpha: float) -> float:
        """M(v + alpha dv), integrated once for each alpha."""
        if alpha not in self._penalties:
            self._penalties[alpha] = self.functional.penalty(self.dual(alpha))
        return self._penalties[alpha]

    def penalty_gradient(self, alpha: float) -> BaseVector:
        """M'(v + alpha dv) as a functional on H; the last one is kept for the next iterate."""
        if self._gradient is None or self._gradient[0] != alpha:
            self._gradient = alpha, self.functional.penalty_gradient(self.dual(alpha))
        return self._gradient[1]

    def derivative(self, alpha: float) -> float:
        """d/d alpha J*_gamma(v + alpha dv)."""
        gradient = self.penalty_gradient(alpha)
        return self.slope + alpha * self.curvature + InnerProduct(gradient, self.dv)

    def iterate(self, step: Step) -> Iterate:
        """The iterate at an accepted step length."""
        y, v = self.dy.CreateVector(), self.dual(step.length)
        y.data = self.here.y + step.length * self.dy
        smooth = self.functional.smooth_energy(y, v)
        residual = self.functional.linear_residual(y, v)
        residual += self.penalty_gradient(step.length)
        return Iterate(y, v, residual, smooth, self.penalty(step.length), step)
