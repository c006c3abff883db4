"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, active sets.

Every function returns a ``matplotlib.figure.Figure``; ``figure.savefig(path)`` writes PNG, PDF or
SVG.  Curved elements are drawn curved.  Curves over something are in ``ngepc.pictures.curves``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_attributes, require_flag, require_instance, require_text
from ngepc.pictures.drawable import (
    UnitNames,
    drawable,
    fields_of,
    method_label,
    require_sources,
    unit_names,
)
from ngepc.pictures.sampling import (
    ColourRange,
    Corners,
    body_corners,
    boundary_corners,
    colour_range,
    element_borders,
    obstacle_lines,
    sample_corners,
)
from ngepc.pictures.style import (
    CONTACT,
    DEFORMED,
    ELASTIC,
    GUIDE,
    OBSTACLE,
    OUTLINE,
    PLASTIC,
    Picture,
    styled,
)
from ngepc.results.fields import Fields

SET_COLOURS = (ELASTIC, PLASTIC, CONTACT)
LIGHT = np.array([0.42, -0.25, 0.87])
"""Where bodies in space are lit from."""


@styled
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
    before the deformation, a black one the obstacle at distance psi.

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
        Text at the colour bar, title (by default how the problem was solved), matplotlib colour
        map, whether to draw the mesh, units.
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
    corners = body_corners(fields_of(source), what.coefficient)
    limits = colour_range(corners, vmin=vmin, vmax=vmax, symmetric=what.signed)
    axes = axes if axes is not None else body_axes(corners, scale)[0]
    patch = _draw(axes, source, corners, limits, colormap or what.colormap, scale, mesh_lines)
    _decorate(axes, source, scale, units, title)
    bar = axes.figure.colorbar(
        patch, ax=axes, extend=limits.extend, shrink=0.85, aspect=25, fraction=0.05
    )
    _label_bar(bar, label or what.label)
    return axes.figure


