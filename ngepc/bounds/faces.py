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

OWN = np.ascontiguousarray(ELEMENT.moments[:, :FREE])
"""Moments of the stresses without divergence, shape (36, 30)."""


class Faces:
    """The unknowns on the faces, and the matrices of the tetrahedra.

    ``free`` (3 nf, 3) are components of delta that no support holds, ``piola`` (nt, 6, 6) gives
    stress coordinates from the components of reference stresses, ``closed`` (3 nf, 3) has unit
    normals where delta is held along them, zero elsewhere; None for none.
    """

    def __init__(self, boundary: Boundary) -> None:
        self.cells = c = boundary.cells
        self.free = np.repeat(boundary.given | ~c.outer[:, None], 3, axis=0)
        self._given, self.closed = self.free.astype(float), None
        self.piola = ELEMENT.piola(c)
        self._inverse = np.empty((len(c.nodes), FREE, FREE), dtype=SINGLE)
        self._jacobian = c.jacobian.astype(SINGLE)
        self._loaded = np.empty((len(c.nodes), FREE, 6), dtype=SINGLE)
        self._blocks = np.empty((len(c.nodes), 4, 9, 9), dtype=SINGLE)
        numbers = np.arange(4 * len(c.nodes))
        self._sides = np.full((len(c.facets), 2), -1)
        self._sides[c.facet_of.ravel(), np.where(c.sign.ravel() > 0, 0, 1)] = numbers

    def fill(self, H: np.ndarray) -> None:
        """Take the compliances d2 phi*/dz2 of the tetrahedra, shape (nt, 6, 6)."""
        for part in portions(len(H), CHUNK):
            P, volume = self.piola[part], self.cells.volume[part, None, None]
            product = np.matmul(np.matmul(P, H[part]), P.transpose(0, 2, 1)) * volume
            A = (product.astype(SINGLE).reshape(-1, 36) @ GRAM).reshape(-1, 36, 36)
            self._loaded[part] = A[:, :FREE, FREE:]
            self._inverse[part] = np.linalg.inv(A[:, :FREE, :FREE])
            self._fill_blocks(part)
        self._invert_blocks()

    def _fill_blocks(self, part: slice) -> None:
        """The blocks of S of each face, its vertices in the order of the face."""
        J, place = self._jacobian[part], self.cells.place[part]
        n, own = np.arange(len(J)), OWN.astype(SINGLE)
        half = np.matmul(self._inverse[part], own.T)
        for k in range(4):
            face = slice(9 * k, 9 * k + 9)
            block = np.matmul(own[face], half[:, :, face]).reshape(-1, 9, 3, 3)
            block = np.matmul(block, J[:, None].transpose(0, 1, 3, 2)).reshape(-1, 9, 9)
            block = block.transpose(0, 2, 1).reshape(-1, 9, 3, 3)
            block = np.matmul(block, J[:, None].transpose(0, 1, 3, 2)).reshape(-1, 9, 9)
            at = (3 * place[:, k, :, None] + np.arange(3)).reshape(-1, 9)
            turned = np.empty_like(block)
            turned[n[:, None, None], at[:, :, None], at[:, None]] = block
            self._blocks[part, k] = turned

    def _invert_blocks(self) -> None:
        first, second = self._sides.T
        flat = self._blocks.reshape(-1, 9, 9)
        D = flat[first]
        D[second >= 0] += flat[second[second >= 0]]
        held = ~self.free.reshape(-1, 9)
        D[held[:, :, None] | held[:, None, :]] = 0.0
        D[:, np.arange(9), np.arange(9)] += held
        self._face_inverse = np.linalg.inv(D)
        self._face_inverse[:, np.arange(9), np.arange(9)] -= held

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

    def work(self, delta: np.ndarray) -> np.ndarray:
        """B' delta of each tetrahedron, in single precision, shape (nt, 30)."""
        local = np.take(delta.astype(SINGLE), self.cells.slot.reshape(-1, 12), axis=0)
        return np.matmul(local, self._jacobian).reshape(-1, 36) @ OWN.astype(SINGLE)

    def answer(self, strains: np.ndarray) -> np.ndarray:
        """A^-1 times vectors of the tetrahedra, both (nt, 30); in single precision."""
        return np.matmul(self._inverse, strains.astype(SINGLE)[:, :, None])[:, :, 0]

    def pulled(self, loads: np.ndarray) -> np.ndarray:
        """What loads (nt, 6) add to the linear term c, shape (nt, 30)."""
        return np.matmul(self._loaded, loads[:, :, None].astype(SINGLE))[:, :, 0]

    def moments(self, x: np.ndarray, loads: np.ndarray | None = None) -> np.ndarray:
        """Outward moments (nt, 12, 3) of stresses x (nt, 30) and of loads (nt, 6)."""
        reference = x.astype(float) @ OWN.T
        if loads is not None:
            reference = reference + loads @ ELEMENT.moments[:, FREE:].T
        return np.matmul(reference.reshape(-1, 12, 3), self.cells.jacobian.transpose(0, 2, 1))

    def product(self, delta: np.ndarray) -> np.ndarray:
        """S delta, zero where supports hold."""
        reference = self.answer(self.work(delta)) @ OWN.T.astype(SINGLE)
        moments = np.matmul(reference.reshape(-1, 12, 3), self._jacobian.transpose(0, 2, 1))
        return self.kept(self.cells.sums(moments))

    def spread(self, u: np.ndarray) -> np.ndarray:
        """Nodal displacements (nodes, 3) on the faces."""
        return np.take(u, self.cells.facets.ravel(), axis=0)

    def at_nodes(self, r: np.ndarray) -> np.ndarray:
        """The transpose of ``spread``."""
        return self.cells.at_nodes(r, self.cells.facets)
