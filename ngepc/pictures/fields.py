"""Figures of bodies with matplotlib: fields on the deformed body, plastic zones, active sets.

Every function returns a ``matplotlib.figure.Figure``; ``figure.savefig(path)`` writes PNG, PDF or
SVG.  Curved elements are drawn curved.  Curves over something are in ``ngepc.pictures.curves``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

import ngepc.pictures.style as style
from ngepc.checks.arguments import require_number, require_vector
from ngepc.checks.declared import Check, Declared, Flag, NotNegative, Text
from ngepc.checks.kinds import require_attributes, require_instance
from ngepc.checks.sentences import in_words
from ngepc.pictures.cutting import Part, Plane
from ngepc.pictures.drawable import (
    PLAIN,
    UnitNames,
    fields_of,
    on_one_scale,
    pressure_on_boundary,
    require_units,
    sources_of,
)
from ngepc.pictures.meshes import axis_names, draw_names, is_mesh
from ngepc.pictures.sampling import Corners, corners_of, obstacle_lines, visible
from ngepc.pictures.stills import Angles, draw_solid, solid_image
from ngepc.pictures.style import new_picture, styled
from ngepc.results.fields import Fields

SETS = (style.ELASTIC, style.PLASTIC, style.CONTACT)


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
    body: str | None = None,
    boundary: str | None = None,
    cut: Plane | None = None,
    cmap: str | Colormap | None = None,
    axes: Axes | None = None,
) -> Figure:
    """A scalar field on the deformed body; in 3D on its surface.

    Fields are interpolated in each element on its own.  Thin lines show the body
    before the deformation, a black one the obstacle at distance psi.

    Parameters
    ----------
    source
        Result of a solver, or ``Fields``; or title -> either, drawn side by side on one scale.
    field
        Name of a field ('equivalent_plastic_strain', 'yield_function', 'stress_xy', ...) or a
        coefficient.
    deformation_scale
        Factor >= 0 on the displacement, 1 in the paper's figures.
    vmin, vmax
        Ends of the colour scale; by default percentiles (``colour_scale``), with arrows on the
        colour bar where values lie outside.
    title
        By default how the problem was solved; behind it the factor on the displacement, if it is
        not 1.
    mesh_lines
        Whether to draw the mesh.
    units
        Names of the units, for the axes and the colour bar.
    view
        Where solids are seen from: degrees around the z axis and above the xy plane.
    body
        Name of a material: draw that body alone.
    boundary
        Names of boundaries of a solid, 'a' or 'a|b': draw these alone, inner faces in contact
        for example.
    cut
        (point, normal) of a plane: what lies on the side of the normal is taken away, and the
        section of a solid is drawn.  Positions are those before the deformation.
    cmap
        A colour map of matplotlib or its name; by default one that suits the field.
    axes
        Axes to draw one result into; by default those of a new figure.

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
    part = Part(body, boundary, cut)
    sources = sources_of("source", source, title or "")
    if axes is not None and len(sources) > 1:
        raise ValueError(
            f"source: one result is needed for given axes, there are {len(sources)}"
        )
    what, corners, colours = on_one_scale(
        sources.values(), field, drawing.units, (vmin, vmax), part, cmap
    )
    if not part.whole:
        drawing = replace(drawing, mesh_lines=False, outline=False)
    panels = drawing.bodies(sources, corners, colours, bar=True)
    figure = panels[0].figure
    place = {"shrink": 0.85, "fraction": 0.05}
    if axes is None and figure.get_figwidth() > 3 * figure.get_figheight():
        figure.set_figheight(figure.get_figheight() + 0.9)
        place = {"shrink": 0.5, "location": "bottom", "fraction": 0.5}
    bar = figure.colorbar(colours, ax=panels, label=what[0].label, aspect=30, **place)
    bar.outline.set_linewidth(0.4)
    if bar.orientation == "vertical":  # powers of ten where numbers are small or large
        bar.formatter.set_powerlimits((-2, 4))
        bar.ax.yaxis.get_offset_text().set_fontsize(8)
    return figure


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
    fields = fields_of(source)
    sampled = corners_of(fields, visible(fields, fields.equivalent_plastic_strain))
    words = rf"plastic zone (dark): $|p|_F > {threshold:g}$"
    return _draw_sets(
        drawing, source, sampled, sampled.values.mean(axis=1) > threshold, words
    )


