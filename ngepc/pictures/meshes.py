"""Meshes and problems before a solve: the elements, and the names of boundaries and bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize, to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from ngsolve import CF, GridFunction, Mesh, VectorH1

import ngepc.pictures.style as style
from ngepc.checks.sentences import counted
from ngepc.model.problem import Problem
from ngepc.pictures.cutting import Part, Plane, part_of
from ngepc.pictures.sampling import Corners, corners_of
from ngepc.pictures.stills import Angles, draw_solid, solid_image
from ngepc.pictures.style import COLOURS, new_picture, styled

PALE = 0.75  # part of white in the colours of bodies
ROLES = ("traction", "pressure", "prescribed", "springs")
"""Arguments of a problem that belong to boundaries."""


@dataclass(frozen=True)
class UndeformedMesh:
    """An undeformed mesh for pictures, in place of ``Fields``."""

    mesh: Mesh

    @property
    def problem(self) -> UndeformedMesh:
        """The object itself, as only the mesh is known."""
        return self

    @property
    def N(self) -> int:
        """Space dimension."""
        return self.mesh.dim

    @property
    def displacement(self) -> GridFunction:
        """Zero."""
        return GridFunction(VectorH1(self.mesh, order=1))


def is_mesh(source: object) -> bool:
    """Whether a source is a mesh or a problem, not a result."""
    return isinstance(source, Mesh | Problem)


def drawn_mesh(source: Mesh | Problem) -> Mesh:
    """The mesh itself, or that of a problem."""
    return source.mesh if isinstance(source, Problem) else source


def axis_names(source: Mesh | Problem) -> tuple[str, ...]:
    """Names of the coordinates: x, y, z; of bodies of revolution r and z."""
    ring = isinstance(source, Problem) and source.kinematics.hoop
    return ("r", "z") if ring else ("x", "y", "z")[: drawn_mesh(source).dim]


def boundary_labels(source: Mesh | Problem) -> dict[str, str]:
    """Name of each boundary -> its label, for a problem with its loads and supports."""
    names = dict.fromkeys(drawn_mesh(source).GetBoundaries())
    if isinstance(source, Mesh):
        return {name: name for name in names}
    happens: dict[str, list[str]] = {name: [] for name in names}
    for name in source.clamped_names:
        happens[name].append("clamped")
    for argument in ROLES:
        for place in source.single(argument):
            if place in happens:
                happens[place].append(argument)
    second = {name for pair in source.contact_pairs for name in pair.second.split("|")}
    for name in {*source.touching_names, *second}:
        happens[name].append("contact")
    text = {n: ", ".join(words) for n, words in happens.items()}
    return {n: n if words in ("", n) else f"{n}: {words}" for n, words in text.items()}


def boundary_colours(mesh: Mesh) -> dict[str, tuple]:
    """Name of each boundary -> its colour."""
    names = list(dict.fromkeys(mesh.GetBoundaries()))
    return {n: to_rgb(COLOURS[k % len(COLOURS)]) for k, n in enumerate(names)}


def body_colours(mesh: Mesh) -> dict[str, tuple]:
    """Name of each material -> a pale colour; grey for a single one."""
    names = list(dict.fromkeys(mesh.GetMaterials()))
    if len(names) == 1:
        return {names[0]: to_rgb(style.ELASTIC)}
    pale = [
        tuple(PALE + (1 - PALE) * part for part in to_rgb(colour)) for colour in COLOURS
    ]
    return {name: pale[k % len(pale)] for k, name in enumerate(names)}


@styled
def draw_names(
    source: Mesh | Problem,
    view: Angles | None = None,
    body: str | None = None,
    cut: Plane | None = None,
    axes: Axes | None = None,
) -> Figure:
    """A mesh with its names, as ``plot_mesh`` draws it."""
    mesh = drawn_mesh(source)
    axes = new_picture(figsize=(5.8, 4.2)).subplots() if axes is None else axes
    draw = _draw_plane if mesh.dim == 2 else _draw_solid
    drawn = draw(axes, UndeformedMesh(mesh), Part(body, None, cut), view)
    if mesh.dim == 2:
        axes.set(**dict(zip(("xlabel", "ylabel"), axis_names(source), strict=True)))
    labels = boundary_labels(source)
    patches = [
        Patch(color=colour, label=labels.get(name, name))
        for name, colour in drawn.items()
    ]
    place = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}
    axes.legend(handles=patches, **place)
    axes.set_title(f"{mesh.nv} nodes, {counted(mesh.ne, 'element')}")
    return axes.figure


def numbered(names: Sequence[str], of: str, mesh: Mesh) -> CF:
    """The number of the boundary or the material at each point."""
    numbers = {name: float(k) for k, name in enumerate(names)}
    make = mesh.BoundaryCF if of == "boundary" else mesh.MaterialCF
    return make(numbers, default=0.0)


def _sets(corners: Corners, colours: dict) -> tuple[Corners, ScalarMappable]:
    norm = Normalize(-0.5, len(colours) - 0.5)
    return corners, ScalarMappable(norm, ListedColormap(list(colours.values())))


def _draw_plane(
    axes: Axes, rest: UndeformedMesh, part: Part, view: Angles | None
) -> dict[str, tuple]:
    """Bodies in pale colours, boundaries as thick lines; returns the names for a legend."""
    mesh = rest.mesh
    bodies = body_colours(mesh)
    number = numbered(list(bodies), "body", mesh)
    corners = part_of(rest, number, number, part)
    _, colours = _sets(corners, bodies)
    shade = {"cmap": colours.cmap, "norm": colours.norm, "rasterized": True}
    triangles = np.arange(corners.points.size // 2).reshape(-1, 3)
    values = corners.values.mean(axis=1)
    xy = corners.points.reshape(-1, 2).T
    axes.tripcolor(*xy, facecolors=values, triangles=triangles, **shade)
    edges = corners_of(rest, border=True).points
    thin = {"colors": style.GUIDE, "linewidths": min(0.4, 600 / mesh.ne)}
    axes.add_collection(LineCollection(edges, **thin))
    lines = boundary_colours(mesh)
    for name, colour in lines.items():
        segments = corners_of(rest, where=name).points
        thick = {"colors": [colour], "linewidths": 2.6, "zorder": 4}
        axes.add_collection(LineCollection(segments, **thick))
    axes.set_aspect("equal")
    axes.grid(False)
    axes.autoscale_view()
    axes.margins(0.03)
    return lines | (bodies if len(bodies) > 1 else {})


def _draw_solid(
    axes: Axes, rest: UndeformedMesh, part: Part, view: Angles | None
) -> dict[str, tuple]:
    """The surface in the colours of its boundaries, a section in those of the bodies."""
    mesh = rest.mesh
    faces = boundary_colours(mesh)
    bodies = body_colours(mesh)
    colours = faces | {f"body {name}": colour for name, colour in bodies.items()}
    on_surface = numbered(list(faces), "boundary", mesh)
    inside = numbered(list(bodies), "body", mesh) + float(len(faces))
    corners, mapped = _sets(part_of(rest, on_surface, inside, part), colours)
    lines = None if part != Part() else corners_of(rest, border=True).points
    image = solid_image(corners.points, corners.values, mapped, lines, view)
    draw_solid(axes, image, view)
    return colours if part.cut is not None else faces


def legend_of_names(source: Mesh | Problem) -> str:
    """The names of boundaries and bodies in their colours, as HTML."""
    mesh = drawn_mesh(source)
    labels = boundary_labels(source)
    bodies = body_colours(mesh) if mesh.dim == 2 else {}
    colours = boundary_colours(mesh) | (bodies if len(bodies) > 1 else {})
    parts = [
        f'<b style="color:{to_hex(colour)}">■</b> {labels.get(name, name)}'
        for name, colour in colours.items()
    ]
    return " &ensp; ".join(parts)
