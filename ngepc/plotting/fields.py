"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, comparisons.

Every function returns a ``matplotlib.figure.Figure`` and touches no pyplot state, so that it works
in notebooks, scripts and servers alike; ``figure.savefig(path)`` writes PNG, PDF or SVG.
Curves (histories, counts, pressures) are in ``ngepc.plotting.curves``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import (
    require_attributes,
    require_flag,
    require_instance,
    require_text,
)
from ngepc.plotting.drawable import UnitNames, drawable, fields_of, require_sources, unit_names
from ngepc.plotting.picture import Picture
from ngepc.plotting.sampling import (
    ColourRange,
    Corners,
    body_corners,
    boundary_corners,
    colour_range,
    obstacle_lines,
    sample_corners,
)
from ngepc.recovery import Fields

ZONE_COLOURS = ("#dfe3e8", "#26323f")
OUTLINE, OBSTACLE, CONTACT = "#9aa3ad", "#b3402e", "#2f7fc1"
SET_COLOURS = (*ZONE_COLOURS, CONTACT)


def plot_field(
    source: object,
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    *,
    deformation_scale: float = 1.0,
    vmin: float | None = None,
    vmax: float | None = None,
    label: str | None = None,
    title: str | None = None,
    colormap: str | None = None,
    mesh_lines: bool = False,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """A scalar field on the deformed body; in 3D on its surface.

    Piecewise constant fields are drawn flat, others interpolated.  Thin lines show the body
    before the deformation and, where it is given, the obstacle at distance psi.

    Parameters
    ----------
    source
        Result of a solver, or ``Fields``.
    field
        Name of a field ('equivalent_plastic_strain', 'yield_function', 'stress_xy', ...) or a
        coefficient.
    deformation_scale
        Factor >= 0 on the displacement, 1 in the paper's figures.
    vmin, vmax
        Ends of the colour scale; by default percentiles (``colour_range``), with arrows on the
        colour bar where values lie outside.
    label, title, colormap, mesh_lines, units
        Text at the colour bar, title, matplotlib colour map, whether to draw the mesh, units.
    axes
        Axes to draw into (3D axes for 3D bodies); by default a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        For an unknown field or colour map, a negative scale, vmin >= vmax, or an argument of the
        wrong kind.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    check_drawing(axes, label=label, title=title, colormap=colormap)
    require_flag("mesh_lines", mesh_lines)
    what = drawable(source, field, units)
    fields = fields_of(source)
    corners = body_corners(fields, what.coefficient)
    limits = colour_range(corners, vmin=vmin, vmax=vmax, symmetric=what.signed)
    axes = axes if axes is not None else _body_figure(corners, scale, bar=True)
    patch = _draw_body(axes, corners, limits, colormap or what.colormap, scale, mesh_lines)
    _decorate(axes, fields, scale, units)
    _colour_bar(axes, patch, limits, label or what.label)
    if title:
        axes.set_title(title, fontsize=10)
    return axes.figure


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


def plot_yield_function(source: object, **options: object) -> Figure:
    """The yield function phi of (3.9) on the deformed body; options as in ``plot_field``."""
    return plot_field(source, "yield_function", **options)


def plot_plastic_zone(
    source: object,
    threshold: float = 0.0,
    *,
    deformation_scale: float = 1.0,
    title: str | None = None,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The zone |p|_F > ``threshold`` dark on the light deformed body, Figures 2 and 6.

    The paper takes 0.1 for Example (a) and 1e-2 for Example (b).

    Raises
    ------
    ValueError
        If ``threshold`` or ``deformation_scale`` is negative.
    """
    threshold = require_number("threshold", threshold, 0.0)
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    check_drawing(axes, title=title)
    fields = fields_of(source)
    sampled = body_corners(fields, drawable(source, "equivalent_plastic_strain").coefficient)
    inside = np.repeat((sampled.values.mean(axis=1) > threshold)[:, None], 3, axis=1)
    corners = Corners(sampled.points, sampled.displacement, inside.astype(float))
    axes = axes if axes is not None else _body_figure(corners, scale, bar=False)
    _draw_body(axes, corners, ColourRange(0.0, 1.0), ListedColormap(ZONE_COLOURS), scale, False)
    _decorate(axes, fields, scale, units)
    axes.set_title(title or rf"plastic zone (dark): $|p|_F > {threshold:g}$", fontsize=10)
    return axes.figure


def plot_comparison(
    sources: Mapping[str, object],
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    *,
    deformation_scale: float = 1.0,
    vmin: float | None = None,
    vmax: float | None = None,
    units: UnitNames | None = None,
) -> Figure:
    """The same field of several results side by side on one colour scale.

    Parameters
    ----------
    sources
        Title -> result or ``Fields``; two-dimensional bodies.

    Raises
    ------
    ValueError
        If there is nothing to compare.
    """
    require_sources(sources)
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    what = {title: drawable(source, field, units) for title, source in sources.items()}
    corners = {t: body_corners(fields_of(s), what[t].coefficient) for t, s in sources.items()}
    first = next(iter(what.values()))
    limits = colour_range(*corners.values(), vmin=vmin, vmax=vmax, symmetric=first.signed)
    width, height = _body_size(next(iter(corners.values())), scale)
    rows = math.ceil(len(sources) / 3)
    columns = math.ceil(len(sources) / rows)
    shrink = min(1.0, 3.6 / width) if columns > 2 else 1.0
    size = (shrink * width * columns + 0.8, shrink * height * rows)
    figure = Picture(figsize=size, layout="compressed")
    three = next(iter(corners.values())).points.shape[2] == 3
    projection = {"projection": "3d"} if three else {}
    panels = figure.subplots(rows, columns, squeeze=False, subplot_kw=projection).ravel()
    for panel in panels[len(sources) :]:
        panel.set_axis_off()
    panels = panels[: len(sources)]
    for panel, (title, sampled) in zip(panels, corners.items(), strict=True):
        patch = _draw_body(panel, sampled, limits, first.colormap, scale, False)
        _decorate(panel, fields_of(sources[title]), scale, units)
        panel.set_title(title, fontsize=10)
    bar = figure.colorbar(patch, ax=list(panels), extend=limits.extend, shrink=0.85, aspect=30)
    _label_bar(bar, first.label)
    return figure


def plot_mesh(
    source: object, *, units: UnitNames | None = None, axes: Axes | None = None
) -> Figure:
    """The mesh before the deformation, the initial configuration of Figure 5."""
    fields, units = fields_of(source), unit_names(units)
    check_drawing(axes)
    sampled = body_corners(fields, CoefficientFunction(0.0))
    axes = axes if axes is not None else _body_figure(sampled, 0.0, bar=False)
    colours = ListedColormap(["#eef1f4"])
    _draw_body(axes, sampled, ColourRange(0.0, 1.0), colours, 0.0, True)
    _decorate(axes, fields, 0.0, units)
    return axes.figure


def plot_active_sets(
    result: object,
    *,
    deformation_scale: float = 0.0,
    title: str | None = None,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The active sets on the body: dark where it yields in this step, blue where it is in contact.

    Parameters
    ----------
    result
        A result of a solver, or the snapshot of an iterate.
    deformation_scale
        Factor >= 0 on the displacement; by default the body before the deformation, which stays
        where it is while iterates come and go.
    title, units, axes
        As for ``plot_field``.

    Raises
    ------
    ValueError
        If ``deformation_scale`` is negative.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    check_drawing(axes, title=title)
    require_attributes("result", result, ("fields", "yield_excess"), "a result of a solver")
    fields = fields_of(result)
    cuts = max(1, round(math.sqrt(16_000 / fields.problem.mesh.ne)))
    sampled = body_corners(fields, result.yield_excess, cuts)
    classes = (sampled.values.mean(axis=1) > 0.0).astype(float)
    if fields.problem.N == 3:
        classes[_touching(fields, result, cuts).values.mean(axis=1) > 0.0] = 2.0
    corners = Corners(sampled.points, sampled.displacement, np.repeat(classes[:, None], 3, axis=1))
    axes = axes if axes is not None else _body_figure(corners, scale, bar=False)
    _draw_body(axes, corners, ColourRange(0.0, 2.0), ListedColormap(SET_COLOURS), scale, False)
    _decorate(axes, fields, scale, units)
    if fields.problem.N == 2:
        sampled = _touching(fields, result, 1)
        lines = sampled.deformed(scale)[sampled.values.mean(axis=1) > 0.0]
        axes.add_collection(LineCollection(lines, colors=CONTACT, linewidths=3.0, zorder=5))
    words = "yields (dark), in contact (blue)" if fields.problem.contact_names else "yields (dark)"
    axes.set_title(title or words, fontsize=10)
    return axes.figure


def _touching(fields: Fields, result: object, cuts: int) -> Corners:
    """The contact pressure on the whole boundary, zero where there is no contact boundary."""
    mesh, names = fields.problem.mesh, fields.problem.contact_names
    pressures = dict.fromkeys(names, result.contact_pressure) if names else {}
    pressure = mesh.BoundaryCF(pressures, default=0.0)
    return sample_corners(mesh, mesh.Boundaries(".*"), fields.displacement, pressure, cuts)


def _body_size(corners: Corners, scale: float) -> tuple[float, float]:
    """Inches of the drawing area: the aspect of the body, inside 3.5 to 7 by 2.2 to 5."""
    if corners.points.shape[2] == 3:
        return 5.0, 4.4
    both = np.concatenate([corners.points, corners.deformed(scale)]).reshape(-1, 2)
    width, height = np.ptp(both, axis=0)
    unit = min(6.0 / width, 4.0 / height)
    return max(3.5, unit * width + 0.8), max(2.2, unit * height + 0.8)


def _body_figure(corners: Corners, scale: float, *, bar: bool) -> Axes:
    width, height = _body_size(corners, scale)
    figure = Picture(figsize=(width + (0.9 if bar else 0.0), height), layout="compressed")
    three = corners.points.shape[2] == 3
    return figure.add_subplot(projection="3d" if three else None)


def _draw_body(
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


def _decorate(axes: Axes, fields: Fields, scale: float, units: UnitNames) -> None:
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


def _colour_bar(axes: Axes, patch: object, limits: ColourRange, label: str) -> None:
    pad = {"pad": 0.1} if hasattr(axes, "get_zlim") else {}
    bar = axes.figure.colorbar(
        patch, ax=axes, extend=limits.extend, shrink=0.85, aspect=25, fraction=0.05, **pad
    )
    _label_bar(bar, label)


def _label_bar(bar: object, label: str) -> None:
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.formatter.set_powerlimits((-2, 4))
    bar.ax.yaxis.get_offset_text().set_fontsize(8)
    bar.outline.set_linewidth(0.4)
