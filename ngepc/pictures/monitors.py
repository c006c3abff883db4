"""Monitors: callables that see each ``IterationRecord`` while a solver runs.

Any function ``record -> None`` is a monitor.  If it raises StopIteration, the run ends with
Status.STOPPED and keeps the state.  ``record.snapshot()`` is the result of a run that stopped at
that iterate; it costs nothing until it is called.  The monitor here draws the run; a line of
progress is in ``results.progress``.
"""

import time
from dataclasses import replace

from matplotlib.figure import Figure

from ngepc._deprecated import old_names
from ngepc.checks.arguments import require_number
from ngepc.pictures.curves import draw_runs
from ngepc.pictures.fields import plot_active_sets
from ngepc.pictures.style import Picture, line_style, styled
from ngepc.results.outcome import History, IterationRecord


class LivePlotMonitor:
    """A figure that grows while the solver runs, for notebooks: active sets, residuals, steps.

    A run that begins while the monitor is in use goes on where the last one ended, so that as
    ``newton_monitor`` of ``follow_path`` it shows the whole path; ``with`` begins anew, and draws
    the last step at its end.  ``runs`` are the histories of the runs seen.

    Parameters
    ----------
    interval
        Least time between two drawings (seconds); drawing takes a fifth of the time at most.
    tolerance
        Drawn as a line; the step that falls below it is drawn at once.
    """

    def __init__(self, interval: float = 0.3, tolerance: float | None = None) -> None:
        self.interval = require_number("interval", interval, 0.0)
        if tolerance is not None:
            require_number("tolerance", tolerance, 0, strict=True)
        self.tolerance = tolerance
        self.__enter__()

    def __call__(self, record: IterationRecord) -> None:
        """Add a step, and draw if the last drawing is old enough."""
        if record.iteration == 0:
            self.runs.append(History())
        self.runs[-1].records.append(replace(record, snapshot=None))
        self._last = record
        done = self.tolerance is not None and record.residual_norm < self.tolerance
        if done or time.monotonic() >= self._next:
            self.draw()

    @styled
    def draw(self) -> None:
        """Show the active sets, if the record has them, and the runs, in one place."""
        begin = time.monotonic()
        snapshot = self._last.snapshot
        widths = (1.0, 1.0) if snapshot is None else (1.2, 1.0, 1.0)
        figure = Picture(figsize=(3 * sum(widths), 3.0))
        *body, left, right = figure.subplots(1, len(widths), width_ratios=widths)
        if snapshot is not None:
            plot_active_sets(snapshot(), axes=body[0])
        drawn = []
        first = 0
        for run in self.runs:  # one after the other, the newest in colour
            style = {} if run is self.runs[-1] else {"color": "#a7b0b9"}
            drawn.append((run, first, line_style(0, len(run.records)) | style))
            first += len(run.step_lengths)
        draw_runs((left, right), drawn, self.tolerance)
        if self._handle is None:
            self._handle = _display(figure)
        else:
            self._handle.update(figure)
        end = time.monotonic()
        self._next = end + max(self.interval, 4 * (end - begin))

    def __enter__(self) -> "LivePlotMonitor":
        """The monitor itself, without records."""
        self.runs: list[History] = []
        self._last = None
        self._handle = None
        self._next = float("-inf")
        return self

    def __exit__(self, *_: object) -> None:
        """Draw the last step and release its iterate."""
        if self._last is not None:
            self.draw()
            self._last = None


live_plot_monitor = LivePlotMonitor


def _display(figure: Figure) -> object:
    """Show a figure in the running notebook; returns the handle that updates it."""
    try:
        from IPython.display import display
    except ImportError as error:
        raise ImportError('live figures need: pip install "ngepc[notebook]"') from error
    return display(figure, display_id=True)


__getattr__ = old_names(__name__)
