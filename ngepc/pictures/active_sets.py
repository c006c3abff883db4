"""Active sets on the body: where it yields and where it is in contact."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_attributes
from ngepc.pictures.body import body_figure, check_drawing, decorate, draw_body
from ngepc.pictures.drawable import UnitNames, fields_of, unit_names
from ngepc.pictures.fields import ZONE_COLOURS
from ngepc.pictures.sampling import ColourRange, Corners, body_corners, sample_corners
from ngepc.results.fields import Fields

CONTACT = "#2f7fc1"
SET_COLOURS = (*ZONE_COLOURS, CONTACT)


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
    axes = axes if axes is not None else body_figure(corners, scale, bar=False)
    draw_body(axes, corners, ColourRange(0.0, 2.0), ListedColormap(SET_COLOURS), scale, False)
    decorate(axes, fields, scale, units)
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
