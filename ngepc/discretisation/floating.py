"""Rigid motions of parts of a body that contact alone holds, or springs much softer than it.

Some parts of a body may be held by contact alone.  Rigid motions z of such a
part need no energy, so that J has a minimum only if forces of contact can balance the loads l on
all of them: there are admissible forces x of the rows with

    l(z) = x . R z    for all z that the supports leave free.

This is a small linear program, because a part has at most six rigid motions.  In a solution the
rows with pressure or sticking friction determine z, and in space rows that slip its part across the
slip; a motion that vanishes on all of them is undetermined.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.linalg import matrix_rank
from scipy.linalg import eigvalsh, null_space
from scipy.sparse import csr_matrix, diags

from ngepc.discretisation.conditions import ContactConditions
from ngepc.discretisation.held_by_contact import missing
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

SAME = 1e-8  # smaller changes of gaps in a rigid motion are rounding errors
SMALL = 1e-6  # smaller parts of the loads or of a motion count as zero


def as_coordinates(centre: np.ndarray) -> str:
    """The coordinates of the centre of a part."""
    return ", ".join(f"{c:.3g}" for c in centre)


def at_nodes(motions: np.ndarray, count: int) -> np.ndarray:
    """Motions at vertices, shape (vertices, N, k), at so many nodes; zero at edges."""
    z = np.zeros((count, *motions.shape[1:]))
    z[: len(motions)] = motions
    return z


def gram_matrix(z: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """The products z' D z of motions (nodes, N, k) with a diagonal stiffness D (nodes, N)."""
    return np.einsum("nia,ni,nib->ab", z, diagonal, z)


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
        self._centre = as_coordinates(x[vertices].mean(axis=0))

    def _share(self, motions: np.ndarray) -> float:
        """The least ratio of the energies of springs and of the diagonal of the stiffness."""
        z = at_nodes(motions, len(self._diagonal))
        own = gram_matrix(z, self._diagonal)
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
        none = np.zeros((*x.shape, 0))
        together = np.concatenate([none, *(motions for motions, _ in found)], axis=2)
        self.motions = at_nodes(together, len(diagonal))
        self.springs = np.zeros_like(diagonal)
        if found:
            soft = SOFT[contact.friction.d > 0]
            self.springs = soft / len(diagonal) * diagonal
        self._on_rows = contact.matrix @ self.motions.reshape(diagonal.size, -1)

    @cached_property
    def compliance(self) -> np.ndarray:
        """C with C C' = R Z (Z' K Z)^-1 Z' R', the compliance of the rows by these springs K."""
        stiffness = gram_matrix(self.motions, self.springs)
        return np.linalg.solve(np.linalg.cholesky(stiffness), self._on_rows.T).T

    def unheld(self, load: np.ndarray) -> str:
        """A message if contact cannot balance a load (nodes, N); empty if it can.

        It can if the minimum over x of the sum of |l(z) - x . R z| over the motions z is zero, with
        forces in units of the loads.
        """
        size = np.abs(load).sum()
        if not self.centres or size == 0:
            return ""
        law = self._contact.friction
        units = replace(law, cap=law.cap / size)
        wanted = np.einsum("ni,nik->k", load, self.motions) / size
        if missing(wanted, self._on_rows, units, SMALL) <= SMALL:
            return ""
        return f"Contact cannot hold the part around ({self.place}) against its loads."

    @property
    def place(self) -> str:
        """The coordinates of the part that messages name."""
        return as_coordinates(self.centres[-1])

    def rigid_part(self, change: np.ndarray, closed: np.ndarray) -> np.ndarray:
        """The rigid motion, shape (nodes, N), that is closest to a change of u.

        Of those that leave the gaps of some rows, boolean of shape (m,), as they are.
        """
        kept = self._on_rows[: len(closed)][closed]
        free = np.eye(self.motions.shape[2])
        if len(kept):
            free = null_space(np.linalg.qr(kept, mode="r"), SAME)
        motions = self.motions @ free
        work = np.einsum("nia,ni->a", motions, self.springs * change)
        return motions @ np.linalg.solve(gram_matrix(motions, self.springs), work)

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
        """Number of rigid motions that active rows and friction do not prevent.

        Of a row that slips, friction has the direction of the slip: in space it determines the
        motion across.
        """
        if not self.centres:
            return 0
        normal = self._contact.normal(forces)
        bound = self._contact.bound(forces)
        presses = np.abs(normal) > SMALL * np.abs(normal).max(initial=0.0)
        friction = self._contact.tangential(forces)
        size = np.linalg.norm(friction, axis=1)
        sticks = size < (1 - SMALL) * bound
        d = self._contact.friction.d
        kept = [self._on_rows[np.append(presses, np.repeat(sticks, d))]]
        if d == 2:
            slips = ~sticks & (size > 0)
            across = friction[slips][:, ::-1] * [-1, 1] / size[slips, None]
            along = self._on_rows[len(normal) :].reshape(len(normal), d, -1)[slips]
            kept.append(np.einsum("ic,ick->ik", across, along))
        rank = matrix_rank(np.concatenate(kept), tol=SMALL)
        return self._on_rows.shape[1] - int(rank)