@styled
def plot_active_sets(
    result: object, *, view: Angles | None = None, axes: Axes | None = None
) -> Figure:
    """The active sets: dark where the body yields in this step, orange where it is in contact.

    ``result`` is a result of a solver or the snapshot of an iterate.  It is drawn before the
    deformation, where it stays while iterates come and go.
    """
    require_attributes(
        "result", result, ("fields", "yield_excess"), "a result of a solver"
    )
    drawing = Drawing(0.0, view=view, axes=axes)
    fields = fields_of(result)
    cuts = max(1, round(math.sqrt(16_000 / fields.problem.mesh.ne)))
    sampled = corners_of(fields, visible(fields, result.yield_excess), cuts=cuts)
    sets = (sampled.values.mean(axis=1) > 0.0).astype(int)
    touching = corners_of(fields, pressure_on_boundary(result), ".*", cuts)
    pushed = touching.values.mean(axis=1) > 0.0
    if fields.problem.N == 3:
        sets[pushed] = 2
    words = "yields (dark)" + ", in contact (orange)" * bool(
        fields.problem.touching_names
    )
    figure = _draw_sets(drawing, result, sampled, sets, words)
    if fields.problem.N == 2:
        thick = {"colors": style.CONTACT, "linewidths": 3.0, "zorder": 5}
        (axes or figure.axes[0]).add_collection(
            LineCollection(touching.points[pushed], **thick)
        )
    return figure


