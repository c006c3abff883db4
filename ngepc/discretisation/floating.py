"""Rigid motions of parts of a body that contact alone holds, or springs much softer than it.

Some parts of a body may be held by contact alone.  Rigid motions z of such a
part need no energy, so that J has a minimum only if forces of contact can balance the loads l on
all of them: there are admissible forces x of the rows with

    l(z) = x . R z    for all z that the supports leave free.

This is a small linear program, because a part has at most six rigid motions.  In a solution the
rows with pressure or sticking friction determine z; a motion that vanishes on all of them is
undetermined.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy
from numpy.linalg import matrix_rank
from scipy.linalg import eigvalsh
from scipy.sparse import csr_matrix, diags, eye, hstack, vstack

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.supports import Supports
from ngepc.model.elements import vertex_coordinates
from ngepc.model.problem import Problem

SOFT = {False: 1e-4, True: 1e-3}
"""Approximate stiffness of all springs of a floating part relative to that of the part, without
and with friction.  With friction 1e-4 saves one Newton step of four, but 2 of 120 random problems
failed."""

LOOSE = 1e-6
"""Springs with a smaller stiffness than this part of the body's hold a rigid motion loosely."""

STIFFER = 1e-2
"""As ``SOFT``, of the springs with which contact of a loosely held part is found."""

SMALL = 1e-6  # smaller parts of the loads or of a motion count as zero


class LooselyHeld:
    """Parts in contact that are held by springs otherwise, and soft ones.

    Without contact they would travel so far that Newton's method does not find back.
    """

    share: float
    """Least stiffness of the springs against a rigid motion, as a part of the body's, >= 0."""
    springs: csr_matrix
    """Stiffer ones that resist the change of a Newton step, u flattened node by node."""

    def __init__(
        self,
        found: list[tuple[np.ndarray, np.ndarray]],
        problem: Problem,
        supports: Supports,
        diagonal: np.ndarray,
    ) -> None:
        """``found`` are motions and vertices of the parts, ``diagonal`` that of the stiffness."""
        self._supports = supports
        self._diagonal = diagonal
        x = vertex_coordinates(problem.mesh)
        soft = STIFFER / len(diagonal)
        self.springs = diags((soft * diagonal).ravel(), format="csr")
        shares = [self._share(motions) for motions, _ in found]
        self.share = min(shares)
        _, vertices = found[int(np.argmin(shares))]
        self._centre = ", ".join(f"{c:.3g}" for c in x[vertices].mean(axis=0))

    def _share(self, motions: np.ndarray) -> float:
        """The least ratio of the energies of springs and of the diagonal of the stiffness."""
        z = np.zeros((*self._diagonal.shape, motions.shape[2]))
        z[: len(motions)] = motions
        own = np.einsum("nia,ni,nib->ab", z, self._diagonal, z)
        flat = z.reshape(self._diagonal.size, -1)
        ratios = eigvalsh(flat.T @ (self._supports.stiffness @ flat), own)
        return max(float(ratios[0]), 0.0)

    @property
    def sentence(self) -> str:
        """What is wrong if no solution was found."""
        return (
            f"The springs of the part around ({self._centre}) have {self.share:.1g} of its own "
            "stiffness against one of its rigid motions: stiffer ones are needed, along all axes "
            "(a single number per place resists the normal displacement alone), or another support."
        )


