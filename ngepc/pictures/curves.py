"""Curves with matplotlib: residual histories, iteration counts, quotients, contact pressures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance, require_mapping, require_sequence
from ngepc.pictures.drawable import UnitNames, fields_of, require_sources, unit_names
from ngepc.pictures.picture import Picture
from ngepc.pictures.sampling import boundary_corners
from ngepc.results.outcome import History

COLOURS = ("#1f5a8c", "#c4622d", "#3d7f4f", "#7d4f9e", "#a3883b", "#4a4a4a", "#b8437a")
MARKERS = "os^Dv<>"


def plot_history(
    histories: History | Mapping[str, History], *, tolerance: float | None = None
) -> Figure:
    """Residual norms ||Psi_gamma||_{H*} and step lengths of one or several runs over the steps.

    Parameters
    ----------
    histories
        A History, or label -> History.
    tolerance
        Drawn as a horizontal line when given.

    Raises
    ------
    TypeError, ValueError
        If there is no history, or one without a record, or the tolerance is no number > 0.
    """
    histories = _labelled(histories)
    if tolerance is not None:
        require_number("tolerance", tolerance, 0, strict=True)
    figure, (left, right) = _figure(7.6, 3.3, 2)
    draw_history(left, right, histories, tolerance)
    if len(histories) > 1:
        handles, labels = left.get_legend_handles_labels()
        options = {"loc": "outside lower center", "ncols": min(4, len(labels))}
        figure.legend(handles, labels, fontsize=8, frameon=False, **options)
    return figure


def draw_history(
    left: Axes, right: Axes, histories: Mapping[str, History], tolerance: float | None = None
) -> None:
    """Residual norms into the left axes, step lengths into the right ones."""
    _history_axes(left, right, tolerance)
    for index, (label, history) in enumerate(histories.items()):
        style = {"label": label or None, **_style(index, len(history.records))}
        _draw_run(left, right, history, 0, style)
    right.set_ylim(top=1.4)


def draw_runs(
    left: Axes, right: Axes, runs: Sequence[History], tolerance: float | None = None
) -> None:
    """Runs one after the other as in ``draw_history``: the last in colour, those before grey."""
    _history_axes(left, right, tolerance)
    first = 0
    for number, history in enumerate(runs):
        style = _style(0, len(history.records))
        if number < len(runs) - 1:
            style |= {"color": "#a7b0b9"}
        _draw_run(left, right, history, first, style)
        first += len(history.step_lengths)
    right.set_ylim(top=1.4)


def _history_axes(left: Axes, right: Axes, tolerance: float | None) -> None:
    for axes in (left, right):
        _plain(axes)
        _iterations_axis(axes)
    left.set_yscale("log")
    left.set_ylabel(r"residual norm $\|\Psi_\gamma\|_{H^*}$", fontsize=9)
    if tolerance is not None:
        left.axhline(tolerance, color="#808890", linewidth=0.8, linestyle=":")
    right.set_yscale("log", base=2)
    right.set_ylabel(r"step length $\alpha^j$", fontsize=9)


def _draw_run(left: Axes, right: Axes, history: History, first: int, style: dict) -> None:
    residuals = np.maximum(history.residual_norms, np.finfo(float).tiny)
    left.plot(range(first, first + len(residuals)), residuals, **style)
    steps = history.step_lengths
    right.plot(range(first + 1, first + 1 + len(steps)), steps, **style)


def plot_counts(
    counts: Mapping[str, Mapping[int, int]],
    paper: Mapping[str, Mapping[int, int]] | None = None,
) -> Figure:
    """Newton steps over the number of nodes, with the paper's counts dashed beside them.

    Parameters
    ----------
    counts, paper
        Label (such as 'gamma = 1e4') -> number of nodes -> steps.

    Raises
    ------
    ValueError
        If ``counts`` is empty.
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
    figure, (axes,) = _figure(5.6, 3.6, 1)
    for index, (label, row) in enumerate(counts.items()):
        style = _style(index, len(row))
        axes.plot(list(row), list(row.values()), label=label, **style)
        if paper and label in paper:
            dashed = {**style, "linestyle": "--", "markerfacecolor": "white", "alpha": 0.7}
            axes.plot(list(paper[label]), list(paper[label].values()), **dashed)
    nodes = sorted({n for row in counts.values() for n in row})
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=1.0, linscale=0.3)
    most = max(steps for row in (*counts.values(), *paper.values()) for steps in row.values())
    axes.set_ylim(0, 1.3 * max(most, 2))
    ticks = [0, 1, *(m * 10**k for k in range(4) for m in (2, 5, 10))]
    axes.set_yticks([t for t in ticks if t <= 1.3 * most])
    axes.set_xticks(nodes, [str(n) for n in nodes], fontsize=8)
    axes.minorticks_off()
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("nodes of the mesh", fontsize=9)
    axes.set_ylabel("Newton steps" + (" (dashed: paper)" if paper else ""), fontsize=9)
    figure.legend(loc="outside right center", fontsize=8, frameon=False)
    return figure


