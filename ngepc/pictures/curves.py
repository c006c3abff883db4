"""Curves with matplotlib: residual histories, iteration counts, contact pressures, progress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, depth_first_order

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import (
    require_attributes,
    require_instance,
    require_mapping,
    require_sequence,
)
from ngepc.pictures.bodies import check_drawing
from ngepc.pictures.drawable import UnitNames, fields_of, require_sources, unit_names
from ngepc.pictures.fields import plot_active_sets
from ngepc.pictures.sampling import boundary_corners
from ngepc.pictures.style import COLOURS, GUIDE, Picture, line_style, styled
from ngepc.results.outcome import History

EARLIER = "#a7b0b9"


@styled
def plot_history(
    histories: History | Mapping[str, History], *, tolerance: float | None = None
) -> Figure:
    """Residual norms and step lengths of one or several runs over the Newton steps.

    Parameters
    ----------
    histories
        A History, or label -> History.
    tolerance
        Drawn as a horizontal line when given.
    """
    histories = {"": histories} if isinstance(histories, History) else histories
    require_mapping("histories", histories, "label -> History, or a History")
    for label, history in histories.items():
        require_instance(f"histories[{label!r}]", history, History, "a History")
        if not history.records:
            raise ValueError(f"histories[{label!r}] has no records: a run fills them")
    figure = Picture(figsize=(7.6, 3.3))
    left, right = figure.subplots(1, 2)
    drawn = [
        (history, 0, {"label": label or None, **line_style(index, len(history.records))})
        for index, (label, history) in enumerate(histories.items())
    ]
    _draw(left, right, drawn, tolerance)
    if len(histories) > 1:
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)))
    return figure


def draw_runs(
    left: Axes, right: Axes, runs: Sequence[History], tolerance: float | None = None
) -> None:
    """Runs one after the other: residuals left, step lengths right, earlier runs grey."""
    first = np.cumsum([0, *(len(history.step_lengths) for history in runs)])
    styles = [line_style(0, len(history.records)) for history in runs]
    styles[:-1] = [style | {"color": EARLIER} for style in styles[:-1]]
    _draw(left, right, list(zip(runs, first[:-1], styles, strict=True)), tolerance)


def _draw(
    left: Axes, right: Axes, runs: list[tuple[History, int, dict]], tolerance: float | None
) -> None:
    """Histories, each with its first step and its style: residuals left, step lengths right."""
    for axes in (left, right):
        axes.set_xlabel("Newton step")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    left.set(yscale="log", ylabel="residual norm")
    right.set_yscale("log", base=2)
    right.set_ylabel("step length")
    if tolerance is not None:
        require_number("tolerance", tolerance, 0, strict=True)
        left.axhline(tolerance, color=GUIDE, linewidth=0.8, linestyle=":")
    for history, first, style in runs:
        residuals = np.maximum(history.residual_norms, np.finfo(float).tiny)
        left.plot(np.arange(first, first + len(residuals)), residuals, **style)
        steps = history.step_lengths
        right.plot(np.arange(first + 1, first + 1 + len(steps)), steps, **style)
    right.set_ylim(top=1.4)


@styled
def plot_progress(
    result: object,
    *,
    runs: Sequence[History] | None = None,
    tolerance: float | None = None,
    deformation_scale: float = 0.0,
) -> Figure:
    """The active sets on the body, residual norms and step lengths, for monitors.

    ``result`` is any iterate, ``runs`` are histories one after the other, such as those of a path;
    by default that of ``result``.
    """
    require_attributes("result", result, ("problem", "history", "yield_excess"), "a result")
    histories = [result.history] if runs is None else runs
    require_sequence("runs", histories, "histories")
    for number, history in enumerate(histories):
        require_instance(f"runs[{number}]", history, History, "a History")
    figure = Picture(figsize=(9.6, 3.0))
    grid = figure.add_gridspec(1, 3, width_ratios=(1.2, 1.0, 1.0))
    body, left, right = map(figure.add_subplot, grid)
    plot_active_sets(result, deformation_scale=deformation_scale, axes=body)
    draw_runs(left, right, histories, tolerance)
    return figure


@styled
def plot_counts(
    counts: Mapping[str, Mapping[int, int]],
    paper: Mapping[str, Mapping[int, int]] | None = None,
) -> Figure:
    """Newton steps over the number of nodes, with the paper's counts dashed beside them.

    Parameters
    ----------
    counts, paper
        Label (such as 'gamma = 1e4') -> number of nodes -> steps.
    """
    require_mapping("counts", counts, "label -> (number of nodes -> steps)")
    paper = {} if paper is None else paper
    for name, rows in (("counts", counts), ("paper", paper)):
        require_instance(name, rows, Mapping, "a mapping of label -> (number of nodes -> steps)")
        for label, row in rows.items():
            require_mapping(f"{name}[{label!r}]", row, "number of nodes -> steps")
            for nodes, steps in row.items():
                require_number(f"nodes in {name}[{label!r}]", nodes, 0, strict=True)
                require_number(f"steps in {name}[{label!r}]", steps, 0)
    figure = Picture(figsize=(5.6, 3.6))
    axes = figure.subplots()
    for index, (label, row) in enumerate(counts.items()):
        style = line_style(index, len(row))
        axes.plot(list(row), list(row.values()), label=label, **style)
        style |= {"linestyle": "--", "markerfacecolor": "white", "alpha": 0.7}
        axes.plot(list(paper.get(label, ())), list(paper.get(label, {}).values()), **style)
    nodes = sorted({n for row in counts.values() for n in row})
    most = 1.3 * max(2, *(n for row in (*counts.values(), *paper.values()) for n in row.values()))
    axes.set(xscale="log", xlabel="nodes of the mesh")
    axes.set_ylabel("Newton steps" + (" (dashed: paper)" if paper else ""))
    axes.set_yscale("symlog", linthresh=1.0, linscale=0.3)
    axes.set_ylim(0, most)
    axes.set_yticks([t for t in (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if t <= most])
    axes.set_xticks(nodes, [str(n) for n in nodes])
    axes.minorticks_off()
    axes.yaxis.set_major_formatter("{x:g}")
    figure.legend(loc="outside right center")
    return figure


@styled
def plot_contact_pressure(
    sources: object | Mapping[str, object],
    *,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The contact pressure (positive in compression) along the contact boundary of 2D bodies.

    The position is the arc length from the end with the smaller x (then y); several contact
    boundaries and several results (label -> result) are separate curves.  ``axes`` are what to draw
    into, by default those of a new figure.
    """
    units = unit_names(units)
    check_drawing(axes)
    if not isinstance(sources, Mapping):
        fields_of(sources, "sources")
        sources = {"": sources}
    require_sources(sources)
    axes = Picture(figsize=(5.6, 3.2)).subplots() if axes is None else axes
    for index, (label, source) in enumerate(sources.items()):
        colour = COLOURS[index % len(COLOURS)]
        for number, (s, pressure) in enumerate(pressure_curves(source)):
            axes.plot(s, pressure, color=colour, label=None if number else label or None)
            axes.fill_between(s, pressure, color=colour, alpha=0.12, linewidth=0)
    axes.axhline(0.0, color=GUIDE, linewidth=0.6)
    axes.margins(x=0)
    axes.set(
        xlabel=f"position along the contact boundary ({units.length})",
        ylabel=f"contact pressure ({units.stress})",
    )
    if any(sources):
        axes.legend()
    return axes.figure


