"""The committed results: their commands exist, their code is in the history, their numbers hold.

``make results`` makes them again (``tests/campaigns/remake.py``).
"""

import json
import math
import re
import shlex
import shutil
import subprocess

import pytest
from campaigns.__main__ import arguments
from campaigns.remake import HERE, RESULTS, TIMES, commands

from ngepc.cli.commands import STUDIES, given, parser
from ngepc.cli.work import study_class

COMMANDS = commands()
NAMES = sorted(COMMANDS)
MACHINE = re.compile(
    r"seconds|_s$|cpu|wall|memory|megabytes|mb$|ratio|load_average|^apart$"
)
"""Numbers that depend on the machine: times, memory and what is made of them."""

CHEAP = (
    "bounds",
    "cones",
    "equilibria",
    "fuzz",
    "hidden",
    "locking",
    "step42",
    "table1",
    "table3",
    "table3_c0.01",
    "table3_c0.3",
)
"""Results whose first cell is solved again, in a second or less."""


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
    assert work(name, tmp_path).name == name


def test_every_result_has_its_commit():
    without = {
        name
        for name in NAMES
        if not json.loads((RESULTS / f"{name}.json").read_text()).get("commit")
    }
    assert without == set()


@pytest.mark.parametrize("name", NAMES)
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
    return [name for name in names if not close(record[name], old[name])]


def close(new, old):
    """Numbers to 1e-6, or both at rounding; anything else is equal."""
    if isinstance(new, list | tuple):
        pairs = zip(new, old, strict=True)
        return len(new) == len(old) and all(close(a, b) for a, b in pairs)
    if isinstance(new, dict):
        return not differing(new, old)
    if isinstance(new, float) and old is None:
        return not math.isfinite(new)
    if isinstance(new, float) and not isinstance(old, str):
        return math.isclose(new, old, rel_tol=1e-6, abs_tol=1e-9)
    return new == old


def test_all_results_take_at_most_four_hours():
    if not TIMES.exists():
        pytest.skip("make results has not run whole yet")
    known = json.loads(TIMES.read_text())
    assert sum(entry["cpu_s"] for entry in known.values()) <= 4 * 3600
