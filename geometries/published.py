"""Bodies of published problems, from Netgen's OCC: half a block, and pairs that touch.

The meshes of the two bodies of a pair do not match.
"""

import math
from collections.abc import Callable, Sequence
from itertools import combinations, permutations

import numpy as np
from netgen.occ import (  # fmt: skip
    Box,
    Circle,
    Compound,
    Face,
    Glue,
    MoveTo,
    OCCGeometry,
    Rectangle,
    WorkPlane,
    X,
    Y,
    Z,
)
from ngsolve import Mesh

from .outlines import meshed, netgen_mesh
from .outlines import polygon as outline


def polygon(corners: Sequence[tuple[float, float]]) -> Face:
    """The face within straight edges."""
    path = WorkPlane().MoveTo(*corners[0])
    for corner in corners[1:]:
        path = path.LineTo(*corner)
    return path.Close().Face()


def name_edges(
    shape: Face, distances: Callable[..., dict[str, float]], otherwise: str
) -> None:
    """Name edges by the first of the ``distances`` of their centres that is zero."""
    for edge in shape.edges:
        found = (name for name, d in distances(edge.center).items() if abs(d) < 1e-9)
        edge.name = next(found, otherwise)


def half_block(
    width: float, depth: float, patch: float, fine: float, maxh: float
) -> Mesh:
    """The right half, x > 0, of a block below y = 0, fine on the patch 0 < x < ``patch``.

    Boundaries ``contact`` (the patch), ``symmetry`` (x = 0), ``bottom``, ``right`` and ``free``;
    triangles grow slowly from ``fine`` to ``maxh``.
    """
    face = polygon([(0, 0), (0, -depth), (width, -depth), (width, 0), (patch, 0)])

    def distances(c: tuple) -> dict[str, float]:
        """Distances of a point from the boundaries."""
        sides = {"symmetry": c.x, "bottom": c.y + depth, "right": c.x - width}
        return sides | {"contact": c.y if c.x < patch else patch}

    name_edges(face, distances, "free")
    for edge in face.edges:
        if edge.name == "contact":
            edge.maxh = fine
    return Mesh(OCCGeometry(face, dim=2).GenerateMesh(maxh=maxh, grading=0.12))


def roller_on_block(fine: float) -> Mesh:
    """Half of a disc of radius 50 on a block, NAFEMS R94; ``fine`` is the width where they touch.

    Materials ``roller`` and ``block``; boundaries ``arc`` and ``flat`` may touch, ``load`` is the
    top of the half disc, ``symmetry`` x = 0, ``bottom``, ``free``.
    """
    disc = Circle((0, 50), 50).Face() * Rectangle(50, 50).Face()
    box = Rectangle(9, 6).Face()
    under = MoveTo(0, -6).Rectangle(9, 6).Face()
    block = MoveTo(0, -200).Rectangle(100, 200).Face()
    parts = [(disc * box, fine, "roller"), (disc - box, 6, "roller")]
    parts += [(block * under, 1.4 * fine, "block"), (block - under, 12, "block")]

    def sides(c: tuple) -> dict[str, float]:
        """Distances of a point from the boundaries."""
        return {"symmetry": c.x, "bottom": c.y + 200, "load": c.y - 50}

    for shape, maxh, name in parts:
        shape.faces.name = name
        shape.faces.maxh = maxh
        name_edges(shape, sides, "free")
    (tip, *_), _, (top, *_), _ = parts
    for edge in tip.edges:
        if 0.1 < edge.center.x < 9 and edge.center.y < 1.5:
            edge.name = "arc"
    for edge in top.edges:
        if abs(edge.center.y) < 1e-9:
            edge.name = "flat"
    shapes = [shape for shape, *_ in parts]
    geometry = OCCGeometry(Compound([Glue(shapes[:2]), Glue(shapes[2:])]), dim=2)
    return Mesh(geometry.GenerateMesh(maxh=12, grading=0.3))


