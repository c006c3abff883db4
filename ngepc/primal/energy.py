"""The energy of the displacement alone, its gradient and tangent, as symbolic forms of NGSolve."""

from __future__ import annotations

import numpy as np
from ngsolve import (
    H1,
    BaseMatrix,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Norm,
    dx,
    specialcf,
)
from scipy.sparse import csr_matrix

from ngepc.discretisation.balance import Balance, Frame
from ngepc.discretisation.contact_step import EXAMINED, FEW
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.stiffness import ComponentBlocks
from ngepc.linalg.direct import SOLVER_ERRORS, FactorisationError
from ngepc.model.elements import plastic_points
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.processes import require_whole
from ngepc.primal.return_mapping import ReturnMapping

ANSWER = 1e-8
"""Relative residual of linear systems that are solved by iterations."""


class ReducedEnergy(Frame):
    """min over p of J(u, p), (2.14), for nodal displacements u of shape (nodes, N).

    Its own ``Tangent``, with a solver as in ``PrimalOptions``; ``displacement`` and ``mapping`` are
    the GridFunction that holds the displacement looked at last, and ``ReturnMapping`` there.
    """

    stiffened = None

    def __init__(self, problem: Problem, inverse: str | object = "sparsecholesky") -> None:
        require_whole("primal_newton", problem.mesh)
        super().__init__(problem)
        space = self.supports.space
        self.displacement = GridFunction(space, name="displacement")
        self.mapping = ReturnMapping(problem, self.displacement)
        self.rules = plastic_points(problem.mesh, problem.order)
        u, v = space.TnT()
        self._forces = LinearForm(self._integral(self.mapping.power(v)))
        self._tangent = BilinearForm(self._integral(self.mapping.tangent(u, v)))
        self._density = self.mapping.energy_density.Compile()
        self._plastic = self.mapping.plastic.Compile()
        self._name, self._inverse = inverse, None
        matrix = self.assemble(self.supports.stiffness)
        diagonal = csr_matrix(tuple(map(np.asarray, matrix.CSR()))).diagonal()
        self.stiffness_diagonal = nodal(diagonal, problem)
        self.yield_forces = self._yield_forces()
        self._iterative, self.examined = None, EXAMINED
        if not isinstance(inverse, str):
            self._iterative = inverse.tangent(self, ComponentBlocks(matrix, self.free))
            self.examined = FEW

    def _integral(self, density: CoefficientFunction):
        return self.problem.kinematics.weight * density * dx(intrules=self.rules)

    def integral(self, density: CoefficientFunction) -> float:
        """The integral over the body by the rule that carries the plastic strain."""
        return float(Integrate(self._integral(density), self.problem.mesh))

    def set(self, u: np.ndarray) -> None:
        """Look at the nodal displacements ``u``."""
        self.displacement.vec.FV().NumPy()[:] = u.T.ravel()
        self.mapping.update()

    def energy(self, u: np.ndarray) -> float:
        """J(u) smallest over p (force times length)."""
        self.set(u)
        work = np.vdot(self.load - 0.5 * self.supports.pull(u), u)
        return self.integral(self._density) - float(work)

    def internal_forces(self, u: np.ndarray) -> np.ndarray:
        """Nodal forces of the stress and on the springs, shape (nodes, N).

        Minus ``load`` they are the gradient.
        """
        self.set(u)
        stress = nodal(self._forces.Assemble().vec.FV().NumPy(), self.problem)
        return stress + self.supports.pull(u)

    def assemble(self, springs: csr_matrix) -> BaseMatrix:
        """The tangent at the displacement looked at last, with springs."""
        matrix = self._tangent.Assemble().mat
        if springs.nnz:
            values, columns, starts = (np.asarray(a) for a in matrix.CSR())
            keys = np.repeat(np.arange(len(starts) - 1), np.diff(starts.astype(int)))
            keys = keys * matrix.width + columns
            springs, N = springs.tocoo(), self.problem.N
            i, j = (d % N * (matrix.width // N) + d // N for d in (springs.row, springs.col))
            values[np.searchsorted(keys, i * matrix.width + j)] += springs.data
        return matrix

    def linearise(self, here: Balance) -> None:
        """Assemble and factorise the tangent at a state; FactorisationError if that fails."""
        self.set(here.u)
        try:
            self._factorise(self.assemble(self.added))
        except SOLVER_ERRORS as error:
            raise FactorisationError(f"the factorisation failed: {error}") from error

    def _factorise(self, matrix: BaseMatrix) -> None:
        if self._iterative is not None:
            self._iterative.update(matrix)
        elif self._inverse is None:
            free = BitArray(self.free.T.ravel().tolist())
            self._inverse = matrix.Inverse(free, inverse=self._name)
        else:
            self._inverse.Update()

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements, zero where held, that the last tangent answers ``forces`` with."""
        if self._iterative is not None:
            return self._iterative.solve(forces, ANSWER)
        right = self.displacement.vec.CreateVector()
        right.FV().NumPy()[:] = forces.T.ravel()
        u = nodal((self._inverse * right).Evaluate().FV().NumPy(), self.problem)
        if not np.isfinite(u).all():
            raise FactorisationError("the tangent stiffness is singular")
        return np.where(self.free, u, 0.0)

    def plastic_measure(self, u: np.ndarray) -> float:
        """Area or volume of the part of the body that yields in this step."""
        self.set(u)
        return self.integral(self._plastic)

    def first_order_energy(self, u: np.ndarray) -> float:
        """l(u, p) + int beta |p| of (2.15), (2.16) at the plastic strain of ``u``.

        With a law of hardening the last term is what makes it twice J at the solution.
        """
        self.set(u)
        problem, kinematics = self.problem, self.problem.kinematics
        p, p_0, (_, alpha_2) = self.mapping.plastic_increment, problem.p_0, problem.alpha_0
        density = (
            2 * self.mapping.hardening_energy
            - self.mapping.bound * Norm(p)
            + InnerProduct(kinematics.coordinates(alpha_2), p)
            - 2 * as_scalar(problem.material.lame_mu) * InnerProduct(p_0, p_0)
            - InnerProduct(self.mapping.stress, p_0 + problem.eps_0)
        )
        return self.integral(density.Compile()) - float(np.vdot(self.load, u))

    def _yield_forces(self) -> float:
        form = LinearForm(H1(self.problem.mesh, order=1))
        density = as_scalar(self.problem.beta) / specialcf.mesh_size * form.space.TestFunction()
        form += self._integral(density)
        return float(np.linalg.norm(form.Assemble().vec.FV().NumPy()))
