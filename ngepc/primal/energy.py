"""The energy of the displacement alone, its gradient and tangent, as symbolic forms of NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import (
    BaseMatrix,
    BilinearForm,
    BitArray,
    CoefficientFunction,
    GridFunction,
    Integrate,
    LinearForm,
    dx,
)
from scipy.sparse import csr_matrix

from ngepc.discretisation.balance import Balance, Frame
from ngepc.discretisation.contact_step import EXAMINED, FEW
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.stiffness import ComponentBlocks
from ngepc.linalg.direct import SOLVER_ERRORS, FactorisationError
from ngepc.model.elements import plastic_points
from ngepc.model.problem import Problem
from ngepc.model.processes import require_whole
from ngepc.primal.return_mapping import ReturnMapping

ANSWER = 1e-8
"""Relative residual of linear systems that are solved by iterations."""


class ReducedEnergy(Frame):
    """min over p of J(u, p), (2.14), for nodal displacements u of shape (nodes, N).

    Its own tangent, with a solver as in ``PrimalOptions``; ``displacement`` and ``mapping`` are the
    GridFunction that holds the displacement looked at last, and ``ReturnMapping`` there,
    ``forces``, ``density`` and ``plastic`` the forms of forces, of the energy and of what yields.
    """

    stiffened, back_substitutions, linear_iterations = None, 0, 0

    def __init__(self, problem: Problem, inverse: str | object = "sparsecholesky") -> None:
        require_whole("primal_newton", problem.mesh)
        super().__init__(problem)
        space = self.supports.space
        self.displacement = GridFunction(space, name="displacement")
        self.mapping = ReturnMapping(problem, self.displacement)
        self.rules = plastic_points(problem.mesh, problem.order)
        u, v = space.TnT()
        self.forces = LinearForm(self._integral(self.mapping.power(v)))
        self._tangent = BilinearForm(self._integral(self.mapping.tangent(u, v)))
        self.density, self.plastic = (
            self.mapping.energy_density.Compile(),
            self.mapping.plastic.Compile(),
        )
        matrix = self.assemble(self.supports.stiffness)
        diagonal = csr_matrix(tuple(map(np.asarray, matrix.CSR()))).diagonal()
        self.stiffness_diagonal = nodal(diagonal, problem)
        self._name, self._inverse, self._iterative = inverse, None, None
        if not isinstance(inverse, str):
            self._iterative = inverse.tangent(self, ComponentBlocks(matrix, self.free))
        self.examined = EXAMINED if self._iterative is None else FEW

    def _integral(self, density: CoefficientFunction):
        return self.problem.kinematics.weight * density * dx(intrules=self.rules)

    def integral(self, density: CoefficientFunction) -> float:
        """The integral over the body by the rule that carries the plastic strain."""
        return float(Integrate(self._integral(density), self.problem.mesh))

    def at(self, u: np.ndarray) -> ReducedEnergy:
        """The energy itself, looking at the nodal displacements ``u``."""
        self.displacement.vec.FV().NumPy()[:] = u.T.ravel()
        self.mapping.update()
        return self

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
        self.at(here.u)
        self.back_substitutions = self.linear_iterations = 0
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
        self.back_substitutions += 1
        if self._iterative is not None:
            u = self._iterative.solve(forces, ANSWER)
            self.linear_iterations = self._iterative.linear_iterations
            return u
        right = self.displacement.vec.CreateVector()
        right.FV().NumPy()[:] = forces.T.ravel()
        u = nodal((self._inverse * right).Evaluate().FV().NumPy(), self.problem)
        if not np.isfinite(u).all():
            raise FactorisationError("the tangent stiffness is singular")
        return np.where(self.free, u, 0.0)


@dataclass(frozen=True, eq=False)
class PrimalState(Balance):
    """An iterate: displacements and contact forces, see ``Balance``, and the discrete energy."""

    reduced: ReducedEnergy
    u: np.ndarray
    contact: np.ndarray

    @property
    def frame(self) -> ReducedEnergy:
        """The discrete energy, see ``Balance``."""
        return self.reduced

    def on_sphere(self) -> PrimalState:
        """The same state: its tangent always is that of the energy."""
        return self

    def along(self, change: np.ndarray) -> tuple[Callable, Callable]:
        """The work of the stress at u + t du times du, and the state there, see ``iteration``."""

        def moved(t: float, contact: np.ndarray) -> PrimalState:
            return PrimalState(self.reduced, self.u + t * change, contact)

        return lambda t: float(np.vdot(moved(t, self.contact).internal_forces, change)), moved

    @cached_property
    def energy(self) -> float:
        """J, smallest over p, and friction (force times length)."""
        reduced, u = self.reduced.at(self.u), self.u
        work = np.vdot(reduced.load - 0.5 * reduced.supports.pull(u), u)
        return reduced.integral(reduced.density) - float(work) + self.friction_work

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress and on the springs (nodes, N), the gradient plus the load."""
        reduced = self.reduced.at(self.u)
        stress = nodal(reduced.forces.Assemble().vec.FV().NumPy(), reduced.problem)
        return stress + reduced.supports.pull(self.u)

    @property
    def plastic_measure(self) -> float:
        """Area or volume of what yields in this step."""
        reduced = self.reduced.at(self.u)
        return reduced.integral(reduced.plastic)

    @property
    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        return self.reduced.at(self.u).mapping.flowing()
