"""The Slobodeckij double integral of section 5 with s = 1/2 on a polygonal contact boundary.

    |z|^2 = int_Gc int_Gc (z(x) - z(y))^2 / |x - y|^2 ds ds     (two dimensions, z in P1)

A pair of segments is integrated by what it shares.  The same segment: z is affine, the quotient
is the square of its slope.  A vertex P: x = P + s a, y = P + t b makes the integrand homogeneous
of degree 0 in (s, t), Duffy's substitution leaves rational functions of one variable, which have
closed forms.  Nothing: Gauss points, after bisection until the segments are as far apart as they
are long.
"""

from __future__ import annotations

import numpy as np
from ngsolve import BND, FESpace
from ngsolve.la import SparseMatrixd

from ngepc.discretisation.prolongation import vertex_dofs
from ngepc.linalg.assembly import from_entries
from ngepc.model.problem import Problem

GAUSS_POINTS = 8
MOST_BISECTIONS = 14
_PAIRS_AT_ONCE = 20_000


def slobodeckij_matrix(points: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """The symmetric matrix W with z . W z = |z|^2 for the P1 function with vertex values z.

    Parameters
    ----------
    points
        Vertices in the plane, shape (n, 2).
    segments
        Pairs of vertex numbers, shape (m, 2); open or closed curves, one or several.

    Returns
    -------
    numpy.ndarray
        Shape (n, n), dense; constants are in its kernel.  It has no unit.

    Raises
    ------
    ValueError
        If segments without a common vertex touch: the integral is infinite there.
    """
    W = np.zeros((len(points),) * 2)
    _add(W, segments, np.broadcast_to([[1.0, -1.0], [-1.0, 1.0]], (len(segments), 2, 2)))
    first, second = np.triu_indices(len(segments), 1)
    for k in range(0, len(first), _PAIRS_AT_ONCE):
        S, T = segments[first[k : k + _PAIRS_AT_ONCE]], segments[second[k : k + _PAIRS_AT_ONCE]]
        shared = (S[:, :, None] == T[:, None, :]).any(axis=(1, 2))
        corners = _corners(S[shared], T[shared])
        _add(W, corners, 2 * _adjacent(points[corners]))
        pairs = np.hstack([S[~shared], T[~shared]])
        _add(W, pairs, 2 * _separated(points[pairs]))
    return W


def _add(W: np.ndarray, numbers: np.ndarray, local: np.ndarray) -> None:
    np.add.at(W, (numbers[:, :, None], numbers[:, None, :]), local)


def _corners(S: np.ndarray, T: np.ndarray) -> np.ndarray:
    """Vertex numbers (P, end of S, end of T) of pairs that share the vertex P."""
    swap_S = (S[:, :1] != T).all(axis=1)
    S = np.where(swap_S[:, None], S[:, ::-1], S)
    swap_T = T[:, 0] != S[:, 0]
    T = np.where(swap_T[:, None], T[:, ::-1], T)
    return np.column_stack([S[:, 0], S[:, 1], T[:, 1]])


def _adjacent(x: np.ndarray) -> np.ndarray:
    """Local matrices for the vertices (P, P + a, P + b), shape (m, 3, 3)."""
    a, b = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    (a_0, a_1, a_2), (b_0, b_1, b_2) = _moments(a, b), _moments(b, a)
    J = np.empty((len(x), 2, 2))
    J[:, 0, 0], J[:, 1, 1] = a_0 + b_2, a_2 + b_0
    J[:, 0, 1] = J[:, 1, 0] = -(a_1 + b_1)
    J *= (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1) / 2)[:, None, None]
    slopes = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])  # z(P + a) - z(P), z(P + b) - z(P)
    return slopes.T @ J @ slopes


