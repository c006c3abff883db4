"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, comparisons.

Every function returns a ``matplotlib.figure.Figure`` and touches no pyplot state, so that it works
in notebooks, scripts and servers alike; ``figure.savefig(path)`` writes PNG, PDF or SVG.
Curves (histories, counts, pressures) are in ``ngepc.pictures.curves``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_flag
from ngepc.pictures.body import (
    body_figure,
    body_size,
    check_drawing,
    colour_bar,
    decorate,
    draw_body,
    label_bar,
)
from ngepc.pictures.drawable import UnitNames, drawable, fields_of, require_sources, unit_names
from ngepc.pictures.picture import Picture
from ngepc.pictures.sampling import ColourRange, Corners, body_corners, colour_range

ZONE_COLOURS = ("#dfe3e8", "#26323f")


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
    axes = axes if axes is not None else body_figure(corners, scale, bar=True)
    patch = draw_body(axes, corners, limits, colormap or what.colormap, scale, mesh_lines)
    decorate(axes, fields, scale, units)
    colour_bar(axes, patch, limits, label or what.label)
    if title:
        axes.set_title(title, fontsize=10)
    return axes.figure


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
    axes = axes if axes is not None else body_figure(corners, scale, bar=False)
    draw_body(axes, corners, ColourRange(0.0, 1.0), ListedColormap(ZONE_COLOURS), scale, False)
    decorate(axes, fields, scale, units)
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
    width, height = body_size(next(iter(corners.values())), scale)
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
        patch = draw_body(panel, sampled, limits, first.colormap, scale, False)
        decorate(panel, fields_of(sources[title]), scale, units)
        panel.set_title(title, fontsize=10)
    bar = figure.colorbar(patch, ax=list(panels), extend=limits.extend, shrink=0.85, aspect=30)
    label_bar(bar, first.label)
    return figure


def plot_mesh(
    source: object, *, units: UnitNames | None = None, axes: Axes | None = None
) -> Figure:
    """The mesh before the deformation, the initial configuration of Figure 5."""
    fields, units = fields_of(source), unit_names(units)
    check_drawing(axes)
    sampled = body_corners(fields, CoefficientFunction(0.0))
    axes = axes if axes is not None else body_figure(sampled, 0.0, bar=False)
    colours = ListedColormap(["#eef1f4"])
    draw_body(axes, sampled, ColourRange(0.0, 1.0), colours, 0.0, True)
    decorate(axes, fields, 0.0, units)
    return axes.figure
