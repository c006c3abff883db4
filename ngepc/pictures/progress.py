"""Where a run stands: the active sets on the body beside residual norms and step lengths."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_attributes, require_instance, require_sequence
from ngepc.pictures.active_sets import plot_active_sets
from ngepc.pictures.curves import draw_runs
from ngepc.pictures.picture import Picture
from ngepc.results.outcome import History


def plot_progress(
    result: object,
    *,
    runs: Sequence[History] | None = None,
    tolerance: float | None = None,
    deformation_scale: float = 0.0,
) -> Figure:
    """The active sets on the body, residual norms and step lengths, for monitors.

    Parameters
    ----------
    result
        Any iterate: a result of a solver, or the snapshot of a record.
    runs
        Histories one after the other, such as those of a path; by default that of ``result``.
    tolerance
        Drawn as a line when given.
    deformation_scale
        Factor >= 0 on the displacement.
    """
    require_attributes("result", result, ("problem", "history", "yield_excess"), "a result")
    histories = [result.history] if runs is None else runs
    require_sequence("runs", histories, "histories")
    for number, history in enumerate(histories):
        require_instance(f"runs[{number}]", history, History, "a History")
    if tolerance is not None:
        require_number("tolerance", tolerance, 0, strict=True)
    require_number("deformation_scale", deformation_scale, 0.0)
    figure = Picture(figsize=(9.6, 3.0), layout="constrained")
    grid = figure.add_gridspec(1, 3, width_ratios=(1.2, 1.0, 1.0))
    three = result.problem.N == 3
    body = figure.add_subplot(grid[0], projection="3d" if three else None)
    plot_active_sets(result, deformation_scale=deformation_scale, axes=body)
    if three:
        body.set_axis_off()
    left, right = figure.add_subplot(grid[1]), figure.add_subplot(grid[2])
    draw_runs(left, right, histories, tolerance)
    return figure
