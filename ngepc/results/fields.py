"""Fields that follow from a displacement and a plastic strain: stresses, yield function, zones."""

import math
from dataclasses import dataclass

from ngsolve import (
    CF,
    CoefficientFunction,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Norm,
    Trace,
    sqrt,
)

from ngepc.checks.arguments import require_coefficient, require_covering
from ngepc.checks.kinds import require_instance
from ngepc.model.data import as_scalar
from ngepc.model.own import require_same_mesh
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ


def frobenius(A: CoefficientFunction) -> CoefficientFunction:
    """|A|_F of a matrix-valued coefficient."""
    return sqrt(InnerProduct(A, A))


class Quantities:
    """Quantities of (u, p) at the end of the step, as coefficient functions that can be drawn.

    u (length) is a vector, p, what is gained of the plastic strain in this step, has d coordinates.
    """

    problem: Problem
    displacement: GridFunction
    plastic_increment: CoefficientFunction

    @property
    def strain(self) -> CoefficientFunction:
        """eps(u), a tensor; in plane stress with the eps_zz for which sigma_zz = 0."""
        problem = require_same_mesh(self.problem)
        in_plane = problem.kinematics.strain(self.displacement)
        if not problem.kinematics.thin:
            return in_plane
        inelastic = problem.eps_0 + self.plastic_strain
        elastic = in_plane - inelastic
        trace = elastic[0, 0] + elastic[1, 1]
        material = problem.material
        modulus = material.lame_lambda + 2 * material.lame_mu
        across = inelastic[2, 2] - material.lame_lambda / modulus * trace
        return in_plane + across * CF((0.0,) * 8 + (1.0,), dims=(3, 3))

    @property
    def plastic_strain(self) -> CoefficientFunction:
        """Total plastic strain p_0 + p, a tensor."""
        problem = require_same_mesh(self.problem)
        return problem.p_0 + problem.kinematics.tensor(self.plastic_increment)

    @property
    def elastic_strain(self) -> CoefficientFunction:
        """eps(u) - eps_0 - p_0 - p, a tensor."""
        return self.strain - self.problem.eps_0 - self.plastic_strain

    @property
    def stress(self) -> CoefficientFunction:
        """Sigma = C (eps(u) - eps_0 - p_0 - p), a tensor (stress), (2.7)."""
        m = self.problem.material
        kinematics = self.problem.kinematics
        e = self.elastic_strain
        return m.lame_lambda * Trace(e) * Id(kinematics.size) + 2 * m.lame_mu * e

    @property
    def deviatoric_stress(self) -> CoefficientFunction:
        """Dev sigma, a tensor (stress)."""
        return self.problem.kinematics.deviator(self.stress)

    @property
    def back_stress(self) -> CoefficientFunction:
        """Kinematic hardening variable alpha_2 = alpha_2,0 + k p, a tensor (stress).

        With sub-elements the centre of the smallest yield surface.
        """
        if self.problem.material.overlay is not None:
            return self.deviatoric_stress - self._first_stress
        _, alpha_2 = self.problem.alpha_0
        p = self.problem.kinematics.tensor(self.plastic_increment)
        return alpha_2 + as_scalar(self.problem.material.hardening) * p

    @property
    def _first_stress(self) -> CoefficientFunction:
        """The deviatoric stress of the sub-element that yields first, a tensor (stress)."""
        problem = self.problem
        kinematics = problem.kinematics
        material = problem.material
        p_0 = problem.p_0
        if problem.initial_hardening is not None:
            stack = problem.initial_hardening
            first = tuple(stack[k] for k in range(kinematics.d))
            p_0 = kinematics.tensor(CF(first))
        strain = self.strain - problem.eps_0 - p_0
        trial = 2 * material.lame_mu * kinematics.deviator(strain)
        bound = material.yield_stress
        size = frobenius(trial)
        return trial * IfPos(size - bound, bound / size, 1.0)

    @property
    def hardening_variable(self) -> CoefficientFunction:
        """Isotropic hardening variable alpha_1 = alpha_1,0 + k_1 H sigma_y |p|, scalar."""
        alpha_1, _ = self.problem.alpha_0
        growth = as_scalar(self.problem.material.scalar_growth)
        return alpha_1 + growth * self._gained

    @property
    def _gained(self) -> CoefficientFunction:
        """|p|, and for Hill's ellipsoid the measure that is dual to its own, scalar (1)."""
        problem = self.problem
        if problem.material.hill is None:
            return Norm(self.plastic_increment)
        p = problem.kinematics.tensor(self.plastic_increment)
        return problem.material.hill.dual_measure(p)

    @property
    def yield_function(self) -> CoefficientFunction:
        """Phi = |dev sigma - alpha_2|_F minus ``Material.yield_bound``, scalar (stress), <= 0.

        With ``Material.hill`` its measure, (2/3)^(1/2) S, takes the place of the norm.
        """
        hardened = self.hardening_variable, self.accumulated_plastic_strain
        bound = self.problem.material.yield_bound(*hardened)
        shifted = self.deviatoric_stress - self.back_stress
        hill = self.problem.material.hill
        return (frobenius(shifted) if hill is None else hill.measure(shifted)) - bound

    @property
    def equivalent_plastic_strain(self) -> CoefficientFunction:
        """|p_0 + p|_F, scalar (1); the paper's |p|_F when p_0 = 0."""
        return frobenius(self.plastic_strain)

    @property
    def von_mises(self) -> CoefficientFunction:
        """(3/2)^(1/2) |dev sigma|_F, the equivalent stress of engineers, scalar (stress)."""
        return math.sqrt(1.5) * frobenius(self.deviatoric_stress)

    @property
    def accumulated_plastic_strain(self) -> CoefficientFunction:
        """PEEQ: the value of earlier steps plus (2/3)^(1/2) |p|, scalar (1)."""
        return self.problem.accumulated_0 + PEEQ * self._gained

    def plastic_zone(self, threshold: float = 0.0) -> CoefficientFunction:
        """1 where the plastic strain gained in this step has |p| > ``threshold``, 0 elsewhere."""
        return IfPos(Norm(self.plastic_increment) - threshold, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Fields(Quantities):
    """The quantities of a displacement and a plastic strain, from any source.

    Parameters
    ----------
    problem
        The problem that was solved.
    displacement
        u, vector-valued (length).
    plastic_increment
        Coordinates of the plastic strain p gained in this step (1), d components.

    Raises
    ------
    TypeError, ValueError
        If one is of the wrong kind or shape, or a function of a mesh that misses a part of
        the body.
    """

    problem: Problem
    displacement: GridFunction
    plastic_increment: CoefficientFunction

    def __post_init__(self) -> None:
        require_instance("problem", self.problem, Problem, "a Problem")
        require_coefficient("displacement", self.displacement, [(self.problem.N,)])
        d = self.problem.kinematics.d
        require_coefficient("plastic_increment", self.plastic_increment, [(d,)])
        require_same_mesh(self.problem)
        for name in ("displacement", "plastic_increment"):
            require_covering(name, getattr(self, name), self.problem.mesh)
