"""The plastic strain eliminated point by point: Moreau's theorem on (EP), section 2, and [19].

At a point with strain e the energy density of (2.14) is, in orthonormal coordinates of p,

    1/2 C (e - p_0) : (e - p_0) - s . p + 1/2 (2 mu_2 + h) |p|^2 + beta |p|   (+ a constant),
    s = 2 mu_2 (dev e - p_0) - dev alpha_2,

smallest at  p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|,  which leaves a differentiable energy of the
displacement alone.  Its slanting function is the tangent of the radial return.  With a law of
hardening beta |p| is an integral of beta(g), and  (2 mu_2 + h) g + beta(g) = |s|  for g = |p|.
"""

from ngsolve import (
    CF,
    L2,
    CoefficientFunction,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Norm,
    Trace,
)
from ngsolve.comp import ProxyFunction
from ngsolve.fem import CacheCF, NewtonCF

from ngepc.checks.arguments import Coefficient, is_number
from ngepc.discretisation.law import SOFTEST
from ngepc.discretisation.points import PointFunctions, Points
from ngepc.model.material import PEEQ
from ngepc.model.problem import Problem

YIELD_ROUNDING = 1e-9
"""Part of beta by which |s| has to exceed beta, for the tangent of an elastic point to change.

A load step starts with |s| = beta wherever the last one has yielded, up to rounding.  These points
count as elastic: unloading then needs one Newton step.
"""

MOST_STEPS = 200  # of Newton's method at a point: with a power law of the rate it begins far away
NOTHING = (
    1e-200  # overstress in place of zero, where powers have no derivative for NGSolve
)
SOLVED = 1e-15
"""Part of the stress to which the equation of a law of hardening is solved."""


