"""The plastic strain eliminated point by point: Moreau's theorem on (EP), section 2, and [19].

At a point with strain e the energy density of (2.14) is, in orthonormal coordinates of p,

    1/2 C (e - p_0) : (e - p_0) - s . p + 1/2 (2 mu_2 + h) |p|^2 + beta |p|   (+ a constant),
    s = 2 mu_2 (dev e - p_0) - dev alpha_2,

smallest at  p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|,  which leaves a differentiable energy of the
displacement alone.  Its slanting function is the tangent of the radial return.  With a law of
hardening beta |p| is an integral of beta(g), and  (2 mu_2 + h) g + beta(g) = |s|  for g = |p|.
"""

from ngsolve import CF, L2, CoefficientFunction, GridFunction, Id, IfPos, InnerProduct, Norm, Trace
from ngsolve.comp import ProxyFunction
from ngsolve.fem import CacheCF, NewtonCF

from ngepc.discretisation.law import SOFTEST
from ngepc.discretisation.pointfunctions import PointFunctions
from ngepc.discretisation.points import Points
from ngepc.model.material import PEEQ
from ngepc.model.problem import Problem, as_scalar

YIELD_ROUNDING = 1e-9
"""Part of beta by which |s| has to exceed beta, for the tangent of an elastic point to change."""

SOLVED = 1e-15
"""Part of the stress to which the equation of a law of hardening is solved."""


