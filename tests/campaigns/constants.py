"""Upper bounds of the constants of ``ngepc.bounds.oscillation``, by stresses on cut cells.

The reference cell is cut n times into similar ones with the stresses of Johnson and Mercier.  A
load r that does no work on rigid motions, with its part r_R in the rigid motions of the small cells
and Q r_R constant on their parts with the same work, has the energy

    E(r)^(1/2) <= E(Q r_R)^(1/2) + C/n |r - Q r_R|,    E(r) = min {|tau|^2: div tau = r, tau n = 0},

since r - Q r_R does no work on the rigid motions of the small cells, and C scales with the length.
Let m be the largest E(Q r_R) over |r_R|^2, of a discrete stress, and b that of |(1 - Q) r_R|^2 over
|r_R|^2.  Then

    C^2 <= m + m^1/2 C/n + max(b, 1) (C^2/n^2 + m^1/2 C/n).

The same holds for tractions on one facet: those that are affine on small facets are represented
exactly, the rest has no moments on them, and C'^2 <= m' + C'^2/n.
"""

from itertools import combinations
from math import factorial, sqrt

import numpy as np
from scipy.linalg import block_diag, lapack, null_space, solve_triangular

from ngepc.bounds.oscillation import REFERENCE, rotations


def cut(cell):
    """A simplex cut into 2^N simplices."""
    N = cell.shape[1]

    def mid(pair):
        return (cell[pair[0]] + cell[pair[1]]) / 2

    corners = [
        [cell[j] if j == i else mid((i, j)) for j in range(N + 1)] for i in range(N + 1)
    ]
    if N == 2:
        return [
            np.array(c) for c in (*corners, [mid((0, 1)), mid((1, 2)), mid((0, 2))])
        ]
    opposite = [((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2))]
    opposite.sort(key=lambda pairs: np.linalg.norm(mid(pairs[0]) - mid(pairs[1])))
    axis, (a, c), (b, d) = opposite  # the shortest diagonal, and the ring around it
    ends = [mid(pair) for pair in axis]
    ring = [mid(pair) for pair in (a, b, c, d)]
    inner = [[*ends, ring[k], ring[(k + 1) % 4]] for k in range(4)]
    return [np.array(c) for c in (*corners, *inner)]


def normal_of(places):
    """The normal of a facet; its length is the measure of the facet."""
    edges = places[1:] - places[0]
    return (
        np.array([edges[0, 1], -edges[0, 0]])
        if len(edges) == 1
        else np.cross(*edges) / 2
    )


