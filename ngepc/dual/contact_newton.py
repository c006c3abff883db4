"""Newton steps under z <= 0: the quadratic model of J*_gamma is minimised over the feasible set.

One factorisation serves the whole step.  The nodes that the last step left at z_i = 0 keep that
value in the factorised matrix; which nodes leave or join them is a linear complementarity problem
for the pairs w_i = -(z_i + dz_i) >= 0, lambda_i >= 0, and each node that changes sides costs one
back-substitution, and all together one more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from ngsolve.la import BaseVector

from ngepc.dual.contact import ContactConstraint
from ngepc.dual.functional import DualFunctional, NewtonSystem
from ngepc.linalg.complementarity import solve_complementarity
from ngepc.linalg.direct import LinearSolver, linear_solver


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


class Column(NamedTuple):
    """What the exchange of one node does at all of them: changes of z_i and of Psi_i."""

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
        self._last = self._first + self.blocks.spaces[self._number].ndof
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
        self._columns: dict[int, Column] = {}
        self._fixed, self._rows = self._bound, self._cross.values()
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
        fixed, nothing = self._fixed, np.zeros(len(z))
        x = self._solution(-r, -z, nothing)
        dz, change = self._at_nodes(x)
        units = _scale(z + dz), _scale(psi + change)
        unit_x, unit_s = (np.where(fixed, *u) for u in (units, units[::-1]))

        def column(i: int) -> np.ndarray:
            c = self._column(i)
            return _slack(c.dz, c.change, fixed) * unit_x[i] / unit_s

        q = _slack(z + dz, psi + change, fixed) / unit_s
        solution = solve_complementarity(column, q, self._bound != fixed, nothing)
        if solution is None:
            x[:] = np.nan
            return self._completed(x)
        exchanged = solution.values * unit_x
        if exchanged.any():
            x = self._solution(-r, -z, exchanged)
        self._bound = fixed != (exchanged > 0)
        dy, dv = self._completed(x)
        self._settle(dv, z)
        return dy, dv

    def _settle(self, dv: BaseVector, z: np.ndarray) -> None:
        """Remove rounding: z_i + dz_i = 0 exactly at the bound, <= 0 elsewhere."""
        part = self._part(dv)
        dz = np.minimum(self._nodes.of_function(part), -z)
        everywhere = np.ones(len(z), dtype=bool)
        self._nodes.set_function(part, np.where(self._bound, -z, dz), everywhere)

    def _column(self, i: int) -> Column:
        """The response to node i changing sides: w_i = 1 if it is fixed, else lambda_i = 1."""
        if i not in self._columns:
            only_i = np.zeros(len(self._fixed))
            only_i[i] = 1.0
            x = self._solution(self.blocks.H_functional(), np.zeros(len(only_i)), only_i)
            self._columns[i] = self._at_nodes(x)
        return self._columns[i]

    def _solution(self, r: BaseVector, dz: np.ndarray, exchanged: np.ndarray) -> BaseVector:
        """Solve (7.1) for (0, r - lambda), where the fixed z_i change by dz_i - w_i.

        Parameters
        ----------
        r
            A functional on H, or an expression for one.
        dz
            Shape (m,).
        exchanged
            w_i at the fixed nodes, lambda_i at the others, shape (m,).
        """
        multipliers = self.blocks.H_functional()
        self._nodes.set_functional(self._part(multipliers), exchanged, ~self._fixed)
        right = self._right_hand_side((r - multipliers).Evaluate())
        entries, given = right.FV().NumPy(), np.zeros(len(right))
        fixed = self._first + self._nodes.among(self._fixed)
        given[fixed] = (dz - exchanged)[self._nodes.numbers][self._fixed[self._nodes.numbers]]
        self._cross.add_product(self._rows, -given, entries)
        entries[fixed] = given[fixed]  # the row of a fixed node is 1 z_i = dz_i on each process
        return self._back_substitution(right)

    def _at_nodes(self, x: BaseVector) -> Column:
        """Changes of z_i and of Psi_i along a solution x of (7.1)."""
        psi = x.CreateVector()
        psi[:] = 0.0
        self._cross.add_product(self._rows, x.FV().NumPy(), psi.FV().NumPy())
        dz, change = (w.Range(self._first, self._last) for w in (x, psi))
        return Column(self._nodes.of_function(dz), self._nodes.of_functional(change))


def _slack(z: np.ndarray, psi: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """What must stay >= 0: lambda_i = -Psi_i at the bound, w_i = -z_i elsewhere."""
    return -np.where(bound, psi, z)


def _scale(values: np.ndarray) -> float:
    size = float(np.abs(values).max(initial=0.0))
    return size if size > 0 else 1.0
