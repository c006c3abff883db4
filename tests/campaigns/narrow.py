"""Narrow features of loads and obstacles, and meshes that are aligned with them.

On an aligned mesh a feature is a polynomial on each element, so that bounds there do not depend on
samples.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from netgen.occ import Glue, OCCGeometry, WorkPlane
from ngsolve import (
    L2,
    CoefficientFunction,
    GridFunction,
    IfPos,
    Mesh,
    SurfaceL2,
    x,
    y,
    z,
)

from ngepc.geometries import block

SHAPES = ("strip", "spot", "step", "wedge", "spike")
SIDES = (1.0, 0.7, 0.8)
"""The body of all problems is (0, 1) x (0, 0.7), in space (0, 1) x (0, 0.7) x (0, 0.8)."""
FAR = 4.0
"""Longer than the body in any direction."""
DEGREE = 3
"""A spike is a product of N affine functions on each of its parts."""
COARSEST = {2: 0.2, 3: 0.3}
"""The mesh width of an aligned mesh far from the feature."""
GROWTH = 1.0
"""How much longer intervals of a grid in space may be for each length of their distance."""


@dataclass(frozen=True)
class Feature:
    """A function that is nonzero within a small width only, or a step.

    Parameters
    ----------
    shape
        One of ``SHAPES``: a strip, a square or cube (spot), a half of the body (step), a strip on
        which the value rises from 0 to 1 (wedge), a product of hats of one variable (spike).
    at
        Its centre, N coordinates.
    width
        The width of the strip, the side of the square.
    angle
        By which it is turned about ``at``, in the plane.
    """

    shape: str
    at: tuple[float, ...]
    width: float
    angle: float = 0.0

    @property
    def N(self) -> int:
        """Dimensions of the body."""
        return len(self.at)

    def axes(self) -> list[CoefficientFunction]:
        """The coordinates from its centre, along its own axes."""
        from_centre = [c - a for c, a in zip((x, y, z), self.at, strict=False)]
        if self.N == 3:
            return from_centre
        right, up = from_centre
        cosine = math.cos(self.angle)
        sine = math.sin(self.angle)
        return [cosine * right + sine * up, cosine * up - sine * right]

    @property
    def value(self) -> CoefficientFunction:
        """A coefficient between 0 and 1."""
        half = self.width / 2
        first, *_ = axes = self.axes()
        if self.shape == "step":
            return IfPos(first, 1.0, 0.0)
        if self.shape == "strip":
            return inside(first, half)
        if self.shape == "wedge":
            return inside(first, half) * (0.5 + first / self.width)
        factor = inside if self.shape == "spot" else hat
        value = factor(first, half)
        for axis in axes[1:]:
            value = value * factor(axis, half)
        return value

    def breaks(self, axis: int) -> tuple[float, ...]:
        """Where along one of its axes the feature is no polynomial, from its centre."""
        half = self.width / 2
        if axis > 0 and self.shape in ("strip", "step", "wedge"):
            return ()
        if self.shape == "step":
            return (0.0,)
        return (-half, 0.0, half) if self.shape == "spike" else (-half, half)


def inside(s: CoefficientFunction, half: float) -> CoefficientFunction:
    """1 where |s| < half, else 0."""
    return IfPos(half - s, IfPos(half + s, 1.0, 0.0), 0.0)


def hat(s: CoefficientFunction, half: float) -> CoefficientFunction:
    """1 at s = 0, affine to 0 at both ends."""
    rising = 1 + s / half
    falling = 1 - s / half
    return inside(s, half) * IfPos(s, falling, rising)


def aligned_mesh(feature: Feature, on_top: bool) -> Mesh:
    """A mesh of the body on whose elements (facets of the top) the feature is a polynomial."""
    if feature.N == 3:
        return _grid(feature)
    return _with_points(feature) if on_top else _glued(feature)


def _with_points(feature: Feature) -> Mesh:
    """In the plane: the breaks are vertices of the top."""
    a, b = SIDES[:2]
    places = [feature.at[0] + offset for offset in feature.breaks(0)]
    stops = sorted(place for place in places if 0 < place < a)
    path = WorkPlane().MoveTo(0, 0).LineTo(a, 0, "clamped").LineTo(a, b, "right")
    for place in reversed(stops):
        path = path.LineTo(place, b, "contact")
    body = path.LineTo(0, b, "contact").LineTo(0, 0, "left").Face()
    _refine_at(body, feature)
    return _meshed(body)


def _glued(feature: Feature) -> Mesh:
    """In the plane: the breaks are edges inside the body."""
    a, b = SIDES[:2]
    path = WorkPlane().MoveTo(0, 0).LineTo(a, 0, "clamped").LineTo(a, b, "right")
    rest = path.LineTo(0, b, "contact").LineTo(0, 0, "left").Face()
    parts = []
    for low, high in _intervals(feature, 0):
        for bottom, top in _intervals(feature, 1):
            frame = WorkPlane().MoveTo(*feature.at).Rotate(math.degrees(feature.angle))
            corner = frame.Move(low).Rotate(90).Move(bottom).Rotate(-90)
            piece = corner.Rectangle(high - low, top - bottom).Face()
            parts.append(rest * piece)
            rest = rest - piece
    for part in parts:
        part.faces.maxh = max(2 * feature.width, COARSEST[2] / 8)
    return _meshed(Glue([*parts, rest]))


def _intervals(feature: Feature, axis: int) -> list[tuple[float, float]]:
    """The intervals between the breaks along an axis; without any it is the whole axis."""
    stops = feature.breaks(axis)
    if not stops:
        return [(-FAR, FAR)]
    if len(stops) == 1:
        return [(stops[0], FAR)]
    return list(pairwise(stops))


def _refine_at(body: object, feature: Feature) -> None:
    """Short segments where the feature lies on the top."""
    b = SIDES[1]
    for edge in body.edges:
        on_top = abs(edge.center.y - b) < 1e-9
        if on_top and abs(edge.center.x - feature.at[0]) < feature.width:
            edge.maxh = max(feature.width / 2, COARSEST[2] / 20)


def _meshed(shape: object) -> Mesh:
    geometry = OCCGeometry(shape, dim=2)
    return Mesh(geometry.GenerateMesh(maxh=COARSEST[2], grading=0.4))


def _grid(feature: Feature) -> Mesh:
    """In space: a tensor grid with planes at the breaks, each cell cut into six tetrahedra."""
    lines = [_lines(feature, axis) for axis in range(3)]
    counts = [len(line) - 1 for line in lines]
    netgen_mesh = block.structured_mesh(*counts, simplices=True).ngmesh
    for point in netgen_mesh.Points():
        for axis, line in enumerate(lines):
            number = round(point.p[axis] * counts[axis])
            point[axis] = float(line[number])
    return Mesh(netgen_mesh)


def _lines(feature: Feature, axis: int) -> np.ndarray:
    """The planes of the grid along an axis: short intervals at the breaks, longer ones beyond."""
    length = SIDES[axis]
    breaks = [feature.at[axis] + offset for offset in feature.breaks(axis)]
    stops = [stop for stop in breaks if 1e-6 < stop < length - 1e-6]
    lines = sorted({0.0, length, *stops})
    while True:
        lengths = np.diff(lines)
        ends = np.array([lines[:-1], lines[1:]])
        away = np.full(ends.shape, np.inf)
        for stop in breaks:
            away = np.minimum(away, np.abs(ends - stop))
        legal = np.minimum(COARSEST[3], feature.width + GROWTH * away.min(axis=0))
        long = np.flatnonzero(lengths > 1.01 * legal)
        if not len(long):
            return np.array(lines)
        middles = [(lines[n] + lines[n + 1]) / 2 for n in long.tolist()]
        lines = sorted([*lines, *middles])


def on_elements(
    mesh: Mesh, value: CoefficientFunction, on_top: bool, degree: int = DEGREE
) -> GridFunction:
    """The function of finite elements that a polynomial on each element is."""
    if on_top:
        result = GridFunction(SurfaceL2(mesh, order=degree))
        result.Set(value, definedon=mesh.Boundaries("contact"))
    else:
        result = GridFunction(L2(mesh, order=degree))
        result.Set(value)
    return result
