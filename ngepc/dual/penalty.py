"""The nonsmooth terms M^1 and M^2 of (D_gamma), their gradients and Newton derivatives."""

from __future__ import annotations

import numpy as np
from ngsolve import (
    BilinearForm,
    CoefficientFunction,
    FESpace,
    GridFunction,
    Id,
    IfPos,
    InnerProduct,
    LinearForm,
    Norm,
    OuterProduct,
    ds,
    dx,
)
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.checks.arguments import is_number
from ngepc.discretisation.quadrature import ElementSplit, boundary_rules, fine_rules, smooth_rules
from ngepc.dual.regularisation import Regularisation, plastic_threshold
from ngepc.model.problem import Problem, as_scalar
from ngepc.parallel import integral

TINY = 1e-290


class AssembledPenalty:
    """A nonsmooth term M by forms around the state at which they are assembled.

    Parameters
    ----------
    state
        The grid function in the forms.
    energy, active
        M and the measure of its active set as integrals.
    gradient, hessian
        M' and its Newton derivative.
    """

    def __init__(
        self,
        state: GridFunction,
        energy: CoefficientFunction,
        active: CoefficientFunction,
        gradient: LinearForm,
        hessian: BilinearForm,
    ) -> None:
        self._state, self._energy, self._active = state, energy, active
        self._gradient, self._hessian = gradient, hessian

    def _set(self, v: BaseVector) -> None:
        """Make v the state of the forms."""
        self._state.vec.local_vec.data = v

    def energy(self, v: BaseVector) -> float:
        """M(v)."""
        self._set(v)
        return integral(self._energy, self._state.space.mesh)

    def active(self, v: BaseVector) -> float:
        """Measure of the active set."""
        self._set(v)
        return integral(self._active, self._state.space.mesh)

    def gradient(self, v: BaseVector) -> BaseVector:
        """M'(v) as a functional."""
        self._set(v)
        return self._gradient.Assemble().vec.local_vec

    def pattern(self) -> SparseMatrixd:
        """A matrix with all entries that ``hessian`` may ever have."""
        return self._hessian.Assemble(reallocate=True).mat.local_mat

    def hessian(self, v: BaseVector) -> SparseMatrixd:
        """The Newton derivative of M' at v."""
        self._set(v)
        return self._hessian.Assemble(reallocate=True).mat.local_mat


class ContactPenalty(AssembledPenalty):
    """M^1(z) = 1/(2 gamma) |[mu^ + gamma z]^+|^2 on Gamma_c, with Lemma 6.2.

    M^1'(z) = [mu^ + gamma z]^+, its Newton derivative gamma chi on the set where that is positive;
    active is the contact, z + mu^/gamma < 0.

    Parameters
    ----------
    problem, regularisation
        The data.
    Z
        The space of z.
    quadrature_points
        As for the domain; the boundary rule has the same order.
    """

    def __init__(
        self, problem: Problem, regularisation: Regularisation, Z: FESpace, quadrature_points: int
    ) -> None:
        gamma = regularisation.gamma_contact
        mu_hat = as_scalar(regularisation.contact_shift)
        z = GridFunction(Z)
        on_contact = ds(
            "|".join(problem.contact_names),
            intrules=boundary_rules(problem.N, quadrature_points),
        )
        mu = mu_hat + gamma * z  # (OC2_gamma): mu = [mu^ + gamma z]^+
        dz, w = Z.TnT()
        gradient = LinearForm(Z)
        gradient += IfPos(mu, mu, 0) * w * on_contact
        hessian = BilinearForm(Z, symmetric=True, symmetric_storage=True)
        hessian += IfPos(mu, gamma, 0.0) * dz * w * on_contact
        energy = IfPos(mu, mu * mu, 0) / (2 * gamma) * on_contact
        super().__init__(z, energy, IfPos(-mu, 1.0, 0.0) * on_contact, gradient, hessian)


class PlasticPenalty(AssembledPenalty):
    """M^2(q) = int 1/(2 gamma) ([nu^ + gamma (|q| - beta_gamma)]^+)^2, with Lemma 6.3.

    With the overshoot s = |q| - (beta_gamma - nu^/gamma) the density is gamma/2 ([s]^+)^2, the
    gradient gamma [s]^+ q/|q|, its Newton derivative gamma chi M(q) where s > 0, with M(q) of
    (6.1).  The measure of that set is of a low order: for records.

    Parameters
    ----------
    problem, regularisation
        The data.
    R
        The space of q.
    quadrature_points
        Points on elements that the kink crosses.
    """

    def __init__(
        self, problem: Problem, regularisation: Regularisation, R: FESpace, quadrature_points: int
    ) -> None:
        mesh = problem.mesh
        gamma = regularisation.gamma_plastic(problem)
        threshold = plastic_threshold(problem, regularisation)
        if is_number(threshold):
            threshold = float(threshold)
        fine = fine_rules(problem.N, quadrature_points)
        q = GridFunction(R)
        self._split = ElementSplit(mesh, threshold, fine)
        measures = (
            dx(definedonelements=self._split.kinked, intrules=fine),
            dx(definedonelements=self._split.smooth, intrules=smooth_rules(problem.N)),
        )
        size = Norm(q) + TINY
        s = size - threshold
        gamma = as_scalar(gamma)
        rho = s / size
        M = rho * Id(q.dim) + (1 - rho) * OuterProduct(q, q) / (size * size)  # (6.1)
        r, dq = R.TestFunction(), R.TrialFunction()
        density = IfPos(s, gamma / 2 * s * s, 0).Compile()
        slope = (IfPos(s, gamma * rho, 0) * q).Compile()
        curvature = (IfPos(s, gamma, 0) * M).Compile()
        inside = IfPos(s, 1.0, 0.0)
        coarse = dx(definedonelements=self._split.kinked, intrules=smooth_rules(problem.N))
        gradient = LinearForm(R)
        hessian = BilinearForm(R, symmetric=True, symmetric_storage=True)
        for m in measures:
            gradient += InnerProduct(slope, r) * m
            hessian += InnerProduct(curvature * dq, r) * m
        energy = density * measures[0] + density * measures[1]
        super().__init__(q, energy, inside * coarse + inside * measures[1], gradient, hessian)
        self._split_at: np.ndarray | None = None

    def _set(self, v: BaseVector) -> None:
        """The elements are sorted anew only where q has changed."""
        super()._set(v)
        values = self._state.vec.FV().NumPy()
        if self._split_at is None or not np.array_equal(values, self._split_at):
            self._split.update(values.reshape(self._state.dim, -1).T)
            self._split_at = values.copy()

    def pattern(self) -> SparseMatrixd:
        """A matrix with all entries that ``hessian`` may ever have."""
        self._split.smooth.Set()
        self._split_at = None
        return super().pattern()
