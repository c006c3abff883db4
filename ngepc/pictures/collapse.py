"""Pictures of limit loads: mechanism, dissipation, residual stress, the bounds by meshes."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

import ngepc.pictures.style as style
from ngepc.bounds.simplices import FACETS
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import outward
from ngepc.limit.bracket import dissipation_of
from ngepc.limit.fields import corner_values
from ngepc.limit.outcome import LimitLoad
from ngepc.limit.shakedown import ShakedownLoad
from ngepc.pictures.stills import draw_solid, solid_image
from ngepc.pictures.style import COLOURS, new_picture, require_axes, styled

RESULT = "the result of limit_load or shakedown_load"

MOVED = 0.05
"""Largest displacement that is drawn, over the extent of the body."""

DARKEST = 0.7
"""Fraction of the dissipation that is drawn in shades; the rest has the darkest one."""


def require_mechanism(limit: LimitLoad | ShakedownLoad) -> None:
    """Accept a limit load, or that of loads that vary, with a mechanism."""
    require_instance("limit", limit, (LimitLoad, ShakedownLoad), RESULT)
    if limit.last.mechanism is None:
        raise ValueError(f"limit has no mechanism: {limit.status.value}")


@styled
def plot_mechanism(
    limit: LimitLoad | ShakedownLoad, *, axes: Axes | None = None
) -> Figure:
    """Draw the collapse of a body: moved along the mechanism, dark where it dissipates.

    In a solid, slips on the faces of elements count as dissipation of the elements; its picture
    needs pyvista, the extra ``stills``.  Loads that vary have the motion that a cycle adds, none
    where plastic strains alternate.

    Parameters
    ----------
    limit
        A result of ``limit_load`` or ``shakedown_load``.
    axes
        Axes to draw into; by default those of a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        For another object, or a result without a mechanism.
    ImportError
        If pyvista is needed and not installed.
    """
    require_mechanism(limit)
    axes = axes_or_new(axes, (6.0, 4.2))
    density, top = shades(limit)
    if limit.problem.N == 3:
        draw_solid(axes, moved_solid(limit, density, top), None)
    else:
        draw_plane(axes, limit, density, top)
    ends = " and ".join(outward(limit.lower, limit.upper, 5))
    axes.set_title(f"{factor(limit)} between {ends}")
    return axes.figure


def factor(limit: LimitLoad | ShakedownLoad) -> str:
    """What the bounds are bounds of."""
    which = "shakedown" if isinstance(limit, ShakedownLoad) else "load"
    return f"{which} factor"


def shades(limit: LimitLoad | ShakedownLoad) -> tuple[np.ndarray, float]:
    """Dissipation over strength for each element, and the value that is drawn as dark as can be."""
    data = limit.last.data
    cells = data.cells
    dissipated = dissipation_of(data, limit.last.mechanism)
    density = dissipated / (data.bound * cells.volume)
    order = np.argsort(density)
    share = np.cumsum(dissipated[order])
    top = density[order][np.searchsorted(share, DARKEST * share[-1])]
    return density, float(top) or 1.0


def moved_corners(limit: LimitLoad | ShakedownLoad) -> np.ndarray:
    """The vertices of each element after the motion that is drawn, (nc, N + 1, N)."""
    cells = limit.last.data.cells
    mechanism = limit.last.mechanism
    velocity = corner_values(mechanism.values, mechanism.degree)
    velocity = velocity * MOVED / np.linalg.norm(velocity, axis=2).max()
    if isinstance(limit, ShakedownLoad) and limit.alternates:
        velocity = 0.0 * velocity  # strains alternate, nothing is added in a cycle
    return limit.length * (cells.points[cells.nodes] + velocity)


def moved_solid(limit: LimitLoad, density: np.ndarray, top: float) -> np.ndarray:
    """The outer faces of a solid in shades of its dissipation, as an image."""
    cells = limit.last.data.cells
    corners = moved_corners(limit)
    owner, k = np.nonzero(cells.outer[cells.facet_of])
    faces = corners[owner[:, None], np.array(FACETS[3])[k]]
    values = np.repeat(density[owner, None], 3, axis=1)
    colours = ScalarMappable(Normalize(0.0, top), "Greys")
    return solid_image(faces, values, colours)


def draw_plane(axes: Axes, limit: LimitLoad, density: np.ndarray, top: float) -> None:
    """Triangles in shades of their dissipation, the outlines before and after the motion."""
    cells = limit.last.data.cells
    moved = np.empty(cells.points.shape)
    moved[cells.nodes] = moved_corners(limit)
    mesh = Triangulation(*moved.T, cells.nodes)
    colours = {"cmap": "Greys", "vmin": 0.0, "vmax": top}
    axes.tripcolor(mesh, facecolors=density, edgecolors="none", **colours)
    ends = cells.facets[cells.outer]
    for points, colour in (
        (limit.length * cells.points, style.OUTLINE),
        (moved, style.DEFORMED),
    ):
        for a, b in points[ends]:
            axes.plot(*np.transpose([a, b]), color=colour, linewidth=0.8)
    axes.set(xlabel="x", ylabel="y", aspect="equal")
    axes.grid(False)


@styled
def plot_residual_stress(limit: ShakedownLoad, *, axes: Axes | None = None) -> Figure:
    """Draw the residual stress of the lower bound: its deviator over the yield bound.

    Stresses of the loads that vary are added to it; it remains when they are taken away.

    Parameters
    ----------
    limit
        A result of ``shakedown_load``.
    axes
        Axes to draw into; by default those of a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        For another object, or a result without a residual stress.
    """
    require_instance("limit", limit, ShakedownLoad, "the result of shakedown_load")
    if limit.last.stress is None:
        raise ValueError(f"limit has no residual stress: {limit.status.value}")
    axes = axes_or_new(axes, (6.0, 4.2))
    data = limit.last.data
    cells = data.cells
    capped = limit.last.stress.coordinates[..., limit.last.shape.free :]
    used = np.linalg.norm(capped, axis=2) / data.bound[:, None]
    corners = limit.length * cells.points[cells.nodes].reshape(-1, 2)
    mesh = Triangulation(*corners.T, np.arange(len(corners)).reshape(-1, 3))
    colours = axes.tripcolor(mesh, used.ravel(), shading="gouraud", vmin=0.0)
    for ends in limit.length * cells.points[cells.facets[cells.outer]]:
        axes.plot(*ends.T, color=style.OUTLINE, linewidth=0.8)
    label = "deviator of the residual stress / yield bound"
    axes.figure.colorbar(colours, ax=axes, label=label)
    ends = " and ".join(outward(limit.lower, limit.upper, 5))
    axes.set_title(f"shakedown factor between {ends}")
    axes.set(xlabel="x", ylabel="y", aspect="equal")
    axes.grid(False)
    return axes.figure


@styled
def plot_bracket(
    limit: LimitLoad | ShakedownLoad,
    exact: float | None = None,
    *,
    axes: Axes | None = None,
) -> Figure:
    """The bounds over the number of unknowns, mesh by mesh.

    Parameters
    ----------
    limit
        A result of ``limit_load`` or ``shakedown_load``.
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
    require_instance("limit", limit, (LimitLoad, ShakedownLoad), RESULT)
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
    style.counts_along(axes, "unknowns of both programs")
    axes.set_ylabel(factor(limit))
    axes.legend()
    return axes.figure


def axes_or_new(axes: Axes | None, size: tuple[float, float]) -> Axes:
    """The given axes, or those of a new figure of this size (inches)."""
    if require_axes(axes) is None:
        return new_picture(figsize=size, layout="compressed").subplots()
    return axes
