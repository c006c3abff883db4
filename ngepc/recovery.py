"""Fields recovered from a displacement and a plastic strain: stresses, yield function, zones."""

from dataclasses import dataclass

from ngsolve import (
    CoefficientFunction,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    Norm,
    Trace,
    sqrt,
)

from ngepc.problem import Problem, as_scalar
from ngepc.tensors import deviator, strain, tensor


def frobenius(A: CoefficientFunction) -> CoefficientFunction:
    """|A|_F of a matrix-valued coefficient."""
    return sqrt(InnerProduct(A, A))


@dataclass(frozen=True, eq=False)
class Fields:
    """Everything that (u, p) says about the body at the end of the step, as drawable coefficients.

    Parameters
    ----------
    problem
        The problem that was solved.
    displacement
        u, vector-valued (length).
    plastic_increment
        Coordinates of the plastic strain p gained in this step (1), d components.
    """

    problem: Problem
    displacement: GridFunction
    plastic_increment: CoefficientFunction

    @property
    def strain(self) -> CoefficientFunction:
        """eps(u), N x N."""
        return strain(self.displacement)

    @property
    def plastic_strain(self) -> CoefficientFunction:
        """Total plastic strain p_0 + p, N x N."""
        return self.problem.p_0 + tensor(self.plastic_increment, self.problem.N)

    @property
    def stress(self) -> CoefficientFunction:
        """Sigma = C (eps(u) - plastic_strain), N x N (stress), (2.7)."""
        m, N = self.problem.material, self.problem.N
        e = self.strain - self.plastic_strain
        return m.lame_lambda * Trace(e) * Id(N) + 2 * m.lame_mu * e

    @property
    def deviatoric_stress(self) -> CoefficientFunction:
        """Dev sigma, N x N (stress)."""
        return deviator(self.stress, self.problem.N)

    @property
    def back_stress(self) -> CoefficientFunction:
        """Kinematic hardening variable alpha_2 = alpha_2,0 + k p, N x N (stress)."""
        _, alpha_2 = self.problem.alpha_0
        p = tensor(self.plastic_increment, self.problem.N)
        return alpha_2 + as_scalar(self.problem.material.hardening) * p

    @property
    def hardening_variable(self) -> CoefficientFunction:
        """Isotropic hardening variable alpha_1 = alpha_1,0 + k_1 H sigma_y |p|, scalar."""
        m = self.problem.material
        alpha_1, _ = self.problem.alpha_0
        factor = m.hardening_stiffness * m.hardening_modulus * m.yield_stress
        return alpha_1 + as_scalar(factor) * Norm(self.plastic_increment)

    @property
    def yield_function(self) -> CoefficientFunction:
        """Phi = |dev sigma - alpha_2|_F - sigma_y (1 + H alpha_1), scalar (stress), <= 0."""
        bound = self.problem.material.yield_bound(self.hardening_variable)
        return frobenius(self.deviatoric_stress - self.back_stress) - bound

    @property
    def equivalent_plastic_strain(self) -> CoefficientFunction:
        """|p_0 + p|_F, scalar (1); the paper's |p|_F when p_0 = 0."""
        return frobenius(self.plastic_strain)

    def plastic_zone(self, threshold: float = 0.0) -> CoefficientFunction:
        """1 where |p_0 + p|_F exceeds ``threshold``, 0 elsewhere."""
        return IfPos(self.equivalent_plastic_strain - threshold, 1.0, 0.0)