@styled
def plot_mesh(
    source: object,
    *,
    view: Angles | None = None,
    body: str | None = None,
    cut: Plane | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The mesh before the deformation; of a mesh or a problem with the names of its boundaries.

    Parameters
    ----------
    source
        A mesh, a ``Problem``, or the result of a solver.  Boundaries of a mesh or a problem are
        drawn in colours, and the legend says their names, of a problem also what happens there:
        'bottom: clamped'.
    view, body, cut, axes
        As in ``plot_field``; ``body`` and ``cut`` are for meshes and problems.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        If the source is of another kind.
    """
    if is_mesh(source):
        return draw_names(source, view, body, cut, axes)
    fields = fields_of(source, "source", "a mesh, a Problem, ")
    for name, value in {"body": body, "cut": cut}.items():
        if value is not None:
            needed = (
                "a mesh or a problem is needed as source, result.problem for example"
            )
            raise ValueError(f"{name}={in_words(value)}: {needed}")
    sampled = corners_of(fields)
    drawing = Drawing(0.0, view=view, axes=axes, mesh_lines=True)
    return _draw_sets(drawing, fields, sampled, np.zeros(len(sampled.points)))


def _draw_sets(
    drawing: "Drawing",
    source: object,
    sampled: Corners,
    sets: np.ndarray,
    words: str = "",
) -> Figure:
    """Each triangle in the colour of the set, 0, 1 or 2, that it belongs to."""
    corners = replace(sampled, values=np.repeat(sets[:, None], 3, axis=1).astype(float))
    colours = ScalarMappable(Normalize(0, len(SETS) - 1), ListedColormap(SETS))
    title = "\n".join(filter(None, (words, _method(source))))
    return drawing.bodies({title: source}, [corners], colours)[0].figure


def _method(source: object) -> str:
    """The method for titles: 'gamma = 1e4'; empty for solutions of the problem itself."""
    label = getattr(source, "method_label", "")
    return label if isinstance(label, str) and label != "exact" else ""


@dataclass(frozen=True)
class Drawing(Declared):
    """Options of all figures of bodies: how they are drawn into axes."""

    deformation_scale: NotNegative
    units: Annotated[UnitNames | None, Check(require_units)] = PLAIN
    view: Annotated[Angles | None, Check(require_vector, lengths=(2,))] = None
    axes: Annotated[
        Axes | None, Check(require_instance, kind=Axes, needed="Axes or None")
    ] = None
    title: Text | None = None
    mesh_lines: Flag = False
    outline: Flag = True

    def bodies(
        self,
        sources: Mapping[str, object],
        corners: Sequence[Corners],
        colours: ScalarMappable,
        bar: bool = False,
    ) -> list[Axes]:
        """Draw title -> body side by side in the colours of its values, with room for a ``bar``."""
        panels = (
            [self.axes] if self.axes else self._panels(corners[0], len(corners), bar)
        )
        for axes, (title, source), sampled in zip(
            panels, sources.items(), corners, strict=True
        ):
            axes.set_title(self.caption(title or _method(source)))
            fields = fields_of(source)
            if fields.problem.N == 3:
                self._draw_solid(axes, fields, sampled, colours)
            else:
                self._draw_plane(axes, fields, sampled, colours)
        return panels

    def caption(self, title: str) -> str:
        """The title of a body, with the factor of its displacements where they are not true."""
        if self.deformation_scale in (0.0, 1.0):
            return title
        enlarged = f"displacements x {self.deformation_scale:g}"
        return f"{title} ({enlarged})" if title else enlarged

    def _mesh_edges(self, fields: Fields) -> np.ndarray | None:
        """The deformed edges of the mesh, if they are to be drawn."""
        if not self.mesh_lines:
            return None
        return corners_of(fields, border=True).deformed(self.deformation_scale)

    def _draw_solid(
        self, axes: Axes, fields: Fields, sampled: Corners, colours: ScalarMappable
    ) -> None:
        """A solid as an image, seen from ``view``."""
        points = sampled.deformed(self.deformation_scale)
        edges = self._mesh_edges(fields)
        image = solid_image(points, sampled.values, colours, edges, self.view)
        draw_solid(axes, image, self.view)

    def _draw_plane(
        self, axes: Axes, fields: Fields, sampled: Corners, colours: ScalarMappable
    ) -> None:
        """A plane body as triangles in colours, with its outlines and the obstacle."""
        points = sampled.deformed(self.deformation_scale)
        axes.tripcolor(
            *points.reshape(-1, 2).T,
            sampled.values.ravel(),
            triangles=np.arange(points.size // 2).reshape(-1, 3),
            cmap=colours.cmap,
            norm=colours.norm,
            shading="gouraud",
            rasterized=True,
        )
        for segments, colour, width, above in self._lines(fields):
            line = {"colors": colour, "linewidths": width, "zorder": above}
            axes.add_collection(LineCollection(segments, **line))
        length = self.units.of("length")
        first, second = axis_names(fields.problem)
        axes.set(xlabel=f"{first}{length}", ylabel=f"{second}{length}", aspect="equal")
        axes.grid(False)
        axes.autoscale_view()
        axes.margins(0.03)

    def _lines(self, fields: Fields) -> list[tuple[np.ndarray, str, float, int]]:
        """Segments, colour, width and depth of the lines on a plane body."""
        scale = self.deformation_scale
        border = corners_of(fields, where=".*")
        lines = [(border.points, style.OUTLINE, 0.7, 0)]
        if self.outline:
            lines.append((border.deformed(scale), style.DEFORMED, 0.6, 3))
        edges = self._mesh_edges(fields)
        if edges is not None:
            width = min(0.3, 450 / fields.problem.mesh.ne)
            lines.append((edges, style.GUIDE, width, 2))
        if scale > 0:
            lines.append((obstacle_lines(fields, scale), style.OBSTACLE, 1.4, 4))
        return lines

    def _panels(self, corners: Corners, count: int, bar: bool) -> list[Axes]:
        """Axes of a new figure for bodies of this size, three in a row.

        Plane bodies have a common scale; each solid is an image with pixels of its own.
        """
        width = 3.8
        height = 3.4  # inches, of a solid
        plane = corners.points.shape[2] == 2
        if plane:
            both = np.concatenate(
                [corners.points, corners.deformed(self.deformation_scale)]
            )
            width, height = np.ptp(both.reshape(-1, 2), axis=0)
            unit = min(6.0 / width, 4.0 / height)
            width = max(3.5, unit * width + 0.8)
            height = max(2.2, unit * height + 0.8)
        rows = math.ceil(count / 3)
        columns = math.ceil(count / rows)
        shrink = min(1.0, 3.6 / width) if columns > 2 else 1.0
        size = (shrink * width * columns + 0.9 * bar, shrink * height * rows)
        figure = new_picture(figsize=size, layout="compressed")
        first = None
        for k in range(count):
            axes = figure.add_subplot(rows, columns, k + 1, sharex=first, sharey=first)
            if plane:
                first = first or axes
        return figure.axes
