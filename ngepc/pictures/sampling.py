"""Samples of fields on elements that are cut into triangles, and colour scales from them.

Elements are sampled one by one, since fields may jump.  Curved elements, and those whose
displacement is not linear, are cut finely enough to look curved.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import Normalize
from ngsolve import (
    BND,
    CF,
    ET,
    VOL,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IntegrationRule,
    Mesh,
    Region,
    x,
    y,
    z,
)
from scipy.spatial import Delaunay

from ngepc.checks.arguments import require_number
from ngepc.model.elements import outward_normal
from ngepc.model.processes import require_whole
from ngepc.results.fields import Fields

CURVED_CUTS, MOST_TRIANGLES = 4, 200_000
PERCENT = 2.0
"""Part of the area that may lie beyond either end of a colour scale."""
NO_OBSTACLE = 5.0
"""A gap of more than this many times the size of the body stands for no obstacle."""


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
        gram = np.einsum("tik,tjk->tij", edges, edges)
        return np.sqrt(np.maximum(np.linalg.det(gram), 0.0)) / max(1, edges.shape[1])


def _pieces(shape: ET, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a reference element whose edges are cut into n parts, and its pieces by number."""
    t = np.arange(n + 1)
    if shape is ET.SEGM:
        return t[:, None] / n, t[:-1, None] + [0, 1]
    points = np.array([(i, j) for j in t for i in t if shape is ET.QUAD or i + j <= n])
    return points / n, Delaunay(points).simplices


