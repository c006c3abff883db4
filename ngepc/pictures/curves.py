"""Curves with matplotlib: residual histories, iteration counts, contact pressures."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra, minimum_spanning_tree

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import (
    require_instance,
    require_mapping,
    require_sequence,
    require_text,
)
from ngepc.checks.sentences import counted, in_words
from ngepc.evolution.result import Evolution
from ngepc.model.problem import Problem
from ngepc.pictures.drawable import UnitNames, fields_of, require_units, sources_of
from ngepc.pictures.quantities import units_of
from ngepc.pictures.sampling import corners_of
from ngepc.pictures.style import (
    COLOURS,
    GUIDE,
    line_style,
    new_picture,
    require_axes,
    styled,
)
from ngepc.results.fields import Fields
from ngepc.results.outcome import History

FEWEST_DIGITS = 1 / 64
"""Powers of two above this have few digits on an axis."""


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

    Returns
    -------
    Figure
        Residuals left, step lengths right.

    Raises
    ------
    TypeError, ValueError
        If a history is none or has no records, or the tolerance is no positive number.
    """
    histories = {"": histories} if isinstance(histories, History) else histories
    needed = "label -> History, or a History (plot_curve draws load histories)"
    require_mapping("histories", histories, needed)
    for label, history in histories.items():
        require_instance(f"histories[{label!r}]", history, History, "a History")
        if not history.records:
            raise ValueError(f"histories[{label!r}] has no records: a run fills them")
    if tolerance is not None:
        require_number("tolerance", tolerance, 0, strict=True)
    runs = [
        (
            history,
            0,
            {"label": label or None, **line_style(index, len(history.records))},
        )
        for index, (label, history) in enumerate(histories.items())
    ]
    figure = new_picture(figsize=(7.6, 3.3))
    draw_runs(figure.subplots(1, 2), runs, tolerance)
    if len(histories) > 1:
        curves = figure.axes[0].get_legend_handles_labels()
        figure.legend(*curves, loc="outside lower center", ncols=4)
    return figure


def draw_runs(
    panels: Sequence[Axes],
    runs: list[tuple[History, int, dict]],
    tolerance: float | None,
) -> None:
    """Residuals left, step lengths right, of histories, each with its first step and its style."""
    left, right = panels
    for history, first, style in runs:
        steps = first + np.arange(len(history.records))
        residuals = np.maximum(history.residual_norms, np.finfo(float).tiny)
        left.plot(steps, residuals, **style)
        right.plot(steps[1:], history.step_lengths, **style)
    left.set(yscale="log", ylabel="residual norm")
    shortest = min((min(h.step_lengths, default=1.0) for h, _, _ in runs), default=1.0)
    right.set(ylabel="step length", ylim=(min(0.4, 0.8 * shortest), 1.4))
    scale_steps(right, shortest)
    for axes in panels:
        axes.set_xlabel("Newton step")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if tolerance is not None:
        left.axhline(tolerance, color=GUIDE, linewidth=0.8, linestyle=":")


def scale_steps(axes: Axes, shortest: float) -> None:
    """Logarithmic axis of step lengths: powers of two, and of ten where those have many digits."""
    few = shortest >= FEWEST_DIGITS
    axes.set_yscale("log", base=2 if few else 10)
    if few:
        axes.yaxis.set_major_formatter("{x:g}")


Quantity = str | Callable[[Fields], float] | Sequence[float]
"""A name, a function of the fields of a step, or one number for each step."""

WORDS = {
    "time": ("time", ""),
    "contact_force": ("contact force", "force"),
    "max_contact_pressure": ("largest contact pressure", "stress"),
    "max_slip": ("largest slip in a step", "length"),
    "max_plastic_strain": (r"largest plastic strain $|p|_F$", ""),
    "dissipation": ("energy dissipated in the step", "energy"),
    "elastic_energy": ("elastic energy", "energy"),
    "iterations": ("Newton steps", ""),
    "reaction": ("force of the supports", "force"),
    "applied_force": ("force of the loads", "force"),
    "contact_resultant": ("force of the obstacles", "force"),
}
"""Names for ``plot_curve`` -> words on an axis, and the unit; others stand as they are."""