def pressure_curves(source: object) -> list[tuple[np.ndarray, np.ndarray]]:
    """Arc length and contact pressure at the ends of the segments, for each connected curve."""
    fields = fields_of(source)
    problem = fields.problem
    if not problem.touching_names:
        raise ValueError("sources: a problem with a contact boundary is needed, one has none")
    if problem.N != 2:
        raise ValueError(
            "sources: bodies of dimension 2 are needed, one is 3D: show its contact pressure with "
            "ngepc.pictures.views"
        )
    corners = boundary_corners(fields, problem.touching_names, source.contact_pressure)
    lengths, found = corners.measures, []
    for chain, backwards in chains(corners.points):
        marks = np.r_[0.0, np.cumsum(lengths[chain])]
        values = np.where(backwards[:, None], corners.values[chain, ::-1], corners.values[chain])
        found.append((np.repeat(marks, 2)[1:-1], values.ravel()))
    return found


def chains(segments: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Connected curves of ``segments`` (n, 2, 2): which in order, and whether they are reversed."""
    size = np.ptp(segments.reshape(-1, 2), axis=0).max() or 1.0
    known, ends = np.unique(
        np.round(segments.reshape(-1, 2) / size, 9), axis=0, return_inverse=True
    )
    ends, place, found = ends.reshape(-1, 2), np.empty(len(known), dtype=int), []
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(len(known), len(known)))
    curves, degree = connected_components(graph)[1], np.bincount(ends.ravel())
    for curve in range(curves.max() + 1):
        nodes = np.flatnonzero(curves == curve)
        start = nodes[np.argmin(degree[nodes])]  # a tip, or the first point of a closed curve
        walk = depth_first_order(graph, start, directed=False, return_predecessors=False)
        place[walk] = np.arange(len(walk))
        own = np.flatnonzero(curves[ends[:, 0]] == curve)
        first, second = place[ends[own]].T
        closes = np.abs(second - first) > 1
        order = np.argsort(np.where(closes, len(walk), np.minimum(first, second)))
        found.append((own[order], ((first > second) != closes)[order]))
    return found
