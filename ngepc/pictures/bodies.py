"""Drawing one body into matplotlib axes: its triangles, outlines, obstacle, labels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.tri import Triangulation

from ngepc.checks.arguments import require_vector
from ngepc.checks.declared import Check, Declared, Flag, NotNegative, Text
from ngepc.checks.kinds import require_instance
from ngepc.pictures.drawable import Units, fields_of, require_units
from ngepc.pictures.sampling import Corners, boundary_corners, element_borders, obstacle_lines
from ngepc.pictures.stills import Angles, camera, solid_image
from ngepc.pictures.style import DEFORMED, GUIDE, OBSTACLE, OUTLINE, Picture

AXES = "matplotlib Axes or None"
SOLID = (3.8, 3.4)
"""Inches that a picture of a solid takes."""


@dataclass(frozen=True)
class Drawing(Declared):
    """How bodies are drawn into axes: what users choose in all figures."""

    deformation_scale: NotNegative
    units: Units = None
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
            both = np.concatenate(
                [corners.points, corners.deformed(self.deformation_scale)]
            ).reshape(-1, 2)
            width, height = np.ptp(both, axis=0)
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
        lines = element_borders(fields).deformed(scale) if self.mesh_lines else None
        if points.shape[2] == 3:
            axes.imshow(solid_image(points, corners.values, colours, lines, self.view))
            self._directions(axes)
            return
        x, y = points.reshape(-1, 2).T
        triangles = Triangulation(x, y, np.arange(len(x)).reshape(-1, 3))
        shade = {"cmap": colours.cmap, "norm": colours.norm, "shading": "gouraud"}
        axes.tripcolor(triangles, corners.values.ravel(), rasterized=True, **shade)
        border = boundary_corners(fields)
        drawn = [(border.points, OUTLINE, 0.7, 0), (border.deformed(scale), DEFORMED, 0.6, 3)]
        if lines is not None:
            drawn += [(lines, GUIDE, min(0.3, 450 / fields.problem.mesh.ne), 2)]
        if scale > 0:
            drawn += [(obstacle_lines(fields, scale), OBSTACLE, 1.4, 4)]
        for segments, colour, width, above in drawn:
            line = {"colors": colour, "linewidths": width, "zorder": above}
            axes.add_collection(LineCollection(segments, **line))
        length = require_units("units", self.units).length
        axes.set(xlabel=f"x ({length})", ylabel=f"y ({length})", aspect="equal")
        axes.grid(False)
        axes.autoscale_view()
        axes.margins(0.03)

    def _directions(self, axes: Axes) -> None:
        """Arrows along x, y and z, left of the image of a solid, which needs no other axes."""
        height, width = axes.images[0].get_size()
        size = 0.08 * max(height, width)
        start = np.array([-1.2 * size, height - size])
        axes.set(xlim=(-2.6 * size, width), ylim=(height, 0))
        axes.set_axis_off()
        for letter, along in zip("xyz", camera(self.view)[:2].T * (size, -size), strict=True):
            if np.linalg.norm(along) > 0.2 * size:
                arrow = {"arrowstyle": "<|-", "color": GUIDE, "shrinkB": 0, "linewidth": 0.8}
                at = {"ha": "center", "va": "center", "color": GUIDE, "fontsize": 8}
                axes.annotate(letter, start, start + 1.25 * along, arrowprops=arrow, **at)


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
