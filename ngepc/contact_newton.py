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

from ngepc.complementarity import solve_complementarity
from ngepc.contact import ContactConstraint
from ngepc.functional import DualFunctional, NewtonSystem


def newton_system(functional: DualFunctional, inverse: str) -> NewtonSystem:
    """The system that suits the functional: with the contact constraint or without one.

    Parameters
    ----------
    functional
        J*_gamma.
    inverse
        NGSolve's name of the direct solver.
    """
    if functional.constraint is None:
        return NewtonSystem(functional, inverse)
    return ConstrainedSystem(functional, inverse)


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
        self._dofs = int(self.blocks.firsts[self._number]) + functional.constraint.dofs
        self._bound: np.ndarray | None = None

    @property
    def constraint(self) -> ContactConstraint:
        """The constraint of the functional in use."""
        return self.functional.constraint

    def _finish(self) -> None:
        """Fix the nodes at z_i = 0 in the assembled matrix."""
        if self._bound is not None:
            self._sum.decouple(self.blocks.Y.ndof + self._dofs[self._bound])

    def step(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """The step from v to the minimiser over z <= 0 of the quadratic model with gradient r."""
        z = v.FV().NumPy()[self._dofs].copy()
        if self._bound is None:
            self._bound = z >= 0
        self.factorise(v)
        self.back_substitutions = 0
        bound, psi = self._bound, r.FV().NumPy()[self._dofs].copy()
        free = self._response((-r).Evaluate(), -z)
        columns: dict[int, Response] = {}
        units = _scale(z + free.dz), _scale(psi + free.change)
        unit_x, unit_s = (np.where(bound, *u) for u in (units, units[::-1]))

        def column(i: int) -> np.ndarray:
            columns[i] = self._exchange(i)
            return _slack(columns[i].dz, columns[i].change, bound) * unit_x[i] / unit_s

        q = _slack(z + free.dz, psi + free.change, bound) / unit_s
        nothing = np.zeros(len(z))
        x = solve_complementarity(column, q, nothing > 0, nothing)
        if x is None:
            free.dv[:] = np.nan
            return free.dy, free.dv
        for i in np.flatnonzero(x):
            free.dy.data += float(x[i] * unit_x[i]) * columns[i].dy
            free.dv.data += float(x[i] * unit_x[i]) * columns[i].dv
        self._bound = np.where(bound, x <= 0, x > 0)
        self._settle(free.dv, z)
        return free.dy, free.dv

    def _settle(self, dv: BaseVector, z: np.ndarray) -> None:
        """Remove rounding: z_i + dz_i = 0 exactly at the bound, <= 0 elsewhere."""
        entries = dv.FV().NumPy()
        entries[self._dofs] = np.where(self._bound, -z, np.minimum(entries[self._dofs], -z))

    def _exchange(self, i: int) -> Response:
        """The response to node i leaving its side: w_i = 1 at the bound, lambda_i = 1 elsewhere."""
        r, dz = self.blocks.H_vector(), np.zeros(len(self._dofs))
        if self._bound[i]:
            dz[i] = -1.0
        else:
            r.FV().NumPy()[self._dofs[i]] = -1.0
        return self._response(r, dz)

    def _response(self, r: BaseVector, dz: np.ndarray) -> Response:
        """Solve (7.1) with right-hand side (0, r), but dz_i given at the nodes of the bound."""
        blocks, functional = self.blocks, self.functional
        bound = self._dofs[self._bound]
        given = blocks.H_vector()
        given.FV().NumPy()[bound] = dz[self._bound]
        right, load = r.CreateVector(), blocks.load.CreateVector()
        right.data = r - functional.tichonov_gradient(given)
        right.FV().NumPy()[bound] = dz[self._bound]
        load.data = -1 * (blocks.Lambda.T * given)
        dy, dv = self.solve(right, load)
        change = functional.tichonov_gradient(dv)
        change.data += blocks.Lambda * dy
        values = dv.FV().NumPy()[self._dofs].copy()
        return Response(dy, dv, values, change.FV().NumPy()[self._dofs].copy())


def _slack(z: np.ndarray, psi: np.ndarray, bound: np.ndarray) -> np.ndarray:
    """What must stay >= 0: lambda_i = -Psi_i at the bound, w_i = -z_i elsewhere."""
    return -np.where(bound, psi, z)


def _scale(values: np.ndarray) -> float:
    size = float(np.abs(values).max(initial=0.0))
    return size if size > 0 else 1.0
