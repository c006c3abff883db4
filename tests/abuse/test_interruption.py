"""Nothing lost: killed, interrupted, full disks, damaged files.

Commands run in children of this process; a child that is killed gets SIGKILL, no handler runs.
"""

import contextlib
import json
import logging
import math
import multiprocessing
import os
import shutil
import signal
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ngepc import (
    Coulomb,
    Curve,
    Material,
    Problem,
    Response,
    Schedule,
    Status,
    calibrate,
    confidence,
    contact_force_bracket,
    error_bound,
    lshape_problem,
    semismooth_newton,
    shakedown_load,
)
from ngepc.__main__ import main
from ngepc.cli.output import reporter
from ngepc.dual.path import PathOptions, follow_path
from ngepc.evolution.distance import bound_of_step
from ngepc.evolution.solver import evolve
from ngepc.geometries import block, lshape
from ngepc.local import solver
from ngepc.results import checkpoint, files, iteration
from ngepc.results.records import write_text
from ngepc.studies.counts import Table1
from ngepc.studies.shakedown_problems import bree_problem, bree_vertices

FORK = multiprocessing.get_context("fork" if sys.platform == "linux" else None)
pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="signals and limits of Linux"
)

TABLE = ["study", "table1", "--levels", "1", "--rows", "1e0,1e1,1e2"]
PATH = ["path", "lshape", "--nodes", "113", "--gamma-end", "1e4", "--growth", "4"]


def child(function, *arguments, **limits):
    """A forked process that runs ``function`` and exits with the number it returns."""

    def body():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        import resource

        for name, most in limits.items():
            resource.setrlimit(getattr(resource, name), (most, most))
        os._exit(int(function(*arguments) or 0))

    process = FORK.Process(target=body)
    process.start()
    return process


