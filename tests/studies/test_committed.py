"""The committed results: their commands exist, their code is in the history, their numbers hold.

``make results`` makes them again (``tests/campaigns/remake.py``).
"""

import json
import math
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from campaigns import remake
from campaigns.__main__ import arguments
from campaigns.remake import HERE, RESULTS, TIMES, commands, sources, times, waiting

from ngepc.cli.commands import STUDIES, given, parser
from ngepc.cli.work import study_class
from ngepc.studies.work import PACKAGE

COMMANDS = commands()
NAMES = sorted(COMMANDS)
MACHINE = re.compile(
    r"seconds|_s$|cpu|wall|memory|megabytes|mb$|ratio|load_average|^apart$|^of_solve$"
    r"|^of_both$|^messages?$"
)
"""Numbers that depend on the machine (times, memory and what is made of them), and sentences."""

STOPPED = {"effectivity": 1e-3, "reference": 1e-3}
"""Numbers with bounds whose conjugate gradients stop when a step gains little, and their precision.

The last step depends on rounding: with the kernels of OpenBLAS for other processors these two
differed by 7e-5 and 2e-5.
"""

LONG = {
    "accuracy": "five meshes by each of two programs",
    "cost": "processes of their own, whose times are measured",
    "cubes": "a reference on adaptive tetrahedra",
    "derivatives": "twenty solves",
    "duality": "a path to gamma = 1e6",
    "figure4": "solves to rounding at each gamma",
    "figures": "a path on a fine mesh",
    "foreign": "files of other projects are needed",
    "large": "PETSc is needed",
    "mutants": "the tests of each fault",
    "processes": "PETSc is needed",
    "table3_c0.01": "paths like those of table3",
    "table3_c0.3": "paths like those of table3",
    "order_two/large": "PETSc is needed",
    "order_two/processes": "PETSc is needed",
    "order_two_large/processes": "PETSc is needed",
    "two_processes/processes": "PETSc is needed",
    "verdicts": "limits on many meshes",
    "without_tichonov": "paths that stall",
}
"""Results whose first cell is not solved again, with the reason."""

CHEAP = [name for name in NAMES if name not in LONG]
"""Results whose first cell is solved again, in about a second or less."""


def words(name):
    """The words of a recorded command, without the program."""
    command = COMMANDS[name].removeprefix("python -m ")
    return shlex.split(command)[1:]


def work(name, folder):
    """The study or campaign that a recorded command runs."""
    if "campaigns" in COMMANDS[name]:
        told = arguments().parse_args(words(name))
        options = {key: getattr(told, key) for key in told.options}
        return told.kind(folder, **options)
    told = parser().parse_args(words(name))
    chosen = STUDIES[told.study]
    return study_class(chosen)(folder, **given(told, chosen.options))


@pytest.mark.parametrize("name", NAMES)
def test_the_command_exists(name, tmp_path):
    assert work(name, tmp_path).name == Path(name).name
    assert Path(words(name)[words(name).index("--out") + 1]) == folder_of(name)


def folder_of(name):
    """The folder of a result, from the folder of the project."""
    return Path("results", name).parent


@pytest.mark.parametrize("name", NAMES)
def test_it_is_there_as_table_numbers_and_records(name):
    for kind in ("md", "csv", "json"):
        assert (RESULTS / f"{name}.{kind}").is_file()


def test_every_committed_file_belongs_to_a_result():
    """Tables by their names; a picture has a record with its name, or the name of its study."""
    git = shutil.which("git")
    if git is None or not (HERE / ".git").exists():
        pytest.skip("no list of the committed files here")
    asked = [git, "-C", str(RESULTS), "ls-files"]
    listed = subprocess.run(asked, capture_output=True, text=True).stdout.split()
    known = {f"{name}.{kind}" for name in NAMES for kind in ("md", "csv", "json")}
    left = [name for name in listed if name not in {*known, TIMES.name}]
    assert [name for name in left if not is_picture(name)] == []


def is_picture(name):
    """Whether a study draws a file: it is named like the study, or in one of its records."""
    stem = Path(name).stem
    alike = any(stem == study or stem.startswith(f"{study}_") for study in NAMES)
    named = any(name == record.get("file") for record in drawn_records())
    return name.endswith(".png") and (alike or named)


def drawn_records():
    """The records of all studies whose pictures are named in them."""
    for study in ("benchmarks", "figures"):
        yield from json.loads((RESULTS / f"{study}.json").read_text())["cells"]


def test_every_result_has_its_commit():
    without = {
        name
        for name in NAMES
        if not json.loads((RESULTS / f"{name}.json").read_text()).get("commit")
    }
    assert not without


