"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, active sets.

Every function returns a ``matplotlib.figure.Figure``; ``figure.savefig(path)`` writes PNG, PDF or
SVG.  Curved elements are drawn curved.  Curves over something are in ``ngepc.pictures.curves``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_attributes, require_flag
from ngepc.pictures.bodies import (
    add_bar,
    body_axes,
    check_drawing,
    decorate,
    draw_body,
    draw_classes,
)
from ngepc.pictures.drawable import UnitNames, drawable, fields_of, require_sources, unit_names
from ngepc.pictures.sampling import body_corners, colour_range, pressure_on_boundary, sample_corners
from ngepc.pictures.stills import Angles
from ngepc.pictures.style import CONTACT, ELASTIC, PLASTIC, styled

SET_COLOURS = (ELASTIC, PLASTIC, CONTACT)


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
    view: Angles | None = None,
    axes: Axes | None = None,
) -> Figure:
    """A scalar field on the deformed body; in 3D on its surface.

    Fields are interpolated in each element on its own.  Thin lines show the body
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
    view
        Where solids are seen from: degrees around the z axis and above the xy plane.
    axes
        Axes to draw into; by default those of a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        For an unknown field or colour map, a negative scale, vmin >= vmax, or an argument of the
        wrong kind.
    ImportError
        If the body is a solid and pyvista or libEGL is missing.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    check_drawing(axes, label=label, title=title, colormap=colormap, view=view)
    require_flag("mesh_lines", mesh_lines)
    what = drawable(source, field, units)
    corners = body_corners(fields_of(source), what.coefficient)
    limits = colour_range(corners, vmin=vmin, vmax=vmax, symmetric=what.signed)
    own, axes = axes is None, body_axes(corners, scale)[0] if axes is None else axes
    colormap = colormap or what.colormap
    patch = draw_body(axes, source, corners, limits, colormap, scale, mesh_lines, view)
    decorate(axes, source, scale, units, title)
    add_bar(patch, [axes], limits, label or what.label, own)
    return axes.figure


@styled
def plot_plastic_zone(
    source: object,
    threshold: float = 0.0,
    *,
    deformation_scale: float = 1.0,
    title: str | None = None,
    units: UnitNames | None = None,
    view: Angles | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The part of the body where |p|_F exceeds ``threshold`` >= 0, dark, as in Figures 2 and 6.

    The other arguments are those of ``plot_field``.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    require_number("threshold", threshold, 0.0)
    check_drawing(axes, title=title, view=view)
    what = drawable(source, "equivalent_plastic_strain")
    sampled = body_corners(fields_of(source), what.coefficient)
    classes = (sampled.values.mean(axis=1) > threshold).astype(float)
    axes = draw_classes(axes, source, sampled, classes, (ELASTIC, PLASTIC), scale, view=view)
    words = rf"plastic zone (dark): $|p|_F > {threshold:g}$"
    decorate(axes, source, scale, units, title, words)
    return axes.figure


@styled
def plot_active_sets(
    result: object,
    *,
    deformation_scale: float = 0.0,
    title: str | None = None,
    units: UnitNames | None = None,
    view: Angles | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The active sets: dark where the body yields in this step, orange where it is in contact.

    ``result`` is a result of a solver or the snapshot of an iterate.  By default it is drawn before
    the deformation, where it stays while iterates come and go.
    """
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    check_drawing(axes, title=title, view=view)
    require_attributes("result", result, ("fields", "yield_excess"), "a result of a solver")
    fields = fields_of(result)
    cuts = max(1, round(math.sqrt(16_000 / fields.problem.mesh.ne)))
    sampled = body_corners(fields, result.yield_excess, cuts)
    classes = (sampled.values.mean(axis=1) > 0.0).astype(float)
    everywhere, pressure = fields.problem.mesh.Boundaries(".*"), pressure_on_boundary(result)
    touching = sample_corners(fields, everywhere, pressure, cuts)
    pushed = touching.values.mean(axis=1) > 0.0
    if fields.problem.N == 3:
        classes[pushed] = 2.0
    axes = draw_classes(axes, result, sampled, classes, SET_COLOURS, scale, view=view)
    words = "yields (dark)" + ", in contact (orange)" * bool(fields.problem.touching_names)
    decorate(axes, result, scale, units, title, words)
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
    view: Angles | None = None,
) -> Figure:
    """The same field of several results (title -> result) side by side on one colour scale.

    The other arguments are those of ``plot_field``.
    """
    require_sources(sources)
    check_drawing(view=view)
    scale, units = require_number("deformation_scale", deformation_scale, 0.0), unit_names(units)
    what = {title: drawable(source, field, units) for title, source in sources.items()}
    corners = {t: body_corners(fields_of(s), what[t].coefficient) for t, s in sources.items()}
    first, sample = next(iter(what.values())), next(iter(corners.values()))
    limits = colour_range(*corners.values(), vmin=vmin, vmax=vmax, symmetric=first.signed)
    panels = body_axes(sample, scale, len(sources))
    for panel, (title, sampled) in zip(panels, corners.items(), strict=True):
        patch = draw_body(panel, sources[title], sampled, limits, first.colormap, scale, view=view)
        decorate(panel, sources[title], scale, units, title)
    if sample.points.shape[2] == 2:
        for axis in "xy":
            ends = np.array([getattr(panel, f"get_{axis}lim")() for panel in panels])
            for panel in panels:
                panel.set(**{f"{axis}lim": (ends.min(), ends.max())})
    add_bar(patch, panels, limits, first.label)
    return panels[0].figure


@styled
def plot_mesh(
    source: object, *, units: UnitNames | None = None, axes: Axes | None = None
) -> Figure:
    """The mesh before the deformation, the initial configuration of Figure 5."""
    fields, units = fields_of(source), unit_names(units)
    check_drawing(axes)
    sampled = body_corners(fields, CoefficientFunction(0.0))
    classes = np.zeros(len(sampled.points))
    axes = draw_classes(axes, source, sampled, classes, (ELASTIC, PLASTIC), 0.0, mesh_lines=True)
    decorate(axes, fields, 0.0, units)
    return axes.figure
