"""Samples of fields on elements that are cut into triangles, and colour scales from them.

Elements are sampled one by one, since fields may jump.  Curved elements, and those whose
displacement is not linear, are cut finely enough to look curved.
"""

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import Normalize
from ngsolve import (
    CF,
    ET,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IntegrationRule,
    Region,
    x,
    y,
    z,
)

from ngepc.checks.arguments import require_number
from ngepc.model.elements import elements_by_type, outward_normal
from ngepc.model.features import (
    BASIC_FEATURES,
    CONTACT_FEATURES,
    ELEMENT_FEATURES,
    HISTORY_FEATURES,
    KINEMATICS_FEATURES,
    LAW_FEATURES,
    SUPPORT_FEATURES,
    require_covered,
)
from ngepc.model.processes import require_whole
from ngepc.results.fields import Fields

ROUNDED = 1e-9  # part of the size of a field below which its values are all the same

Ends = tuple[float | None, float | None]

COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | KINEMATICS_FEATURES
    | ELEMENT_FEATURES
    | LAW_FEATURES
    | CONTACT_FEATURES
    | SUPPORT_FEATURES
    | {"anisotropic yield", "cyclic hardening"}
)
"""Features that pictures cover."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Values at the corners of triangles or segments, each element on its own (fields may jump).

    Positions and displacements (length) have the shape (pieces, corners, N), values
    (pieces, corners), or (pieces, corners, components) of a vector.
    """

    points: np.ndarray
    displacement: np.ndarray
    values: np.ndarray

    def deformed(self, scale: float) -> np.ndarray:
        """Corner positions in the configuration deformed by ``scale`` u."""
        return self.points + scale * self.displacement

    @property
    def measures(self) -> np.ndarray:
        """Length or area of each segment or triangle."""
        edges = self.points[:, 1:] - self.points[:, :1]
        squares = np.einsum("tik,tik->it", edges, edges)
        if len(squares) == 1:
            return np.sqrt(squares[0])
        product = np.einsum("tk,tk->t", edges[:, 0], edges[:, 1])
        return 0.5 * np.sqrt(np.maximum(squares[0] * squares[1] - product**2, 0.0))


def is_curved(fields: Fields) -> bool:
    """Whether elements or their displacement are not linear."""
    return (
        max(fields.problem.mesh.GetCurveOrder(), fields.displacement.space.globalorder)
        > 1
    )


def visible(fields: Fields, coefficient: CoefficientFunction) -> CoefficientFunction:
    """The part of a field that pictures show: all of it in 2D, its trace in 3D."""
    return coefficient if fields.problem.N == 2 else BoundaryFromVolumeCF(coefficient)