def _border(shape: ET, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The same for the segments of its border: the sides of one piece alone."""
    points, pieces = _pieces(shape, n)
    sides = np.sort(pieces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
    found, count = np.unique(sides, axis=0, return_counts=True)
    return points, found[count == 1]


def is_curved(fields: Fields) -> bool:
    """Whether elements or their displacement are not linear."""
    return max(fields.problem.mesh.GetCurveOrder(), fields.displacement.space.globalorder) > 1


def visible(mesh: Mesh, coefficient: CoefficientFunction) -> tuple[Region, CoefficientFunction]:
    """What pictures show of a body and a field: all of it in 2D, surface and trace in 3D."""
    require_whole("pictures", mesh)
    if mesh.dim == 2:
        return mesh.Materials(".*"), coefficient
    return mesh.Boundaries(".*"), BoundaryFromVolumeCF(coefficient)


def body_corners(
    fields: Fields, coefficient: CoefficientFunction, cuts: int | None = None
) -> Corners:
    """The field on the triangles of the body (2D) or of its surface (3D)."""
    return sample_corners(fields, *visible(fields.problem.mesh, coefficient), cuts)


def boundary_corners(
    fields: Fields, names: tuple[str, ...] | None = None, coefficient: CoefficientFunction = None
) -> Corners:
    """A field at the ends (2D) or corners (3D) of the elements of the named boundaries."""
    region = fields.problem.mesh.Boundaries(".*" if names is None else "|".join(names))
    return sample_corners(fields, region, CF(0.0) if coefficient is None else coefficient)


def element_borders(fields: Fields) -> Corners:
    """The borders of what is visible of the elements in segments, for the lines of the mesh."""
    return sample_corners(fields, visible(fields.problem.mesh, CF(0.0))[0], CF(0.0), cut=_border)


def sample_corners(
    fields: Fields,
    region: Region,
    coefficient: CoefficientFunction,
    cuts: int | None = None,
    cut: object = _pieces,
) -> Corners:
    """Position, displacement and a coefficient at the corners of the pieces of ``region``.

    Each edge is cut into ``cuts`` parts; None for as many as bodies need to look as they are.
    """
    mesh, types = fields.problem.mesh, np.array([e.type for e in region.Elements()])
    if cuts is None:
        bent = is_curved(fields) or ET.QUAD in types or mesh.dim == 3
        most = math.sqrt(MOST_TRIANGLES / mesh.GetNE(VOL if mesh.dim == 2 else BND))
        cuts = max(1, min(CURVED_CUTS, int(most))) if bent else 1
    legal = (ET.TRIG, ET.QUAD) if set(types) <= {ET.TRIG, ET.QUAD} else (ET.SEGM,)
    parts = {shape: cut(shape, cuts) for shape in legal}
    rules = {shape: IntegrationRule(p.tolist(), [0.0] * len(p)) for shape, (p, _) in parts.items()}
    mapped = mesh.MapToAllElements(rules, region)
    counts = np.array([len(parts[shape][0]) for shape in types])
    first = np.cumsum(counts) - counts
    pieces = np.vstack([
        (first[types == shape][:, None, None] + corners).reshape(-1, corners.shape[1])
        for shape, (_, corners) in parts.items()
    ])  # fmt: skip
    sampled = (CF((x, y, z)[: mesh.dim]), fields.displacement, coefficient)
    found = (np.asarray(c(mapped), float).reshape(len(mapped), -1)[pieces] for c in sampled)
    points, displacement, values = found
    return Corners(points, displacement, values[..., 0] if coefficient.dim == 1 else values)


def offset(
    fields: Fields, names: tuple[str, ...], distance: CoefficientFunction, scale: float
) -> np.ndarray:
    """Segments of boundaries in 2D, deformed by ``scale`` u, moved by ``distance`` n."""
    reach = distance * outward_normal(fields.problem.mesh)
    corners = boundary_corners(fields, names, reach)
    return corners.deformed(scale) + corners.values


def obstacle_lines(fields: Fields, scale: float) -> np.ndarray:
    """The obstacle, ``scale`` psi away from the 2D contact boundary, as far as a picture has room.

    Parts whose gap stands for no obstacle are left out, and those farther away than a quarter of
    the body, unless all are.  A straight obstacle is drawn as long as the body above it.
    """
    psi, names = fields.problem.psi, fields.problem.contact_names
    if not names:
        return np.empty((0, 2, 2))
    gaps = boundary_corners(fields, names, psi).values.max(axis=1)
    border = boundary_corners(fields)
    extent = np.ptp(border.points.reshape(-1, 2), axis=0).max()
    room = max(0.25 * extent, 1.2 * scale * gaps.min())
    shown = (scale * gaps <= room) & (gaps < NO_OBSTACLE * extent)
    segments = offset(fields, names, scale * psi, 0.0)[shown]
    if not len(segments):
        return segments
    points = segments.reshape(-1, 2)
    centre = points.mean(axis=0)
    _, size, (along, _) = np.linalg.svd(points - centre, full_matrices=False)
    if size[1] > 1e-6 * extent:  # not straight
        return segments
    reach = (np.vstack([points, border.deformed(scale).reshape(-1, 2)]) - centre) @ along
    ends = centre + np.outer([reach.min(), reach.max()], along)
    return np.concatenate([segments, ends[None]])


def colour_scale(
    *samples: Corners,
    ends: tuple[float | None, float | None] = (None, None),
    symmetric: bool = False,
) -> Normalize:
    """Limits that a re-entrant corner does not swallow, common to all ``samples``.

    The limits are percentiles by area over the part where the field is not zero.  An end where
    that would gain less than a quarter of the scale stays where the data end, and a scale of one
    sign that comes close to zero begins there.  ``symmetric`` fields get limits of opposite sign;
    ``ends`` overrule.  Its ``extend`` tells colour bars where values lie outside.
    """
    vmin, vmax = (
        None if end is None else require_number(name, end)
        for name, end in zip(("vmin", "vmax"), ends, strict=True)
    )
    if vmin is not None and vmax is not None and vmin >= vmax:
        raise ValueError(f"vmin={vmin!r}, vmax={vmax!r}: vmin < vmax is needed")
    values = np.concatenate([s.values.mean(axis=1) for s in samples])
    areas = np.concatenate([s.measures for s in samples])
    lowest = min(float(s.values.min()) for s in samples)
    highest = max(float(s.values.max()) for s in samples)
    span = highest - lowest
    low, high = _percentiles(values, areas)
    low = lowest if low - lowest <= 0.25 * span else low
    high = highest if highest - high <= 0.25 * span else high
    low = 0.0 if lowest >= 0.0 and low <= 0.2 * high else low
    high = 0.0 if highest <= 0.0 and high >= 0.2 * low else high
    if symmetric:
        low, high = -max(-low, high), max(-low, high)
    low, high = (0.0 if abs(end) < 1e-9 * span else end for end in (low, high))
    low, high = low if vmin is None else vmin, high if vmax is None else vmax
    if low >= high:  # a constant field
        size = max(abs(low), abs(high)) or 1.0
        low, high = high - size if vmin is None else low, low + size if vmax is None else high
    scale, slack = Normalize(low, high), 1e-6 * (high - low)
    below, above = lowest < low - slack, highest > high + slack
    scale.extend = (("neither", "max"), ("min", "both"))[below][above]
    return scale


def _percentiles(values: np.ndarray, areas: np.ndarray) -> tuple[float, float]:
    """The ends of all but ``PERCENT`` of the area at either side, where the field is not zero."""
    shown = np.abs(values) > 1e-3 * np.abs(values).max(initial=0.0)
    if not shown.any():
        return float(values.min()), float(values.max())
    order = np.flatnonzero(shown)[np.argsort(values[shown])]
    part = np.cumsum(areas[order]) / areas[order].sum()
    low, high = values[order[np.searchsorted(part, [PERCENT / 100, 1 - PERCENT / 100])]]
    return float(low if shown.all() else min(0.0, low)), float(high)
