"""Drawing one body into matplotlib axes: its triangles, outlines, obstacle, labels."""

from __future__ import annotations

import math

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ngepc.checks.kinds import require_instance, require_text
from ngepc.pictures.drawable import UnitNames, fields_of, method_label
from ngepc.pictures.sampling import (
    ColourRange,
    Corners,
    boundary_corners,
    element_borders,
    obstacle_lines,
)
from ngepc.pictures.style import DEFORMED, GUIDE, OBSTACLE, OUTLINE, Picture

LIGHT = np.array([0.42, -0.25, 0.87])
"""Where bodies in space are lit from."""


def check_drawing(axes: object, *, colormap: object = None, **texts: object) -> None:
    """Refuse axes that are none, texts that are none, and colour maps that nobody knows."""
    if axes is not None:
        require_instance("axes", axes, Axes, "matplotlib Axes or None")
    for name, text in texts.items():
        require_text(name, text, optional=True)
    if colormap is not None and not isinstance(colormap, Colormap):
        require_text("colormap", colormap)
        if colormap not in colormaps:
            raise ValueError(
                f"colormap={colormap!r}: the name of a matplotlib colour map is needed, such as "
                "'viridis' or 'RdBu_r'"
            )


def body_axes(corners: Corners, scale: float, count: int = 1, bar: bool = True) -> list[Axes]:
    """Axes of a new figure for bodies of this size, at most three in a row."""
    three = corners.points.shape[2] == 3
    both = np.concatenate([corners.points, corners.deformed(scale)]).reshape(-1, 2 + three)
    width, height = np.ptp(both, axis=0)[:2]
    unit = 3.0 / max(width, height) if three else min(6.0 / width, 4.0 / height)
    width, height = max(3.5, unit * width + 0.8), max(3.4 if three else 2.2, unit * height + 0.8)
    rows = math.ceil(count / 3)
    columns = math.ceil(count / rows)
    shrink = min(1.0, 3.6 / width) if columns > 2 else 1.0
    size = (shrink * width * columns + 0.9 * bar, shrink * height * rows)
    figure = Picture(figsize=size, layout="compressed")
    projection = "3d" if three else None
    return [figure.add_subplot(rows, columns, k + 1, projection=projection) for k in range(count)]


def draw_classes(
    axes: Axes | None,
    source: object,
    sampled: Corners,
    classes: np.ndarray,
    colours: tuple[str, ...],
    scale: float,
    mesh_lines: bool = False,
) -> Axes:
    """Each triangle in the colour of its class; returns the axes, new ones for None."""
    values = np.repeat(classes[:, None], 3, axis=1)
    corners = Corners(sampled.points, sampled.displacement, values)
    axes = axes if axes is not None else body_axes(corners, scale, bar=False)[0]
    limits = ColourRange(0.0, len(colours) - 1.0)
    draw_body(axes, source, corners, limits, ListedColormap(colours), scale, mesh_lines)
    return axes


def draw_body(
    axes: Axes,
    source: object,
    corners: Corners,
    limits: ColourRange,
    colormap: str | ListedColormap,
    scale: float,
    mesh_lines: bool,
) -> ScalarMappable:
    """Draw the triangles with their values; returns what a colour bar needs."""
    points, colours = corners.deformed(scale), Normalize(limits.least, limits.most)
    if points.shape[2] == 3:
        return _draw_solid(axes, points, corners, ScalarMappable(colours, colormap), mesh_lines)
    x, y = points.reshape(-1, 2).T
    triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    options = {"cmap": colormap, "norm": colours, "rasterized": True}
    if corners.constant:
        options |= {"facecolors": corners.values[:, 0], "edgecolors": "none", "antialiased": False}
        patch = axes.tripcolor(triangles, **options)
    else:
        patch = axes.tripcolor(triangles, corners.values.ravel(), shading="gouraud", **options)
    if mesh_lines:
        fields = fields_of(source)
        thin = {"linewidths": 0.3, "alpha": min(1.0, 1500 / fields.problem.mesh.ne)}
        lines = element_borders(fields).deformed(scale)
        axes.add_collection(LineCollection(lines, colors=GUIDE, zorder=2, **thin))
    return patch


def _draw_solid(
    axes: Axes, points: np.ndarray, corners: Corners, scale: ScalarMappable, mesh_lines: bool
) -> ScalarMappable:
    """Triangles in space, lit from above and the side; returns the scale of their colours."""
    normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    colours = scale.to_rgba(corners.values.mean(axis=1))
    colours[:, :3] *= (0.8 + 0.2 * np.abs(normals @ LIGHT))[:, None]
    edges = GUIDE if mesh_lines else colours
    solid = Poly3DCollection(points, facecolors=colours, edgecolors=edges, linewidths=0.3)
    axes.add_collection3d(solid)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.set_axis_off()
    return scale


def decorate(
    axes: Axes,
    source: object,
    scale: float,
    units: UnitNames,
    title: str | None = None,
    words: str = "",
) -> None:
    """Title, axis labels, equal aspect, and in 2D the undeformed outline and the obstacle."""
    fields = fields_of(source)
    heading = title or "\n".join(filter(None, (words, method_label(source))))
    axes.set_title(heading)
    if fields.problem.N == 3:
        return
    axes.set(xlabel=f"x ({units.length})", ylabel=f"y ({units.length})")
    outline = boundary_corners(fields)
    drawn = [(outline.points, OUTLINE, 0.7, 0), (outline.deformed(scale), DEFORMED, 0.6, 3)]
    drawn += [(obstacle_lines(fields, scale), OBSTACLE, 1.4, 4)] if scale > 0 else []
    for lines, colour, width, above in drawn:
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=width, zorder=above))
    axes.set_aspect("equal")
    axes.grid(False)
    axes.autoscale_view()
    axes.margins(0.03)


def add_bar(
    patch: ScalarMappable, panels: list[Axes], limits: ColourRange, label: str, own: bool = True
) -> None:
    """A colour bar beside the axes, below them where a figure of its ``own`` is wide and low."""
    figure, place = panels[0].figure, {"shrink": 0.85, "fraction": 0.05}
    if own and figure.get_figwidth() > 3 * figure.get_figheight():
        figure.set_figheight(figure.get_figheight() + 0.9)
        place = {"shrink": 0.5, "location": "bottom", "fraction": 0.5}
    bar = figure.colorbar(patch, ax=panels, extend=limits.extend, label=label, aspect=30, **place)
    bar.outline.set_linewidth(0.4)
    if bar.orientation == "vertical":  # powers of ten where numbers are small or large
        bar.formatter.set_powerlimits((-2, 4))
        bar.ax.yaxis.get_offset_text().set_fontsize(8)
