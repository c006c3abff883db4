"""The data of limit analysis: growing and constant loads, supports, obstacles, strength.

The data are constant on cells or affine on boundary facets of the mesh of the problem; they are
transferred to finer meshes exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ngepc.bounds.simplices import Simplices
from ngepc.bounds.sizes import power_of_two

GROWS = 0
STAYS = 1
"""First index of load arrays: growing loads and constant loads."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LimitData:
    """The data of a limit load on some cells.

    Parameters
    ----------
    cells
        The cells and their facets; nc cells, nf facets.
    bound
        The yield bound beta of each cell (stress), shape (nc,).
    force
        Growing and constant body forces, (2, nc, N) (force per volume).
    traction
        The same on facets, at their vertices, (2, nf, N, N) (stress).
    motion
        Velocity of the supports at the vertices of facets, (nf, N, N).
    frame, held
        Orthonormal rows for each facet, (nf, N, N), of which supports hold the first ``held``.
        Where an obstacle touches, the first row is the outer normal.
    contact, friction
        Whether an obstacle touches the facet; Tresca's bound at the vertices (stress), (nf, N).
    moves
        Whether the load is a motion of supports, and not a set of forces.
    region, side
        Number of the material of each cell, and of the boundary of each facet, -1 inside.
    """

    cells: Simplices
    bound: np.ndarray
    force: np.ndarray
    traction: np.ndarray
    motion: np.ndarray
    frame: np.ndarray
    held: np.ndarray
    contact: np.ndarray
    friction: np.ndarray
    moves: bool
    region: np.ndarray
    side: np.ndarray

    @property
    def has_constant(self) -> bool:
        """Whether there are constant loads."""
        return bool(self.force[STAYS].any() or self.traction[STAYS].any())

    def on(self, cells: Simplices, parents: np.ndarray) -> LimitData:
        """The same data on finer ``cells`` inside the cells ``parents``."""
        coarse = self.cells
        outer = np.flatnonzero(cells.outer)
        above = parents[cells.owners[outer, 0]]
        vertices = cells.points[cells.facets[outer]]
        shares = barycentric(coarse, above, vertices)
        opposite = np.abs(shares).max(axis=1).argmin(axis=1)
        facet = coarse.facet_of[above, opposite]
        corners = coarse.nodes[above][:, None, :]
        same = corners == coarse.facets[facet][:, :, None]
        weights = np.einsum("fvc,fec->fve", shares, same)

        def at_vertices(values: np.ndarray) -> np.ndarray:
            """Affine functions on the coarse facets at the vertices of the fine ones."""
            result = np.zeros((len(cells.facets), *values.shape[1:]))
            result[outer] = np.einsum("fve,fe...->fv...", weights, values[facet])
            return result

        def of_facet(values: np.ndarray, inside: np.ndarray | int) -> np.ndarray:
            """Values that are constant on facets, with a given value inside the body."""
            result = np.empty((len(cells.facets), *values.shape[1:]), values.dtype)
            result[:] = inside
            result[outer] = values[facet]
            return result

        return LimitData(
            cells=cells,
            bound=self.bound[parents],
            force=self.force[:, parents],
            traction=np.stack([at_vertices(load) for load in self.traction]),
            motion=at_vertices(self.motion),
            frame=of_facet(self.frame, np.eye(cells.N)),
            held=of_facet(self.held, 0),
            contact=of_facet(self.contact, 0),
            friction=at_vertices(self.friction),
            moves=self.moves,
            region=self.region[parents],
            side=of_facet(self.side, -1),
        )

    def without_units(self) -> tuple[LimitData, float]:
        """The data in units in which numbers are of order one, and the unit of the load factor.

        The units are the extent of the body, the largest yield bound, and the size of the loads,
        rounded to powers of two: the numbers do not change otherwise.
        """
        cells = self.cells
        length = power_of_two(float(np.ptp(cells.points, axis=0).max()))
        stress = power_of_two(float(self.bound.max()))
        units = [stress, stress]
        growing = [
            np.abs(self.force[GROWS]).max(initial=0.0) * length,
            np.abs(self.traction[GROWS]).max(initial=0.0),
        ]
        speed = power_of_two(float(np.abs(self.motion).max(initial=0.0)))
        units[GROWS] = power_of_two(float(max(growing)) or stress)
        loads = np.array(units)[:, None, None]
        plain = replace(
            self,
            cells=Simplices(cells.points / length, cells.nodes),
            bound=self.bound / stress,
            force=self.force * length / loads,
            traction=self.traction / loads[..., None],
            motion=self.motion / speed,
            friction=self.friction / stress,
        )
        if self.moves:
            return plain, stress * length ** (cells.N - 1) * speed
        return plain, stress / units[GROWS]


def barycentric(cells: Simplices, chosen: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Coordinates (k, m, N + 1) of points (k, m, N) in the chosen cells (k,)."""
    away = points - cells.points[cells.nodes[chosen, 0]][:, None]
    shares = np.einsum("kmi,kci->kmc", away, cells.gradients[chosen])
    shares[:, :, 0] += 1.0
    return shares