def plot_quotients(quotients: Mapping[str, Sequence[float]]) -> Figure:
    """Convergence quotients Q_j = ||v^{j+1} - v*|| / ||v^j - v*|| over the steps, Figure 4.

    Raises
    ------
    ValueError
        If ``quotients`` is empty.
    """
    require_mapping("quotients", quotients, "label -> numbers")
    for label, values in quotients.items():
        require_sequence(f"quotients[{label!r}]", values, "numbers")
        for value in values:
            require_number(f"quotients[{label!r}]", value, 0)
    figure, (axes,) = _figure(5.6, 3.4, 1)
    for index, (label, values) in enumerate(quotients.items()):
        style = _style(index, len(values))
        axes.plot(range(len(values)), values, label=label, **style)
    axes.axhline(1.0, color="#808890", linewidth=0.8, linestyle=":")
    axes.set_ylim(bottom=0)
    axes.set_ylabel(r"convergence quotient $Q_j$", fontsize=9)
    _iterations_axis(axes)
    axes.legend(fontsize=8, frameon=False)
    return figure


def plot_contact_pressure(
    sources: object | Mapping[str, object], *, units: UnitNames | None = None
) -> Figure:
    """The contact pressure (positive in compression) along the contact boundary of 2D bodies.

    The position is the arc length from the end with the smaller x (then y); several contact
    boundaries and several results are separate curves.

    Parameters
    ----------
    sources
        A result with ``contact_pressure``, or label -> result.

    Raises
    ------
    ValueError
        For problems without contact boundary and for 3D bodies.
    """
    units = unit_names(units)
    if not isinstance(sources, Mapping):
        fields_of(sources, "sources")
        sources = {"": sources}
    require_sources(sources)
    figure, (axes,) = _figure(5.6, 3.2, 1)
    for index, (label, source) in enumerate(sources.items()):
        colour = COLOURS[index % len(COLOURS)]
        for number, (s, pressure) in enumerate(pressure_curves(source)):
            line = {"color": colour, "linewidth": 1.4, "label": None if number else label or None}
            axes.plot(s, pressure, **line)
            axes.fill_between(s, pressure, color=colour, alpha=0.12, linewidth=0)
    axes.axhline(0.0, color="#808890", linewidth=0.6)
    axes.margins(x=0)
    axes.set_xlabel(f"position along the contact boundary ({units.length})", fontsize=9)
    axes.set_ylabel(f"contact pressure ({units.stress})", fontsize=9)
    if any(sources):
        axes.legend(fontsize=8, frameon=False)
    return figure


def pressure_curves(source: object) -> list[tuple[np.ndarray, np.ndarray]]:
    """Arc length and contact pressure at the ends of the segments, for each connected curve."""
    fields = fields_of(source)
    problem = fields.problem
    if not problem.contact_names:
        raise ValueError("sources: a problem with a contact boundary is needed, one has none")
    if problem.N != 2:
        raise ValueError(
            "sources: bodies of dimension 2 are needed, one is 3D: show its contact pressure with "
            "ngepc.pictures.views"
        )
    corners = boundary_corners(fields, problem.contact_names, source.contact_pressure)
    return [_along(corners.points, corners.values, chain) for chain in chains(corners.points)]


def chains(segments: np.ndarray) -> list[list[tuple[int, bool]]]:
    """Connected curves of ``segments`` (n, 2, 2): lists of (segment, whether it is reversed)."""
    size = np.ptp(segments.reshape(-1, 2), axis=0).max() or 1.0
    points = np.round(segments.reshape(-1, 2) / size, 9)
    known, ends = np.unique(points, axis=0, return_inverse=True)
    ends = ends.reshape(-1, 2)
    left = set(range(len(ends)))
    found = []
    while left:
        degree = np.bincount(ends[sorted(left)].ravel(), minlength=len(known))
        tips = np.flatnonzero(degree == 1)
        at = int(tips[0]) if len(tips) else int(np.flatnonzero(degree)[0])
        chain = []
        while (following := next((k for k in sorted(left) if at in ends[k]), None)) is not None:
            left.remove(following)
            backwards = bool(ends[following, 0] != at)
            chain.append((following, backwards))
            at = int(ends[following, 0 if backwards else 1])
        found.append(chain)
    return found


def _along(
    points: np.ndarray, values: np.ndarray, chain: list[tuple[int, bool]]
) -> tuple[np.ndarray, np.ndarray]:
    lengths = [np.linalg.norm(points[k, 1] - points[k, 0]) for k, _ in chain]
    marks = np.r_[0.0, np.cumsum(lengths)]
    position = np.column_stack([marks[:-1], marks[1:]]).ravel()
    ordered = [values[k, ::-1] if backwards else values[k] for k, backwards in chain]
    return position, np.concatenate(ordered)


def _labelled(histories: History | Mapping[str, History]) -> Mapping[str, History]:
    histories = {"": histories} if isinstance(histories, History) else histories
    require_mapping("histories", histories, "label -> History, or a History")
    for label, history in histories.items():
        require_instance(f"histories[{label!r}]", history, History, "a History")
        if not history.records:
            raise ValueError(f"histories[{label!r}] has no records: a run fills them")
    return histories


def _figure(width: float, height: float, columns: int) -> tuple[Figure, Sequence[Axes]]:
    figure = Picture(figsize=(width, height), layout="constrained")
    panels = figure.subplots(1, columns, squeeze=False)[0]
    for axes in panels:
        _plain(axes)
    return figure, panels


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
    axes.grid(color="#e3e6ea", linewidth=0.6)
    axes.set_axisbelow(True)


def _style(index: int, count: int) -> dict:
    return {
        "color": COLOURS[index % len(COLOURS)],
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 3.5,
        "linewidth": 1.2,
        "markevery": max(1, count // 20),
    }


def _iterations_axis(axes: Axes) -> None:
    axes.set_xlabel("Newton step", fontsize=9)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