class ReturnMapping:
    """The closed forms of the eliminated plastic strain for the current displacement.

    Coefficients that follow later changes of ``displacement``, with a law of hardening after
    ``update``: ``elastic_strain_trial``, e - eps_0 - p_0, and ``stress``, C (e - eps_0 - p_0 - p),
    tensors; ``plastic_increment``, p in coordinates; ``bound``, beta(|p|), and its integral from 0
    to |p|, ``hardening_energy``; ``energy_density``, that of J without the loads, smallest over p;
    ``plastic``, 1 where the body yields in this step, 0 elsewhere.
    """

    def __init__(self, problem: Problem, displacement: GridFunction) -> None:
        points = Points(problem.mesh, problem.kinematics, problem.order)
        self._points = points
        self._functions = PointFunctions(points)
        self.kinematics = problem.kinematics
        beta = self._own(problem.beta)
        h = self._own(problem.material.effective_hardening)
        two_mu = 2 * self._own(problem.material.lame_mu)
        self._two_mu = two_mu
        self._h = h
        self._modulus = two_mu + h
        lame_lambda = self._own(problem.material.lame_lambda)
        size = self.kinematics.size
        given = (
            problem.initial_hardening,
            problem.initial_plastic_strain,
            problem.initial_strain,
        )
        tensors = zip(
            given, (problem.alpha_0[1], problem.p_0, problem.eps_0), strict=True
        )
        back, p_0, eps_0 = (t if g is None else self._own(t) for g, t in tensors)
        self._bulk = lame_lambda + two_mu / size
        e = self.kinematics.strain(displacement) - (p_0 + eps_0)
        s = self.kinematics.coordinates(two_mu * e - back)
        length = IfPos(Norm(s) - beta, Norm(s), beta)  # > 0
        self.elastic_strain_trial = e
        self._trial = s
        self._length = length
        self.plastic = IfPos(Norm(s) - (1 + YIELD_ROUNDING) * beta, 1.0, 0.0)
        self._eliminate(problem, beta)
        self.plastic_increment = self._gained / length * s

        # what the return leaves of s; the stress without the cancellation of e and p
        self._retained = (h + two_mu * self.bound / length) / self._modulus
        deviator = self.kinematics.tensor(self._retained * s) + back
        self.stress = self._bulk * Trace(e) * Id(size) + deviator

        kept = IfPos(Norm(s) - beta, self.bound, Norm(s))
        back = self.kinematics.coordinates(back)
        shape = (
            Norm(s) * Norm(s) * h / (two_mu * self._modulus)
            + kept * kept / self._modulus
        )
        given = InnerProduct(back, back + 2 * s) / two_mu
        given -= two_mu * InnerProduct(p_0, p_0)
        volume = self._bulk * Trace(e) * Trace(e)
        self.energy_density = 0.5 * (volume + shape + 2 * self.hardening_energy + given)

    def _eliminate(self, problem: Problem, beta: CoefficientFunction) -> None:
        """|p|, in closed form or by Newton's method, with beta(|p|), its slope and integral."""
        law = problem.material.law
        M = self._modulus
        x = self._own(problem.initial_accumulated or 0.0)
        self._solution = None
        self._softest = 0.0
        rate = problem.rate
        if law is None and rate is None:
            g = self._gained = (self._length - beta) / M
            self.bound = beta
            self._slope = CF(0.0)
            self.hardening_energy = beta * g
            return
        law = None if law is None else law.at(self._own)
        rate = None if rate is None else rate.at(self._own)
        dt = problem.duration

        def hardened(g: CoefficientFunction) -> CoefficientFunction:
            """beta(g) without the rate (stress)."""
            if law is None:
                return beta
            return beta + PEEQ * (law.stress(x + PEEQ * g) - law.stress(x))

        def gained(value: CoefficientFunction) -> CoefficientFunction:
            """g for a value of the unknown: g itself, with a rate the overstress of a bar."""
            if rate is None:
                return value
            return dt / PEEQ * rate.rate(IfPos(value - NOTHING, value, NOTHING))

        def bound(value: CoefficientFunction) -> CoefficientFunction:
            """beta(g) for a value of the unknown (stress)."""
            g = gained(value)
            return hardened(g) if rate is None else hardened(g) + PEEQ * value

        unknown = L2(problem.mesh, order=0).TrialFunction()
        equation = (M * gained(unknown) + bound(unknown)) / self._length - 1
        self._solution = NewtonCF(equation, CF(0.0), tol=SOLVED, maxiter=MOST_STEPS)
        self._softest = SOFTEST
        self._found = self._functions.function(self._points.at(self._solution))
        g = self._gained = gained(self._found)
        self.bound = bound(self._found)
        more = PEEQ * g
        self._slope = CF(0.0)
        self.hardening_energy = beta * g
        if law is not None:
            self._slope += PEEQ**2 * law.slope(x + more)
            stored = law.energy(x + more) - law.energy(x) - law.stress(x) * more
            self.hardening_energy += stored
        if rate is not None:
            self._slope += PEEQ**2 / dt * rate.slope(more / dt)
            self.hardening_energy += dt * rate.energy(more / dt)

    def _own(self, value: Coefficient) -> CoefficientFunction:
        """Data as a function on the mesh, the same at the points.

        With coefficients that NGSolve cannot evaluate for several points at once, such as functions
        on other meshes, it leaves matrices on ``H1(dim=N)`` unset.
        """
        if is_number(value):
            return CF(float(value))
        function = self._functions.function(self._points.at(value))
        if not value.dims:
            return function
        return CF(tuple(function[i] for i in range(value.dim)), dims=tuple(value.dims))

    def update(self) -> None:
        """Solve at the points, where a law of hardening or of the rate leaves no closed form."""
        if self._solution is not None:
            found = self._functions.function(self._points.at(self._solution))
            self._found.vec.data = found.vec

    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        if self._solution is None:
            return 0.0
        stiff = self._h + self._slope - SOFTEST * self._two_mu
        return float(self._points.at(IfPos(stiff, 0.0, self._gained)).max())

    def power(self, v: ProxyFunction) -> CoefficientFunction:
        """Sigma : eps(v), the integrand of the internal forces."""
        return InnerProduct(cached(self.stress), self.kinematics.strain(v))

    def tangent(self, u: ProxyFunction, v: ProxyFunction) -> CoefficientFunction:
        """The slant derivative of ``power``: radial return differentiated where |s| > beta."""
        two_mu = self._two_mu
        M = self._modulus
        length = self._length
        slope = self._slope
        softer = (1 - self._softest) * (self.bound / length - slope / (M + slope))
        across = cached(two_mu * self._retained)
        along = cached(two_mu * two_mu / M * self.plastic * softer)
        direction = cached(self.kinematics.tensor(self._trial / length))
        e = self.kinematics.strain(u)
        d = self.kinematics.strain(v)
        volume = (self._bulk - across / self.kinematics.size) * Trace(e) * Trace(d)
        shape = across * InnerProduct(e, d)
        return (
            volume
            + shape
            - along * InnerProduct(direction, e) * InnerProduct(direction, d)
        )


def cached(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A coefficient that is evaluated once per element and not once per pair of components."""
    return CacheCF(coefficient.Compile())
