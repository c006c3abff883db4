"""Newton steps under z <= 0: the quadratic model of J*_gamma is minimised over the feasible set.

One factorisation serves the whole step.  The nodes that the last step left at z_i = 0 keep that
value in the factorised matrix; which nodes leave or join them is a linear complementarity problem
for the pairs w_i = -(z_i + dz_i) >= 0, lambda_i >= 0, and each node that changes sides costs one
back-substitution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ngsolve.la import BaseVector

from ngepc.contact import ContactConstraint
from ngepc.direct import LinearSolver, linear_solver
from ngepc.functional import DualFunctional, NewtonSystem
from ngepc.primal.complementarity import solve_complementarity


def newton_system(functional: DualFunctional, inverse: str | LinearSolver) -> NewtonSystem:
    """The system that suits the functional: with the contact constraint or without one.

    Parameters
    ----------
    functional
        J*_gamma.
    inverse
        A ``LinearSolver`` or NGSolve's name of a direct one.
    """
    return linear_solver(inverse).newton_system(functional)


@dataclass(frozen=True)
class Response:
    """A solution (dy, dv) of (7.1) with what it means for the contact nodes.

    Parameters
    ----------
    dy, dv
        Primal and dual step.
    dz
        Change of z_i at the nodes, shape (m,).
    change
        Change of Psi_i at the nodes, shape (m,).
    """

    dy: BaseVector
    dv: BaseVector
    dz: np.ndarray
    change: np.ndarray


class ConstrainedSystem(NewtonSystem):
    """(7.1) with z <= 0.

    Parameters
    ----------
    functional
        The first functional to be used; later ones must share its blocks.
    inverse
        NGSolve's name of the direct solver.
    """

    def __init__(self, functional: DualFunctional, inverse: str) -> None:
        super().__init__(functional, inverse)
        self._number = functional.penalties.index(functional.constraint)
        self._first = self.blocks.Y.ndof + int(self.blocks.firsts[self._number])
        self._nodes = functional.constraint.nodes
        self._cross = self._sum.cross(self._first + self._nodes.dofs)
        self._bound: np.ndarray | None = None

    @property
    def constraint(self) -> ContactConstraint:
        """The constraint of the functional in use."""
        return self.functional.constraint

    def _part(self, v: BaseVector) -> BaseVector:
        """The component z of a vector on H."""
        return self.blocks.part_of(v, self._number)

    def _finish(self) -> None:
        """Fix the nodes at z_i = 0 in the assembled matrix."""
        self._columns: dict[int, Response] = {}
        self._fixed = self._bound
        if self._fixed is not None:
            self._cross.decouple(self._first + self._nodes.among(self._fixed))

    def factorise(self, v: BaseVector | None) -> None:
        """Assemble and factorise the Newton matrix at v with the nodes at the bound fixed."""
        if self._bound is None:
            self._bound = self._nodes.of_function(self._part(v)) >= 0
        super().factorise(v)

    def direction(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """The step from v to the minimiser over z <= 0 of the quadratic model with gradient r."""
        z = self._nodes.of_function(self._part(v))
        psi = self._nodes.of_functional(self._part(r))
        fixed = self._fixed
        free = self._response((-r).Evaluate(), -z)
        units = _scale(z + free.dz), _scale(psi + free.change)
        unit_x, unit_s = (np.where(fixed, *u) for u in (units, units[::-1]))

        def column(i: int) -> np.ndarray:
            c = self._column(i)
            return _slack(c.dz, c.change, fixed) * unit_x[i] / unit_s

        q = _slack(z + free.dz, psi + free.change, fixed) / unit_s
        solution = solve_complementarity(column, q, self._bound != fixed, np.zeros(len(z)))
        if solution is None:
            free.dv[:] = np.nan
            return free.dy, free.dv
        x = solution.values
        for i in np.flatnonzero(x):
            free.dy.data += float(x[i] * unit_x[i]) * self._columns[i].dy
            free.dv.data += float(x[i] * unit_x[i]) * self._columns[i].dv
        self._bound = np.where(fixed, x <= 0, x > 0)
        self._settle(free.dv, z)
        return free.dy, free.dv

    def _settle(self, dv: BaseVector, z: np.ndarray) -> None:
        """Remove rounding: z_i + dz_i = 0 exactly at the bound, <= 0 elsewhere."""
        part = self._part(dv)
        dz = np.minimum(self._nodes.of_function(part), -z)
        everywhere = np.ones(len(z), dtype=bool)
        self._nodes.set_function(part, np.where(self._bound, -z, dz), everywhere)

    def _column(self, i: int) -> Response:
        """The response to node i changing sides: w_i = 1 if it is fixed, else lambda_i = 1."""
        if i not in self._columns:
            r, dz = self.blocks.H_functional(), np.zeros(len(self._fixed))
            if self._fixed[i]:
                dz[i] = -1.0
            else:
                only_i = np.arange(len(dz)) == i
                self._nodes.set_functional(self._part(r), -1.0 * only_i, only_i)
            self._columns[i] = self._response(r, dz)
        return self._columns[i]

    def _response(self, r: BaseVector, dz: np.ndarray) -> Response:
        """Solve (7.1) with right-hand side (0, r), but dz_i given at the fixed nodes."""
        blocks, functional = self.blocks, self.functional
        given = blocks.H_vector()
        self._nodes.set_function(self._part(given), dz, self._fixed)
        right, load = r.CreateVector(), blocks.load.CreateVector()
        right.data = r - functional.tichonov_gradient(given)
        # the row of a fixed node is 1 z_i = dz_i on each process
        self._nodes.set_function(self._part(right), dz, self._fixed)
        load.data = -1 * (blocks.Lambda.T * given)
        dy, dv = self.solve(right, load)
        change = functional.tichonov_gradient(dv)
        change.data += blocks.Lambda * dy
        values = self._nodes.of_function(self._part(dv))
        return Response(dy, dv, values, self._nodes.of_functional(self._part(change)))


def _slack(z: np.ndarray, psi: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """What must stay >= 0: lambda_i = -Psi_i at the bound, w_i = -z_i elsewhere."""
    return -np.where(bound, psi, z)


def _scale(values: np.ndarray) -> float:
    size = float(np.abs(values).max(initial=0.0))
    return size if size > 0 else 1.0