def corners_of(
    fields: Fields,
    coefficient: CoefficientFunction | None = None,
    where: str | None = None,
    cuts: int | None = None,
    border: bool = False,
    keep: np.ndarray | None = None,
) -> Corners:
    """A coefficient, zero for None, at the corners of the drawn pieces of elements.

    Drawn are the body, in 3D its surface, or the boundaries ``where`` (a pattern); with ``border``
    the borders of elements in segments.  Each edge is cut into ``cuts`` parts; None for as many as
    bodies need to look as they are.  ``keep`` says which of these elements are drawn.
    """
    mesh = fields.problem.mesh
    require_whole("a picture", mesh)
    if isinstance(fields, Fields):
        require_covered(fields.problem, "a picture", COVERS)
    plane = where is None and mesh.dim == 2
    region = mesh.Materials(".*") if plane else mesh.Boundaries(where or ".*")
    dimension = 2 if plane else mesh.dim - 1
    types = elements_by_type(mesh, dimension, region.Mask())
    number = sum(len(alike) for alike in types.values()) // max(1, len(types))
    if cuts is None:
        bent = is_curved(fields) or ET.QUAD in types or mesh.dim == 3
        cuts = max(1, min(4, math.isqrt(200_000 // number))) if bent else 1
    parts = {shape: _pieces(shape, cuts, border) for shape in types}
    kept = np.ones(number, dtype=bool) if keep is None else keep
    chosen = {shape: alike & kept for shape, alike in types.items()}
    coefficient = CF(0.0) if coefficient is None else coefficient
    points, displacement, values = at_corners(
        fields, coefficient, region, parts, types, chosen
    )
    values = values[..., 0] if coefficient.dim == 1 else values
    return Corners(points, displacement, values)


Pieces = dict[ET, tuple[np.ndarray, np.ndarray]]
"""Shape of elements -> points of the reference element, numbers of the corners of its pieces."""


def at_corners(
    fields: Fields,
    coefficient: CoefficientFunction,
    region: Region,
    parts: Pieces,
    types: dict[ET, np.ndarray],
    chosen: dict[ET, np.ndarray],
) -> list[np.ndarray]:
    """Positions, displacement and a coefficient at the corners of pieces, (pieces, corners, .).

    ``types`` and ``chosen`` say which elements of the region have a shape, and of which the pieces
    are wanted.
    """
    mesh = fields.problem.mesh
    rules = {
        shape: IntegrationRule(points.tolist(), [0.0] * len(points))
        for shape, (points, _) in parts.items()
    }
    mapped = mesh.MapToAllElements(rules, region)
    counts = sum(alike * len(parts[shape][0]) for shape, alike in types.items())
    first = np.cumsum(counts) - counts

    pieces = []
    for shape, (_, corners) in parts.items():
        numbers = first[chosen[shape]][:, None, None] + corners
        pieces.append(numbers.reshape(-1, corners.shape[1]))
    every = np.concatenate(pieces)

    values = []
    for sampled in (CF((x, y, z)[: mesh.dim]), fields.displacement, coefficient):
        at_points = np.asarray(sampled(mapped), float).reshape(len(mapped), -1)
        values.append(at_points[every])
    return values


def _pieces(shape: ET, n: int, border: bool) -> tuple[np.ndarray, np.ndarray]:
    """Points of a reference element whose edges are cut into n parts, and its pieces by number."""
    t = np.arange(n + 1)
    if shape == ET.SEGM:
        return t[:, None] / n, t[:-1, None] + [0, 1]
    points = [(i, j) for j in t for i in t if shape == ET.QUAD or i + j <= n]
    number = {point: k for k, point in enumerate(points)}
    halves = [
        corners
        for i, j in points
        for corners in (
            [(i, j), (i + 1, j), (i, j + 1)],
            [(i + 1, j), (i + 1, j + 1), (i, j + 1)],
        )
        if set(corners) <= set(number)
    ]
    pieces = np.array([[number[corner] for corner in half] for half in halves])
    if border:
        sides = np.sort(pieces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
        sides, count = np.unique(sides, axis=0, return_counts=True)
        pieces = sides[count == 1]
    return np.array(points) / n, pieces


def offset(
    fields: Fields, names: tuple[str, ...], distance: CoefficientFunction, scale: float
) -> np.ndarray:
    """Segments of boundaries in 2D, deformed by ``scale`` u, moved by ``distance`` n."""
    corners = corners_of(
        fields, distance * outward_normal(fields.problem.mesh), "|".join(names)
    )
    return corners.deformed(scale) + corners.values


def obstacle_lines(fields: Fields, scale: float) -> np.ndarray:
    """The obstacle, ``scale`` psi away from the 2D contact boundary, as far as a picture has room.

    Left out are parts whose gap, 5 times the size of the body, stands for no obstacle, and those
    farther away than a quarter of it, unless all are.  A straight obstacle is drawn as long as the
    body above it.
    """
    psi = fields.problem.psi
    names = fields.problem.contact_names
    if not names:
        return np.empty((0, 2, 2))
    gaps = corners_of(fields, psi, "|".join(names)).values.max(axis=1)
    border = corners_of(fields, where=".*", cuts=1)
    extent = np.ptp(border.points.reshape(-1, 2), axis=0).max()
    room = max(0.25 * extent, 1.2 * scale * gaps.min())
    shown = (scale * gaps <= room) & (gaps < 5 * extent)
    segments = offset(fields, names, scale * psi, 0.0)[shown]
    points = segments.reshape(-1, 2)
    if not len(segments):
        return segments
    centre = points.mean(axis=0)
    _, size, (along, _) = np.linalg.svd(points - centre, full_matrices=False)
    if size[1] > 1e-6 * extent:  # not straight
        return segments
    reach = (
        np.vstack([points, border.deformed(scale).reshape(-1, 2)]) - centre
    ) @ along
    ends = centre + np.outer([reach.min(), reach.max()], along)
    return np.concatenate([segments, ends[None]])


def colour_scale(
    *samples: Corners, ends: Ends = (None, None), symmetric: bool = False
) -> Normalize:
    """Common colour limits of all ``samples``, without the peaks at re-entrant corners.

    At each end 2 percent of the area where the field is not zero are left out.  An end where that
    would gain less than a quarter of the scale stays where the data end, and a scale of one sign
    that comes close to zero begins there.  ``symmetric`` fields get limits of opposite sign;
    ``ends`` overrule.  Its ``extend`` tells colour bars where values lie outside.
    """
    vmin, vmax = ends
    for name, end in (("vmin", vmin), ("vmax", vmax)):
        if end is not None:
            require_number(name, end)
    if vmin is not None and vmax is not None and vmin >= vmax:
        raise ValueError(f"vmin={vmin!r}, vmax={vmax!r}: vmin < vmax is needed")
    corners = np.concatenate([s.values for s in samples])
    areas = np.concatenate([s.measures for s in samples])
    low, high = lowest, highest = float(corners.min()), float(corners.max())
    span = highest - lowest
    values = corners.mean(axis=1)
    shown = np.abs(values) > 1e-3 * np.abs(values).max()
    if shown.any():
        order = np.flatnonzero(shown)[np.argsort(values[shown])]
        part = np.cumsum(areas[order]) / areas[order].sum()
        low, high = values[order[np.searchsorted(part, [0.02, 0.98])]].tolist()
        if not shown.all():  # zero is seen as well
            low = min(0.0, low)
            high = max(0.0, high)
    low = lowest if low - lowest <= 0.25 * span else low
    high = highest if highest - high <= 0.25 * span else high
    low = 0.0 if lowest >= 0.0 and low <= 0.2 * high else low
    high = 0.0 if highest <= 0.0 and high >= 0.2 * low else high
    if symmetric:
        low, high = -max(-low, high), max(-low, high)
    low, high = (0.0 if abs(end) < 1e-9 * span else end for end in (low, high))
    low = low if vmin is None else vmin
    high = high if vmax is None else vmax
    size = max(abs(lowest), abs(highest))
    if low >= high or span <= ROUNDED * size:  # a constant field
        size = max(abs(low), abs(high))
        below = size or float(symmetric or vmax is not None)  # no sign: zero begins it
        low, high = (
            high - below if vmin is None else low,
            low + (size or 1.0) if vmax is None else high,
        )
    scale = Normalize(low, high)
    slack = 1e-6 * (high - low)
    below = lowest < low - slack
    above = highest > high + slack
    scale.extend = (("neither", "max"), ("min", "both"))[below][above]
    return scale
