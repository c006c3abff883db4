"""Samples of fields at element corners, and colour ranges from them: what pictures are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ngsolve import (
    CF,
    ET,
    VOL,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    GridFunction,
    IntegrationRule,
    Mesh,
    Region,
    x,
    y,
    z,
)

from ngepc.checks.arguments import require_number
from ngepc.model.normals import outward_normal
from ngepc.results.fields import Fields


def _segments(n: int) -> tuple[list[tuple], list[tuple]]:
    """The points that cut the reference segment into n parts, and the parts as point numbers."""
    return [(i / n,) for i in range(n + 1)], [(i, i + 1) for i in range(n)]


def _triangles(n: int) -> tuple[list[tuple], list[tuple]]:
    """The same for the reference triangle, cut into n^2 triangles."""
    cells = [(i, j) for j in range(n + 1) for i in range(n + 1 - j)]
    number = {cell: k for k, cell in enumerate(cells)}
    corners = [((i, j), (i + 1, j), (i, j + 1)) for i, j in cells if i + j < n]
    corners += [((i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in cells if i + j < n - 1]
    return [(i / n, j / n) for i, j in cells], [
        tuple(number[c] for c in three) for three in corners
    ]


def _squares(n: int) -> tuple[list[tuple], list[tuple]]:
    """The same for the reference square, cut into 2 n^2 triangles."""
    cells = [(i, j) for j in range(n + 1) for i in range(n + 1)]
    number = {cell: k for k, cell in enumerate(cells)}
    inner = [(i, j) for i, j in cells if i < n and j < n]
    corners = [((i, j), (i + 1, j), (i + 1, j + 1)) for i, j in inner]
    corners += [((i, j), (i + 1, j + 1), (i, j + 1)) for i, j in inner]
    return [(i / n, j / n) for i, j in cells], [
        tuple(number[c] for c in three) for three in corners
    ]


NO_OBSTACLE = 5.0
"""A gap of more than this many times the size of the body stands for no obstacle."""

_PARTS = {ET.SEGM: _segments, ET.TRIG: _triangles, ET.QUAD: _squares}


@dataclass(frozen=True, eq=False)
class Corners:
    """Values at the corners of elements, each element on its own (fields may jump).

    Parameters
    ----------
    points, displacement
        Positions and displacements (length), shape (triangles, corners, N).
    values
        Values of the field, shape (triangles, corners).
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

    def refined(self) -> Corners:
        """Each triangle cut into four at the middles of its edges, data interpolated."""

        def split(data: np.ndarray) -> np.ndarray:
            a, b, c = data[:, 0], data[:, 1], data[:, 2]
            ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
            parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
            return np.concatenate([np.stack(part, axis=1) for part in parts])

        return Corners(split(self.points), split(self.displacement), split(self.values))

    @property
    def constant(self) -> bool:
        """Whether the field is constant on each element."""
        spread = np.ptp(self.values, axis=1).max()
        return bool(spread <= 1e-9 * max(np.abs(self.values).max(), 1e-300))


def surface_value(mesh: Mesh, coefficient: CoefficientFunction) -> CoefficientFunction:
    """A coefficient of the body where pictures show it: in 3D its trace from inside."""
    return BoundaryFromVolumeCF(coefficient) if mesh.dim == 3 else coefficient


def body_corners(fields: Fields, coefficient: CoefficientFunction, cuts: int = 1) -> Corners:
    """The field at the corners of the triangles of the body (2D) or of its surface (3D).

    Each edge is cut into ``cuts`` parts.
    """
    mesh = fields.problem.mesh
    region = mesh.Materials(".*") if mesh.dim == 2 else mesh.Boundaries(".*")
    value = surface_value(mesh, coefficient)
    return sample_corners(mesh, region, fields.displacement, value, cuts)


def boundary_corners(
    fields: Fields, names: tuple[str, ...] | None = None, coefficient: CoefficientFunction = None
) -> Corners:
    """A field at the ends (2D) or corners (3D) of the elements of the named boundaries."""
    mesh = fields.problem.mesh
    region = mesh.Boundaries(".*" if names is None else "|".join(names))
    value = CF(0.0) if coefficient is None else coefficient
    return sample_corners(mesh, region, fields.displacement, value)


def contact_offset(fields: Fields, distance: CoefficientFunction, scale: float) -> np.ndarray:
    """The 2D contact boundary, deformed by ``scale`` u, moved by ``distance`` along n.

    Returns
    -------
    numpy.ndarray
        Segments, shape (segments, 2, 2).
    """
    reach = distance * outward_normal(fields.problem.mesh)
    names = fields.problem.contact_names
    place = [boundary_corners(fields, names, reach[i]) for i in range(2)]
    return place[0].deformed(scale) + np.stack([c.values for c in place], axis=-1)


def obstacle_lines(fields: Fields, scale: float) -> np.ndarray:
    """The obstacle, ``scale`` psi away from the 2D contact boundary, where a picture has room.

    Left out are parts farther away than a quarter of the body, unless all are, and those whose
    gap stands for no obstacle.

    Returns
    -------
    numpy.ndarray
        Segments, shape (segments, 2, 2).
    """
    psi = fields.problem.psi
    gaps = boundary_corners(fields, fields.problem.contact_names, psi).values.max(axis=1)
    extent = np.ptp(boundary_corners(fields).points.reshape(-1, 2), axis=0).max()
    room = max(0.25 * extent, 1.2 * scale * gaps.min())
    shown = (scale * gaps <= room) & (gaps < NO_OBSTACLE * extent)
    return contact_offset(fields, scale * psi, 0.0)[shown]


