"""Strains in the elements of one shape, and the forces of stresses: rows on nodal displacements.

Gradients of the shape functions are kept; rows of strains are five times as many numbers, and are
made where they are needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ngepc.model.kinematics import Kinematics

CHUNK = 20_000
"""Elements whose matrices are held in memory at once."""


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

    def __len__(self) -> int:
        return len(self.nodes)

    def part(self, chosen: slice) -> Elements:
        """Some of the elements, as views."""
        arrays = {n: getattr(self, n) for n in ("nodes", "points", "gradients", "radii", "mean")}
        return replace(self, **{n: a[chosen] for n, a in arrays.items() if a is not None})

    @property
    def parts(self) -> Iterator[Elements]:
        """The elements in chunks."""
        return (self.part(chosen) for chosen in chunks(len(self)))

    @property
    def _hoop(self) -> np.ndarray | None:
        """Rows of the hoop strain on the radial displacements, shape (elements, p, k)."""
        return None if self.radii is None else self.shapes / self.radii[:, :, None]

    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of tr eps and of the coordinates of dev eps on the nodal displacements.

        Node by node, shapes (elements, p, k N) and (elements, p, d, k N).
        """
        volume, deviator = strain_rows(self.kinematics, self.gradients, self._hoop)
        if self.mean is not None:
            volume[:] = self.mean[:, None]
        return volume, deviator

    def strain(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """tr eps(u) and the coordinates of dev eps(u), shapes (elements, p) and (elements, p, d).

        The rows times u, without making them.
        """
        N, d, local = self.kinematics.N, self.kinematics.d, u[self.nodes]
        slopes = np.matmul(local.swapaxes(1, 2)[:, None], self.gradients)
        volume = np.trace(slopes, axis1=2, axis2=3)
        deviator = slopes.reshape(*volume.shape, N * N) @ self._basis.reshape(d, N * N).T
        if self.radii is not None:
            ring = np.einsum("epk,ek->ep", self._hoop, local[:, :, 0])
            volume, deviator = volume + ring, deviator + ring[:, :, None] * self._ring
        if self.mean is not None:
            mean = np.einsum("ek,ek->e", self.mean, local.reshape(len(self), -1))
            volume = np.repeat(mean[:, None], volume.shape[1], axis=1)
        return volume, deviator

    def forces(self, pressure: np.ndarray, deviator: np.ndarray) -> np.ndarray:
        """The transposed rows times a stress, shape (elements, k, N).

        ``pressure`` has shape (elements, p), the coordinates ``deviator`` (elements, p, d).
        """
        N, d = self.kinematics.N, self.kinematics.d
        stress = (deviator @ self._basis.reshape(d, N * N)).reshape(*pressure.shape, N, N)
        if self.mean is None:
            stress += pressure[:, :, None, None] * np.eye(N)
        forces = np.matmul(self.gradients, stress).sum(axis=1)
        if self.radii is not None:
            ring = deviator @ self._ring + (pressure if self.mean is None else 0.0)
            forces[:, :, 0] += np.einsum("ep,epk->ek", ring, self._hoop)
        if self.mean is not None:
            forces += (pressure.sum(axis=1)[:, None] * self.mean).reshape(forces.shape)
        return forces

    @property
    def _basis(self) -> np.ndarray:
        """The part of the trace-free tensors in the plane or space of the mesh, (d, N, N)."""
        N = self.kinematics.N
        return np.ascontiguousarray(self.kinematics.basis[:, :N, :N])

    @property
    def _ring(self) -> np.ndarray:
        """The hoop component of the trace-free tensors, shape (d,)."""
        return self.kinematics.basis[:, 2, 2]


def chunks(count: int) -> list[slice]:
    """The slices of ``CHUNK`` that cover ``count`` elements."""
    return [slice(first, first + CHUNK) for first in range(0, count, CHUNK)]


def strain_rows(
    kinematics: Kinematics, gradients: np.ndarray, hoop: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of tr eps and dev eps from gradients (..., k, N) of shape functions, and N_i / r."""
    N, *_, k = kinematics.N, gradients.shape[-2]
    volume = gradients.copy()
    # E : eps(phi_i e_c) = E[c, :] . grad phi_i for symmetric E
    deviator = np.einsum("dcj,...kj->...dkc", kinematics.basis[:, :N, :N], gradients, optimize=True)
    if hoop is not None:
        volume[..., 0] += hoop
        deviator[..., 0] += kinematics.basis[:, 2, 2][:, None] * hoop[..., None, :]
    shape = gradients.shape[:-2]
    return volume.reshape(*shape, k * N), deviator.reshape(*shape, kinematics.d, k * N)