class Stresses:
    """The stresses of one cell, in an orthonormal basis with continuous normal components.

    ``divergence`` (parts, N, k) and ``traction`` (facet, vertex, N, k) act on it.
    """

    def __init__(self, cell):
        N = self.N = cell.shape[1]
        self.cell, self.middle = cell, cell.mean(axis=0)
        self.volume = abs(np.linalg.det(cell[1:] - cell[0])) / factorial(N)
        pairs = [(i, i) for i in range(N)] + list(combinations(range(N), 2))
        self.symmetric = np.zeros((len(pairs), N, N))
        for k, (i, j) in enumerate(pairs):
            self.symmetric[k, i, j] = self.symmetric[k, j, i] = 1
        self.points = np.vstack([cell, self.middle])
        self.parts = [
            [N + 1 if v == k else v for v in range(N + 1)] for k in range(N + 1)
        ]
        jumps = []
        for k, j in combinations(range(N + 1), 2):
            face = [v for v in range(N + 1) if v not in (k, j)] + [N + 1]
            n = normal_of(self.points[face])
            jumps += [self._rows(k, v, n) - self._rows(j, v, n) for v in face]
        basis = null_space(np.concatenate(jumps), rcond=1e-10)
        weights = np.einsum("qij,pij->qp", self.symmetric, self.symmetric)
        nodes = (np.ones((N + 1, N + 1)) + np.eye(N + 1)) * self.volume / (N + 1)
        nodes = np.kron(np.eye(N + 1), nodes / ((N + 1) * (N + 2)))
        mass = basis.T @ np.kron(nodes, weights) @ basis
        basis = solve_triangular(np.linalg.cholesky(mass), basis.T, lower=True).T
        self.divergence = np.stack([self._divergence(k) @ basis for k in range(N + 1)])
        self.facets = [[v for v in range(N + 1) if v != k] for k in range(N + 1)]
        self.traction = np.stack([self._traction(k) @ basis for k in range(N + 1)])

    def _rows(self, part, vertex, n):
        N, count = self.N, len(self.symmetric)
        rows = np.zeros((N, N + 1, N + 1, count))
        rows[:, part, self.parts[part].index(vertex)] = (self.symmetric @ n).T
        return rows.reshape(N, -1)

    def _divergence(self, k):
        N = self.N
        frame = np.column_stack([np.ones(N + 1), self.points[self.parts[k]]])
        rows = np.zeros((N, N + 1, N + 1, len(self.symmetric)))
        rows[:, k] = np.einsum("qij,jv->ivq", self.symmetric, np.linalg.inv(frame)[1:])
        return rows.reshape(N, -1)

    def _traction(self, k):
        n = normal_of(self.cell[self.facets[k]])
        n = n * np.sign(n @ (self.middle - self.cell[k])) / np.linalg.norm(n)
        return np.stack([self._rows(k, v, n) for v in self.facets[k]])

    def rotating(self):
        """Orthonormal rotations as matrices, Q of them on the parts (a, parts, N), and b."""
        N, away = self.N, self.cell - self.middle
        second = self.volume / ((N + 1) * (N + 2)) * away.T @ away
        turns = rotations(N)
        gram = np.einsum("aij,jk,bik->ab", turns, second, turns)
        turns = np.einsum("ab,bij->aij", np.linalg.inv(np.linalg.cholesky(gram)), turns)
        on_parts = np.einsum("aij,kj->aki", turns, -away / (N + 1))
        work = np.einsum("aki,bki->ab", on_parts, on_parts) * self.volume / (N + 1)
        Q = np.linalg.inv(work)
        b = np.linalg.eigvalsh(Q - np.eye(len(turns))).max()
        return second, turns, np.einsum("ab,bki->aki", Q, on_parts), b


def square_on_null_space(operator, rows):
    """A P A^T of an operator A, P the projection onto the null space of dependent rows.

    With independent rows B and the Cholesky decomposition B B^T = L L^T
    P = 1 - (L^-1 B)^T L^-1 B.
    """
    square = rows @ rows.T
    small = 1e-10 * square.diagonal().max()
    factor, order, rank, _ = lapack.dpstrf(square, tol=small, lower=1)
    independent = rows[order[:rank] - 1]
    lower = np.tril(factor[:rank, :rank])
    left_out = solve_triangular(lower, independent @ operator.T, lower=True)
    return operator @ operator.T - left_out.T @ left_out


def largest_energy(square, loads):
    """The largest |tau|^2 of tau with A tau = one of the loads' span, by A A^T."""
    values, vectors = np.linalg.eigh(square)
    kept = values > 1e-10 * values[-1]
    assert (
        np.abs(vectors[:, ~kept].T @ loads).max(initial=0.0)
        < 1e-7 * np.abs(loads).max()
    )
    return np.linalg.norm((vectors[:, kept] / np.sqrt(values[kept])).T @ loads, 2) ** 2


