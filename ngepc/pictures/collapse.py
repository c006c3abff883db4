"""Pictures of limit loads: the collapse mechanism, its dissipation, the bounds by meshes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

import ngepc.pictures.style as style
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance
from ngepc.limit.load import LimitLoad
from ngepc.pictures.style import COLOURS, Picture, styled

MOVED = 0.05
"""Largest displacement that is drawn, over the extent of the body."""

DARKEST = 0.7
"""Part of the dissipation that is drawn in shades; the rest has the darkest one."""


def require_plane(limit: LimitLoad) -> None:
    """Accept the limit load of a body in the plane with a mechanism."""
    require_instance("limit", limit, LimitLoad, "the result of limit_load")
    if limit.problem.N != 2:
        raise ValueError(
            "limit has a solid: pictures of mechanisms are for bodies in the plane, "
            "export limit.mechanism by ngsolve.VTKOutput"
        )
    if limit.last.mechanism is None:
        raise ValueError(f"limit has no mechanism: {limit.status.value}")


@styled
def plot_mechanism(limit: LimitLoad, *, axes: Axes | None = None) -> Figure:
    """Draw the collapse of a plane body: moved along the mechanism, dark where it dissipates.

    Parameters
    ----------
    limit
        A result of ``limit_load``.
    axes
        Axes to draw into; by default those of a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        For another object, a solid, or a result without a mechanism.
    """
    require_plane(limit)
    axes = axes_or_new(axes, (6.0, 4.2))
    data = limit.last.data
    cells = data.cells
    mechanism = limit.last.mechanism
    corners = mechanism.values[:, :3]
    velocity = np.empty(cells.points.shape)
    velocity[cells.nodes] = corners
    velocity *= MOVED / np.linalg.norm(velocity, axis=1).max()
    length = limit.length
    moved = length * (cells.points + velocity)
    density = mechanism.dissipated / (data.bound * cells.volume)
    order = np.argsort(density)
    share = np.cumsum(mechanism.dissipated[order])
    top = density[order][np.searchsorted(share, DARKEST * share[-1])]
    mesh = Triangulation(*moved.T, cells.nodes)
    colours = {"cmap": "Greys", "vmin": 0.0, "vmax": top or 1.0}
    axes.tripcolor(mesh, facecolors=density, edgecolors="none", **colours)
    ends = cells.facets[cells.outer]
    for points, colour in (
        (length * cells.points, style.OUTLINE),
        (moved, style.DEFORMED),
    ):
        for a, b in points[ends]:
            axes.plot(*np.transpose([a, b]), color=colour, linewidth=0.8)
    axes.set(xlabel="x", ylabel="y", aspect="equal")
    axes.set_title(f"load factor between {limit.lower:.5g} and {limit.upper:.5g}")
    axes.grid(False)
    return axes.figure


@styled
def plot_bracket(
    limit: LimitLoad, exact: float | None = None, *, axes: Axes | None = None
) -> Figure:
    """The bounds over the number of unknowns, mesh by mesh.

    Parameters
    ----------
    limit
        A result of ``limit_load``.
    exact
        The limit load, if it is known.
    axes
        Axes to draw into; by default those of a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError
        For another object.
    """
    require_instance("limit", limit, LimitLoad, "the result of limit_load")
    if exact is not None:
        require_number("exact", exact)
    axes = axes_or_new(axes, (4.8, 3.6))
    finite = [r for r in limit.records if np.isfinite(r.relative_width)]
    unknowns = [sum(r.unknowns) for r in finite]
    lower = [r.lower for r in finite]
    upper = [r.upper for r in finite]
    axes.fill_between(unknowns, lower, upper, color=style.ELASTIC)
    axes.plot(unknowns, upper, "v-", color=COLOURS[0], label="no load above this")
    axes.plot(unknowns, lower, "^-", color=COLOURS[1], label="every load up to this")
    if exact is not None:
        axes.axhline(exact, color=style.GUIDE, linewidth=0.8, label=f"{exact:.5g}")
    axes.set(xscale="log", xlabel="unknowns of both programs", ylabel="load factor")
    axes.legend()
    return axes.figure


def axes_or_new(axes: Axes | None, size: tuple[float, float]) -> Axes:
    """The given axes, or those of a new figure of this size (inches)."""
    if axes is None:
        return Picture(figsize=size, layout="compressed").subplots()
    return require_instance("axes", axes, Axes, "matplotlib Axes or None")
