"""Parts of a body that nothing but contact with other parts holds.

Rigid motions z of such a part cost no energy, so that J has a minimum only if forces of contact can
balance the loads l on all of them: there are admissible forces x of the rows with

    l(z) = x . R z    for all z that the supports leave free.

That is a linear program, small since a part has at most six motions.  In a solution the rows that
press or stick determine z; a motion that is zero on all of them is left undetermined.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.linalg import matrix_rank
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, eye, hstack, vstack

from ngepc.discretisation.conditions import ContactConditions
from ngepc.model.elements import vertex_coordinates
from ngepc.model.problem import Problem
from ngepc.model.support import floating_motions

SOFT = {False: 1e-4, True: 1e-3}
"""Stiffness of all springs of a floating part, about, relative to that of the part, by friction.

With friction 1e-4 saves a Newton step of four, but leaves small problems that are so badly
conditioned that 2 of 120 random ones failed.
"""

SMALL = 1e-6  # part of the loads, or of a motion, that counts as none


class Floating:
    """The rigid motions that are left to contact, for nodal forces of the loads (nodes, N)."""

    def __init__(self, problem: Problem, contact: ContactConditions, load: np.ndarray) -> None:
        self._contact, self._load = contact, load
        found = floating_motions(problem)
        x = vertex_coordinates(problem.mesh)
        self.centres = [x[vertices].mean(axis=0) for _, vertices in found]
        self._motions = np.zeros((*load.shape, sum(m.shape[2] for m, _ in found)))
        if found:
            self._motions[: len(x)] = np.concatenate([motions for motions, _ in found], axis=2)
        self._on_rows = contact.matrix @ self._motions.reshape(load.size, -1)

    def __bool__(self) -> bool:
        return bool(self.centres)

    def springs(self, stiffness_diagonal: np.ndarray) -> np.ndarray:
        """Weak springs of the tangent, shape (nodes, N), zero if no part floats.

        They resist the change of each Newton step, not the displacement: a proximal term that does
        not change the solution and costs about a factor SOFT in the speed of convergence.
        """
        soft = SOFT[self._contact.friction.d > 0] if self else 0.0
        return soft / len(stiffness_diagonal) * stiffness_diagonal

    def compliance(self, stiffness_diagonal: np.ndarray) -> np.ndarray:
        """C with C C' = R Z (Z' K Z)^-1 Z' R', the compliance of the rows by these springs K."""
        if not self:
            return self._on_rows
        k = self.springs(stiffness_diagonal)
        stiffness = np.einsum("nia,ni,nib->ab", self._motions, k, self._motions)
        return np.linalg.solve(np.linalg.cholesky(stiffness), self._on_rows.T).T

    @cached_property
    def unheld(self) -> str:
        """Why contact cannot balance the loads, empty if it can.

        Tangential forces may reach the corners of the box around the cone of friction: what is
        said here is certain, that nothing is said does not prove that friction is enough.
        """
        size = np.abs(self._load).sum()
        if not self or size == 0:
            return ""
        loads = np.einsum("ni,nik->k", self._load, self._motions) / size
        if self._missing(loads, size) <= SMALL:
            return ""
        centre = ", ".join(f"{c:.3g}" for c in self.centres[-1])
        return f"Contact cannot hold the part around ({centre}) against its loads."

    def _missing(self, loads: np.ndarray, size: float) -> float:
        """The least sum of |l(z) - x . R z| over the motions z, all forces in units of ``size``."""
        n, k = self._on_rows.shape
        tied, friction = self._contact.rows.tied, self._contact.friction
        m, row = len(tied), np.repeat(np.arange(len(tied)), friction.d)
        most = np.append(np.full(m, np.inf), friction.cap[row] / size)
        least = np.append(np.where(tied, -np.inf, 0.0), -most[m:])
        grip = csr_matrix((friction.coefficient[row], (np.arange(n - m), row)), (n - m, m))
        no = csr_matrix((n - m, 2 * k))
        limits = vstack([hstack([-grip, s * eye(n - m), no]) for s in (1, -1)])
        found = linprog(
            np.concatenate([np.zeros(n), np.ones(2 * k)]),
            A_ub=limits,
            b_ub=np.zeros(limits.shape[0]),
            A_eq=np.hstack([self._on_rows.T, np.eye(k), -np.eye(k)]),
            b_eq=loads,
            bounds=[*zip(least, most, strict=True), *[(0, None)] * (2 * k)],
        )
        return found.fun

    def undetermined(self, forces: np.ndarray) -> int:
        """How many motions the rows with contact forces leave free: those that press or stick."""
        if not self:
            return 0
        normal, bound = self._contact.normal(forces), self._contact.bound(forces)
        presses = np.abs(normal) > SMALL * np.abs(normal).max(initial=0.0)
        size = np.linalg.norm(self._contact.tangential(forces), axis=1)
        sticks = size < (1 - SMALL) * bound
        presses = np.append(presses, np.repeat(sticks, self._contact.friction.d))
        return self._on_rows.shape[1] - int(matrix_rank(self._on_rows[presses], tol=SMALL))
