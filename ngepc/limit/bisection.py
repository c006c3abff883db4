"""Triangles cut in two along their longest edges, and fans at points where stresses jump.

At a point where a load or a support ends, the stress depends on the polar angle at every distance
(a fan).  Cutting triangles along their longest edges adds no rays at such a point: triangles there
are cut along the edge opposite to it, until their angle is small enough.
"""

from __future__ import annotations

import math

import numpy as np

from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.limit.data import GROWS, STAYS, LimitData

STRAIGHT = math.pi + 1e-6
"""Boundary points with a larger interior angle are re-entrant corners."""

RESOLVED = math.radians(22.5)
"""Angle of a fan's triangles that suits a bracket of relative width ``AT_WIDTH``."""

AT_WIDTH = 0.08
"""Errors of fans are proportional to the square of the angle: 0.025 at 22.5 degrees for Prandtl's
strip."""


WIDEST = math.radians(60)
"""Largest angle at a singular point on all meshes but the first."""

WIDE = 0.5
"""Relative width of a bracket beyond which its mechanism is not yet used for marking."""


def split_corners(data: LimitData) -> tuple[Simplices, np.ndarray]:
    """Cut cells with several outer facets at the centre, so that each has one; and the parents.

    In one cell with an affine stress the tractions on two facets are coupled along their common
    edge: loads that are not compatible there would admit no stress at all.
    """
    cells = data.cells
    N = cells.N
    several = cells.outer[cells.facet_of].sum(axis=1) > 1
    own = np.arange(len(several))
    middle = len(cells.points) + np.arange(several.sum())
    points = np.vstack([cells.points, cells.points[cells.nodes[several]].mean(axis=1)])
    nodes = [cells.nodes[~several]]
    parents = [own[~several]]
    for k in range(N + 1):
        part = cells.nodes[several].copy()
        part[:, k] = middle
        nodes.append(part)
        parents.append(own[several])
    numbers = np.concatenate(parents)
    order = np.argsort(data.region[numbers], kind="stable")
    return Simplices(points, np.concatenate(nodes)[order]), numbers[order]


def fan_angle(width: float) -> float:
    """Largest angle of a fan's triangles on the mesh after one with this relative width."""
    return min(WIDEST, RESOLVED * math.sqrt(width / AT_WIDTH))


def corner_angles(cells: Simplices) -> np.ndarray:
    """The angles of triangles at their vertices, (nc, 3)."""
    x = cells.points[cells.nodes]
    sides = np.roll(x, -1, axis=1) - x
    return np.stack([_angle(sides[:, k], -sides[:, k - 1]) for k in range(3)], axis=1)


def singular_points(data: LimitData) -> np.ndarray:
    """Boundary vertices where loads or supports change, and re-entrant corners, as booleans."""
    cells = data.cells
    count = len(cells.points)
    angle = corner_angles(cells)
    total = np.bincount(cells.nodes.ravel(), angle.ravel(), minlength=count)
    outer = np.flatnonzero(cells.outer)
    ends = cells.facets[outer]
    on_boundary = np.zeros(count, dtype=bool)
    on_boundary[ends] = True
    result = on_boundary & (total > STRAIGHT)
    features = np.concatenate(
        [
            data.held[outer, None, None] * np.ones((1, 2, 1)),
            data.contact[outer, None, None] * np.ones((1, 2, 1)),
            data.friction[outer, :, None],
            data.traction[GROWS][outer],
            data.traction[STAYS][outer],
            data.motion[outer],
        ],
        axis=2,
    )
    order = np.argsort(ends.ravel(), kind="stable")
    vertex = ends.ravel()[order]
    values = features.reshape(len(order), -1)[order]
    same = vertex[1:] == vertex[:-1]
    scale = np.abs(values).max(axis=0) + 1e-300
    jumps = (np.abs(values[1:] - values[:-1]) > 1e-9 * scale).any(axis=1) & same
    result[vertex[1:][jumps]] = True
    return result


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between vectors in the plane."""
    cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.abs(np.arctan2(cross, (a * b).sum(axis=1)))


def fan_cells(
    data: LimitData, singular: np.ndarray, dissipated: np.ndarray, width: float
) -> np.ndarray:
    """For each cell the local vertex at which its angle has to be halved, or -1.

    These are cells with a large angle at a ``singular`` vertex that dissipate; while the relative
    ``width`` of the bracket is large, all cells with such an angle.
    """
    most = fan_angle(width)
    cells = data.cells
    singular = singular[cells.nodes]
    angle = corner_angles(cells)
    density = dissipated / cells.volume
    busy = density > 0.1 * dissipated.sum() / cells.volume.sum()
    busy |= width > WIDE
    wide = np.where(singular & (angle > most) & busy[:, None], angle, 0.0)
    return np.where(wide.any(axis=1), wide.argmax(axis=1), -1)


def bisected_cells(
    cells: Simplices, chosen: np.ndarray, fans: np.ndarray
) -> tuple[Simplices, np.ndarray]:
    """Cut the chosen cells and those of fans, and neighbours until the mesh conforms; and parents.

    All edges of chosen cells are cut.  ``fans`` is the result of ``fan_cells``: each cell is first
    cut along the edge opposite to this vertex, or along the longest edge for -1.
    """
    lengths = cells.measure[cells.facet_of]
    first = np.where(fans >= 0, fans, lengths.argmax(axis=1))
    own = np.arange(len(first))
    edge = cells.facet_of[own, first]
    cut = np.zeros(len(cells.facets), dtype=bool)
    cut[cells.facet_of[chosen & (fans < 0)]] = True
    cut[edge[fans >= 0]] = True
    while True:
        needed = cut[cells.facet_of].any(axis=1) & ~cut[edge]
        if not needed.any():
            break
        cut[edge[needed]] = True
    middle = np.full(len(cut), -1)
    middle[cut] = len(cells.points) + np.arange(cut.sum())
    points = np.vstack([cells.points, cells.points[cells.facets[cut]].mean(axis=1)])
    whole = ~cut[edge]
    nodes = [cells.nodes[whole]]
    parents = [own[whole]]
    top, left, right = (
        np.take_along_axis(cells.nodes, ((first + k) % 3)[:, None], axis=1)[~whole, 0]
        for k in range(3)
    )
    m = middle[edge[~whole]]
    for a, b, apart in ((top, left, 2), (right, top, 1)):
        side = np.take_along_axis(cells.facet_of, ((first + apart) % 3)[:, None], 1)
        q = middle[side[~whole, 0]]
        halved = q >= 0
        nodes.append(np.column_stack([a, b, m])[~halved])
        nodes.append(np.column_stack([a, q, m])[halved])
        nodes.append(np.column_stack([q, b, m])[halved])
        parents += [own[~whole][~halved], own[~whole][halved], own[~whole][halved]]
    return Simplices(points, np.concatenate(nodes)), np.concatenate(parents)


assert FACETS[2] == ((1, 2), (2, 0), (0, 1))
