"""A body in matplotlib axes: its triangles with colours, outline and obstacle, the colour bar."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ngepc.checks.kinds import require_instance, require_text
from ngepc.pictures.drawable import UnitNames
from ngepc.pictures.picture import Picture
from ngepc.pictures.sampling import ColourRange, Corners, boundary_corners, obstacle_lines
from ngepc.results.fields import Fields

OUTLINE, OBSTACLE = "#9aa3ad", "#b3402e"


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


def body_size(corners: Corners, scale: float) -> tuple[float, float]:
    """Inches of the drawing area: the aspect of the body, inside 3.5 to 7 by 2.2 to 5."""
    if corners.points.shape[2] == 3:
        return 5.0, 4.4
    both = np.concatenate([corners.points, corners.deformed(scale)]).reshape(-1, 2)
    width, height = np.ptp(both, axis=0)
    unit = min(6.0 / width, 4.0 / height)
    return max(3.5, unit * width + 0.8), max(2.2, unit * height + 0.8)


def body_figure(corners: Corners, scale: float, *, bar: bool) -> Axes:
    """Axes of a new figure with the aspect of the body, and room for a colour bar if asked."""
    width, height = body_size(corners, scale)
    figure = Picture(figsize=(width + (0.9 if bar else 0.0), height), layout="compressed")
    three = corners.points.shape[2] == 3
    return figure.add_subplot(projection="3d" if three else None)


def draw_body(
    axes: Axes,
    corners: Corners,
    limits: ColourRange,
    colormap: str | ListedColormap,
    scale: float,
    mesh_lines: bool,
) -> object:
    """Draw the triangles with their values; returns what a colour bar needs."""
    if corners.points.shape[2] == 3 and not corners.constant and not mesh_lines:
        while len(corners.points) < 8000:
            corners = corners.refined()
    points = corners.deformed(scale)
    edge, width = ("#6b7680", 0.2) if mesh_lines else ("none", 0.0)
    options = {"cmap": colormap, "clim": (limits.least, limits.most), "antialiased": mesh_lines}
    if points.shape[2] == 3:
        flat = Poly3DCollection(points, edgecolors=edge, linewidths=width, **options)
        flat.set_array(corners.values.mean(axis=1))
        return axes.add_collection3d(flat)
    x, y = points.reshape(-1, 2).T
    triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    if corners.constant:
        options |= {"facecolors": corners.values[:, 0], "edgecolors": edge, "linewidths": width}
        return axes.tripcolor(triangles, rasterized=True, **options)
    patch = axes.tripcolor(
        triangles, corners.values.ravel(), shading="gouraud", rasterized=True, **options
    )
    if mesh_lines:
        axes.triplot(triangles, color="#6b7680", linewidth=0.2)
    return patch


def decorate(axes: Axes, fields: Fields, scale: float, units: UnitNames) -> None:
    """Axis labels, equal aspect, and in 2D the undeformed outline and the obstacle."""
    names = "xyz"[: fields.problem.N]
    for name in names:
        getattr(axes, f"set_{name}label")(f"{name} ({units.length})", fontsize=9)
    axes.tick_params(labelsize=8)
    if fields.problem.N == 3:
        corners = boundary_corners(fields).deformed(scale).reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        axes.set(**{f"{n}lim": (a, b) for n, a, b in zip(names, low, high, strict=True)})
        axes.set_box_aspect(high - low)
        return
    outline = boundary_corners(fields)
    axes.add_collection(LineCollection(outline.points, colors=OUTLINE, linewidths=0.7, zorder=0))
    axes.add_collection(
        LineCollection(outline.deformed(scale), colors="#3b4650", linewidths=0.6, zorder=3)
    )
    if fields.problem.contact_names and scale > 0:
        obstacle = obstacle_lines(fields, scale)
        axes.add_collection(LineCollection(obstacle, colors=OBSTACLE, linewidths=1.4, zorder=4))
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.03)
    axes.spines[["top", "right"]].set_visible(False)


def colour_bar(axes: Axes, patch: object, limits: ColourRange, label: str) -> None:
    """Add a colour bar for what ``draw_body`` returned."""
    pad = {"pad": 0.1} if hasattr(axes, "get_zlim") else {}
    bar = axes.figure.colorbar(
        patch, ax=axes, extend=limits.extend, shrink=0.85, aspect=25, fraction=0.05, **pad
    )
    label_bar(bar, label)


def label_bar(bar: Colorbar, label: str) -> None:
    """The text and the ticks of a colour bar."""
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.formatter.set_powerlimits((-2, 4))
    bar.ax.yaxis.get_offset_text().set_fontsize(8)
    bar.outline.set_linewidth(0.4)
