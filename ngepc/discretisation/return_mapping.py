"""The plastic strain eliminated point by point: Moreau's theorem on (EP), section 2, and [19].

At a point with strain e the energy density of (2.14) is, in orthonormal coordinates of p,

    1/2 C (e - p_0) : (e - p_0) - s . p + 1/2 (2 mu_2 + h) |p|^2 + beta |p|   (+ a constant),
    s = 2 mu_2 (dev e - p_0) - dev alpha_2,

smallest at  p = [|s| - beta]_+ / (2 mu_2 + h) s/|s|,  which leaves a differentiable energy of the
displacement alone.  Its slanting function is the tangent of the radial return.
"""

import math

from ngsolve import (
    ET,
    L2,
    BilinearForm,
    CoefficientFunction,
    Grad,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    IntegrationRule,
    LinearForm,
    Mesh,
    Norm,
    Sym,
    Trace,
    VectorValued,
    dx,
)
from ngsolve.comp import DifferentialSymbol, ProxyFunction
from ngsolve.fem import CacheCF

from ngepc.checks.arguments import ELEMENT_TYPES
from ngepc.discretisation.spaces import has_straight_simplices, plastic_order
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.tensors import coordinates, strain, tensor

_FLAT_ORDER = {ET.TRIG: 1, ET.TET: 1}
_ORDER = {ET.TRIG: 2, ET.QUAD: 3, ET.TET: 2, ET.HEX: 3, ET.PRISM: 2}

ROUNDING = 1e-9
"""Part of beta by which |s| has to exceed beta, for the tangent of an elastic point to change."""


def plastic_points(mesh: Mesh) -> dict[ET, IntegrationRule]:
    """The points that carry plastic strain: one per simplex, 2 x 2 (x 2) Gauss points otherwise.

    Simplices that are curved or stand beside other shapes, prisms and pyramids get a rule of order
    two.  Each has as many points as there are polynomials in ``spaces.plastic_space``.
    """
    if has_straight_simplices(mesh):
        return {s: IntegrationRule(s, order) for s, order in _FLAT_ORDER.items()}
    rules = {s: IntegrationRule(s, _ORDER[s]) for s in ELEMENT_TYPES[mesh.dim] if s in _ORDER}
    return rules | ({ET.PYRAMID: pyramid_rule()} if mesh.dim == 3 else {})


def pyramid_rule() -> IntegrationRule:
    """Five points of degree two on the pyramid with base (0, 1)^2 and apex (0, 0, 1).

    The section at z has the area (1 - z)^2, whose Gauss points are c, d = 1/3 -+ (2/45)^(1/2).  The
    weight at c is shared by the corners of a square that has the second moments of x and y,
    1/60 about the middle of the sections; the other one stays on the axis.
    """
    c, d = (1 / 3 + sign * math.sqrt(2 / 45) for sign in (-1, 1))
    upper = (1 / 12 - c / 3) / (d - c)
    lower = 1 / 3 - upper
    half, middle = 1 / math.sqrt(60 * lower), (1 - c) / 2
    square = [(middle + i * half, middle + j * half, c) for i in (-1, 1) for j in (-1, 1)]
    axis = ((1 - d) / 2, (1 - d) / 2, d)
    return IntegrationRule([*square, axis], [lower / 4] * 4 + [upper])


def interpolated(problem: Problem, value: CoefficientFunction) -> GridFunction:
    """A piecewise polynomial with the values of the vector ``value`` at the plastic points.

    Piecewise constant on flat simplices, (multi)linear on each element otherwise: it takes the
    values at the points to round-off.
    """
    order = plastic_order(problem.mesh)
    components = max(1, value.dim)
    scalar = L2(problem.mesh, order=order)
    space = scalar if components == 1 else VectorValued(scalar, components)
    u, v = space.TnT()
    dp = at_plastic_points(problem, dx)
    mass, moments = BilinearForm(space), LinearForm(space)
    mass += InnerProduct(u, v) * dp
    moments += InnerProduct(value, v) * dp
    inverse = mass.Assemble().mat.Inverse(inverse="sparsecholesky")
    result = GridFunction(space)
    result.vec.data = inverse * moments.Assemble().vec
    return result