def logged(arguments, log):
    """Exit status of a command that writes its standard error to a file, line by line."""
    os.dup2(os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    sys.stderr = os.fdopen(2, "w", buffering=1)
    logging.root.handlers.clear()  # those of pytest
    code = main(arguments)
    sys.stderr.flush()
    return code


def finished(process, timeout=120):
    process.join(timeout)
    return process.exitcode


def cells(folder):
    """The numbers of a finished table that may not depend on interruptions."""
    records = json.loads((folder / "table1.json").read_text())["cells"]
    return [
        (r["row"], r["nodes"], r["iterations"], r["status"], r["dual_energy"])
        for r in records
    ]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    assert main([*TABLE, "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def whole_path(tmp_path_factory):
    target = tmp_path_factory.mktemp("path") / "path.json"
    assert main([*PATH, "--json", str(target)]) == 0
    return json.loads(target.read_text())


def assert_same_cells(ours, theirs):
    for one, other in zip(ours, theirs, strict=True):
        assert one[:-1] == other[:-1]
        assert one[-1] == pytest.approx(other[-1], rel=1e-12)


def assert_same_path(one, other):
    for key in ("gammas", "inner_iterations", "status"):
        assert one[key] == other[key]
    for key in (
        "path_values",
        "residual_norms",
        "dual_energy",
        "primal_energy",
        "contact_force",
    ):
        assert one[key] == pytest.approx(other[key], rel=1e-12)


# SIGKILL


def test_table_killed_at_random_moments_resumes_with_the_same_digits(
    uninterrupted, tmp_path
):
    random = np.random.default_rng(1)
    arguments, kills, patience = [*TABLE, "--out", str(tmp_path)], 0, 0.6
    for _ in range(6):
        process = child(main, arguments)
        process.join(random.uniform(0.05, patience))
        if process.exitcode is None:
            process.kill()
            kills += 1
        if finished(process) == 0:
            if kills > 0:
                break
            patience /= 2  # a fast machine: nothing was interrupted, start again and kill sooner
            shutil.rmtree(tmp_path)
    assert kills > 0
    assert finished(child(main, arguments)) == 0
    assert_same_cells(cells(tmp_path), cells(uninterrupted))
    for cell in (uninterrupted / "cells").glob("*.npz"):
        ours, theirs = np.load(tmp_path / "cells" / cell.name), np.load(cell)
        assert str(ours["header"]) == str(theirs["header"])


def test_path_killed_at_random_moments_resumes_with_the_same_digits(
    whole_path, tmp_path
):
    random = np.random.default_rng(2)
    target, store = tmp_path / "path.json", tmp_path / "path.npz"
    arguments = [*PATH, "--checkpoint", str(store), "--json", str(target)]
    for _ in range(6):
        process = child(main, arguments)
        process.join(random.uniform(0.05, 0.6))
        process.kill()
        finished(process)
    assert finished(child(main, arguments)) == 0
    assert_same_path(json.loads(target.read_text()), whole_path)


def killed_at(moment, number, arguments):
    """Run a command that kills itself at the n-th moment: 'fsync', 'replace' or 'replaced'."""
    count, fsync, replace = [0], os.fsync, Path.replace

    def die_if_it_is_time():
        count[0] += 1
        if count[0] == number:
            os.kill(os.getpid(), signal.SIGKILL)

    def fsync_(handle):
        if moment == "fsync":
            die_if_it_is_time()
        fsync(handle)

    def replace_(self, target):
        if moment == "replace":
            die_if_it_is_time()
        replace(self, target)
        if moment == "replaced":
            die_if_it_is_time()

    os.fsync, Path.replace = fsync_, replace_
    return main(arguments)


@pytest.mark.parametrize("moment", ["fsync", "replace", "replaced"])
def test_path_killed_while_it_writes_resumes(whole_path, tmp_path, moment):
    target, store = tmp_path / "path.json", tmp_path / "path.npz"
    arguments = [*PATH, "--checkpoint", str(store), "--json", str(target)]
    for number in (5, 4, 3) if moment == "fsync" else (3, 2, 1):
        assert finished(child(killed_at, moment, number, arguments)) == -signal.SIGKILL
        assert not target.exists()
    assert finished(child(main, arguments)) == 0
    assert_same_path(json.loads(target.read_text()), whole_path)


def bar_history(store, kill_after=None):
    """Four steps of a bar with a checkpoint; SIGKILL in the monitor of one step."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
    )
    problem = Problem(mesh, material, contact="contact", gap=0.002)
    steps = [
        (float(t), {"traction": {"left": (0.0, 2.0 * s)}})
        for t, s in enumerate((1, 3, 1, -2))
    ]

    def monitor(step):
        if kill_after is not None and step.record.time == kill_after:
            os.kill(os.getpid(), signal.SIGKILL)

    return evolve(problem, steps, checkpoint=store, monitor=monitor)


def test_history_killed_after_every_step_resumes_with_the_same_digits(tmp_path):
    whole = bar_history(None)
    store = tmp_path / "history.npz"
    for time_of_death in (0.0, 1.0, 2.0):
        assert finished(child(bar_history, store, time_of_death)) == -signal.SIGKILL
    resumed = bar_history(store)
    assert len(resumed.steps) == len(whole.steps) == 4
    for a, b in zip(resumed.steps, whole.steps, strict=True):
        ours, theirs = (s.fields.displacement.vec.FV().NumPy() for s in (a, b))
        assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max()


def test_killed_writer_leaves_the_old_file_or_the_new_one(tmp_path):
    """Fifteen kills of a process that rewrites one file again and again."""
    target = tmp_path / "numbers.txt"

    def rewrite():
        for n in range(10**6):
            write_text(target, f"{n % 10}" * 200_000)

    random = np.random.default_rng(3)
    sizes = set()
    write_text(target, "0" * 200_000)
    for _ in range(15):
        process = child(rewrite)
        time.sleep(random.uniform(0.005, 0.05))
        process.kill()
        process.join()
        text = target.read_text()
        sizes.add(len(text))
        assert len(set(text)) == 1
    assert sizes == {200_000}


# Ctrl-C


def interrupted_at(line, arguments, log):
    """Run ``ngepc --verbose`` and send SIGINT once a line with ``line`` has been logged."""
    log.touch()
    process = child(logged, ["--verbose", *arguments], log)
    deadline = time.monotonic() + 100
    while line not in log.read_text() and time.monotonic() < deadline:
        assert process.is_alive(), log.read_text()
        time.sleep(0.005)
    os.kill(process.pid, signal.SIGINT)
    return finished(process)


def test_ctrl_c_writes_the_state_of_a_solve(tmp_path):
    target = tmp_path / "result.json"
    arguments = [
        "solve",
        "lshape",
        "--nodes",
        "833",
        "--gamma",
        "1e6",
        "--json",
        str(target),
    ]
    assert interrupted_at("it:   3", arguments, tmp_path / "log") == 130
    record = json.loads(target.read_text())
    assert record["status"] == "stopped"
    assert record["iterations"] >= 3
    assert math.isfinite(record["dual_energy"])
    assert len(record["residual_norms"]) in (
        record["iterations"] + 1,
        record["iterations"] + 2,
    )


def test_ctrl_c_ends_a_study_between_cells_and_a_rerun_completes_it(
    uninterrupted, tmp_path
):
    """A cell that was stopped half-way (the last one, 1e2) is not kept as if it were finished."""
    study = [
        "study",
        "table1",
        "--levels",
        "1",
        "--rows",
        "1e0,1e2",
        "--out",
        str(tmp_path / "cut"),
    ]
    log = tmp_path / "log"
    assert interrupted_at("row 1e0, nodes", study, log) == 130
    assert "ngepc study: interrupted" in log.read_text()
    assert "Traceback" not in log.read_text()
    assert main(study) == 0
    whole = [cell for cell in cells(uninterrupted) if cell[0] in ("1e0", "1e2")]
    assert_same_cells(cells(tmp_path / "cut"), whole)


def test_ctrl_c_that_gets_lost_ends_the_study_at_its_next_line(tmp_path, monkeypatch):
    """The bindings clear an exception raised while they convert arguments; here a test does."""
    progress, tell = [], reporter(quiet=False)

    def swallowing(line):
        progress.append(line)
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        tell(line)

    monkeypatch.setattr("ngepc.cli.work.reporter", lambda quiet: swallowing)
    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        arguments = ["study", "table1", "--levels", "1", "--rows", "1e0,1e1"]
        assert main([*arguments, "--out", str(tmp_path)]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(progress) == 1


def test_series_of_runs_ends_with_the_run_that_was_stopped():
    problem = lshape_problem(lshape.paper_mesh(113))

    def stop(record):
        raise KeyboardInterrupt

    stopped = semismooth_newton(problem, 1.0, monitor=stop)
    assert stopped.status is Status.STOPPED
    with pytest.raises(KeyboardInterrupt):
        stopped.or_interrupted()
    done = semismooth_newton(problem, 1.0)
    assert done.or_interrupted() is done


METAL = Material.metal(young=1e3, poisson=0.3, yield_stress=5.0, plastic_modulus=100.0)


def square(n=2, **given):
    """A square of triangles, or a cube of tetrahedra, that is pulled."""
    dimension = given.pop("dimension", 2)
    mesh = block.structured_mesh(*(n,) * dimension, simplices=True)
    load = {"right": (3.0, *(0.0,) * (dimension - 1))}
    return Problem(mesh, METAL, traction=load, **given)


def solved(**given):
    return semismooth_newton(square(**given))


PRESSED = {"contact": "contact", "gap": -0.01}
INNER = {
    "confidence": lambda: partial(confidence, solved(**PRESSED, friction=Coulomb(0.3))),
    "contact_force_bracket": lambda: partial(contact_force_bracket, solved(**PRESSED)),
    "error_bound": lambda: partial(error_bound, solved(dimension=3, order=2)),
    "Response": lambda: partial(
        Response(square(**PRESSED), "contact_force", ["hardening"]), [100.0]
    ),
    "shakedown_load": lambda: partial(
        shakedown_load, bree_problem(), bree_vertices(0.8, 0.8)
    ),
    "calibrate": lambda: partial(
        calibrate,
        square(**PRESSED),
        Curve(Schedule([1.0], lambda t: {}), "contact_force", [1.0]),
        {"yield_stress": 4.0},
    ),
    "distance_bound": lambda: partial(
        bound_of_step, solved(order=1), square(order=1, body_force=(0.0, 1.0))
    ),
}


@pytest.mark.parametrize("name", INNER)
def test_ctrl_c_in_a_solve_inside_of_something_ends_that(name, monkeypatch):
    """It was lost, became one of many failures, or a SolverError, which loops catch."""
    call = INNER[name]()

    def pressed(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(iteration, "newton_step", pressed)
    with pytest.raises(KeyboardInterrupt):
        call()


def test_ctrl_c_while_contact_is_searched_stops_the_solve(monkeypatch):
    """The second run, with stiffer springs, is interrupted."""
    pin = Problem(
        block.structured_mesh(2, 2, simplices=True),
        METAL,
        None,
        springs={"right": (1e-6, 1e-6)},
        body_force=(0.0, -1.0),
        contact="clamped",
        gap=0.01,
    )
    runs = []
    run = solver.newton_iteration

    def pressed(record):
        raise KeyboardInterrupt

    def counted(*given, **named):
        runs.append(named["tangent"])
        if len(runs) == 2:
            named["monitor"] = pressed
        found = run(*given, **named)
        return replace(found, status=Status.STAGNATED) if len(runs) == 1 else found

    monkeypatch.setattr(solver, "newton_iteration", counted)
    assert semismooth_newton(pin).status is Status.STOPPED
    assert len(runs) == 2


def test_stopped_cell_is_not_stored(tmp_path, monkeypatch):
    solve = semismooth_newton

    def stopped(problem, gamma, start, options, _):
        def monitor(record):
            raise KeyboardInterrupt

        return solve(problem, gamma, start, options, monitor)

    monkeypatch.setattr("ngepc.studies.examples.semismooth_newton", stopped)
    with pytest.raises(KeyboardInterrupt):
        Table1(tmp_path, levels=1, rows=("1e0",)).run()
    assert list((tmp_path / "cells").glob("*.npz")) == []


# Full disks, missing folders


def one_line(text):
    lines = text.strip().splitlines()
    assert len(lines) == 1, text
    return lines[0]


def refused(arguments, log, **limits):
    """The one line on stderr of a command that ends with status 2 under resource limits."""

    assert finished(child(logged, arguments, log, **limits)) == 2, log.read_text()
    return one_line(log.read_text())


OUTPUTS = {
    "solve --json": ["solve", "lshape", "--nodes", "113", "--json", "{}/r.json"],
    "solve --save": ["solve", "lshape", "--nodes", "113", "--save", "{}/r.npz"],
    "solve --figures": ["solve", "lshape", "--nodes", "113", "--figures", "{}"],
    "path --json": [*PATH, "--json", "{}/r.json"],
    "path --checkpoint": [*PATH, "--checkpoint", "{}/r.npz"],
    "study table1": [*TABLE, "--out", "{}"],
    "study table2": ["study", "table2", "--levels", "1", "--out", "{}"],
    "study locking": ["study", "locking", "--levels", "1", "--out", "{}"],
}


def test_full_disk_is_an_error_before_the_work(tmp_path):
    """A limit on the size of files stands for the full disk."""
    for name, words in OUTPUTS.items():
        room = tmp_path / name.replace(" ", "-")
        room.mkdir()
        begin = time.perf_counter()
        line = refused(
            [word.format(room) for word in words], tmp_path / "log", RLIMIT_FSIZE=2048
        )
        assert "cannot be written: File too large" in line, name
        assert time.perf_counter() - begin < 20, name
        assert [p for p in room.rglob("*") if p.is_file()] == [], name


def test_what_cannot_be_written_is_named_and_not_a_temporary_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"file/page\.html cannot be written: "):
        write_text(tmp_path / "file" / "page.html", "")


def test_a_file_in_place_of_the_folder_is_an_error_before_the_work(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("precious")
    for name, words in OUTPUTS.items():
        line = refused(
            [word.format(blocked / "sub") for word in words], tmp_path / "log"
        )
        assert str(blocked) in line, name
        assert blocked.read_text() == "precious", name


def test_disk_that_fills_up_keeps_the_old_file_and_leaves_no_rubbish(tmp_path):
    target = tmp_path / "file"
    target.write_text("old")

    def write():
        with contextlib.suppress(OSError):
            write_text(target, "n" * 10_000)
            return 1
        return 0

    assert finished(child(write, RLIMIT_FSIZE=4096)) == 0
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_devices_are_written_and_never_replaced(tmp_path):
    """--json /dev/null must not turn the device into a file; /dev/full says that it is full."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = child(lambda: len(pipe.read_bytes()) != 5)
    files.check_writable(pipe)
    write_text(pipe, "hello")
    assert finished(reader) == 0
    assert pipe.is_fifo()
    for device in ("/dev/null", "/dev/full"):
        assert files.is_special(Path(device))
    write_text(Path("/dev/null"), "nothing")
    with pytest.raises(OSError, match="No space left"):
        write_text(Path("/dev/full"), "too much")
    assert Path("/dev/null").is_char_device()
    assert Path("/dev/full").is_char_device()


# Damaged, foreign and older checkpoints


def small_path(store, **changes):
    options = {"gamma_start": 10.0, "gamma_end": 100.0, "growth": 10.0, **changes}
    return follow_path(
        lshape_problem(lshape.paper_mesh(33)), PathOptions(**options), checkpoint=store
    )


WORKS = {
    "path": small_path,
    "history": bar_history,
    "table": lambda store: Table1(store.parent.parent, levels=1, rows=("1e0",)).run(),
}


@pytest.fixture(scope="module", params=WORKS)
def work(request, tmp_path_factory):
    """A way to run some work again, its checkpoint file and the contents of that."""
    folder = tmp_path_factory.mktemp("work") / "cells"
    folder.mkdir()
    store = folder / ("table1-1e0-833.npz" if request.param == "table" else "work.npz")
    WORKS[request.param](store)
    return lambda: WORKS[request.param](store), store, store.read_bytes()


def damages(whole):
    """Files that are not the whole one: cut, flipped, empty, text, another archive."""
    middle = bytearray(whole)
    middle[len(whole) // 2] ^= 1
    header = bytearray(whole)
    header[header.find(b"fingerprint") + 40] ^= 2
    return {
        "cut": whole[: len(whole) // 2],
        "one byte short": whole[:-1],
        "one bit": bytes(middle),
        "a bit of the header": bytes(header),
        "empty": b"",
        "text": b"a letter to my grandmother",
    }


def test_damaged_checkpoint_is_refused_and_kept(work):
    rerun, store, whole = work
    for kind, damaged in damages(whole).items():
        store.write_bytes(damaged)
        with pytest.raises(ValueError, match="move it away"):
            rerun()
        assert store.read_bytes() == damaged, kind
    store.write_bytes(whole)
    rerun()


def test_foreign_and_older_checkpoints_are_refused_and_kept(work):
    rerun, store, whole = work
    checkpoint.save(store, {"kind": "another study"}, {"steps": []}, {"v": np.zeros(3)})
    foreign = store.read_bytes()
    with pytest.raises(ValueError, match="belongs to other work"):
        rerun()
    assert store.read_bytes() == foreign
    with np.load(store) as data:
        header, arrays = json.loads(str(data["header"])), {"v": data["v"]}
    header["format"] = 0
    np.savez(store, header=np.array(json.dumps(header)), **arrays)
    older = store.read_bytes()
    with pytest.raises(ValueError, match="has format 0"):
        rerun()
    assert store.read_bytes() == older
    store.write_bytes(whole)


def test_checkpoint_of_an_earlier_version_is_refused(tmp_path, monkeypatch):
    store = tmp_path / "path.npz"
    small_path(store)
    monkeypatch.setattr("ngepc.results.checkpoint.__version__", "99.0")
    with pytest.raises(ValueError, match="version differ"):
        small_path(store)


def test_every_flipped_bit_of_a_checkpoint_is_refused_or_harmless(tmp_path):
    """Whatever is accepted has the record and the arrays that were saved."""
    store = tmp_path / "c.npz"
    arrays = {"v": np.arange(40.0), "w": np.arange(6).reshape(2, 3)}
    checkpoint.save(store, {"a": 1}, {"x": [1.5]}, arrays)
    whole, refused_count = store.read_bytes(), 0
    for place in range(0, len(whole), 3):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << (place % 8)
        store.write_bytes(bytes(flipped))
        try:
            back = checkpoint.load(store, {"a": 1})
        except ValueError:
            refused_count += 1
            continue
        assert back.record == {"x": [1.5]}
        assert set(back.arrays) == {"v", "w"}
        for name, array in arrays.items():
            assert (back.arrays[name] == array).all()
    assert refused_count > 0.7 * len(whole) / 3


def test_changed_options_are_other_work(tmp_path):
    store = tmp_path / "path.npz"
    small_path(store)
    with pytest.raises(ValueError, match="growth differ"):
        small_path(store, growth=5.0)