class Floating:
    """The rigid motions of a body that only contact can hold, whatever the loads and gaps are."""

    centres: list[np.ndarray]  # of the parts
    motions: np.ndarray  # shape (nodes, N, motions); values at edges are zero
    springs: np.ndarray
    """Weak springs of the tangent, shape (nodes, N), zero if no part floats: they resist the change
    of a Newton step, not the displacement, and the convergence factor is about SOFT."""

    def __init__(
        self,
        found: list[tuple[np.ndarray, np.ndarray]],
        problem: Problem,
        contact: ContactConditions,
        diagonal: np.ndarray,
    ) -> None:
        """``found`` are motions and vertices of the parts, ``diagonal`` that of the stiffness."""
        self._contact = contact
        x = vertex_coordinates(problem.mesh)
        self.centres = [x[vertices].mean(axis=0) for _, vertices in found]
        count = sum(motions.shape[2] for motions, _ in found)
        self.motions = np.zeros((*diagonal.shape, count))
        self.springs = np.zeros_like(diagonal)
        if found:
            together = np.concatenate([motions for motions, _ in found], axis=2)
            self.motions[: len(x)] = together
            soft = SOFT[contact.friction.d > 0]
            self.springs = soft / len(diagonal) * diagonal
        self._on_rows = contact.matrix @ self.motions.reshape(diagonal.size, -1)

    @cached_property
    def compliance(self) -> np.ndarray:
        """C with C C' = R Z (Z' K Z)^-1 Z' R', the compliance of the rows by these springs K."""
        stiffness = np.einsum(
            "nia,ni,nib->ab", self.motions, self.springs, self.motions
        )
        return np.linalg.solve(np.linalg.cholesky(stiffness), self._on_rows.T).T

    def unheld(self, load: np.ndarray) -> str:
        """A message if contact cannot balance a load (nodes, N); empty if it can.

        It can if the minimum over x of the sum of |l(z) - x . R z| over the motions z is zero, with
        forces in units of the loads.  Tangential forces may reach the corners of the box around the
        cone of friction: hence a message is certain, but no message does not prove that friction is
        sufficient.
        """
        size = np.abs(load).sum()
        if not self.centres or size == 0:
            return ""
        n, k = self._on_rows.shape
        tied = self._contact.rows.tied
        friction = self._contact.friction
        m = len(tied)
        row = np.repeat(np.arange(m), friction.d)

        # The unknowns: forces x of the rows, then positive and negative parts of l(z) - x . R z.
        most = np.append(np.full(m, np.inf), friction.cap[row] / size)
        least = np.append(np.where(tied, -np.inf, 0.0), -most[m:])
        ranges = [*zip(least, most, strict=True), *[(0, None)] * (2 * k)]
        work = np.hstack([self._on_rows.T, np.eye(k), -np.eye(k)])
        wanted = np.einsum("ni,nik->k", load, self.motions) / size
        cost = np.concatenate([np.zeros(n), np.ones(2 * k)])

        # Coulomb's law, component by component: -mu n <= t <= mu n.
        by_pressure = np.flatnonzero(~friction.given[row])
        count = len(by_pressure)
        pressing = row[by_pressure]
        entries = (friction.coefficient[pressing], (np.arange(count), pressing))
        bound = csr_matrix(entries, (count, m))
        tangents = eye(n - m, format="csr")[by_pressure]
        zero = csr_matrix((count, 2 * k))
        limits = vstack([hstack([-bound, s * tangents, zero]) for s in (1, -1)])

        given = {"A_ub": limits, "b_ub": np.zeros(limits.shape[0])}
        found = scipy.optimize.linprog(
            cost, A_eq=work, b_eq=wanted, bounds=ranges, **given
        )
        if found.fun <= SMALL:
            return ""
        centre = ", ".join(f"{c:.3g}" for c in self.centres[-1])
        return f"Contact cannot hold the part around ({centre}) against its loads."

    def drift(self, residual: np.ndarray) -> np.ndarray:
        """The part of nodal forces, shape (nodes, N), that comes from rigid motions.

        A Newton step in which nothing but the weak springs S resists leaves forces S z of a motion.
        """
        dot = self._contact.processes.dot
        forces = np.moveaxis(self.springs[:, :, None] * self.motions, 2, 0)
        gram = np.array([[dot(a, b) for b in forces] for a in forces])
        work = np.array([dot(a, residual) for a in forces])
        return np.tensordot(np.linalg.solve(gram, work), forces, 1)

    def undetermined(self, forces: np.ndarray) -> int:
        """Number of rigid motions that active and sticking rows do not prevent."""
        if not self.centres:
            return 0
        normal = self._contact.normal(forces)
        bound = self._contact.bound(forces)
        presses = np.abs(normal) > SMALL * np.abs(normal).max(initial=0.0)
        size = np.linalg.norm(self._contact.tangential(forces), axis=1)
        sticks = np.repeat(size < (1 - SMALL) * bound, self._contact.friction.d)
        on_rows = self._on_rows[np.append(presses, sticks)]
        return self._on_rows.shape[1] - int(matrix_rank(on_rows, tol=SMALL))