def rounded_blocks(fine: float) -> Mesh:
    """Two equal blocks that meet with parabolas of radius 80, the upper one meshed finer.

    Materials ``lower`` and ``upper``; their boundaries ``lower arc``, ``lower end``, ``lower``, ...
    """
    faces = []
    W = 10.0
    H = 10.0
    tip = 1.6
    radius = 80.0
    for side, h, name in ((-1, 1.3 * fine, "lower"), (1, fine, "upper")):
        corners = [(-W, 0), (-tip, 0), (tip, 0), (W, 0), (W, side * H), (-W, side * H)]
        face = polygon(corners if side == 1 else corners[::-1])
        face.faces.name = face.edges.name = name
        for edge in face.edges:
            if abs(edge.center.y) < 1e-9 and abs(edge.center.x) < tip:
                edge.name = f"{name} arc"
                edge.maxh = h
            if abs(edge.center.y - side * H) < 1e-9:
                edge.name = f"{name} end"
        faces.append(face)
    mesh = Mesh(
        OCCGeometry(Compound(faces), dim=2).GenerateMesh(maxh=1.5, grading=0.15)
    )
    above = {v.nr for el in mesh.Materials("upper").Elements() for v in el.vertices}
    for number, point in enumerate(mesh.ngmesh.Points()):
        side = 1 if number in above else -1
        point[1] += side * point[0] ** 2 / (2 * radius) * (1 - abs(point[1]) / H)
    return mesh


def shrunk_rings(
    fine: float, inner: float, middle: float, outer: float, interference: float
) -> Mesh:
    """Quarters of two rings; the outer one is too narrow for the inner one.

    Boundaries ``left`` and ``bottom`` are symmetry edges; ``inner inside``, ``inner outside``,
    ``outer inside`` and ``outer outside`` the arcs.
    """
    faces = []
    box = Rectangle(2 * outer, 2 * outer).Face()
    half = interference / 2
    radii = {"inner": (inner, middle + half), "outer": (middle - half, outer)}
    for number, (name, (a, b)) in enumerate(radii.items()):
        face = (Circle((0, 0), b).Face() - Circle((0, 0), a).Face()) * box
        face.faces.maxh = fine * (1 + 0.3 * number)
        name_edges(face, lambda c: {"left": c.x, "bottom": c.y}, f"{name} outside")
        for edge in face.edges:
            if (
                edge.name.endswith("outside")
                and math.hypot(edge.center.x, edge.center.y) < (a + b) / 2
            ):
                edge.name = f"{name} inside"
        faces.append(face)
    return Mesh(OCCGeometry(Compound(faces), dim=2).GenerateMesh(maxh=outer))


def stacked_blocks(N: int, maxh: float) -> Mesh:
    """A block on top of a wider one in N = 2 or 3 dimensions.

    Boundaries ``above`` and ``below`` may touch, ``clamped`` is the bottom of the wider one,
    ``right`` its right, ``top`` that of the other, ``side`` the rest.
    """
    if N == 2:
        lower = MoveTo(0, 0).Rectangle(1, 0.7)
        upper = MoveTo(0.2, 0.7).Rectangle(0.6, 0.4)
        bodies = [body.Face() for body in (lower, upper)]
    else:
        bodies = [Box((0, 0, 0), (1, 1, 0.7)), Box((0.2, 0.2, 0.7), (0.8, 0.8, 1.1))]
    up = (Y, Z)[N - 2]
    names = (("clamped", "below", "right"), ("above", "top", "side"))
    for body, size, (bottom, top, right) in zip(
        bodies, (maxh, 0.7 * maxh), names, strict=True
    ):
        sides = body.edges if N == 2 else body.faces
        (body.faces if N == 2 else body.solids).maxh = size * (1 if N == 2 else 1.5)
        sides.name = "side"
        sides.Max(X).name = right
        sides.Min(up).name, sides.Max(up).name = bottom, top
    return Mesh(
        OCCGeometry(Compound(bodies), dim=N).GenerateMesh(
            maxh=1, parallel_meshing=False
        )
    )


