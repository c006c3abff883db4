"""A picture of the interval of a force or displacement, mesh by mesh."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure

import ngepc.pictures.style as style
from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.goals.refinement import BoundedResult
from ngepc.pictures.collapse import axes_or_new
from ngepc.pictures.style import COLOURS, styled


@styled
def plot_interval(
    run: BoundedResult, limit: float | None = None, *, axes: Axes | None = None
) -> Figure:
    """The interval of a goal over the number of nodes, mesh by mesh.

    Parameters
    ----------
    run
        A result of ``solve_to(problem, goal=...)``, or the ``run`` of a verdict.
    limit
        A number that the goal is compared with.
    axes
        Axes to draw into; by default those of a new figure.

    Returns
    -------
    Figure
        The figure, also when ``axes`` were given.

    Raises
    ------
    TypeError, ValueError
        For another object, and for a run without a goal.
    """
    require_instance("run", run, BoundedResult, "the result of solve_to with a goal")
    if run.goal is None:
        raise ValueError(f"run={in_words(run)}: a run with a goal is needed")
    if limit is not None:
        require_number("limit", limit)
    axes = axes_or_new(axes, (4.8, 3.6))
    records = [record for record in run.records if math.isfinite(record.lower)]
    nodes = [record.nodes for record in records]
    lower = [record.lower for record in records]
    upper = [record.upper for record in records]
    axes.fill_between(nodes, lower, upper, color=style.ELASTIC)
    axes.plot(nodes, upper, "v-", color=COLOURS[0], label="no more than this")
    axes.plot(nodes, lower, "^-", color=COLOURS[1], label="no less than this")
    if limit is not None:
        label = f"limit {limit:.5g}"
        axes.axhline(limit, color=style.GUIDE, linewidth=0.8, label=label)
    style.counts_along(axes, "nodes")
    axes.set_ylabel(run.goal.name)
    axes.legend()
    return axes.figure