def sample_corners(
    mesh: Mesh,
    region: Region,
    displacement: GridFunction,
    coefficient: CoefficientFunction,
    cuts: int = 1,
) -> Corners:
    """Position, displacement and a scalar at the corners of the elements of ``region``.

    The elements are cut into triangles or segments, each edge into ``cuts`` parts.
    """
    elements = list(region.Elements())
    parts = {shape: cut(cuts) for shape, cut in _PARTS.items()}
    rules = {shape: IntegrationRule(c, [0.0] * len(c)) for shape, (c, _) in parts.items()}
    dim = mesh.dim if region.VB() == VOL else mesh.dim - 1
    legal = {1: (ET.SEGM,), 2: (ET.TRIG, ET.QUAD)}[dim]
    points = mesh.MapToAllElements({t: rules[t] for t in legal}, region)
    N = mesh.dim
    data = np.hstack(
        [_evaluated(c, points) for c in (CF((x, y, z)[:N]), displacement, coefficient)]
    )
    counts = np.array([len(parts[element.type][0]) for element in elements])
    first = np.r_[0, np.cumsum(counts)[:-1]]
    rows = [
        first[counts == len(corners)][:, None] + np.array(split)
        for corners, splits in (parts[t] for t in legal)
        for split in splits
    ]
    data = data[np.vstack(rows)]
    return Corners(data[..., :N], data[..., N : 2 * N], data[..., -1])


def _evaluated(coefficient: CoefficientFunction, points: object) -> np.ndarray:
    return np.asarray(coefficient(points), dtype=float).reshape(len(points), -1)


@dataclass(frozen=True)
class ColourRange:
    """Limits of the colour scale, and whether values lie outside.

    Parameters
    ----------
    least, most
        Values at the ends of the scale.
    below, above
        Whether the field has values outside the scale, for the arrows on the colour bar.
    """

    least: float
    most: float
    below: bool = False
    above: bool = False

    @property
    def extend(self) -> str:
        """The word that matplotlib wants: 'neither', 'min', 'max' or 'both'."""
        return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[
            self.below, self.above
        ]


def colour_range(
    *samples: Corners,
    vmin: float | None = None,
    vmax: float | None = None,
    percent: float = 2.0,
    symmetric: bool = False,
) -> ColourRange:
    """Limits that a re-entrant corner does not swallow, common to all ``samples``.

    The limits are percentiles by area over the part where the field is not zero: ``percent`` of
    it may lie outside at either end.  An end where that would gain less than a quarter of the
    scale stays where the data end, and a scale of one sign that comes close to zero
    begins there.  ``symmetric`` fields get limits of opposite sign;
    ``vmin`` and ``vmax`` overrule either limit.

    Raises
    ------
    TypeError, ValueError
        If a limit is no finite number, or ``vmin`` not below ``vmax``.
    """
    for name, end in (("vmin", vmin), ("vmax", vmax)):
        if end is not None:
            require_number(name, end)
    values = np.concatenate([s.values.mean(axis=1) for s in samples])
    weights = np.concatenate([s.measures for s in samples])
    every = np.concatenate([s.values.ravel() for s in samples])
    lowest, highest = float(every.min()), float(every.max())
    low, high = _percentiles(values, weights, percent)
    span = highest - lowest
    if low - lowest <= 0.25 * span:
        low = lowest
    if highest - high <= 0.25 * span:
        high = highest
    if lowest >= 0.0 and low <= 0.2 * high:
        low = 0.0
    if highest <= 0.0 and high >= 0.2 * low:
        high = 0.0
    if symmetric:
        low, high = -max(abs(low), abs(high)), max(abs(low), abs(high))
    low, high = (0.0 if abs(end) < 1e-9 * span else end for end in (low, high))
    low = low if vmin is None else require_number("vmin", vmin)
    high = high if vmax is None else require_number("vmax", vmax)
    if low >= high:
        if vmin is not None and vmax is not None:
            raise ValueError(f"vmin={vmin!r}, vmax={vmax!r}: vmin < vmax is needed")
        low, high = _widened(low, high, fixed_low=vmin is not None, fixed_high=vmax is not None)
    slack = 1e-6 * (high - low)
    return ColourRange(low, high, lowest < low - slack, highest > high + slack)


def _percentiles(values: np.ndarray, weights: np.ndarray, percent: float) -> tuple[float, float]:
    shown = np.abs(values) > 1e-3 * np.abs(values).max(initial=0.0)
    if not shown.any():
        return float(values.min()), float(values.max())
    order = np.argsort(values[shown])
    ordered, area = values[shown][order], np.cumsum(weights[shown][order])
    share = area / area[-1]
    low, high = np.searchsorted(share, [percent / 100, 1 - percent / 100])
    lowest = min(0.0, ordered[low]) if not shown.all() else ordered[low]
    return float(lowest), float(ordered[min(high, len(ordered) - 1)])


def _widened(low: float, high: float, *, fixed_low: bool, fixed_high: bool) -> tuple[float, float]:
    size = max(abs(low), abs(high)) or 1.0
    if fixed_low:
        return low, low + size
    return (high - size, high) if fixed_high else (low - 0.5 * size, low + 0.5 * size)