@pytest.mark.parametrize("name", sorted(NAMES))
def test_the_code_is_in_the_history(name):
    git = shutil.which("git")
    if git is None or not (HERE / ".git").exists():
        pytest.skip("no history here")
    asked = [git, "-C", str(HERE), "rev-parse", "--is-shallow-repository"]
    if subprocess.run(asked, capture_output=True, text=True).stdout.strip() == "true":
        pytest.skip("the history is not complete here")
    made_by = json.loads((RESULTS / f"{name}.json").read_text())["commit"].rstrip("+")
    is_older = [git, "-C", str(HERE), "merge-base", "--is-ancestor", made_by, "HEAD"]
    assert subprocess.run(is_older, capture_output=True).returncode == 0, made_by


@pytest.mark.parametrize("name", CHEAP)
def test_the_first_numbers_are_those_of_this_code(name, tmp_path):
    study = work(name, tmp_path)
    cell = study.cells()[0]
    found = study.kept(cell)
    committed = json.loads((RESULTS / f"{name}.json").read_text())["cells"]
    for record in found:
        same = [old for old in committed if agrees(cell, old)]
        assert any(differing(record, old) == [] for old in same), (
            differing(record, same[0]) if same else cell
        )


def agrees(cell, record):
    """Whether a record is of a cell."""
    return all(
        json.loads(json.dumps(record.get(key))) == value for key, value in cell.items()
    )


def differing(record, old):
    """Names of numbers and words that differ, those of the machine left out."""
    names = [name for name in record if name in old and not MACHINE.search(name)]
    return [
        name
        for name in names
        if not close(record[name], old[name], STOPPED.get(name, 1e-6))
    ]


def close(new, old, precision=1e-6):
    """Numbers to a precision, or both at rounding; anything else is equal."""
    if isinstance(new, list | tuple):
        pairs = zip(new, old, strict=True)
        return len(new) == len(old) and all(close(a, b, precision) for a, b in pairs)
    if isinstance(new, dict):
        return not differing(new, old)
    if isinstance(new, float) and old is None:
        return not math.isfinite(new)
    if isinstance(new, float) and not isinstance(old, str):
        return math.isclose(new, old, rel_tol=precision, abs_tol=1e-9)
    return new == old


def test_all_results_take_at_most_four_hours():
    known = times()
    assert set(known) <= set(NAMES)
    if missing := set(NAMES) - set(known):
        pytest.skip(f"make results has not run for {', '.join(sorted(missing))}")
    assert sum(entry["cpu_s"] for entry in known.values()) <= 4 * 3600


def test_a_result_of_this_commit_is_up_to_date(monkeypatch):
    entry = {"finished": True, "commit": "HEAD", "cpu_s": 1.0}
    unfinished = {**entry, "finished": False}
    known = {
        "bounds": entry,
        "table1": unfinished,
        "table2": {**unfinished, "cpu_s": 0.5},
    }
    monkeypatch.setattr(remake, "times", lambda: known)
    monkeypatch.setattr(remake, "same_code", lambda name, entry: True)
    assert waiting(["bounds", "table1", "table2"]) == ["table2", "table1"]


BURNS = """
import pathlib, time
while time.process_time() < 0.5:
    pass
pathlib.Path({ready!r}).touch()
time.sleep(60)
"""


def interrupt_once(ready):
    """Ctrl-C as soon as the file is there."""
    while not ready.exists():
        time.sleep(0.01)
    ready.unlink()
    os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture
def interruptible():
    """Ctrl-C interrupts also what a shell has started in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
def test_attempts_that_are_interrupted_add_up(tmp_path, monkeypatch):
    """The CPU time of each is counted, though its command has not ended by itself."""
    ready = tmp_path / "ready"
    words = [sys.executable, "-c", BURNS.format(ready=str(ready))]
    monkeypatch.setattr(remake, "TIMES", tmp_path / "times.json")
    monkeypatch.setattr(remake, "program", lambda command: words)
    monkeypatch.setattr(remake, "same_code", lambda name, entry: True)
    spent = [0.0]
    for _ in range(2):
        Thread(target=interrupt_once, args=[ready], daemon=True).start()
        with pytest.raises(KeyboardInterrupt):
            remake.run("bounds")
        spent.append(remake.times()["bounds"]["cpu_s"])
    assert (np.diff(spent) > 0.4).all()  # stored to a tenth of a second


def test_a_campaign_is_made_with_its_module_and_the_package():
    assert sources("table3") == [PACKAGE]
    assert [path.name for path in sources("verdicts")] == ["ngepc", "intervals.py"]
    assert [path.name for path in sources("crossings")] == ["ngepc", "crossings.py"]
