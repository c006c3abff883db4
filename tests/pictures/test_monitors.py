"""Monitors see every record, stop runs on request, and draw what the history holds."""

import io

import pytest
from ngsolve import IfPos, Integrate

from ngepc import (
    PathOptions,
    Status,
    follow_path,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import lshape
from ngepc.pictures import monitors
from ngepc.pictures.monitors import LivePlotMonitor, live_plot_monitor
from ngepc.results.outcome import History, IterationRecord
from ngepc.results.progress import progress_line

RECORDS = [
    IterationRecord(iteration=k, residual_norm=10.0**-k, step_length=0.5**k, halvings=k)
    for k in range(4)
]


class Screen:
    """A notebook: keeps the figures that stand in each place."""

    def __init__(self):
        self.places, self.drawings = [], 0

    def __call__(self, figure):
        self.places.append(figure)
        self.drawings += 1
        return self

    def update(self, figure):
        self.places[-1] = figure
        self.drawings += 1


@pytest.fixture
def screen(monkeypatch):
    screen = Screen()
    monkeypatch.setattr(monitors, "_display", screen)
    return screen


@pytest.fixture(scope="module")
def problem():
    return lshape_problem(lshape.paper_mesh(113))


def test_solver_tells_monitors_the_history(problem):
    seen = []
    result = semismooth_newton(problem, 1e3, monitor=seen.append)
    assert seen == result.history.records


def test_stop_iteration_in_a_monitor_stops_the_run(problem):
    def stop(record):
        seen.append(record)
        if record.iteration == 2:
            raise StopIteration

    seen = []
    result = semismooth_newton(problem, 1e3, monitor=stop)
    assert result.status is Status.STOPPED
    assert [record.iteration for record in seen] == [0, 1, 2]


def test_library_writes_nothing_unasked(problem, capsys):
    semismooth_newton(problem, 10.0)
    with progress_line() as monitor:
        monitor(RECORDS[0])
    assert capsys.readouterr() == ("", "")


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_keeps_one_line_on_a_terminal_and_writes_nothing_to_a_file(
    monkeypatch,
):
    texts = []
    for stream in (io.StringIO(), Terminal()):
        monkeypatch.setattr("sys.stderr", stream)
        with progress_line("run") as monitor:
            for record in RECORDS:
                monitor(record)
            texts.append(stream.getvalue())
    nothing, text = texts
    assert "\n" not in text
    last = text.split("\r")[-1]
    assert all(
        word in last for word in ("run", "step 3", "1.00e-03", "in contact", "plastic")
    )
    assert nothing == ""


def test_live_plot_stays_in_one_place_and_ends_with_all_steps(screen):
    with live_plot_monitor(interval=3600.0) as monitor:
        for record in RECORDS:
            monitor(record)
        assert screen.drawings == 1
    assert len(screen.places) == 1
    residuals = screen.places[0].axes[0].lines[0]
    assert list(residuals.get_ydata()) == [1.0, 0.1, 0.01, 0.001]


def test_live_plot_draws_convergence_at_once(screen):
    monitor = live_plot_monitor(interval=3600.0, tolerance=0.05)
    for record in RECORDS[:3]:
        monitor(record)
    assert screen.drawings == 2


def test_live_plot_begins_anew_with_each_block_and_not_with_each_run(screen):
    monitor = live_plot_monitor(interval=0.0)
    with monitor:
        for record in [*RECORDS, *RECORDS[:2]]:
            monitor(record)
    assert monitor.runs == [History(RECORDS), History(RECORDS[:2])]
    first, second = screen.places[-1].axes[0].lines
    assert list(first.get_xdata()) == [0, 1, 2, 3]
    assert list(second.get_xdata()) == [3, 4]
    with monitor:
        monitor(RECORDS[0])
    assert monitor.runs == [History(RECORDS[:1])]
    assert len(screen.places) == 2


def test_live_plot_leaves_most_of_the_time_to_the_solver(screen, monkeypatch):
    clock = iter(range(1000))  # a step takes a second, so does a drawing
    monkeypatch.setattr(monitors.time, "monotonic", lambda: float(next(clock)))
    monitor = live_plot_monitor(interval=0.0)
    for k in range(40):
        monitor(IterationRecord(iteration=k, residual_norm=1.0))
    assert 8 <= screen.drawings <= 10


def paper(problem, monitor):
    return semismooth_newton(problem, 1e4, monitor=monitor)


def default(problem, monitor):
    return semismooth_newton(problem, monitor=monitor)


def primal(problem, monitor):
    return primal_newton(problem, monitor=monitor)


def path(problem, monitor):
    options = PathOptions(gamma_end=1e4)
    return follow_path(problem, options, newton_monitor=monitor).last


@pytest.mark.parametrize("solver", [paper, default, primal, path])
def test_snapshots_are_the_iterates_whenever_they_are_made(problem, solver):
    seen = []
    result = solver(problem, seen.append)
    for record in seen[1::4]:
        stopped = record.snapshot()
        assert stopped.status is Status.STOPPED
        assert stopped.history.records[-1] == record
        rounding = getattr(stopped, "residual_rounding", 1e-13)
        assert stopped.residual_norm == pytest.approx(
            record.residual_norm, rel=1e-6, abs=10 * rounding
        )
    last = seen[-1].snapshot()
    assert last.iterations == result.iterations
    assert last.contact_force == pytest.approx(result.contact_force, rel=1e-9)
    assert (last.displacement.vec - result.displacement.vec).Evaluate().Norm() < 1e-9


@pytest.mark.parametrize("solver", [paper, default, primal])
def test_zones_of_snapshots_have_the_measures_of_the_record(problem, solver):
    def compare(record):
        state, mesh = record.snapshot(), problem.mesh
        yields, pressed = (
            IfPos(f, 1.0, 0.0) for f in (state.yield_excess, state.contact_pressure)
        )
        plastic = Integrate(yields, mesh, order=20)
        assert plastic == pytest.approx(record.plastic_active, rel=0.03, abs=0.01)
        on_contact = mesh.Boundaries("contact")
        contact = Integrate(pressed, mesh, definedon=on_contact, order=20)
        assert abs(contact - record.contact_active) < 1.6 / 8

    history = solver(problem, compare).history
    assert 1e-3 < history.records[-1].plastic_active < 0.74
    assert 0.05 < history.records[-1].contact_active < 1.0


def test_records_are_numbers_in_tables_and_files(problem):
    result = semismooth_newton(problem, 10.0, monitor=lambda record: None)
    row = result.history.as_rows()[-1]
    assert IterationRecord(**row) == result.history.records[-1]
    assert all(isinstance(value, float | int) for value in row.values())
    assert result.history.records[-1].snapshot is None


@pytest.mark.parametrize("solver", [paper, default, primal, path])
def test_live_plot_shows_the_active_sets_on_the_body(problem, screen, solver):
    with live_plot_monitor() as monitor:
        result = solver(problem, monitor)
    body, residuals, steps = screen.places[-1].axes
    dark = (body.collections[0].get_array() > 0.5).mean() * 0.75  # the area of the body
    plastic = result.history.records[-1].plastic_active
    assert dark == pytest.approx(plastic, rel=0.02, abs=2e-3)
    contact = body.collections[-1].get_segments()
    length = sum(abs(segment[-1] - segment[0]).max() for segment in contact)
    assert 0 < length < 8 / 8
    assert len(residuals.lines) == len(monitor.runs)
    assert sum(len(line.get_xdata()) for line in steps.lines) == sum(
        len(run.step_lengths) for run in monitor.runs
    )


@pytest.mark.parametrize("solver", [paper, primal, path])
def test_interrupting_while_the_plot_is_drawn_keeps_the_state(problem, screen, solver):
    class Impatient(LivePlotMonitor):
        def draw(self):
            super().draw()
            if self.runs[-1].records[-1].iteration == 2:
                raise KeyboardInterrupt

    monitor = Impatient(tolerance=1e9)  # every step is drawn at once
    result = solver(problem, monitor)
    assert result.status is Status.STOPPED
    assert result.iterations == 2
    assert result.displacement.vec.Norm() > 0
    assert result.history == monitor.runs[-1]
