"""The plastic strain eliminated point by point: Moreau's theorem on (EP), section 2, and [19].

At a point with strain e the energy density of (2.14) is, in orthonormal coordinates of p,

    1/2 C (e - p_0) : (e - p_0) - s . p + 1/2 (2 mu_2 + h) |p|^2 + beta |p|   (+ a constant),
    s = 2 mu_2 (dev e - p_0) - dev alpha_2,0,

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
from ngepc.discretisation.finer import seen_problem
from ngepc.discretisation.law import SOFTEST
from ngepc.discretisation.points import Points
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ

YIELD_ROUNDING = 1e-9
"""Points are plastic in the tangent if |s| exceeds beta by more than this fraction.

A load step starts with |s| = beta wherever the last one has yielded, up to rounding.  These points
count as elastic: unloading then needs one Newton step.
"""

MOST_STEPS = 200  # of Newton's method at a point; many with a power law of the rate
NOTHING = 1e-200
"""Overstress in place of zero, where powers have no derivative for NGSolve."""

SOLVED = 1e-15
"""Fraction of the stress to which the equation of a law of hardening is solved."""


class DataOnMesh:
    """Data of a problem as functions on its mesh, by their values at the points."""

    def __init__(self, problem: Problem) -> None:
        self.points = Points(problem.mesh, problem.kinematics, problem.order)
        self.functions = self.points.functions

    def sampled(self, value: CoefficientFunction) -> GridFunction:
        """The function with the values of a coefficient at the points, as they are now."""
        return self.functions.function(self.points.at(value))

    def own(self, value: Coefficient) -> CoefficientFunction:
        """Data as a function on the mesh, the same at the points.

        With coefficients that NGSolve cannot evaluate for several points at once, such as functions
        on other meshes, it leaves matrices on ``H1(dim=N)`` unset.
        """
        if is_number(value):
            return CF(float(value))
        function = self.sampled(value)
        if not value.dims:
            return function
        return CF(tuple(function[i] for i in range(value.dim)), dims=tuple(value.dims))


class LinearReturn:
    """|p| = (|s| - beta) / (2 mu_2 + h), without a law of hardening or of the rate.

    ``gained`` is |p|, ``bound`` beta(|p|), ``slope`` its derivative, ``energy`` its integral from 0
    to |p|; ``least_stiffness`` is the smallest part of the stiffness that the tangent keeps.
    """

    least_stiffness = 0.0

    def __init__(
        self,
        modulus: CoefficientFunction,
        length: CoefficientFunction,
        beta: CoefficientFunction,
    ) -> None:
        self.gained = (length - beta) / modulus
        self.bound = beta
        self.slope = CF(0.0)
        self.energy = beta * self.gained

    def update(self) -> None:
        """Nothing to do: the form is closed."""


class LawReturn:
    """|p| by Newton's method at the points, with a law of hardening, of the rate, or both.

    The attributes are those of ``LinearReturn``.  The unknown is |p|, with a rate the overstress of
    a bar; it follows the displacement after ``update``.
    """

    least_stiffness = SOFTEST

    def __init__(
        self,
        problem: Problem,
        data: DataOnMesh,
        modulus: CoefficientFunction,
        length: CoefficientFunction,
        beta: CoefficientFunction,
    ) -> None:
        law = problem.material.law
        rate = problem.rate
        self._data = data
        self._law = None if law is None else law.at(data.own)
        self._rate = None if rate is None else rate.at(data.own)
        self._duration = problem.duration
        self._start = data.own(problem.initial_accumulated or 0.0)
        self._beta = beta

        unknown = L2(problem.mesh, order=0).TrialFunction()
        stress = modulus * self._gained(unknown) + self._bound(unknown)
        equation = stress / length - 1
        self._solution = NewtonCF(equation, CF(0.0), tol=SOLVED, maxiter=MOST_STEPS)
        self._found = data.sampled(self._solution)
        self.gained = self._gained(self._found)
        self.bound = self._bound(self._found)
        self.slope = CF(0.0)
        self.energy = beta * self.gained
        self._add_law()
        self._add_rate()

    def _gained(self, value: CoefficientFunction) -> CoefficientFunction:
        """|p| for a value of the unknown."""
        if self._rate is None:
            return value
        overstress = IfPos(value - NOTHING, value, NOTHING)
        return self._duration / PEEQ * self._rate.rate(overstress)

    def _bound(self, value: CoefficientFunction) -> CoefficientFunction:
        """beta(|p|) for a value of the unknown (stress)."""
        bound = self._beta
        if self._law is not None:
            x = self._start
            more = PEEQ * self._gained(value)
            bound = bound + PEEQ * (self._law.stress(x + more) - self._law.stress(x))
        return bound if self._rate is None else bound + PEEQ * value

    def _add_law(self) -> None:
        """Slope and energy of the law of hardening."""
        if self._law is not None:
            law = self._law
            x = self._start
            more = PEEQ * self.gained
            self.slope += PEEQ**2 * law.slope(x + more)
            self.energy += law.energy(x + more) - law.energy(x) - law.stress(x) * more

    def _add_rate(self) -> None:
        """Slope and energy of the rate."""
        if self._rate is not None:
            dt = self._duration
            speed = PEEQ * self.gained / dt
            self.slope += PEEQ**2 / dt * self._rate.slope(speed)
            self.energy += dt * self._rate.energy(speed)

    def update(self) -> None:
        """Solve at the points for the current displacement."""
        self._found.vec.data = self._data.sampled(self._solution).vec


class ReturnMapping:
    """The closed forms of the eliminated plastic strain for the current displacement.

    Coefficients that follow later changes of ``displacement``, with a law of hardening after
    ``update``: ``elastic_strain_trial``, e - eps_0 - p_0, and ``stress``, C (e - eps_0 - p_0 - p),
    tensors; ``plastic_increment``, p in coordinates; ``bound``, beta(|p|), and its integral from 0
    to |p|, ``hardening_energy``; ``energy_density``, that of J without the loads, smallest over p;
    ``plastic``, 1 where the body yields in this step, 0 elsewhere.  ``problem`` has the data that
    ``finer.seen_problem`` gives.
    """

    def __init__(self, problem: Problem, displacement: GridFunction) -> None:
        data = DataOnMesh(problem)
        problem = seen_problem(problem, data.points)
        material = problem.material
        self.problem = problem
        self.kinematics = problem.kinematics
        size = self.kinematics.size
        self._points = data.points
        self._h = data.own(material.effective_hardening)
        self._two_mu = 2 * data.own(material.lame_mu)
        self._modulus = self._two_mu + self._h
        self._bulk = data.own(material.lame_lambda) + self._two_mu / size
        beta = data.own(problem.beta)
        back, p_0, eps_0 = self._initial(problem, data)

        e = self.kinematics.strain(displacement) - (p_0 + eps_0)
        s = self.kinematics.coordinates(self._two_mu * e - back)
        length = IfPos(Norm(s) - beta, Norm(s), beta)  # > 0
        self.elastic_strain_trial = e
        self._trial = s
        self._length = length
        self.plastic = IfPos(Norm(s) - (1 + YIELD_ROUNDING) * beta, 1.0, 0.0)
        given = self._modulus, length, beta
        hardens = material.law is not None or problem.rate is not None
        self._return = (
            LawReturn(problem, data, *given) if hardens else LinearReturn(*given)
        )
        self.bound = self._return.bound
        self.hardening_energy = self._return.energy
        self.plastic_increment = self._return.gained / length * s

        # the part of s that remains; this avoids the cancellation of e and p in the stress
        h = self._h
        self._retained = (h + self._two_mu * self.bound / length) / self._modulus
        deviator = self.kinematics.tensor(self._retained * s) + back
        self.stress = self._bulk * Trace(e) * Id(size) + deviator
        self.energy_density = self._density(beta, back, p_0)

    def _initial(self, problem: Problem, data: DataOnMesh) -> list[CoefficientFunction]:
        """dev alpha_2,0, p_0 and eps_0 as tensors, zero where nothing is given."""
        pairs = (
            (problem.initial_hardening, problem.alpha_0[1]),
            (problem.initial_plastic_strain, problem.p_0),
            (problem.initial_strain, problem.eps_0),
        )
        return [t if given is None else data.own(t) for given, t in pairs]

    def _density(
        self,
        beta: CoefficientFunction,
        back: CoefficientFunction,
        p_0: CoefficientFunction,
    ) -> CoefficientFunction:
        """The energy density of J at the best p, with the constant."""
        s = self._trial
        e = self.elastic_strain_trial
        h = self._h
        two_mu = self._two_mu
        kept = IfPos(Norm(s) - beta, self.bound, Norm(s))
        shape = (
            Norm(s) * Norm(s) * h / (two_mu * self._modulus)
            + kept * kept / self._modulus
        )
        stress = self.kinematics.coordinates(back)
        constant = InnerProduct(stress, stress + 2 * s) / two_mu
        constant -= two_mu * InnerProduct(p_0, p_0)
        volume = self._bulk * Trace(e) * Trace(e)
        return 0.5 * (volume + shape + 2 * self.hardening_energy + constant)

    def update(self) -> None:
        """Solve at the points if a law of hardening or of the rate has no closed form."""
        self._return.update()

    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        found = self._return
        if isinstance(found, LinearReturn):
            return 0.0
        stiff = self._h + found.slope - SOFTEST * self._two_mu
        return float(self._points.at(IfPos(stiff, 0.0, found.gained)).max())

    def power(self, v: ProxyFunction) -> CoefficientFunction:
        """Sigma : eps(v), the integrand of the internal forces."""
        return InnerProduct(cached(self.stress), self.kinematics.strain(v))

    def tangent(self, u: ProxyFunction, v: ProxyFunction) -> CoefficientFunction:
        """The slant derivative of ``power``: radial return differentiated where |s| > beta."""
        two_mu = self._two_mu
        M = self._modulus
        length = self._length
        slope = self._return.slope
        softer = (1 - self._return.least_stiffness) * (
            self.bound / length - slope / (M + slope)
        )
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
