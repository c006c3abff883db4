"""The nonsmooth terms M^1 and M^2 of (D_gamma), their gradients and Newton derivatives."""

from __future__ import annotations

import numpy as np
from ngsolve import (
    BilinearForm,
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
from ngepc.parallel import integral
from ngepc.problem import Problem, as_scalar
from ngepc.quadrature import ElementSplit, boundary_rules, fine_rules, smooth_rules
from ngepc.regularisation import Regularisation, plastic_threshold

TINY = 1e-290


class ContactPenalty:
    """M^1(z) = 1/(2 gamma) |[mu^ + gamma z]^+|^2 on Gamma_c, with Lemma 6.2.

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
        self._z = z = GridFunction(Z)
        self._mesh = problem.mesh
        self._ds = ds(
            "|".join(problem.contact_names),
            intrules=boundary_rules(problem.N, quadrature_points),
        )
        mu = mu_hat + gamma * z  # (OC2_gamma): mu = [mu^ + gamma z]^+
        self._densities = (IfPos(mu, mu * mu, 0) / (2 * gamma), IfPos(-mu, 1.0, 0.0))
        dz, w = Z.TnT()
        self._gradient = LinearForm(Z)
        self._gradient += IfPos(mu, mu, 0) * w * self._ds
        self._hessian = BilinearForm(Z, symmetric=True, symmetric_storage=True)
        self._hessian += IfPos(mu, gamma, 0.0) * dz * w * self._ds

    def energy(self, z: BaseVector) -> float:
        """M^1(z)."""
        self._z.vec.local_vec.data = z
        return integral(self._densities[0] * self._ds, self._mesh)

    def active(self, z: BaseVector) -> float:
        """Measure of the set where z + mu^/gamma < 0: contact."""
        self._z.vec.local_vec.data = z
        return integral(self._densities[1] * self._ds, self._mesh)

    def gradient(self, z: BaseVector) -> BaseVector:
        """([mu^ + gamma z]^+, .) as a functional on Z."""
        self._z.vec.local_vec.data = z
        return self._gradient.Assemble().vec.local_vec

    def pattern(self) -> SparseMatrixd:
        """A matrix with all entries that ``hessian`` may ever have."""
        return self._hessian.Assemble(reallocate=True).mat.local_mat

    def hessian(self, z: BaseVector) -> SparseMatrixd:
        """gamma (chi_{z + mu^/gamma > 0} ., .)."""
        self._z.vec.local_vec.data = z
        return self._hessian.Assemble(reallocate=True).mat.local_mat


class PlasticPenalty:
    """M^2(q) = int 1/(2 gamma) ([nu^ + gamma (|q| - beta_gamma)]^+)^2, with Lemma 6.3.

    With the overshoot s = |q| - (beta_gamma - nu^/gamma) the density is gamma/2 ([s]^+)^2.

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
        self._mesh = mesh
        self._q = q = GridFunction(R)
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
        gradient = (IfPos(s, gamma * rho, 0) * q).Compile()
        hessian = (IfPos(s, gamma, 0) * M).Compile()
        inside = IfPos(s, 1.0, 0.0)
        coarse = dx(definedonelements=self._split.kinked, intrules=smooth_rules(problem.N))
        self._energy = density * measures[0] + density * measures[1]
        self._measure = inside * coarse + inside * measures[1]
        self._gradient = LinearForm(R)
        self._hessian = BilinearForm(R, symmetric=True, symmetric_storage=True)
        for m in measures:
            self._gradient += InnerProduct(gradient, r) * m
            self._hessian += InnerProduct(hessian * dq, r) * m
        self._split_at: np.ndarray | None = None

    def _set(self, q: BaseVector) -> None:
        """Evaluate the forms at q; the elements are sorted anew only where q has changed."""
        self._q.vec.local_vec.data = q
        values = self._q.vec.FV().NumPy()
        if self._split_at is None or not np.array_equal(values, self._split_at):
            self._split.update(values.reshape(self._q.dim, -1).T)
            self._split_at = values.copy()

    def energy(self, q: BaseVector) -> float:
        """M^2(q)."""
        self._set(q)
        return integral(self._energy, self._mesh)

    def active(self, q: BaseVector) -> float:
        """Measure of the set where |q| + nu^/gamma > beta_gamma, by a low order: for records."""
        self._set(q)
        return integral(self._measure, self._mesh)

    def gradient(self, q: BaseVector) -> BaseVector:
        """([nu^ + gamma (|q| - beta_gamma)]^+ q/|q|, .) as a functional on R."""
        self._set(q)
        return self._gradient.Assemble().vec.local_vec

    def pattern(self) -> SparseMatrixd:
        """A matrix with all entries that ``hessian`` may ever have."""
        self._split.smooth.Set()
        self._split_at = None
        return self._hessian.Assemble(reallocate=True).mat.local_mat

    def hessian(self, q: BaseVector) -> SparseMatrixd:
        """gamma (chi_Q M(q) ., .) with M(q) of (6.1)."""
        self._set(q)
        return self._hessian.Assemble(reallocate=True).mat.local_mat