class ReturnMapping:
    """The closed forms of the eliminated plastic strain for the current displacement.

    Every property is a coefficient that follows later changes of ``displacement``, with a law of
    hardening after ``update``.
    """

    def __init__(self, problem: Problem, displacement: GridFunction) -> None:
        self.problem, self.kinematics = problem, problem.kinematics
        self.displacement = displacement
        self._beta, self._h = as_scalar(problem.beta), problem.effective_hardening
        self._two_mu = 2 * as_scalar(problem.material.lame_mu)
        self._modulus = self._two_mu + self._h
        lame_lambda = as_scalar(problem.material.lame_lambda)
        self._bulk = lame_lambda + self._two_mu / self.kinematics.size
        self._law, self._x = problem.material.law, problem.accumulated_0
        if self._law is not None:
            self._points = Points(problem.mesh, self.kinematics, problem.order)
            self._functions = PointFunctions(self._points)
            self._solution, self._gained = self._solved(), None
            self.update()

    @property
    def elastic_strain_trial(self) -> CoefficientFunction:
        """e - eps_0 - p_0, a tensor; e in the formulas is beyond the initial strain eps_0."""
        given = self.problem.p_0 + self.problem.eps_0
        return self.kinematics.strain(self.displacement) - given

    @property
    def trial(self) -> CoefficientFunction:
        """Coordinates of s = 2 mu_2 (dev e - p_0) - dev alpha_2 (stress)."""
        shifted = self._two_mu * self.elastic_strain_trial - self.problem.alpha_0[1]
        return self.kinematics.coordinates(shifted)

    @property
    def plastic_increment(self) -> CoefficientFunction:
        """Coordinates of p, d components (1)."""
        s = self.trial
        return self.gained / self._size(s) * s

    @property
    def gained(self) -> CoefficientFunction:
        """|p|, scalar (1)."""
        if self._law is not None:
            return self._gained
        return (self._size(self.trial) - self._beta) / self._modulus

    def _solved(self) -> CoefficientFunction:
        """The g with (2 mu_2 + h) g + beta(g) = max(|s|, beta)."""
        g = L2(self.problem.mesh, order=0).TrialFunction()
        equation = (self._modulus * g + self._bound(g)) / self._size(self.trial) - 1
        return NewtonCF(equation, CF(0.0), tol=SOLVED, maxiter=50)

    def update(self) -> None:
        """Solve for |p| at the points, where a law of hardening makes it no closed form."""
        if self._law is None:
            return
        found = self._functions.function(self._points.at(self._solution))
        if self._gained is None:
            self._gained = found
        self._gained.vec.data = found.vec

    @property
    def bound(self) -> CoefficientFunction:
        """beta(|p|), scalar (stress)."""
        return self._bound(self.gained)

    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        if self._law is None:
            return 0.0
        stiff = self._h + self._slope - SOFTEST * self._two_mu
        return float(self._points.at(IfPos(stiff, 0.0, self._gained)).max())

    @property
    def _slope(self) -> CoefficientFunction:
        """beta'(|p|) (stress)."""
        if self._law is None:
            return CF(0.0)
        return PEEQ**2 * self._law.slope(self._x + PEEQ * self.gained)

    def _bound(self, g: CoefficientFunction) -> CoefficientFunction:
        """beta(g) (stress)."""
        if self._law is None:
            return self._beta
        gain = self._law.stress(self._x + PEEQ * g) - self._law.stress(self._x)
        return self._beta + PEEQ * gain

    @property
    def hardening_energy(self) -> CoefficientFunction:
        """The integral of beta from 0 to |p| (energy per volume)."""
        if self._law is None:
            return self._beta * self.gained
        x, law, more = self._x, self._law, PEEQ * self.gained
        return (
            self._beta * self.gained + law.energy(x + more) - law.energy(x) - law.stress(x) * more
        )

    @property
    def stress(self) -> CoefficientFunction:
        """Sigma = C (e - p_0 - p), a tensor (stress), without the cancellation of e and p."""
        s, mean = self.trial, self._bulk * Trace(self.elastic_strain_trial)
        deviatoric = self.kinematics.tensor(self._retained(s) * s) + self.problem.alpha_0[1]
        return mean * Id(self.kinematics.size) + deviatoric

    @property
    def energy_density(self) -> CoefficientFunction:
        """The density of J without the loads, smallest over p (energy per volume), (2.14)."""
        two_mu, M, s = self._two_mu, self._modulus, self.trial
        m = Norm(s)
        b = IfPos(m - self._beta, self.bound, m)
        volume = Trace(self.elastic_strain_trial)
        shape = m * m * self._h / (two_mu * M) + b * b / M + 2 * self.hardening_energy
        p_0, back = self.problem.p_0, self.kinematics.coordinates(self.problem.alpha_0[1])
        shift = InnerProduct(back, back + 2 * s) / two_mu - two_mu * InnerProduct(p_0, p_0)
        return 0.5 * (self._bulk * volume * volume + shape + shift)

    @property
    def plastic(self) -> CoefficientFunction:
        """1 where the body yields in this step, 0 elsewhere.

        A load step starts with |s| = beta wherever the last one has yielded, up to rounding.  These
        points count as elastic: unloading then needs one Newton step.
        """
        return IfPos(Norm(self.trial) - (1 + YIELD_ROUNDING) * self._beta, 1.0, 0.0)

    def power(self, v: ProxyFunction) -> CoefficientFunction:
        """Sigma : eps(v), the integrand of the internal forces."""
        return InnerProduct(cached(self.stress), self.kinematics.strain(v))

    def tangent(self, u: ProxyFunction, v: ProxyFunction) -> CoefficientFunction:
        """The slant derivative of ``power``: radial return differentiated where |s| > beta."""
        two_mu, s, size = self._two_mu, self.trial, self.kinematics.size
        length, slope = self._size(s), self._slope
        softer = (1.0 if self._law is None else 1 - SOFTEST) * (
            self.bound / length - slope / (self._modulus + slope)
        )
        across = cached(two_mu * self._retained(s))
        along = cached(two_mu * two_mu / self._modulus * self.plastic * softer)
        direction = cached(self.kinematics.tensor(s / length))
        e, d = self.kinematics.strain(u), self.kinematics.strain(v)
        volume = (self._bulk - across / size) * Trace(e) * Trace(d)
        shape = across * InnerProduct(e, d)
        return volume + shape - along * InnerProduct(direction, e) * InnerProduct(direction, d)

    def _size(self, s: CoefficientFunction) -> CoefficientFunction:
        """max(|s|, beta) > 0."""
        return IfPos(Norm(s) - self._beta, Norm(s), self._beta)

    def _retained(self, s: CoefficientFunction) -> CoefficientFunction:
        """The part of s that the return leaves, (h + 2 mu_2 beta(g)/|s|) / (2 mu_2 + h) or 1."""
        return (self._h + self._two_mu * self.bound / self._size(s)) / self._modulus


def cached(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A coefficient that is evaluated once per element and not once per pair of components."""
    return CacheCF(coefficient.Compile())