def _moments(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """int_0^1 t^k / |a - t b|^2 dt for k = 0, 1, 2."""
    A, B, g = (np.einsum("ij,ij->i", *pair) for pair in ((a, a), (b, b), (a, b)))
    w = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    straight = w <= 1e-9 * np.abs(A - g)  # the angle at P is 180 degrees: arctan(r) / r -> 1
    m_0 = np.where(straight, 1 / (A - g), np.arctan2(w, A - g) / np.where(straight, 1.0, w))
    m_1 = (np.log((A - 2 * g + B) / A) / 2 + g * m_0) / B
    m_2 = (1 + 2 * g * m_1 - A * m_0) / B
    return m_0, m_1, m_2


def _separated(x: np.ndarray) -> np.ndarray:
    """Local matrices for the vertices (S_0, S_1, T_0, T_1) of disjoint pairs, (m, 4, 4)."""
    local = np.zeros((len(x), 4, 4))
    pair, limits = np.arange(len(x)), np.tile([0.0, 1.0, 0.0, 1.0], (len(x), 1))
    for _ in range(2 * MOST_BISECTIONS):
        ends = _places(x[pair], limits)
        centre = np.linalg.norm(ends[:, :2].mean(axis=1) - ends[:, 2:].mean(axis=1), axis=1)
        lengths = np.linalg.norm(ends[:, [1, 3]] - ends[:, [0, 2]], axis=2)
        apart = centre - lengths.mean(axis=1) >= 0.99 * lengths.max(axis=1)
        np.add.at(local, pair[apart], _gauss(x[pair[apart]], limits[apart]))
        pair, limits, lengths = pair[~apart], limits[~apart], lengths[~apart]
        if not len(pair):
            return local
        limits = _bisected(limits, lengths.argmax(axis=1))
        pair = np.tile(pair, 2)
    raise ValueError(
        "the contact boundary touches itself at points that are not common vertices: "
        "the H^(1/2) product is infinite there, use tichonov=FullProduct()"
    )


def _places(x: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Points at the parameters ``limits``, columns 0 and 1 on S, 2 and 3 on T: (m, 4, 2)."""
    s, t = limits[:, :2, None], limits[:, 2:, None]
    on_S = (1 - s) * x[:, None, 0] + s * x[:, None, 1]
    on_T = (1 - t) * x[:, None, 2] + t * x[:, None, 3]
    return np.hstack([on_S, on_T])


def _bisected(limits: np.ndarray, longer: np.ndarray) -> np.ndarray:
    """Both halves of each pair, cut across its longer segment (0: S, 1: T)."""
    rows, low, high = np.arange(len(limits)), 2 * longer, 2 * longer + 1
    middle = (limits[rows, low] + limits[rows, high]) / 2
    left, right = limits.copy(), limits.copy()
    left[rows, high] = middle
    right[rows, low] = middle
    return np.vstack([left, right])


def _gauss(x: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """The integrals over parts of S and T by a product rule, shape (m, 4, 4)."""
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_POINTS)
    nodes, weights = (nodes + 1) / 2, weights / 2
    s = limits[:, :1] + (limits[:, 1:2] - limits[:, :1]) * nodes
    t = limits[:, 2:3] + (limits[:, 3:] - limits[:, 2:3]) * nodes
    on_S = x[:, None, 0] + s[:, :, None] * (x[:, None, 1] - x[:, None, 0])
    on_T = x[:, None, 2] + t[:, :, None] * (x[:, None, 3] - x[:, None, 2])
    squares = ((on_S[:, :, None] - on_T[:, None, :]) ** 2).sum(axis=3)
    parts = (limits[:, 1] - limits[:, 0]) * (limits[:, 3] - limits[:, 2])
    sizes = np.linalg.norm(x[:, 1] - x[:, 0], axis=1) * np.linalg.norm(x[:, 3] - x[:, 2], axis=1)
    kernel = (parts * sizes)[:, None, None] * weights[:, None] * weights / squares
    K_S, K_T = kernel.sum(axis=2), kernel.sum(axis=1)
    S, T = np.stack([1 - s, s], axis=1), -np.stack([1 - t, t], axis=1)  # of z(x) - z(y)
    local = np.empty((len(x), 4, 4))
    local[:, :2, :2] = np.einsum("mik,mk,mjk->mij", S, K_S, S)
    local[:, 2:, 2:] = np.einsum("mik,mk,mjk->mij", T, K_T, T)
    local[:, :2, 2:] = np.einsum("mik,mkl,mjl->mij", S, kernel, T)
    local[:, 2:, :2] = local[:, :2, 2:].transpose(0, 2, 1)
    return local


def contact_seminorm(problem: Problem, Z: FESpace) -> np.ndarray:
    """W of ``slobodeckij_matrix`` on the degrees of freedom of Z, a P1 space on Gamma_c.

    Curved boundary elements are replaced by their chords.

    Raises
    ------
    ValueError
        In three dimensions, or if Gamma_c touches itself.
    """
    mesh = problem.mesh
    if mesh.dim != 2:
        raise ValueError(
            "tichonov=Fractional(): the H^(1/2) product is there for curves in two dimensions; "
            "on surfaces use SurfaceGradient() or FullProduct()"
        )
    names = set(problem.contact_names)
    vertices, dofs = vertex_dofs(Z, mesh)
    number = dict(zip(vertices, dofs, strict=True))
    segments = [
        [number[v.nr] for v in element.vertices]
        for element in mesh.Elements(BND)
        if element.mat in names
    ]
    points = np.empty((Z.ndof, 2))
    points[dofs] = np.asarray(mesh.ngmesh.Coordinates())[vertices, :2]
    return slobodeckij_matrix(points, np.array(segments))


def from_dense(A: np.ndarray) -> SparseMatrixd:
    """A dense symmetric matrix in NGSolve's format, all entries stored."""
    rows, columns = np.indices(A.shape, dtype=np.int32)
    return from_entries(rows.ravel(), columns.ravel(), A.ravel(), *A.shape)


def to_dense(A: SparseMatrixd) -> np.ndarray:
    """The inverse of ``from_dense``."""
    values, columns, starts = (np.asarray(a) for a in A.CSR())
    dense = np.zeros(A.shape)
    dense[np.repeat(np.arange(len(starts) - 1), np.diff(starts.astype(np.int64))), columns] = values
    return dense