@styled
def plot_plastic_zone(
    source: object,
    threshold: float = 0.0,
    *,
    deformation_scale: float = 1.0,
    title: str | None = None,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The part of the body where |p|_F exceeds ``threshold`` >= 0, dark, as in Figures 2 and 6.

    The other arguments are those of ``plot_field``.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    require_number("threshold", threshold, 0.0)
    check_drawing(axes, title=title)
    what = drawable(source, "equivalent_plastic_strain")
    sampled = body_corners(fields_of(source), what.coefficient)
    classes = (sampled.values.mean(axis=1) > threshold).astype(float)
    axes = _draw_classes(axes, source, sampled, classes, (ELASTIC, PLASTIC), scale)
    words = rf"plastic zone (dark): $|p|_F > {threshold:g}$"
    _decorate(axes, source, scale, units, title, words)
    return axes.figure


@styled
def plot_active_sets(
    result: object,
    *,
    deformation_scale: float = 0.0,
    title: str | None = None,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The active sets: dark where the body yields in this step, orange where it is in contact.

    ``result`` is a result of a solver or the snapshot of an iterate.  By default it is drawn before
    the deformation, where it stays while iterates come and go.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    check_drawing(axes, title=title)
    require_attributes("result", result, ("fields", "yield_excess"), "a result of a solver")
    fields = fields_of(result)
    cuts = max(1, round(math.sqrt(16_000 / fields.problem.mesh.ne)))
    sampled = body_corners(fields, result.yield_excess, cuts)
    classes = (sampled.values.mean(axis=1) > 0.0).astype(float)
    touching = _pressure_on_boundary(fields, result, cuts)
    pushed = touching.values.mean(axis=1) > 0.0
    if fields.problem.N == 3:
        classes[pushed] = 2.0
    axes = _draw_classes(axes, result, sampled, classes, SET_COLOURS, scale)
    words = "yields (dark)" + ", in contact (orange)" * bool(fields.problem.touching_names)
    _decorate(axes, result, scale, units, title, words)
    if fields.problem.N == 2:
        lines = touching.deformed(scale)[pushed]
        axes.add_collection(LineCollection(lines, colors=CONTACT, linewidths=3.0, zorder=5))
    return axes.figure


@styled
def plot_comparison(
    sources: Mapping[str, object],
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    *,
    deformation_scale: float = 1.0,
    vmin: float | None = None,
    vmax: float | None = None,
    units: UnitNames | None = None,
) -> Figure:
    """The same field of several results (title -> result) side by side on one colour scale.

    The other arguments are those of ``plot_field``.
    """
    require_sources(sources)
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    what = {title: drawable(source, field, units) for title, source in sources.items()}
    corners = {t: body_corners(fields_of(s), what[t].coefficient) for t, s in sources.items()}
    first, sample = next(iter(what.values())), next(iter(corners.values()))
    limits = colour_range(*corners.values(), vmin=vmin, vmax=vmax, symmetric=first.signed)
    panels = body_axes(sample, scale, len(sources))
    for panel, (title, sampled) in zip(panels, corners.items(), strict=True):
        patch = _draw(panel, sources[title], sampled, limits, first.colormap, scale, False)
        _decorate(panel, sources[title], scale, units, title)
    if sample.points.shape[2] == 2:
        for axis in "xy":
            ends = np.array([getattr(panel, f"get_{axis}lim")() for panel in panels])
            for panel in panels:
                panel.set(**{f"{axis}lim": (ends.min(), ends.max())})
    figure = panels[0].figure
    bar = figure.colorbar(patch, ax=panels, extend=limits.extend, shrink=0.85, aspect=30)
    _label_bar(bar, first.label)
    return figure


@styled
def plot_mesh(
    source: object, *, units: UnitNames | None = None, axes: Axes | None = None
) -> Figure:
    """The mesh before the deformation, the initial configuration of Figure 5."""
    fields, units = fields_of(source), unit_names(units)
    check_drawing(axes)
    sampled = body_corners(fields, CoefficientFunction(0.0))
    classes = np.zeros(len(sampled.points))
    axes = _draw_classes(axes, source, sampled, classes, (ELASTIC, PLASTIC), 0.0, mesh_lines=True)
    _decorate(axes, fields, 0.0, units)
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


def _draw_classes(
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
    _draw(axes, source, corners, limits, ListedColormap(colours), scale, mesh_lines)
    return axes


def _draw(
    axes: Axes,
    source: object,
    corners: Corners,
    limits: ColourRange,
    colormap: str | ListedColormap,
    scale: float,
    mesh_lines: bool,
) -> object:
    """Draw the triangles with their values; returns what a colour bar needs."""
    points, options = corners.deformed(scale), {"cmap": colormap}
    options["clim"] = (limits.least, limits.most)
    if points.shape[2] == 3:
        return _draw_solid(axes, points, corners.values.mean(axis=1), mesh_lines, **options)
    x, y = points.reshape(-1, 2).T
    triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
    if corners.constant:
        options |= {"facecolors": corners.values[:, 0], "edgecolors": "none", "antialiased": False}
        patch = axes.tripcolor(triangles, rasterized=True, **options)
    else:
        values = corners.values.ravel()
        patch = axes.tripcolor(triangles, values, shading="gouraud", rasterized=True, **options)
    if mesh_lines:
        borders = element_borders(fields_of(source)).deformed(scale)
        thin = min(1.0, 1500 / len(borders))
        lines = LineCollection(borders, colors=GUIDE, linewidths=0.3, alpha=thin, zorder=2)
        axes.add_collection(lines)
    return patch


def _draw_solid(
    axes: Axes, points: np.ndarray, values: np.ndarray, mesh_lines: bool, cmap: object, clim: tuple
) -> ScalarMappable:
    """Triangles in space, lit from above and the side; returns the scale of their colours."""
    scale = ScalarMappable(Normalize(*clim), cmap)
    normals = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    colours = scale.to_rgba(values)
    colours[:, :3] *= (0.8 + 0.2 * np.abs(normals @ LIGHT))[:, None]
    edges = GUIDE if mesh_lines else colours
    solid = Poly3DCollection(points, facecolors=colours, edgecolors=edges, linewidths=0.3)
    axes.add_collection3d(solid)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.set_axis_off()
    return scale


def _decorate(
    axes: Axes,
    source: object,
    scale: float,
    units: UnitNames,
    title: str | None = None,
    words: str = "",
) -> None:
    """Title, axis labels, equal aspect, and in 2D the undeformed outline and the obstacle."""
    fields = fields_of(source)
    heading = title or ", ".join(filter(None, (words, method_label(source))))
    axes.set_title(heading)
    if fields.problem.N == 3:
        return
    axes.set(xlabel=f"x ({units.length})", ylabel=f"y ({units.length})")
    outline = boundary_corners(fields)
    axes.add_collection(LineCollection(outline.points, colors=OUTLINE, linewidths=0.7, zorder=0))
    deformed = LineCollection(outline.deformed(scale), colors=DEFORMED, linewidths=0.6, zorder=3)
    axes.add_collection(deformed)
    if scale > 0:
        obstacle = obstacle_lines(fields, scale)
        axes.add_collection(LineCollection(obstacle, colors=OBSTACLE, linewidths=1.4, zorder=4))
    axes.set_aspect("equal")
    axes.grid(False)
    axes.autoscale_view()
    axes.margins(0.03)


def _label_bar(bar: Colorbar, label: str) -> None:
    bar.set_label(label)
    bar.formatter.set_powerlimits((-2, 4))
    bar.ax.yaxis.get_offset_text().set_fontsize(8)
    bar.outline.set_linewidth(0.4)


def _pressure_on_boundary(fields: Fields, result: object, cuts: int) -> Corners:
    """The contact pressure on the whole boundary, zero where there is no contact boundary."""
    mesh, names = fields.problem.mesh, fields.problem.touching_names
    pressures = dict.fromkeys(names, result.contact_pressure) if names else {}
    pressure = mesh.BoundaryCF(pressures, default=0.0)
    return sample_corners(fields, mesh.Boundaries(".*"), pressure, cuts)
