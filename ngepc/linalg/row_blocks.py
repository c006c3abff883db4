"""Matrices with a block for the forces of each row; the normal forces of all rows come first."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix


def of_rows(blocks: np.ndarray, A: np.ndarray) -> np.ndarray:
    """``matrix_of_rows`` times a dense matrix: sparse products take longer for few rows."""
    m, size = blocks.shape[:2]
    n = A[:m, None]
    t = A[m:].reshape(m, size - 1, A.shape[1])
    parts = np.matmul(blocks, np.concatenate([n, t], axis=1))
    return np.concatenate([parts[:, 0], parts[:, 1:].reshape(A[m:].shape)])


def add_to_rows(A: np.ndarray, blocks: np.ndarray) -> None:
    """Add ``matrix_of_rows`` to a dense matrix."""
    places = force_places(blocks)
    A[places[:, :, None], places[:, None, :]] += blocks


def matrix_of_rows(blocks: np.ndarray) -> csr_matrix:
    """The matrix (n, n) with these blocks of the forces of each row, (m, 1 + d, 1 + d)."""
    places = force_places(blocks)
    given = blocks != 0
    rows = np.broadcast_to(places[:, :, None], blocks.shape)[given]
    columns = np.broadcast_to(places[:, None, :], blocks.shape)[given]
    return csr_matrix((blocks[given], (rows, columns)), shape=(places.size,) * 2)


def force_places(blocks: np.ndarray) -> np.ndarray:
    """Where the forces of each row stand among all, (m, 1 + d)."""
    m, size = blocks.shape[:2]
    tangents = np.arange(m, m * size).reshape(m, size - 1)
    return np.concatenate([np.arange(m)[:, None], tangents], axis=1)