def constants(N, cuts):
    """Upper bounds of C and C' on the reference cell."""
    whole = np.vstack([np.zeros(N), REFERENCE[N].T])
    cells = [whole]
    for _ in range(cuts):
        cells = [small for cell in cells for small in cut(cell)]
    all_stresses, n = [Stresses(cell) for cell in cells], 2**cuts
    size = all_stresses[0].divergence.shape[-1]
    faces = {}
    for t, s in enumerate(all_stresses):
        for k, face in enumerate(s.facets):
            keys = [tuple(np.round(p * 16 * n).astype(int)) for p in s.cell[face]]
            order = np.argsort([hash(key) for key in keys])
            found = faces.setdefault(
                frozenset(keys), [np.zeros((N, N, len(cells) * size)), 0]
            )
            found[0][:, :, t * size : (t + 1) * size] += s.traction[k][order]
            found[1], found[2:] = found[1] + 1, [s.cell[face][order]]
    jumps = np.concatenate([f[0].reshape(N * N, -1) for f in faces.values()])
    divergence = block_diag(*[s.divergence.reshape(-1, size) for s in all_stresses])
    m, b = largest_inside(all_stresses, square_on_null_space(divergence, jumps))
    first = [
        f[1] == 1 and np.abs(lowest(whole, f[2])).max() < 1e-9 for f in faces.values()
    ]
    places = [f[2] for f, there in zip(faces.values(), first, strict=True) if there]
    rows = np.repeat(first, N * N)
    fixed = np.vstack([jumps[~rows], divergence])
    tractions = square_on_null_space(jumps[rows], fixed)
    outside = largest_energy(tractions, without_moments(whole, places))
    C = sqrt(m)
    for _ in range(1000):
        C = sqrt(m + sqrt(m) * C / n + max(b, 1) * ((C / n) ** 2 + sqrt(m) * C / n))
    return C, sqrt(outside / (1 - 1 / n)), sqrt(m)


def with_moments(N, cuts, C):
    """An upper bound of C'' on the reference cell, from C."""
    whole = np.vstack([np.zeros(N), REFERENCE[N].T])
    cells = [whole]
    for _ in range(cuts):
        cells = [small for cell in cells for small in cut(cell)]
    stresses = [Stresses(cell) for cell in cells]
    rows, tractions, moments = affine_tractions(whole, stresses)
    divergence = block_diag(
        *[s.divergence.reshape(-1, s.divergence.shape[-1]) for s in stresses]
    )
    volume = np.concatenate(
        [np.full(N * (N + 1), s.volume / (N + 1)) for s in stresses]
    )
    divergence *= np.sqrt(volume)[:, None]
    middles = np.concatenate(
        [s.points[part].mean(axis=0)[None] for s in stresses for part in s.parts]
    )
    rigid = rigid_motions(whole)
    load = moments(rigid)
    means = np.stack([motion(middles).ravel() for motion in rigid], axis=1) @ load
    means *= np.sqrt(volume)[:, None]
    given = np.linalg.lstsq(rows, tractions, rcond=1e-10)[0]
    assert np.abs(rows @ given - tractions).max() < 1e-8
    free = null_space(rows, rcond=1e-10)
    both = np.vstack([free, 3 * C * divergence @ free])
    wanted = np.vstack([-given, 3 * C * (means - divergence @ given)])
    tau = given + free @ np.linalg.lstsq(both, wanted, rcond=1e-12)[0]
    missed = divergence @ tau - means
    left = load.T @ load - means.T @ means + missed.T @ missed
    return np.linalg.norm(tau, 2) + C * sqrt(np.linalg.eigvalsh(left)[-1])


def rigid_motions(whole):
    """An orthonormal basis of the rigid motions on a cell, functions of points (., N)."""
    N = whole.shape[1]
    away = whole - whole.mean(axis=0)
    volume = abs(np.linalg.det(whole[1:] - whole[0])) / factorial(N)
    second = volume / ((N + 1) * (N + 2)) * away.T @ away
    turns = rotations(N)
    gram = np.einsum("aij,jk,bik->ab", turns, second, turns)
    turns = np.einsum("ab,bij->aij", np.linalg.inv(np.linalg.cholesky(gram)), turns)
    shifts = [
        lambda x, e=e: np.broadcast_to(e / sqrt(volume), x.shape) for e in np.eye(N)
    ]
    return shifts + [lambda x, w=w: (x - whole.mean(axis=0)) @ w.T for w in turns]


