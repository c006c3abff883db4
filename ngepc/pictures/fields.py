"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, active sets.

Every function returns a ``matplotlib.figure.Figure``; ``figure.savefig(path)`` writes PNG, PDF or
SVG.  Curved elements are drawn curved.  Curves over something are in ``ngepc.pictures.curves``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from ngsolve import CoefficientFunction

import ngepc.pictures.sampling as sampling
import ngepc.pictures.style as style
from ngepc.checks.arguments import require_number, require_vector
from ngepc.checks.declared import Check, Declared, Flag, NotNegative, Text
from ngepc.checks.kinds import require_attributes, require_instance
from ngepc.pictures.drawable import (
    PLAIN,
    UnitNames,
    Units,
    fields_of,
    on_one_scale,
    pressure_on_boundary,
    require_sources,
)
from ngepc.pictures.sampling import Corners, body_corners
from ngepc.pictures.stills import Angles, draw_solid
from ngepc.pictures.style import Picture, styled

SET_COLOURS = (style.ELASTIC, style.PLASTIC, style.CONTACT)
AXES = "matplotlib Axes or None"
SOLID = (3.8, 3.4)
"""Inches that a picture of a solid takes."""


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
    touching = sampling.sample_corners(
        fields, mesh.Boundaries(".*"), pressure_on_boundary(result), cuts
    )
    pushed = touching.values.mean(axis=1) > 0.0
    if mesh.dim == 3:
        classes[pushed] = 2
    words = "yields (dark)" + ", in contact (orange)" * contact
    axes = _draw_classes(drawing, result, sampled, classes, words)
    if mesh.dim == 2:
        thick = {"colors": style.CONTACT, "linewidths": 3.0, "zorder": 5}
        axes.add_collection(LineCollection(touching.points[pushed], **thick))
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
    drawing: Drawing, source: object, sampled: Corners, classes: np.ndarray, words: str = ""
) -> Axes:
    """Each triangle in the colour of its class; returns the axes."""
    values = np.repeat(classes[:, None], 3, axis=1)
    corners = Corners(sampled.points, sampled.displacement, values)
    colours = ScalarMappable(Normalize(0, len(SET_COLOURS) - 1), ListedColormap(SET_COLOURS))
    (axes,) = drawing.panels(corners, bar=False)
    drawing.body(axes, source, corners, colours, words)
    return axes


@dataclass(frozen=True)
class Drawing(Declared):
    """How bodies are drawn into axes: what users choose in all figures."""

    deformation_scale: NotNegative
    units: Units = PLAIN
    view: Annotated[Angles | None, Check(require_vector, lengths=(2,))] = None
    axes: Annotated[Axes | None, Check(require_instance, kind=Axes, needed=AXES)] = None
    title: Text | None = None
    mesh_lines: Flag = False

    def panels(self, corners: Corners, count: int = 1, bar: bool = True) -> list[Axes]:
        """The given axes, or those of a new figure for bodies of this size, three in a row."""
        if self.axes is not None:
            return [self.axes]
        width, height = SOLID
        if corners.points.shape[2] == 2:
            both = [corners.points, corners.deformed(self.deformation_scale)]
            width, height = np.ptp(np.concatenate(both).reshape(-1, 2), axis=0)
            unit = min(6.0 / width, 4.0 / height)
            width, height = max(3.5, unit * width + 0.8), max(2.2, unit * height + 0.8)
        rows = math.ceil(count / 3)
        columns = math.ceil(count / rows)
        shrink = min(1.0, 3.6 / width) if columns > 2 else 1.0
        size = (shrink * width * columns + 0.9 * bar, shrink * height * rows)
        figure, panels = Picture(figsize=size, layout="compressed"), []
        for k in range(count):  # on a common scale
            shared = dict.fromkeys(("sharex", "sharey"), panels[0] if panels else None)
            panels.append(figure.add_subplot(rows, columns, k + 1, **shared))
        return panels

    def body(
        self,
        axes: Axes,
        source: object,
        corners: Corners,
        colours: ScalarMappable,
        words: str = "",
        title: str = "",
    ) -> None:
        """The triangles in the colours of their values, title, and what surrounds the body."""
        fields, scale = fields_of(source), self.deformation_scale
        axes.set_title(title or self.title or "\n".join(filter(None, (words, _method(source)))))
        points = corners.deformed(scale)
        lines = sampling.element_borders(fields).deformed(scale) if self.mesh_lines else None
        if points.shape[2] == 3:
            draw_solid(axes, points, corners.values, colours, lines, self.view)
            return
        x, y = points.reshape(-1, 2).T
        triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
        shade = {"cmap": colours.cmap, "norm": colours.norm, "shading": "gouraud"}
        axes.tripcolor(triangles, corners.values.ravel(), rasterized=True, **shade)
        border = sampling.boundary_corners(fields)
        drawn = [
            (border.points, style.OUTLINE, 0.7, 0),
            (border.deformed(scale), style.DEFORMED, 0.6, 3),
        ]
        if lines is not None:
            drawn += [(lines, style.GUIDE, min(0.3, 450 / fields.problem.mesh.ne), 2)]
        if scale > 0:
            drawn += [(sampling.obstacle_lines(fields, scale), style.OBSTACLE, 1.4, 4)]
        for segments, colour, width, above in drawn:
            line = {"colors": colour, "linewidths": width, "zorder": above}
            axes.add_collection(LineCollection(segments, **line))
        length = self.units.length
        axes.set(xlabel=f"x ({length})", ylabel=f"y ({length})", aspect="equal")
        axes.grid(False)
        axes.autoscale_view()
        axes.margins(0.03)


def _method(source: object) -> str:
    """What solved it, for titles: 'gamma = 1e+04'; empty for solutions of the problem itself."""
    label = getattr(source, "method_label", "")
    return label if isinstance(label, str) and label != "exact" else ""


def add_bar(colours: ScalarMappable, panels: list[Axes], label: str, own: bool) -> None:
    """A colour bar beside the axes, below them where a figure of its ``own`` is wide and low."""
    figure, place = panels[0].figure, {"shrink": 0.85, "fraction": 0.05}
    if own and figure.get_figwidth() > 3 * figure.get_figheight():
        figure.set_figheight(figure.get_figheight() + 0.9)
        place = {"shrink": 0.5, "location": "bottom", "fraction": 0.5}
    bar = figure.colorbar(colours, ax=panels, label=label, aspect=30, **place)
    bar.outline.set_linewidth(0.4)
    if bar.orientation == "vertical":  # powers of ten where numbers are small or large
        bar.formatter.set_powerlimits((-2, 4))
        bar.ax.yaxis.get_offset_text().set_fontsize(8)
