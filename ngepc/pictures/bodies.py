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

from ngepc.checks.arguments import require_vector
from ngepc.checks.kinds import require_instance, require_text
from ngepc.pictures.drawable import UnitNames, fields_of, method_label
from ngepc.pictures.sampling import (
    ColourRange,
    Corners,
    boundary_corners,
    element_borders,
    obstacle_lines,
)
from ngepc.pictures.stills import Angles, camera, solid_image
from ngepc.pictures.style import DEFORMED, GUIDE, OBSTACLE, OUTLINE, Picture

SOLID = (3.8, 3.4)
"""Inches that a picture of a solid takes."""


def check_drawing(
    axes: object = None, *, colormap: object = None, view: object = None, **texts: object
) -> None:
    """Refuse what are no axes, texts, pairs of angles, and colour maps that nobody knows."""
    if axes is not None:
        require_instance("axes", axes, Axes, "matplotlib Axes or None")
    if view is not None:
        require_vector("view", view, (2,))
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
    width, height = SOLID
    if corners.points.shape[2] == 2:
        both = np.concatenate([corners.points, corners.deformed(scale)]).reshape(-1, 2)
        width, height = np.ptp(both, axis=0)
        unit = min(6.0 / width, 4.0 / height)
        width, height = max(3.5, unit * width + 0.8), max(2.2, unit * height + 0.8)
    rows = math.ceil(count / 3)
    columns = math.ceil(count / rows)
    shrink = min(1.0, 3.6 / width) if columns > 2 else 1.0
    size = (shrink * width * columns + 0.9 * bar, shrink * height * rows)
    figure = Picture(figsize=size, layout="compressed")
    return [figure.add_subplot(rows, columns, k + 1) for k in range(count)]


def draw_classes(
    axes: Axes | None,
    source: object,
    sampled: Corners,
    classes: np.ndarray,
    colours: tuple[str, ...],
    scale: float,
    mesh_lines: bool = False,
    view: Angles | None = None,
) -> Axes:
    """Each triangle in the colour of its class; returns the axes, new ones for None."""
    values = np.repeat(classes[:, None], 3, axis=1)
    corners = Corners(sampled.points, sampled.displacement, values)
    axes = axes if axes is not None else body_axes(corners, scale, bar=False)[0]
    limits = ColourRange(0.0, len(colours) - 1.0)
    draw_body(axes, source, corners, limits, ListedColormap(colours), scale, mesh_lines, view)
    return axes


def draw_body(
    axes: Axes,
    source: object,
    corners: Corners,
    limits: ColourRange,
    colormap: str | ListedColormap,
    scale: float,
    mesh_lines: bool = False,
    view: Angles | None = None,
) -> ScalarMappable:
    """Draw the triangles with their values; returns what a colour bar needs."""
    points, colours = corners.deformed(scale), Normalize(limits.least, limits.most)
    lines = element_borders(fields_of(source)).deformed(scale) if mesh_lines else None
    if points.shape[2] == 3:
        patch = ScalarMappable(colours, colormap)
        axes.imshow(solid_image(points, corners.values, patch, lines, view))
        _draw_directions(axes, view)
        return patch
    x, y = points.reshape(-1, 2).T
    triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    options = {"cmap": colormap, "norm": colours, "rasterized": True, "shading": "gouraud"}
    patch = axes.tripcolor(triangles, corners.values.ravel(), **options)
    if lines is not None:
        thin = {"linewidths": 0.3, "alpha": min(1.0, 1500 / fields_of(source).problem.mesh.ne)}
        axes.add_collection(LineCollection(lines, colors=GUIDE, zorder=2, **thin))
    return patch


def _draw_directions(axes: Axes, view: Angles | None) -> None:
    """Arrows along x, y and z, left of the image of a solid, which needs no other axes."""
    height, width = axes.images[0].get_size()
    size = 0.08 * max(height, width)
    start = np.array([-1.2 * size, height - size])
    axes.set(xlim=(-2.6 * size, width), ylim=(height, 0))
    axes.set_axis_off()
    for letter, along in zip("xyz", camera(view)[:2].T * (size, -size), strict=True):
        if np.linalg.norm(along) > 0.2 * size:
            arrow = {"arrowstyle": "<|-", "color": GUIDE, "shrinkB": 0, "linewidth": 0.8}
            at = {"ha": "center", "va": "center", "color": GUIDE, "fontsize": 8}
            axes.annotate(letter, start, start + 1.25 * along, arrowprops=arrow, **at)


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
