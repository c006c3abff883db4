"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, active sets.

Every function returns a ``matplotlib.figure.Figure``; ``figure.savefig(path)`` writes PNG, PDF or
SVG.  Curved elements are drawn curved.  Curves over something are in ``ngepc.pictures.curves``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_attributes
from ngepc.pictures.bodies import Drawing, add_bar
from ngepc.pictures.drawable import (
    UnitNames,
    fields_of,
    on_one_scale,
    pressure_on_boundary,
    require_sources,
)
from ngepc.pictures.sampling import Corners, body_corners, sample_corners
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
    title: str | None = None,
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
    title, mesh_lines, units
        Title (by default how the problem was solved), whether to draw the mesh, units.
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
        For an unknown field, a negative scale, vmin >= vmax, or an argument of the wrong kind.
    ImportError
        If the body is a solid and pyvista or libEGL is missing.
    """
    drawing = Drawing(deformation_scale, units, view, axes, title, mesh_lines)
    return _draw_fields(drawing, {"": source}, field, (vmin, vmax))


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
    return _draw_fields(Drawing(deformation_scale, units, view), sources, field, (vmin, vmax))


@styled
def plot_plastic_zone(
    source: object,
    threshold: float = 0.0,
    *,
    deformation_scale: float = 1.0,
    view: Angles | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The part of the body where |p|_F exceeds ``threshold`` >= 0, dark, as in Figures 2 and 6.

    The other arguments are those of ``plot_field``.
    """
    require_number("threshold", threshold, 0.0)
    drawing = Drawing(deformation_scale, view=view, axes=axes)
    sampled = body_corners(fields_of(source), fields_of(source).equivalent_plastic_strain)
    words = rf"plastic zone (dark): $|p|_F > {threshold:g}$"
    dark = sampled.values.mean(axis=1) > threshold
    return _draw_classes(drawing, source, sampled, dark, words).figure


@styled
def plot_active_sets(
    result: object, *, view: Angles | None = None, axes: Axes | None = None
) -> Figure:
    """The active sets: dark where the body yields in this step, orange where it is in contact.

    ``result`` is a result of a solver or the snapshot of an iterate.  It is drawn before the
    deformation, where it stays while iterates come and go.
    """
    require_attributes("result", result, ("fields", "yield_excess"), "a result of a solver")
    drawing, fields = Drawing(0.0, view=view, axes=axes), fields_of(result)
    mesh, contact = fields.problem.mesh, bool(fields.problem.touching_names)
    cuts = max(1, round(math.sqrt(16_000 / mesh.ne)))
    sampled = body_corners(fields, result.yield_excess, cuts)
    classes = (sampled.values.mean(axis=1) > 0.0).astype(int)
    touching = sample_corners(fields, mesh.Boundaries(".*"), pressure_on_boundary(result), cuts)
    pushed = touching.values.mean(axis=1) > 0.0
    if mesh.dim == 3:
        classes[pushed] = 2
    words = "yields (dark)" + ", in contact (orange)" * contact
    axes = _draw_classes(drawing, result, sampled, classes, words)
    if mesh.dim == 2:
        lines = LineCollection(touching.points[pushed], colors=CONTACT, linewidths=3.0, zorder=5)
        axes.add_collection(lines)
    return axes.figure


@styled
def plot_mesh(source: object, *, axes: Axes | None = None) -> Figure:
    """The mesh before the deformation, the initial configuration of Figure 5."""
    drawing = Drawing(0.0, axes=axes, mesh_lines=True)
    sampled = body_corners(fields_of(source), CoefficientFunction(0.0))
    elastic = np.zeros(len(sampled.points))
    return _draw_classes(drawing, fields_of(source), sampled, elastic).figure


def _draw_fields(
    drawing: Drawing,
    sources: Mapping[str, object],
    field: str | CoefficientFunction,
    ends: tuple[float | None, float | None],
) -> Figure:
    """Bodies side by side with one colour bar, in the axes of the drawing if it has some."""
    what, corners, colours = on_one_scale(sources.values(), field, drawing.units, ends)
    panels = drawing.panels(corners[0], len(corners))
    for panel, (title, source), sampled in zip(panels, sources.items(), corners, strict=True):
        drawing.body(panel, source, sampled, colours, title=title)
    add_bar(colours, panels, what[0].label, drawing.axes is None)
    return panels[0].figure


def _draw_classes(
    drawing: Drawing,
    source: object,
    sampled: Corners,
    classes: np.ndarray,
    words: str = "",
) -> Axes:
    """Each triangle in the colour of its class; returns the axes."""
    values = np.repeat(classes[:, None], 3, axis=1)
    corners = Corners(sampled.points, sampled.displacement, values)
    colours = ScalarMappable(Normalize(0, len(SET_COLOURS) - 1), ListedColormap(SET_COLOURS))
    (axes,) = drawing.panels(corners, bar=False)
    drawing.body(axes, source, corners, colours, words)
    return axes
