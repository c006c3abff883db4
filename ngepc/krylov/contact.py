"""Newton steps under z <= 0 with MINRES: primal-dual active sets for the quadratic model.

The nodes at z_i = 0 leave the system as given values.  After each solve all nodes that violate
z_i <= 0 or lambda_i = -Psi_i >= 0 change sides at once, and MINRES goes on from where it stands.
"""

from __future__ import annotations

import numpy as np
from ngsolve.la import BaseVector

from ngepc.dual.functional import DualFunctional
from ngepc.krylov.solver import Krylov
from ngepc.krylov.system import KrylovSystem

MOST_EXCHANGES = 12
"""Solves in one Newton step; what is infeasible after them is cut off."""


class ConstrainedKrylovSystem(KrylovSystem):
    """(7.1) with z <= 0 by MINRES.

    Parameters
    ----------
    functional
        The first functional to be used; later ones must share its blocks.
    solver
        Options.
    """

    def __init__(self, functional: DualFunctional, solver: Krylov) -> None:
        super().__init__(functional, solver)
        self._number = functional.penalties.index(functional.constraint)
        self._dofs = functional.constraint.nodes.dofs
        self._bound: np.ndarray | None = None

    def direction(self, v: BaseVector, r: BaseVector) -> tuple[BaseVector, BaseVector]:
        """The step from v to the minimiser over z <= 0 of the quadratic model with gradient r."""
        z, psi = (self._nodal(self.blocks.part_of(w, self._number)) for w in (v, r))
        bound = z >= 0 if self._bound is None else self._bound
        x, right = self._unknowns(), (-r).Evaluate()
        for _ in range(MOST_EXCHANGES):
            self._fix(bound)
            self._solve(right, self._given(-z, bound), self._restricted(x, bound))
            z_new = z + self._nodal(x[self._number + 1])
            psi_new = psi + self._change_of_psi(x)
            following = np.where(bound, psi_new <= 0, z_new > 0)
            if (following == bound).all():
                break
            bound = following
        self._bound = bound
        entries = x[self._number + 1].FV().NumPy()
        entries[self._dofs] = np.where(bound, -z, np.minimum(entries[self._dofs], -z))
        return self._completed(x, self.blocks.H_vector())

    def _nodal(self, part: BaseVector) -> np.ndarray:
        return part.FV().NumPy()[self._dofs].copy()

    def _fix(self, bound: np.ndarray) -> None:
        free = [f.copy() for f in self._free]
        free[self._number][self._dofs[bound]] = False
        self._precondition(free)

    def _given(self, dz: np.ndarray, bound: np.ndarray) -> BaseVector:
        given = self.blocks.H_vector()
        part = self.blocks.part_of(given, self._number).FV().NumPy()
        part[self._dofs[bound]] = dz[bound]
        return given

    def _restricted(self, x: BaseVector, bound: np.ndarray) -> BaseVector:
        """``x`` as the first guess for the values that are not given."""
        x[self._number + 1].FV().NumPy()[self._dofs[bound]] = 0.0
        return x

    def _change_of_psi(self, x: BaseVector) -> np.ndarray:
        """The change of Psi_i along the step ``x`` at the nodes."""
        i = self._number
        change = x[i + 1].CreateVector()
        change.data = self._L[i] * x[0] + self._S[i].matrix * x[i + 1]
        return self._nodal(change)
