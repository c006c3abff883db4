"""Strains in the elements of one shape, and the forces of stresses: rows on nodal displacements.

A strain is its trace and the d coordinates of its deviator, a stress what they are multiplied with:
s = 1 + d numbers.  Gradients of the shape functions are kept; rows of strains are five times as
many numbers, and are made where they are needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ngepc.model.kinematics import Kinematics

CHUNK = 20_000  # elements whose matrices are held in memory at once


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of one shape, k nodes and p points each."""

    kinematics: Kinematics
    nodes: np.ndarray  # numbers, shape (elements, k)
    points: np.ndarray  # numbers among all points, shape (elements, p)
    shapes: np.ndarray  # shape functions at the points, shape (p, k)
    gradients: np.ndarray  # of the shape functions at the points, shape (elements, p, k, N)
    radii: np.ndarray | None  # of the points of a body of revolution, shape (elements, p)
    mean: np.ndarray | None = None  # rows of the mean of tr eps over each, (elements, k N), or None

    def part(self, chosen: slice) -> Elements:
        """Some of the elements, as views."""
        arrays = {n: getattr(self, n) for n in ("nodes", "points", "gradients", "radii", "mean")}
        return replace(self, **{n: a[chosen] for n, a in arrays.items() if a is not None})

    @property
    def parts(self) -> Iterator[Elements]:
        """The elements in chunks."""
        firsts = range(0, len(self.nodes), CHUNK)
        return (self.part(slice(first, first + CHUNK)) for first in firsts)

    @property
    def _basis(self) -> np.ndarray:
        """The numbers of a strain by those of the displacement gradient, (s, N, N)."""
        N = self.kinematics.N
        return np.concatenate([np.eye(N)[None], self.kinematics.basis[:, :N, :N]])

    @property
    def _ring(self) -> np.ndarray:
        """The same by the hoop strain, shape (s,)."""
        return np.append(1.0, self.kinematics.basis[:, 2, 2])

    @property
    def _hoop(self) -> np.ndarray:
        """Rows of the hoop strain on the radial displacements, shape (elements, p, k)."""
        return self.shapes / self.radii[:, :, None]

    def rows(self) -> np.ndarray:
        """Rows of strains on the nodal displacements node by node, (elements, p, s, k N)."""
        # E : eps(phi_i e_c) = E[c, :] . grad phi_i for symmetric E
        rows = np.einsum("scj,epkj->epskc", self._basis, self.gradients, optimize=True)
        if self.radii is not None:
            rows[..., 0] += self._ring[:, None] * self._hoop[:, :, None]
        rows = rows.reshape(*rows.shape[:3], -1)
        if self.mean is not None:
            rows[:, :, 0] = self.mean[:, None]
        return rows

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Strains, shape (elements, p, s): the rows times u, without making them."""
        local = u[self.nodes]
        slopes = np.matmul(local.swapaxes(1, 2)[:, None], self.gradients)
        basis = self._basis
        found = slopes.reshape(*slopes.shape[:2], -1) @ basis.reshape(len(basis), -1).T
        if self.radii is not None:
            found += np.einsum("epk,ek->ep", self._hoop, local[:, :, 0])[:, :, None] * self._ring
        if self.mean is not None:
            found[:, :, 0] = np.einsum("ek,ek->e", self.mean, local.reshape(len(local), -1))[
                :, None
            ]
        return found

    def forces(self, stress: np.ndarray) -> np.ndarray:
        """The transposed rows times stresses (elements, p, s), shape (elements, k, N)."""
        basis, pressure = self._basis, stress[:, :, 0].sum(axis=1)
        if self.mean is not None:
            stress = np.where(np.arange(len(basis)) > 0, stress, 0.0)
        tensors = stress @ basis.reshape(len(basis), -1)
        tensors = tensors.reshape(*tensors.shape[:2], *basis.shape[1:])
        forces = np.matmul(self.gradients, tensors).sum(axis=1)
        if self.radii is not None:
            forces[:, :, 0] += np.einsum("ep,epk->ek", stress @ self._ring, self._hoop)
        if self.mean is not None:
            forces += (pressure[:, None] * self.mean).reshape(forces.shape)
        return forces
