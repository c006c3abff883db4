"""Factors of the stiffness S of the faces of tetrahedra."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ngepc.linalg.direct import from_entries

COMPONENTS = np.arange(3)


class SmallMatrices(NamedTuple):
    """Symmetric matrices (k, 3 m, 3 m) of m vectors each, and the numbers (k, m) of these."""

    matrices: np.ndarray
    vectors: np.ndarray


class FaceFactors:
    """S^-1 for S that is a sum of small matrices, on vectors that no support holds.

    ``kept`` (n, 3, 3) are the projections of the n vectors onto what is not held.
    """

    def __init__(self, summands: list[SmallMatrices], kept: np.ndarray) -> None:
        stiffness = np.abs(np.einsum("tii->ti", summands[0].matrices)).mean()
        held = stiffness * (np.eye(3) - kept)
        alone = SmallMatrices(held, np.arange(len(kept))[:, None])
        parts = [*(projected(part, kept) for part in summands), alone]
        entries = [lower_entries(part) for part in parts]
        rows, columns, values = (np.concatenate(e) for e in zip(*entries, strict=True))
        size = kept[..., 0].size
        self._matrix = from_entries(rows, columns, values, size, size)
        self._inverse = self._matrix.Inverse(inverse="sparsecholesky")

    def solve(self, r: np.ndarray) -> np.ndarray:
        """S^-1 r for vectors r (n, 3) that have no part in what is held."""
        right = self._matrix.CreateColVector()
        right.FV().NumPy()[:] = r.ravel()
        found = self._matrix.CreateColVector()
        found.data = self._inverse * right
        return found.FV().NumPy().reshape(r.shape).copy()


def projected(part: SmallMatrices, kept: np.ndarray) -> SmallMatrices:
    """P M P for the projections P of the vectors of each matrix M."""
    matrices, vectors = part
    P = kept[vectors]
    for _ in range(2):
        by_vectors = matrices.reshape(*vectors.shape, 3, 3 * vectors.shape[1])
        product = np.matmul(P, by_vectors).reshape(matrices.shape)
        matrices = product.transpose(0, 2, 1)
    return SmallMatrices(matrices, vectors)


def lower_entries(part: SmallMatrices) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, columns and values on and below the diagonal, which sparsecholesky reads."""
    matrices, vectors = part
    numbers = (3 * vectors[:, :, None] + COMPONENTS).reshape(matrices.shape[:2])
    rows = np.broadcast_to(numbers[:, :, None], matrices.shape)
    columns = np.broadcast_to(numbers[:, None, :], matrices.shape)
    lower = rows >= columns
    return rows[lower], columns[lower], matrices[lower]