def affine_tractions(whole, stresses):
    """Rows of jumps and tractions; orthonormal affine tractions of the first facet; their work."""
    N = whole.shape[1]
    size = stresses[0].divergence.shape[-1]
    inverse = np.linalg.inv(whole[1:] - whole[0])
    faces = {}
    for number, s in enumerate(stresses):
        for k, face in enumerate(s.facets):
            keys = [tuple(np.round(p, 9) + 0.0) for p in s.cell[face]]
            order = sorted(range(N), key=keys.__getitem__)
            found = faces.setdefault(
                frozenset(keys),
                [np.zeros((N, N, len(stresses) * size)), s.cell[face][order]],
            )
            found[0][:, :, number * size : (number + 1) * size] += s.traction[k][order]
    area = np.linalg.norm(normal_of(whole[1:]))
    mass = (np.ones((N, N)) + np.eye(N)) * area / (N * (N + 1))
    functions = np.linalg.inv(np.linalg.cholesky(mass))
    given = np.zeros((len(faces), N, N, N, N))
    for number, (_, places) in enumerate(faces.values()):
        shares = (places - whole[0]) @ inverse
        if np.abs(shares.sum(axis=1) - 1).max() < 1e-9:
            values = shares @ functions.T
            given[number] = np.einsum("vj,cd->vcjd", values, np.eye(N))
    rows = np.concatenate([found[0].reshape(N * N, -1) for found in faces.values()])

    def moments(motions):
        """Their work on motions, (motions, tractions)."""
        at = np.stack([motion(whole[1:]) for motion in motions])
        work = np.einsum("ji,ik,akc->ajc", functions, mass, at)
        return work.reshape(len(motions), -1)

    return rows, given.reshape(len(rows), -1), moments


def lowest(whole, places):
    """The barycentric coordinate of the first vertex."""
    return 1 - ((places - whole[0]) @ np.linalg.inv(whole[1:] - whole[0])).sum(axis=1)


def largest_inside(all_stresses, square):
    """The numbers m and b, by the square of the divergence of stresses without jumps."""
    N, r = all_stresses[0].N, len(rotations(all_stresses[0].N))
    loads, rigid, b = [], [], 0.0
    for s in all_stresses:
        second, turns, Q, worst = s.rotating()
        b = max(b, worst)
        means = np.tile(np.eye(N), (N + 1, 1)) / sqrt(s.volume)
        loads.append(np.hstack([means, Q.reshape(r, -1).T]))
        shifts = np.hstack([np.eye(N) * sqrt(s.volume), np.zeros((N, r))])
        spins = [
            np.concatenate(
                [
                    w @ s.middle * sqrt(s.volume),
                    np.einsum("ij,jk,aik->a", w, second, turns),
                ]
            )
            for w in rotations(N)
        ]
        rigid.append(np.vstack([shifts, spins]))
    return largest_energy(square, block_diag(*loads) @ null_space(np.hstack(rigid))), b


def without_moments(whole, places):
    """Orthonormal tractions, affine on small facets, whose moments on the large one vanish."""
    N = whole.shape[1]
    areas = [np.linalg.norm(normal_of(p)) for p in places]
    nodes = (np.ones((N, N)) + np.eye(N)) / (N * (N + 1))
    mass = block_diag(*[np.kron(area * nodes, np.eye(N)) for area in areas])
    directions = np.linalg.svd(whole[2:] - whole[1])[2][: N - 1]
    affine = [
        np.kron([1, *(directions @ (v - whole[1]))], np.eye(N))
        for p in places
        for v in p
    ]
    root = np.linalg.cholesky(mass)
    free = null_space(np.vstack([row.reshape(N, -1) for row in affine]).T @ mass)
    return np.linalg.solve(root.T, np.linalg.qr(root.T @ free)[0])


if __name__ == "__main__":
    for dimension, cuts in ((2, 3), (3, 2)):
        found = constants(dimension, cuts)
        print(dimension, found, with_moments(dimension, cuts - 1, found[0]))
