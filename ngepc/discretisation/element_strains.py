"""Strains of elements as rows on their nodal displacements; forces and stiffness matrices.

A strain is its trace and the d coordinates of its deviator, a stress what they are multiplied with:
s = 1 + d numbers.  The discrete problem needs only the rows B of these numbers at the points, and
the weights of the points: forces are B' times stresses, stiffnesses B' C B.  Slopes of the shape
functions are kept; rows would be five times as many numbers, and are computed when they are needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from ngepc.discretisation.moduli import Moduli

CHUNK = 400_000
"""Numbers in the matrices of the elements that are held in memory at once.

With fewer threads wait for each other: each call of NumPy lets go of Python's lock and takes it
back.  A thread that has to wait for it is woken up some 50 microseconds later.
"""

SMALL = 200_000
"""Fewer numbers are not divided."""


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of one shape, k nodes and p points each.

    Slopes are the N derivatives, on bodies of revolution also that along the circumference, 1/r.
    """

    basis: np.ndarray
    """The s numbers of a strain by the slopes of a displacement, shape (s, N, slopes)."""
    size: int  # tensors are size x size
    averaged: bool  # tr eps is the mean over each element
    shapes: np.ndarray  # shape functions at the points, shape (p, k)
    nodes: np.ndarray  # numbers, shape (elements, k)
    points: np.ndarray  # numbers among all points, shape (elements, p)
    weights: np.ndarray  # of the points, shape (elements, p)
    slopes: np.ndarray
    """Derivatives of the shape functions at the points, shape (elements, p, k, slopes)."""

    def chunks(self, numbers: int) -> list[slice]:
        """The elements in an even number of parts; of each element so many ``numbers``.

        There is one part if they are few.
        """
        elements = len(self.nodes)
        total = numbers * elements
        if total < SMALL:
            return [slice(0, elements)]
        count = 2 * ceil(total / (2 * CHUNK))
        size = max(1, ceil(elements / count))
        return [slice(first, first + size) for first in range(0, elements, size)]

    def of(self, chosen: np.ndarray | slice) -> Elements:
        """Some of the elements."""
        names = ("nodes", "points", "weights", "slopes")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def matrix_chunks(self) -> list[slice]:
        """Parts for matrices of the elements."""
        return self.chunks(self.basis.shape[1] ** 2 * self.shapes.shape[1] ** 2)

    @property
    def row_parts(self) -> list[Elements]:
        """Parts for what has the size of the slopes, as views."""
        return [self.of(chosen) for chosen in self.chunks(self.slopes[0].size)]

    @property
    def _shares(self) -> np.ndarray:
        """Of the points in their elements, shape (elements, p)."""
        return self.weights / self.weights.sum(axis=1, keepdims=True)

    def rows(self) -> np.ndarray:
        """Rows of strains on the nodal displacements node by node, (elements, p, s, k N)."""
        # E : eps(phi_i e_c) = E[c, :] . grad phi_i for symmetric E
        rows = np.einsum("scj,epkj->epskc", self.basis, self.slopes, optimize=True)
        rows = rows.reshape(*rows.shape[:3], -1)
        if self.averaged:
            rows[:, :, 0] = np.einsum("ep,epk->ek", self._shares, rows[:, :, 0])[
                :, None
            ]
        return rows

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Strains, shape (elements, p, s): the rows times u, without making them."""
        own = u.take(self.nodes, axis=0).swapaxes(1, 2)
        slopes = np.matmul(own[:, None], self.slopes)
        basis = self.basis.reshape(len(self.basis), -1)
        found = (slopes.reshape(-1, basis.shape[1]) @ basis.T).reshape(
            *slopes.shape[:2], -1
        )
        if self.averaged:
            found[:, :, 0] = (self._shares * found[:, :, 0]).sum(axis=1)[:, None]
        return found

    def forces(self, stress: np.ndarray) -> np.ndarray:
        """The transposed rows times weighted stresses (points, s), shape (elements, k, N)."""
        stress = self.weights[:, :, None] * stress[self.points]
        if self.averaged:
            stress[:, :, 0] = self._shares * stress[:, :, 0].sum(axis=1)[:, None]
        s, N, kinds = self.basis.shape
        turned = self.basis.swapaxes(1, 2).reshape(s, -1)
        tensors = stress.reshape(-1, s) @ turned
        at_points = np.matmul(
            self.slopes, tensors.reshape(*stress.shape[:2], kinds, N)
        ).swapaxes(0, 1)
        return sum(at_points[1:], at_points[0])

    def diagonal(self, bulk: np.ndarray, shear: np.ndarray) -> np.ndarray:
        """Diagonal of B' C B for C = bulk I (x) I + shear Id, shape (elements, k, N).

        A square of a row b . g is b b' : g g', so that products of slopes g are summed, without
        rows.
        """
        bulk, shear = (self.weights * modulus[self.points] for modulus in (bulk, shear))
        products = self.slopes[..., :, None] * self.slopes[..., None, :]
        volume, *shape = np.einsum("scj,sck->sjkc", self.basis, self.basis)
        found = self._product_sums(shear, products) @ _flat_products(sum(shape))
        if not self.averaged:
            return found + self._product_sums(bulk, products) @ _flat_products(volume)
        trace = self.slopes @ self.basis[0].T
        mean = np.einsum("ep,epkc->ekc", self._shares, trace)
        return found + bulk.sum(axis=1)[:, None, None] * mean**2

    def _product_sums(self, weights: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Weighted sums over the points of products of slopes, (elements, k, slopes^2)."""
        count, points, k = products.shape[:3]
        sums = np.matmul(weights[:, None], products.reshape(count, points, -1))
        return sums.reshape(count, k, -1)

    def stiffness(self, moduli: Moduli) -> Iterator[np.ndarray]:
        """B' C B by two matrices of each element, L, then G, shapes (elements, k N, k N).

        Nodes i, j and components a, b have

            L[i a, j b] + G[i b, j a], and where a = b the sum of G[i c, j c] over c.

        With symmetric tensors dev a : dev b = a : b - tr a tr b / size.  The products G of the
        slopes of two nodes give sym(u grad) : sym(v grad) at once, so that only the trace and the
        direction of the moduli need rows.  L should be given up before G is asked for: a cache has
        room for one of them.
        """
        count, points = self.points.shape
        N = self.basis.shape[1]
        if moduli.coupling is None:
            yield _weighted_squares(*self._single_rows(moduli))
        else:
            rows = _weighted_squares(*self._single_rows(moduli))
            yield rows + self._coupled(moduli.coupling)
        slopes = self.slopes[..., :N].reshape(count, points, -1)
        yield _weighted_squares(slopes, 0.5 * self.weights * moduli.across[self.points])

    def _single_rows(self, moduli: Moduli) -> tuple[np.ndarray, np.ndarray]:
        """Rows whose squares with these factors are what remains of B' C B beside a : b.

        Shapes (elements, rows, k N) and (elements, rows).
        """
        count, points = self.points.shape
        bulk = moduli.bulk[self.points]
        across = moduli.across[self.points]
        s, N, kinds = self.basis.shape
        directions = moduli.direction[self.points].reshape(-1, s - 1)
        tensors = directions @ self.basis[1:].swapaxes(1, 2).reshape(s - 1, -1)
        along = np.matmul(self.slopes, tensors.reshape(count, points, kinds, N))
        trace = self.slopes[..., :N]
        if kinds > N:
            trace = trace.copy()
            trace[..., 0] += self.slopes[..., -1]  # the strain along the circumference
        rows = [trace, along]
        factors = [-across / self.size, moduli.extra[self.points]]
        if self.averaged:
            mean = np.einsum("ep,epic->eic", self._shares, trace)
            rows.append(np.broadcast_to(mean[:, None], trace.shape))
            factors.append(bulk)
        else:
            factors[0] = factors[0] + bulk
        if kinds > N:
            hoop = np.zeros(trace.shape)
            hoop[..., 0] = self.slopes[..., -1]
            rows.append(hoop)
            factors.append(across)
        weighted = [self.weights * factor for factor in factors]
        flat = [row.reshape(count, points, -1) for row in rows]
        return np.concatenate(flat, axis=1), np.concatenate(weighted, axis=1)

    def _coupled(self, coupling: np.ndarray) -> np.ndarray:
        """B' C B for symmetric matrices C on (tr, dev), node by node."""
        strains = self.rows()
        weighted = self.weights[:, :, None, None] * coupling[self.points]
        stresses = np.matmul(weighted, strains)
        flat = (len(strains), -1, strains.shape[-1])
        return np.matmul(strains.reshape(flat).swapaxes(1, 2), stresses.reshape(flat))


def _flat_products(matrices: np.ndarray) -> np.ndarray:
    """Matrices (slopes, slopes, N) as maps of flat products of slopes, (slopes^2, N)."""
    return matrices.reshape(-1, matrices.shape[2])


def _weighted_squares(rows: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """The sum over p of factor_p row_p row_p', shape (elements, n, n); rows (elements, p, n)."""
    weighted = rows * factors[:, :, None]
    return np.matmul(weighted.swapaxes(1, 2), rows)
