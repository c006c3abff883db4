"""Stresses on tetrahedra that nearly minimise a quadratic dual energy, by unknowns on the faces.

Each tetrahedron has the stresses of ``alfeld``.  That their tractions are continuous, and the given
ones on the boundary, is asked for by displacements delta of the faces, affine on each face and
independent from face to face: for given delta the best stress of a tetrahedron is known,

    A x = B' delta - c,     A its compliance, B x its moments,

and delta solves  S delta = b  with  S = sum of B A^-1 B'.  For delta that are continuous S is the
stiffness matrix of displacements of order one: the coarse solver of conjugate gradients.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.element import ELEMENTS
from ngepc.bounds.parts import RULE, portions

CHUNK = 512
"""Tetrahedra whose matrices are made at once: they stay in the processor's cache."""

SINGLE = np.float32
"""Conjugate gradients only steer the search: what is found is made admissible in double."""

ELEMENT, FREE = ELEMENTS[3], ELEMENTS[3].free
AT_POINTS = np.einsum("qa,kacj->kqcj", RULE[4], ELEMENT.stresses.reshape(4, 4, 6, -1))
GRAM = np.einsum("kqci,kqdj->cdij", AT_POINTS, AT_POINTS).reshape(36, -1).astype(SINGLE) / 16
"""Means of the products of components of the basis, from a rule of degree two."""

OWN = ELEMENT.moments[:, :FREE].copy()
OWN_SINGLE = OWN.astype(SINGLE)
"""Moments of the stresses without divergence, shape (36, 30)."""


class Faces:
    """The unknowns on the faces, and the matrices of the tetrahedra.

    ``free`` (3 nf, 3) are components of delta that no support holds; ``closed`` (3 nf, 3) has unit
    normals where delta is held along them, zero elsewhere; None for none.
    """

    def __init__(self, boundary: Boundary, piola: np.ndarray) -> None:
        self.cells = c = boundary.cells
        self.free = np.repeat(boundary.given | ~c.outer[:, None], 3, axis=0)
        self._given, self.closed, self._piola = self.free.astype(float), None, piola
        self._inverse = np.empty((len(c.nodes), FREE, FREE), dtype=SINGLE)
        self._jacobian = c.jacobian.astype(SINGLE)

    def fill(self, H: np.ndarray, loads: np.ndarray) -> np.ndarray:
        """Take the compliances d2 phi*/dz2 of the tetrahedra, (nt, 6, 6), and the blocks of S.

        Returned are the moments (nt, 12, 3) of the best stresses with body forces (nt, 6) and
        delta = 0.
        """
        c, count = self.cells, len(self.cells.facets)
        D, x = np.zeros((count, 9, 9), dtype=SINGLE), np.empty((len(H), FREE), dtype=SINGLE)
        for part in portions(len(H), CHUNK):
            P, J, sign = self._piola[part], self._jacobian[part, None], c.sign[part]
            product = np.matmul(np.matmul(P, H[part]), P.transpose(0, 2, 1))
            product = (product * c.volume[part, None, None]).astype(SINGLE)
            A = (product.reshape(-1, 36) @ GRAM).reshape(-1, 36, 36)
            inverse = self._inverse[part] = np.linalg.inv(A[:, :FREE, :FREE])
            pulled = np.matmul(A[:, :FREE, FREE:], loads[part, :, None].astype(SINGLE))
            x[part] = -np.matmul(inverse, pulled)[:, :, 0]
            for k, own in enumerate(OWN_SINGLE.reshape(4, 3, 3, FREE)):
                order = np.argsort(c.place[part, k], axis=1)  # as the vertices of the face
                B = np.matmul(J, own[order]).reshape(-1, 9, FREE)
                block = np.matmul(np.matmul(B, inverse), B.transpose(0, 2, 1))
                for side in (sign[:, k] > 0, sign[:, k] < 0):
                    D[c.facet_of[part, k][side]] += block[side]
        held, diagonal = ~self.free.reshape(-1, 9), np.arange(9)
        D[held[:, :, None] | held[:, None, :]] = 0.0
        D[:, diagonal, diagonal] += held
        self._face_inverse = np.linalg.inv(D)
        self._face_inverse[:, diagonal, diagonal] -= held
        return self.moments(x) + self._turned(loads @ ELEMENT.moments[:, FREE:].T)

    def _turned(self, reference: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) from those of the reference cell (nt, 36)."""
        return np.matmul(reference.reshape(-1, 12, 3), self.cells.jacobian.transpose(0, 2, 1))

    def smooth(self, r: np.ndarray) -> np.ndarray:
        """The blocks of the faces solved for r, both (3 nf, 3)."""
        s = np.matmul(self._face_inverse, r.astype(SINGLE).reshape(-1, 9, 1)).reshape(-1, 3)
        return s if self.closed is None else self.kept(s)

    def kept(self, r: np.ndarray) -> np.ndarray:
        """Displacements or moments (3 nf, 3) without the components that are held."""
        r = r * self._given
        if self.closed is not None:
            r -= self.closed * np.einsum("si,si->s", self.closed, r)[:, None]
        return r

    def stresses(self, delta: np.ndarray) -> np.ndarray:
        """A^-1 B' delta of each tetrahedron, in single precision, shape (nt, 30)."""
        local = np.take(delta.astype(SINGLE), self.cells.slot.reshape(-1, 12), axis=0)
        strains = np.matmul(local, self._jacobian).reshape(-1, 36) @ OWN_SINGLE
        return np.matmul(self._inverse, strains[:, :, None])[:, :, 0]

    def moments(self, x: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) of stresses x (nt, 30)."""
        return self._turned(x.astype(float) @ OWN.T)

    def product(self, delta: np.ndarray) -> np.ndarray:
        """S delta, zero where supports hold."""
        reference = (self.stresses(delta) @ OWN_SINGLE.T).reshape(-1, 12, 3)
        moments = np.matmul(reference, self._jacobian.transpose(0, 2, 1))
        return self.kept(self.cells.sums(moments))
