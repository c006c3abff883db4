"""Symmetric trace-free tensors in orthonormal coordinates, in place of P and M^(1/2) of (3.1).

P in (3.1) and the matrix M serve to turn |p|_F into a Euclidean norm of coordinates.  Any
orthonormal basis of the trace-free symmetric N x N matrices does the same, so that here
P(p) : P(q) = p . q and M is the identity.  There are d = N(N+1)/2 - 1 coordinates.
"""

import math

import numpy as np
from ngsolve import CF, CoefficientFunction, Grad, Id, InnerProduct, Sym, Trace

_R2, _R6 = math.sqrt(2.0), math.sqrt(6.0)

_BASIS = {
    2: np.array([[[1, 0], [0, -1]], [[0, 1], [1, 0]]]) / _R2,
    3: np.array(
        [
            np.diag([1, -1, 0]) / _R2,
            np.diag([1, 1, -2]) / _R6,
            np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0]]) / _R2,
            np.array([[0, 0, 1], [0, 0, 0], [1, 0, 0]]) / _R2,
            np.array([[0, 0, 0], [0, 0, 1], [0, 1, 0]]) / _R2,
        ]
    ),
}


def coordinates_count(N: int) -> int:
    """D = N(N+1)/2 - 1, the number of coordinates of a trace-free symmetric N x N matrix."""
    return N * (N + 1) // 2 - 1


def basis(N: int) -> np.ndarray:
    """The orthonormal basis, an array of shape (d, N, N); N is 2 or 3."""
    return _BASIS[N].copy()


def tensor(p: CoefficientFunction, N: int) -> CoefficientFunction:
    """The trace-free symmetric N x N matrix P(p) with coordinates ``p`` (d components)."""
    entries = np.moveaxis(_BASIS[N], 0, -1).reshape(N * N, -1)
    rows = [
        sum(float(c) * p[i] for i, c in enumerate(row) if c) if row.any() else CF(0.0)
        for row in entries
    ]
    return CF(tuple(rows), dims=(N, N))


def coordinates(A: CoefficientFunction, N: int) -> CoefficientFunction:
    """The d coordinates of dev A, for a symmetric N x N matrix ``A``."""
    return CF(tuple(InnerProduct(CF(tuple(E.ravel().tolist()), dims=(N, N)), A) for E in _BASIS[N]))


def strain(u: CoefficientFunction) -> CoefficientFunction:
    """Linearised strain eps(u), the symmetric part of the displacement gradient."""
    return Sym(Grad(u))


def deviator(A: CoefficientFunction, N: int) -> CoefficientFunction:
    """Dev A = A - tr(A)/N I."""
    return A - Trace(A) / N * Id(N)