class ReturnMapping:
    """The closed forms of the eliminated plastic strain for the current displacement.

    Every property is a coefficient that follows later changes of ``displacement``.

    Parameters
    ----------
    problem
        Data of the time step.
    displacement
        u, vector-valued (length).
    """

    def __init__(self, problem: Problem, displacement: GridFunction) -> None:
        self.problem = problem
        self.displacement = displacement
        self._two_mu = 2 * as_scalar(problem.material.lame_mu)
        self._modulus = self._two_mu + problem.effective_hardening
        self._bulk = as_scalar(problem.material.lame_lambda) + self._two_mu / problem.N

    @property
    def elastic_strain_trial(self) -> CoefficientFunction:
        """e - p_0, N x N."""
        return strain(self.displacement) - self.problem.p_0

    @property
    def trial(self) -> CoefficientFunction:
        """Coordinates of s = 2 mu_2 (dev e - p_0) - dev alpha_2 (stress)."""
        shifted = self._two_mu * self.elastic_strain_trial - self.problem.alpha_0[1]
        return coordinates(shifted, self.problem.N)

    @property
    def plastic_increment(self) -> CoefficientFunction:
        """Coordinates of p, d components (1)."""
        s = self.trial
        excess = Norm(s) - self.problem.beta
        return IfPos(excess, excess, 0.0) / (self._modulus * self._size(s)) * s

    @property
    def stress(self) -> CoefficientFunction:
        """Sigma = C (e - p_0 - p), N x N (stress), without the cancellation of e and p."""
        N = self.problem.N
        s = self.trial
        deviatoric = tensor(self._retained(s) * s, N) + self.problem.alpha_0[1]
        return self._bulk * Trace(self.elastic_strain_trial) * Id(N) + deviatoric

    @property
    def energy_density(self) -> CoefficientFunction:
        """The density of J without the loads, smallest over p (energy per volume), (2.14)."""
        two_mu, M, beta, N = self._two_mu, self._modulus, self.problem.beta, self.problem.N
        s, p_0, alpha_2 = self.trial, self.problem.p_0, self.problem.alpha_0[1]
        m = Norm(s)
        b = IfPos(m - beta, beta, m)
        volume = Trace(self.elastic_strain_trial)
        shape = m * m * self.problem.effective_hardening / (two_mu * M) + b * (2 * m - b) / M
        back = coordinates(alpha_2, N)
        shift = back * (back + 2 * s) / two_mu - two_mu * InnerProduct(p_0, p_0)
        return 0.5 * (self._bulk * volume * volume + shape + shift)

    @property
    def plastic(self) -> CoefficientFunction:
        """1 where the body yields in this step, 0 elsewhere.

        A load step starts with |s| = beta wherever the last one has yielded, up to rounding.  These
        points count as elastic: unloading then needs one Newton step.
        """
        return IfPos(Norm(self.trial) - (1 + ROUNDING) * self.problem.beta, 1.0, 0.0)

    def power(self, v: ProxyFunction) -> CoefficientFunction:
        """Sigma : eps(v), the integrand of the internal forces."""
        return InnerProduct(cached(self.stress), Grad(v))

    def tangent(self, u: ProxyFunction, v: ProxyFunction) -> CoefficientFunction:
        """The slant derivative of ``power``: radial return differentiated where |s| > beta."""
        N, two_mu = self.problem.N, self._two_mu
        s = self.trial
        size = self._size(s)
        across = cached(two_mu * self._retained(s))
        along = cached(two_mu * two_mu / self._modulus * self.plastic * self.problem.beta / size)
        direction = cached(tensor(s / size, N))
        e, d = Grad(u), Grad(v)
        volume = (self._bulk - across / N) * Trace(e) * Trace(d)
        shape = across * InnerProduct(Sym(e), d)
        return volume + shape - along * InnerProduct(direction, e) * InnerProduct(direction, d)

    def _size(self, s: CoefficientFunction) -> CoefficientFunction:
        """max(|s|, beta) > 0."""
        return IfPos(Norm(s) - self.problem.beta, Norm(s), self.problem.beta)

    def _retained(self, s: CoefficientFunction) -> CoefficientFunction:
        """The part of s that the return leaves, (h + 2 mu_2 beta/|s|) / (2 mu_2 + h) or 1."""
        h, beta = self.problem.effective_hardening, self.problem.beta
        return (h + self._two_mu * beta / self._size(s)) / self._modulus


def cached(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A coefficient that is evaluated once per element and not once per pair of components."""
    return CacheCF(coefficient.Compile())


def at_plastic_points(problem: Problem, dx: DifferentialSymbol) -> DifferentialSymbol:
    """``dx`` on the points of ``plastic_points``."""
    return dx(intrules=plastic_points(problem.mesh))
