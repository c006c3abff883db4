"""The displacements of the faces of a mesh of tetrahedra, and their stiffness S.

Each tetrahedron has the stresses of ``element``.  Its best stress for a displacement delta that is
affine on each face is A^-1 B' delta, A its compliance and B x the moments of stresses x, so that
the moments are those of  S = sum of B A^-1 B'.  S is not assembled: products with it are sums over
the tetrahedra.  Its diagonal blocks, one for each face, precondition conjugate gradients.

Where the compliance of plastic flow is far larger than that of mean stresses, as with little
hardening or in nearly incompressible bodies, S is ill-conditioned: single precision loses mean
stresses and conjugate gradients stop too early.  There S has double precision and, on meshes that
are not too large, factors.

Facets with springs add their stiffness to S.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from copy import copy

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.element import ELEMENTS
from ngepc.bounds.face_matrix import FaceFactors, SmallMatrices
from ngepc.bounds.foundation import Foundation
from ngepc.bounds.polynomials import RULE, portions
from ngepc.bounds.sizes import power_of_two

CHUNK = 512  # tetrahedra whose matrices are made at once: they stay in the processor's cache
# conjugate gradients in single precision; the stress is made admissible in double
SINGLE = np.float32
ELEMENT = ELEMENTS[3]
FREE = ELEMENTS[3].free
AT_POINTS = np.einsum("qa,kacj->kqcj", RULE[4], ELEMENT.stresses.reshape(4, 4, 6, -1))
# means of the products of components of the basis, from a rule of degree two
GRAM = np.einsum("kqci,kqdj->cdij", AT_POINTS, AT_POINTS).reshape(36, -1) / 16
OWN = ELEMENT.moments[:, :FREE].copy()
"""Moments of the stresses without divergence, shape (36, 30)."""
SOFT = 1e3
"""Ratio of the compliances of a tetrahedron above which S counts as ill-conditioned."""
MOST_FACTORISED = 7000
"""Faces up to which S is factorised then: some 5 s and 0.5 GB."""


class Faces:
    """The unknowns on the faces, and the matrices of the tetrahedra.

    ``free`` (3 nf, 3) are components of delta that no support holds.  ``closed`` (3 nf, 3) has the
    unit normal where the normal component of delta is held, zero elsewhere; None if nowhere.
    Rollers hold delta on the ``slanted`` faces along unit vectors, in ``_rolled`` as in ``closed``.

    Numbers in single precision are divided by powers of two near their size, which changes no
    digit: otherwise some would overflow or vanish.  ``length`` and ``stress`` are those of the
    Jacobians and of the inverse compliances.
    """

    stress = 1.0
    soft = False
    _factors: FaceFactors | None = None

    def __init__(
        self, boundary: Boundary, foundation: Foundation, piola: np.ndarray
    ) -> None:
        self.foundation = foundation
        self.cells = c = boundary.cells
        self.free = np.repeat(boundary.given | ~c.outer[:, None], 3, axis=0)
        self._given = self.free.astype(float)
        self.closed = None
        self.slanted = boundary.slanted
        self._rolled = None
        if len(self.slanted):
            self._rolled = np.zeros(self.free.shape)
            slots = 3 * self.slanted[:, None] + np.arange(3)
            self._rolled[slots] = boundary.directions[:, None]
        self._piola = piola
        self.length = power_of_two(np.abs(c.jacobian).max())

    def another(self) -> Faces:
        """The same unknowns, for matrices of their own."""
        return copy(self)

    @contextmanager
    def holding(self, normals: np.ndarray) -> Iterator[None]:
        """Meanwhile delta is held along unit vectors (3 nf, 3), too; zero where it is not."""
        factors = self._factors
        self.closed = normals
        self._factors = None
        try:
            yield
        finally:
            self.closed = None
            self._factors = factors

    def fill(self, H: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Set the compliances d2 phi*/dz2 of the tetrahedra, (nt, 6, 6), and the blocks of S.

        Returns the moments (nt, 12, 3) of the best stresses for body forces (nt, 6) and delta = 0.
        """
        c = self.cells
        self._choose_precision(H)
        self.stress = 1 / power_of_two(np.abs(H).max(axis=(1, 2)).min())
        load = power_of_two(np.abs(loads).max())
        D = np.zeros((len(c.facets), 9, 9), dtype=self._kind)
        stresses = np.empty((len(H), FREE), dtype=self._kind)
        for part in portions(len(H), CHUNK):
            A = self._compliances(H, part)
            inverse = np.linalg.inv(A[:, :FREE, :FREE])
            given = (loads[part, :, None] / load).astype(self._kind)
            pulled = np.matmul(A[:, :FREE, FREE:], given)
            stresses[part] = -np.matmul(inverse, pulled)[:, :, 0]
            self._inverse[part] = inverse
            self._add_to_faces(D, inverse, part)
        springs = self.foundation.blocks / (self.stress * self.length)
        D[self.foundation.facets] += springs.astype(self._kind)
        self._invert_faces(D)
        forced = self._turned(loads @ ELEMENT.moments[:, FREE:].T)
        return self.moments(stresses.astype(float) * load) + forced

    def _choose_precision(self, H: np.ndarray) -> None:
        """Choose single or double precision for matrices with these compliances."""
        self.soft = is_soft(H)
        self._kind = float if self.soft else SINGLE
        self._jacobian = (self.cells.jacobian / self.length).astype(self._kind)
        self._own = OWN.astype(self._kind)
        self._inverse = np.empty((len(H), FREE, FREE), dtype=self._kind)
        self._factors = None

    def _compliances(self, H: np.ndarray, part: slice) -> np.ndarray:
        """The compliance matrices of some elements on the reference cell, (nt, 36, 36)."""
        P = np.ascontiguousarray(self._piola[part])
        product = np.matmul(np.matmul(P, H[part]), P.transpose(0, 2, 1))
        unit = self.stress / self.length
        product = product * self.cells.volume[part, None, None] * unit
        product = product.astype(self._kind).reshape(-1, 36)
        return (product @ GRAM.astype(self._kind)).reshape(-1, 36, 36)

    def _add_to_faces(self, D: np.ndarray, inverse: np.ndarray, part: slice) -> None:
        """Add the contributions of some elements to the diagonal blocks of their four faces."""
        c = self.cells
        J = self._jacobian[part, None]
        sign = c.sign[part]
        for k, own in enumerate(self._own.reshape(4, 3, 3, FREE)):
            as_face = np.argsort(c.place[part, k], axis=1)
            B = np.matmul(J, own[as_face]).reshape(-1, 9, FREE)
            block = np.matmul(np.matmul(B, inverse), B.transpose(0, 2, 1))
            for side in (sign[:, k] > 0, sign[:, k] < 0):
                D[c.facet_of[part, k][side]] += block[side]

    def _invert_faces(self, D: np.ndarray) -> None:
        """Invert the blocks of the faces, where components are held as zero."""
        held = ~self.free.reshape(-1, 9)
        diagonal = np.arange(9)
        D[held[:, :, None] | held[:, None, :]] = 0.0
        D[:, diagonal, diagonal] += held
        self._face_inverse = np.linalg.inv(D)
        self._face_inverse[:, diagonal, diagonal] -= held
        if self._rolled is not None:
            d = self._rolled[3 * self.slanted]
            self._face_inverse[self.slanted] = inverses_across(D[self.slanted], d)

    def _turned(self, reference: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) from those of the reference cell (nt, 36)."""
        return np.matmul(
            reference.reshape(-1, 12, 3), self.cells.jacobian.transpose(0, 2, 1)
        )

    def smooth(self, r: np.ndarray) -> np.ndarray:
        """Solve with the diagonal blocks of the faces; r and the result are (3 nf, 3)."""
        size = power_of_two(np.abs(r).max(initial=0.0))
        r = (r / size).astype(self._kind).reshape(-1, 9, 1)
        s = np.matmul(self._face_inverse, r).reshape(-1, 3).astype(float)
        s *= size / (self.stress * self.length)
        return s if self.closed is None else self.kept(s)

    def kept(self, r: np.ndarray) -> np.ndarray:
        """Displacements or moments (3 nf, 3) with held components set to zero."""
        r = r * self._given
        for directions in (self.closed, self._rolled):
            if directions is not None:
                r -= directions * np.einsum("si,si->s", directions, r)[:, None]
        return r

    def stresses(self, delta: np.ndarray) -> np.ndarray:
        """A^-1 B' delta of each tetrahedron, shape (nt, 30)."""
        x, size = self._pulled(delta)
        return x.astype(float) * (size * self.stress)

    def _pulled(self, delta: np.ndarray) -> tuple[np.ndarray, float]:
        """The same in units of ``stress``, for delta over the second result."""
        size = power_of_two(np.abs(delta).max(initial=0.0))
        delta = (delta / size).astype(self._kind)
        local = np.take(delta, self.cells.slot.reshape(-1, 12), axis=0)
        strains = np.matmul(local, self._jacobian).reshape(-1, 36) @ self._own
        return np.matmul(self._inverse, strains[:, :, None])[:, :, 0], size

    def moments(self, x: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) of stresses x (nt, 30)."""
        return self._turned(x @ OWN.T)

    def product(self, delta: np.ndarray) -> np.ndarray:
        """S delta, zero where supports hold."""
        x, size = self._pulled(delta)
        reference = (x @ self._own.T).reshape(-1, 12, 3)
        moments = np.matmul(reference, self._jacobian.transpose(0, 2, 1))
        pulled = self.foundation.pulled(delta)
        size *= self.stress * self.length
        return self.kept(self.cells.sums(moments) * size + pulled)

    @property
    def has_factors(self) -> bool:
        """Whether S is ill-conditioned, and not too large for ``solve``."""
        return self.soft and len(self.cells.facets) <= MOST_FACTORISED

    def solve(self, r: np.ndarray) -> np.ndarray:
        """S^-1 r by factors, which are computed once for a ``fill`` and what is held."""
        if self._factors is None:
            axes = np.eye(3)[:, None].repeat(len(self.free), axis=1)
            kept = np.stack([self.kept(axis) for axis in axes], axis=2)
            self._factors = FaceFactors(self._summands(), kept)
        return self._factors.solve(r) / (self.stress * self.length)

    def _summands(self) -> list[SmallMatrices]:
        """The matrices of the tetrahedra and of springs whose sum is S."""
        own = self._own.reshape(12, 3, FREE)
        B = np.matmul(self._jacobian[:, None], own).reshape(-1, 36, FREE)
        tetrahedra = np.matmul(np.matmul(B, self._inverse), B.transpose(0, 2, 1))
        springs = self.foundation.blocks / (self.stress * self.length)
        elastic = 3 * self.foundation.facets[:, None] + np.arange(3)
        return [
            SmallMatrices(tetrahedra, self.cells.slot.reshape(-1, 12)),
            SmallMatrices(springs, elastic),
        ]


def is_soft(H: np.ndarray) -> bool:
    """Whether S of tetrahedra with compliances H (..., 6, 6) is ill-conditioned."""
    own = np.diagonal(H, axis1=-2, axis2=-1)
    return bool((own.max(axis=-1) > SOFT * own.min(axis=-1)).any())


def inverses_across(D: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Inverses of matrices (k, 9, 9) on vectors at three vertices that have no part along d (k, 3).

    They are zero on the rest.
    """
    along = np.einsum("ab,ki,kj->kaibj", np.eye(3), d, d).reshape(-1, 9, 9)
    across = (np.eye(9) - along).astype(D.dtype)
    size = np.einsum("kii->k", D)[:, None, None] / 9
    whole = np.matmul(np.matmul(across, D), across) + size * along.astype(D.dtype)
    return np.matmul(np.matmul(across, np.linalg.inv(whole)), across)