def eighth_under_punch(
    half: float, depth: float, patch: float, cells: tuple[int, int]
) -> Mesh:
    """The eighth x > y > 0 of a block below z = 0 with a square patch in the middle of its top.

    Tetrahedra, six in each of so many boxes along a side and the depth; ``patch`` is half of the
    width of the square and ends between boxes.  Boundaries ``punch`` (the patch), ``free`` (the
    rest of the top), ``front`` (y = 0), ``diagonal`` (x = y), ``right``, ``bottom``.
    """
    across, down = cells
    steps = [np.linspace(0, half, across + 1)] * 2 + [np.linspace(-depth, 0, down + 1)]
    x = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)
    shape = (across + 1, across + 1, down + 1)
    number = np.arange(len(x)).reshape(shape)
    tetrahedra = []
    for order in permutations(range(3)):
        corner = np.zeros(3, dtype=int)
        path = [number[:-1, :-1, :-1]]
        for axis in order:
            corner[axis] = 1
            places = (slice(c, n - 1 + c) for c, n in zip(corner, shape, strict=True))
            path.append(number[tuple(places)])
        if np.linalg.det(np.eye(3)[list(order)]) < 0:
            path[:2] = path[1::-1]
        tetrahedra.append(np.stack(path, axis=-1).reshape(-1, 4))
    nodes = np.concatenate(tetrahedra)
    centre = x[nodes].mean(axis=1)
    used, numbers = np.unique(nodes[centre[:, 0] > centre[:, 1]], return_inverse=True)
    x = x[used]
    nodes = numbers.reshape(-1, 4)
    faces = np.sort(nodes[:, list(combinations(range(4), 3))].reshape(-1, 3), axis=1)
    faces, count = np.unique(faces, axis=0, return_counts=True)
    faces = faces[count == 1]
    centre = x[faces].mean(axis=1)
    groups = [(3, "body", nodes)]
    walls = {"front": x[:, 1], "right": x[:, 0] - half, "diagonal": x[:, 0] - x[:, 1]}
    walls |= {"bottom": x[:, 2] + depth, "free": x[:, 2]}
    pressed = (centre[:, 2] == 0) & (centre[:, :2].max(axis=1) < patch)
    groups.append((2, "punch", faces[pressed]))
    for name, distance in walls.items():
        on = np.isclose(distance, 0.0)[faces].all(axis=1) & ~pressed
        groups.append((2, name, faces[on]))
    return Mesh(netgen_mesh(3, x, groups))


def vertical_cut(maxh: float) -> Mesh:
    """Ground with a vertical cut of height 1 at x = 0; boundaries ``held`` and ``free``."""
    corners = [((-2, -1), "held"), ((1.5, -1), "held"), ((1.5, 0), "free")]
    corners += [((0, 0), "free"), ((0, 1), "free"), ((-2, 1), "held")]
    return meshed(outline(corners), maxh)


def ground_under_strip(maxh: float) -> Mesh:
    """Half of the ground under a strip of half width 1.

    Boundaries ``load`` (under the strip), ``axis`` (x = 0), ``free`` and ``held``.
    """
    corners = [((0, -3), "held"), ((4, -3), "held"), ((4, 0), "free")]
    corners += [((1, 0), "load"), ((0, 0), "axis")]
    return meshed(outline(corners), maxh)


def quarter_sheet(half: float, radius: float, maxh: float) -> Mesh:
    """A quarter of a square sheet with a hole in its middle.

    Boundaries ``left``, ``bottom`` (planes of symmetry), ``right``, ``top``, ``hole``.
    """
    square = Rectangle(half, half).Face()
    for edge in square.edges:
        edge.name = "top"
    square.edges.Min(X).name = "left"
    square.edges.Min(Y).name = "bottom"
    square.edges.Max(X).name = "right"
    hole = Circle((0, 0), radius).Face()
    hole.edges.name = "hole"
    return Mesh(OCCGeometry(square - hole, dim=2).GenerateMesh(maxh=maxh))
