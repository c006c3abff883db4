"""Stresses of bodies of revolution that are in equilibrium, polynomials of degree k times 1/r.

In the half plane (r, z) equilibrium of S = r sigma is

    d_r S_rr + d_z S_rz - sigma_tt + r f_r = 0,      d_r S_rz + d_z S_zz + r f_z = 0.

The first equation gives the hoop stress, the second is that of the plane.  Let S_rr, S_rz and S_zz
be polynomials of degree k.  Then the second equation gives the part of S_zz with a positive power
of z, and r sigma_tt has degree k, too.  On the axis S has to vanish: then sigma is bounded.

On a triangle xi = (r - r_c)/h and eta = (z - z_c)/h are the coordinates about its centre.  The
numbers of a stress are the coefficients of S_rr, S_rz and of the part of S_zz that depends on r
only, each divided by the largest radius.
"""

from __future__ import annotations

import numpy as np

from ngepc.bounds.ring_integrals import ON_AXIS
from ngepc.bounds.simplices import sliced
from ngepc.linalg.bernstein import lattice_points
from ngepc.model.kinematics import AXISYMMETRIC

RR, RZ, ZZ, TT = range(4)
"""Places of the components of r sigma."""

COMPONENTS = np.zeros((4, 3, 3))
COMPONENTS[RR, 0, 0] = 1.0
COMPONENTS[[RZ, RZ], [0, 1], [1, 0]] = 1.0
COMPONENTS[ZZ, 1, 1] = 1.0
COMPONENTS[TT, 2, 2] = 1.0

TO_COORDINATES = np.vstack(
    [
        np.einsum("cii->c", COMPONENTS) / 3,
        np.einsum("dij,cij->dc", AXISYMMETRIC.basis, COMPONENTS),
    ]
)
"""The mean and the coordinates of the deviator by the components, (4, 4)."""


def exponents(degree: int) -> list[tuple[int, int]]:
    """The powers (a, b) of xi and eta in polynomials of a degree."""
    return [(a, n - a) for n in range(degree + 1) for a in range(n, -1, -1)]


class RingElement:
    """The stresses in equilibrium on triangles with these corners (cells, 3, 2).

    ``force`` (cells, 3, 2) are the values of the affine body force at the corners, ``degree`` is k:
    at least two, and three if the axial force varies.  ``free`` is the number of numbers.
    """

    OF_CELLS = (
        *("corners", "centre", "size", "outermost", "force"),
        *("_on_axis", "_allowed"),
    )

    def __init__(self, corners: np.ndarray, force: np.ndarray, degree: int) -> None:
        self.degree = degree
        self.corners = corners
        self.centre = corners.mean(axis=1)
        edges = corners - corners[:, [1, 2, 0]]
        self.size = np.sqrt((edges**2).sum(axis=2)).max(axis=1)
        self.outermost = corners[:, :, 0].max(axis=1)
        places = (corners - self.centre[:, None]) / self.size[:, None, None]
        affine = np.concatenate([np.ones_like(places[..., :1]), places], axis=2)
        self.force = np.linalg.solve(affine, force)  # of 1, xi, eta
        self.free = 2 * len(exponents(degree)) + degree + 1
        radii = corners[:, :, 0]
        self._on_axis = radii <= ON_AXIS * radii.max(initial=0.0)
        free = np.eye(self.free)
        self._allowed = np.broadcast_to(free, (len(corners), *free.shape))
        self._allowed = self._vanishing_on_axis()

    def of(self, cells: np.ndarray | slice) -> RingElement:
        """The same on some of the triangles."""
        return sliced(self, cells, self.OF_CELLS)

    @property
    def forbidden(self) -> np.ndarray:
        """Projections (cells, free, free) onto numbers that have no effect."""
        return np.eye(self.free) - self._allowed

    def _vanishing_on_axis(self) -> np.ndarray:
        """Projections (cells, free, free) onto the stresses with S = 0 on the axis."""
        allowed = self._allowed.copy()
        for cell in np.flatnonzero(self._on_axis.any(axis=1)).tolist():
            places = self.corners[cell, self._on_axis[cell]]
            if len(places) == 2:
                places = lattice_points(1, self.degree) @ places
            rows, _ = self.of(np.s_[cell : cell + 1]).rows(places[None])
            S = rows[0][:, [RR, RZ, ZZ]].reshape(-1, self.free)
            allowed[cell] -= np.linalg.pinv(S) @ S
        return allowed

    def rows(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Components of r sigma at points x (cells, q, 2).

        The first result (cells, q, 4, free) maps the numbers, the second (cells, q, 4) is that of
        the body force alone.
        """
        k = self.degree
        r = x[..., 0]
        h = self.size[:, None]
        xi, eta = np.moveaxis((x - self.centre[:, None]) / h[..., None], 2, 0)
        rows = np.zeros((*r.shape, 4, self.free))
        count = len(exponents(k))
        for i, (a, b) in enumerate(exponents(k)):
            by_xi = a * xi ** max(a - 1, 0) * eta**b
            rows[..., RR, i] = rows[..., RZ, count + i] = xi**a * eta**b
            rows[..., TT, i] = r / h * by_xi
            rows[..., TT, count + i] = r / h * xi**a * b * eta ** max(b - 1, 0)
            rows[..., ZZ, count + i] = -by_xi * eta / (b + 1)
        for a in range(k + 1):
            rows[..., ZZ, 2 * count + a] = xi**a
        rows *= self.outermost[:, None, None, None]
        load = np.zeros((*r.shape, 4))
        f = self.force[:, None]
        radial = f[..., 0, 0] + f[..., 1, 0] * xi + f[..., 2, 0] * eta
        axial = f[..., 0, 1] + f[..., 1, 1] * xi + f[..., 2, 1] * eta / 2
        load[..., ZZ] = -h * r * eta * axial
        load[..., TT] = r**2 * radial
        there = self._on_axis.any(axis=1)
        rows[there] = np.matmul(rows[there], self._allowed[there][:, None])
        return rows, load

    def traction_rows(
        self, x: np.ndarray, normal: np.ndarray, frame: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same for r frame (sigma n), (cells, 2, q, free) and (cells, 2, q).

        ``normal`` (cells, 2), ``frame`` (cells, 2, 2).
        """
        rows, load = self.rows(x)
        traction = np.zeros((len(x), 2, 4))
        traction[:, 0, RR] = traction[:, 1, RZ] = normal[:, 0]
        traction[:, 0, RZ] = traction[:, 1, ZZ] = normal[:, 1]
        traction = np.matmul(frame, traction)[:, None]
        found = np.matmul(traction, rows).swapaxes(1, 2)
        given = np.matmul(traction, load[..., None])[..., 0].swapaxes(1, 2)
        return found, given
