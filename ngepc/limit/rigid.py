"""Rigid motions that supports and obstacles leave free: they dissipate nothing."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import scipy

from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.limit.outline import connected_parts
from ngepc.model.support import rigid_motions

WORKS = 1e-6
"""Smallest power of the growing loads in a rigid motion, over their largest one, that counts."""


def moves_freely(data: LimitData) -> bool:
    """Whether parts of the body have a rigid motion that nothing resists.

    Supports, obstacles and friction allow it, and the constant loads do no negative power in it.
    The growing loads do positive power; where supports move instead, it has their velocity.
    """
    if not data.moves and not data.contact.any():
        return False  # ``Problem`` refuses supports that leave a rigid motion free
    motions = RigidMotions(data)
    growing = motions.power(GROWS)
    resisting = np.vstack([motions.into_obstacles, -motions.power(STAYS)])
    held, speeds = motions.held
    sizes = (None, None) if data.moves else (-1.0, 1.0)
    found = scipy.optimize.linprog(
        -growing,
        A_ub=resisting,
        b_ub=np.zeros(len(resisting)),
        A_eq=held,
        b_eq=speeds,
        bounds=sizes,
    )
    if found.status != 0:
        return False
    return data.moves or -found.fun > WORKS * np.abs(growing).sum()


class RigidMotions:
    """Rigid motions of the connected parts of a body, w = (those of each part, one by one).

    Parameters
    ----------
    data
        Loads, supports, obstacles.
    """

    def __init__(self, data: LimitData) -> None:
        self.data = data
        cells = data.cells
        self.parts = connected_parts(cells)
        self.outer = np.flatnonzero(cells.outer)
        corners = cells.points[cells.facets[self.outer]]
        self.speeds = self._velocities(corners, cells.owners[self.outer, 0])
        """Velocities at the vertices of outer facets, (facets, N, N, size of w)."""

    def _velocities(self, points: np.ndarray, owners: np.ndarray) -> np.ndarray:
        """Velocities at points (k, m, N) of these cells, (k, m, N, size of w)."""
        k, m, N = points.shape
        centre = self.data.cells.points.mean(axis=0)
        motions = rigid_motions((points - centre).reshape(-1, N))
        count = motions.shape[2]
        result = np.zeros((k, m, N, self.parts.max() + 1, count))
        own = self.parts[owners]
        result[np.arange(k), :, :, own] = motions.reshape(k, m, N, count)
        return result.reshape(k, m, N, -1)

    def _along_frames(self, chosen: np.ndarray) -> np.ndarray:
        """Components of velocities, chosen by (facets, N) rows of the frames, (n, size of w)."""
        frame = self.data.frame[self.outer]
        components = np.einsum("frp,fvpw->fvrw", frame, self.speeds)
        everywhere = np.broadcast_to(chosen[:, None], components.shape[:3])
        return components[everywhere]

    @cached_property
    def into_obstacles(self) -> np.ndarray:
        """Speeds into obstacles, (n, size of w)."""
        data = self.data
        chosen = np.zeros((len(self.outer), data.cells.N), dtype=bool)
        chosen[:, 0] = data.contact[self.outer]
        return self._along_frames(chosen)

    @cached_property
    def held(self) -> tuple[np.ndarray, np.ndarray]:
        """Speeds that supports prescribe and friction prevents, and their values."""
        data = self.data
        rows = np.arange(data.cells.N)
        chosen = rows < data.held[self.outer, None]
        rubs = data.contact[self.outer] & (data.friction[self.outer] > 0).any(axis=1)
        chosen |= rubs[:, None] & (rows > 0)
        motion = data.motion[self.outer]
        values = np.einsum("frp,fvp->fvr", data.frame[self.outer], motion)
        everywhere = np.broadcast_to(chosen[:, None], values.shape)
        return self._along_frames(chosen), values[everywhere]

    def power(self, kind: int) -> np.ndarray:
        """The power of the loads that grow or stay, (size of w,)."""
        data = self.data
        cells = data.cells
        N = cells.N
        mass = (np.ones((N, N)) + np.eye(N)) / (N * (N + 1))
        loads = data.traction[kind][self.outer]
        measure = cells.measure[self.outer]
        of_facets = np.einsum(
            "f,ij,fip,fjpw->w", measure, mass, loads, self.speeds, optimize=True
        )
        centres = cells.points[cells.nodes].mean(axis=1)[:, None]
        owners = np.arange(len(cells.nodes))
        speeds = self._velocities(centres, owners)[:, 0]
        force = cells.volume[:, None] * data.force[kind]
        return of_facets + np.einsum("tp,tpw->w", force, speeds)