@styled
def plot_curve(
    history: Evolution | Mapping[str, Evolution],
    x: Quantity = "time",
    y: Quantity = "contact_force",
    *,
    xlabel: str | None = None,
    ylabel: str | None = None,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """One quantity of a load history over another one: a force-displacement curve, for example.

    Parameters
    ----------
    history
        A result of ``evolve``, or label -> result.
    x, y
        A column of the history: 'time', 'contact_force', 'max_contact_pressure', 'dissipation',
        ...; a component of a vector, 'reaction_y', of one support 'reaction_y:bottom'; a function
        of the ``Fields`` of a step; or one number for each step.
    xlabel, ylabel
        Words on the axes; by default those of the quantity.
    units, axes
        As in ``plot_field``.

    Returns
    -------
    Figure
        The curve, with a marker for each step.

    Raises
    ------
    TypeError, ValueError
        If a history is none or has no steps, or a quantity is unknown.
    """
    units = require_units("units", units)
    axes = require_axes(axes)
    histories = history if isinstance(history, Mapping) else {"": history}
    require_mapping("history", histories, "label -> what evolve returned")
    for name, words in {"xlabel": xlabel, "ylabel": ylabel}.items():
        if words is not None:
            require_text(name, words)
    columns = []
    for one in histories.values():
        if not isinstance(one, Evolution):
            needed = "what evolve returned, or label -> that, is needed"
            raise TypeError(f"history={in_words(history)}: {needed}")
        if not one.steps:
            raise ValueError("history has no finished step: at least one is needed")
        columns.append((quantity_of("x", one, x), quantity_of("y", one, y)))
    axes = new_picture(figsize=(5.2, 3.4)).subplots() if axes is None else axes
    for index, (label, points) in enumerate(zip(histories, columns, strict=True)):
        style = line_style(index, len(points[0]))
        axes.plot(*points, label=label or None, **style)
    problem = next(iter(histories.values())).problem
    axes.set_xlabel(words_for(x, problem, units) if xlabel is None else xlabel)
    axes.set_ylabel(words_for(y, problem, units) if ylabel is None else ylabel)
    if any(histories):
        axes.legend()
    return axes.figure


def quantity_of(argument: str, history: Evolution, quantity: Quantity) -> list[float]:
    """The numbers of a quantity, one for each step."""
    if callable(quantity):
        return [float(value) for value in history.values(quantity)]
    if not isinstance(quantity, str):
        needed = "numbers, one for each step, a name, or a function of the fields"
        require_sequence(argument, quantity, needed)
        numbers = [float(value) for value in quantity]
        if len(numbers) != len(history.steps):
            raise ValueError(
                f"{argument} has {counted(len(numbers), 'number')}: one for each of the "
                f"{counted(len(history.steps), 'step')} is needed"
            )
        return numbers
    name, _, support = quantity.partition(":")
    vector, _, letter = name.rpartition("_")
    axis = "xyz"[: history.problem.N].find(letter) if len(letter) == 1 else -1
    if support and vector == "reaction" and axis >= 0:
        return history.reactions(support)[:, axis].tolist()
    if axis >= 0 and vector in ("reaction", "applied_force", "contact_resultant"):
        return [force[axis] for force in history.column(vector)]
    record = vars(history.steps[0].record)
    numbers = [n for n, v in record.items() if isinstance(v, int | float)]
    if name not in numbers or support:
        raise ValueError(
            f"{argument}={quantity!r}: the quantities are {', '.join(numbers)}, components such as "
            "reaction_y, contact_resultant_x, reaction_y:bottom, and functions of the fields"
        )
    return history.column(name)


def words_for(quantity: Quantity, problem: Problem, names: UnitNames) -> str:
    """The label of an axis for a quantity of a history of this problem."""
    if not isinstance(quantity, str):
        return ""
    units = units_of(names, problem)
    name, _, support = quantity.partition(":")
    if name in WORDS:
        words, kind = WORDS[name]
        return f"{words} ({units[kind]})" if units.get(kind) else words
    vector, _, letter = name.rpartition("_")
    if vector not in WORDS:
        return name.replace("_", " ")
    words, kind = WORDS[vector]
    if support:
        words = words.replace("the supports", f"support '{support}'")
    direction = problem.kinematics.directions["xyz".index(letter)]
    words = f"{words}, component {direction}"
    return f"{words} ({units[kind]})" if units.get(kind) else words


@styled
def plot_counts(
    counts: Mapping[str, Mapping[int, int]],
    paper: Mapping[str, Mapping[int, int]] | None = None,
) -> Figure:
    """Newton steps over the number of nodes, with the paper's counts dashed beside them.

    Both are label (such as 'gamma = 1e4') -> number of nodes -> steps.
    """
    require_mapping("counts", counts, "label -> (number of nodes -> steps)")
    paper = require_instance(
        "paper", {} if paper is None else paper, Mapping, "a mapping or None"
    )
    for name, rows in (("counts", counts), ("paper", paper)):
        for label, row in rows.items():
            require_mapping(f"{name}[{label!r}]", row, "number of nodes -> steps")
            for nodes, steps in row.items():
                require_number(f"nodes in {name}[{label!r}]", nodes, 0, strict=True)
                require_number(f"steps in {name}[{label!r}]", steps, 0)
    figure = new_picture(figsize=(5.6, 3.6))
    axes = figure.subplots()
    for index, (label, row) in enumerate(counts.items()):
        style = line_style(index, len(row))
        printed = paper.get(label, {})
        axes.plot(list(row), list(row.values()), label=label, **style)
        style |= {"linestyle": "--", "markerfacecolor": "white", "alpha": 0.7}
        axes.plot(list(printed), list(printed.values()), **style)
    nodes = sorted({n for row in counts.values() for n in row})
    numbers = [n for row in (*counts.values(), *paper.values()) for n in row.values()]
    most = 1.3 * max(2, *numbers)
    ticks = [
        tick for tick in (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000) if tick <= most
    ]
    axes.set(xscale="log", xlabel="nodes of the mesh")
    axes.set_yscale("symlog", linthresh=1.0, linscale=0.3)
    axes.set(
        ylabel="Newton steps" + " (dashed: paper)" * bool(paper),
        ylim=(0, most),
        yticks=ticks,
    )
    axes.set_xticks(nodes, list(map(str, nodes)))
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
    units = require_units("units", units)
    axes = require_axes(axes)
    sources = sources_of("sources", sources)
    curves = [pressure_curves(source) for source in sources.values()]
    axes = new_picture(figsize=(5.6, 3.2)).subplots() if axes is None else axes
    for index, (label, parts) in enumerate(zip(sources, curves, strict=True)):
        colour = COLOURS[index % len(COLOURS)]
        for number, (s, pressure) in enumerate(parts):
            axes.plot(
                s, pressure, color=colour, label=None if number else label or None
            )
            axes.fill_between(s, pressure, color=colour, alpha=0.12, linewidth=0)
    axes.axhline(0.0, color=GUIDE, linewidth=0.6)
    axes.margins(x=0)
    if not any(np.any(line.get_ydata()) for line in axes.lines):  # no contact
        axes.set_ylim(0.0, 1.0)
    axes.set_xlabel(f"position along the contact boundary{units.of('length')}")
    axes.set_ylabel(f"contact pressure{units.of('stress')}")
    if any(sources):
        axes.legend()
    return axes.figure


def pressure_curves(source: object) -> list[tuple[np.ndarray, np.ndarray]]:
    """Arc length and contact pressure at the ends of the segments, for each connected curve."""
    fields = fields_of(source)
    if not fields.problem.touching_names:
        raise ValueError(
            "sources: a problem with a contact boundary is needed, one has none"
        )
    if fields.problem.N != 2:
        raise ValueError(
            "sources: bodies of dimension 2 are needed, one is 3D: plot_field(result, "
            "'contact_pressure') and show(result, 'contact_pressure') draw those"
        )
    corners = corners_of(
        fields, source.contact_pressure, "|".join(fields.problem.touching_names)
    )
    s, curves = arc_lengths(corners.points)
    along = np.argsort(s, axis=1)
    s, p = (np.take_along_axis(values, along, axis=1) for values in (s, corners.values))
    order = np.argsort(s[:, 0])
    parts = [order[curves[order] == curve] for curve in range(curves.max() + 1)]
    return [(s[part].ravel(), p[part].ravel()) for part in parts]


def arc_lengths(segments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Arc lengths at the ends of segments (n, 2, 2), and the connected curve of each segment.

    They are distances from a tip in the graph of the ends; closed curves are cut at one segment.
    """
    lengths = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)
    extent = np.ptp(segments) or 1.0
    places = np.round(segments.reshape(-1, 2) / extent, 9)
    known, ends = np.unique(places, axis=0, return_inverse=True)
    ends = ends.reshape(-1, 2)

    graph = csr_matrix((lengths, ends.T), shape=(len(known), len(known)))
    tree = minimum_spanning_tree(graph)
    curves = connected_components(graph)[1]
    joints = np.bincount(np.concatenate(tree.nonzero()), minlength=len(known))
    tips = [_least_of(joints, curves == curve) for curve in set(curves)]
    s = dijkstra(tree, directed=False, indices=tips, min_only=True)[ends]

    # where a closed curve is cut, the nearer end gets the length of the whole curve
    cut = np.flatnonzero(np.abs(s[:, 1] - s[:, 0]) > 1.5 * lengths)
    nearer = np.argmin(s[cut], axis=1)
    s[cut, nearer] = s[cut].max(axis=1) + lengths[cut]
    return s, curves[ends[:, 0]]


def _least_of(values: np.ndarray, chosen: np.ndarray) -> int:
    """The index of the smallest of the chosen values."""
    return np.flatnonzero(chosen)[np.argmin(values[chosen])]
