"""Every option of every command with nonsense: exit status 2, one line that names it, no traceback.

The options are read from the parsers themselves, so that a new one is tried too.  What is refused
while parsing runs inside this process; what only the work can tell has its own table.
"""

import argparse
from functools import cache
from pathlib import Path

import pytest

from ngepc import __main__ as command_line
from ngepc.__main__ import main
from ngepc.cli.commands import COMMANDS, STUDIES, parser

NUMBERS = [
    "junk",
    "",
    "-1",
    "0",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "1,5",
    "0x10",
    "1e-400",
]
COUNTS = [*NUMBERS, "1.5", "two", "1e3"]


def options(command: argparse.ArgumentParser, path=()):
    """(path of commands, parser, action) for everything that can be given."""
    for action in command._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, sub in action.choices.items():
                yield from options(sub, (*path, name))
        elif not isinstance(action, argparse._HelpAction | argparse._VersionAction):
            yield path, command, action


def required(command):
    """Legal values of the positional arguments."""
    given = (a for a in command._actions if not a.option_strings)
    return [next(iter(a.choices)) if a.choices else "place" for a in given]


def nonsense(action):
    """Texts that an option must refuse while parsing."""
    if action.choices:
        return ["junk", "", next(iter(action.choices)).upper()]
    kind = getattr(action.type, "__name__", "text")
    tables = {"positive": NUMBERS, "count": COUNTS, "words": ["", ",", "a,,b"]}
    return {**tables, "counts": ["junk", "", "two", "1,", "0", "2,-3"]}.get(kind, [""])


CASES = [
    ([*path, *required(command), f"{option}={text}"], option)
    for path, command, action in options(parser())
    for option in action.option_strings
    if action.nargs != 0 and action.dest != "start"
    for text in nonsense(action)
]
CASES += [
    ([*path, *required(command), f"{option}=junk"], option)
    for path, command, action in options(parser())
    for option in action.option_strings
    if action.nargs == 0 and path
]
CASES += [
    ([*path, *required(command), option], option)
    for path, command, action in options(parser())
    for option in action.option_strings
    if action.nargs != 0
]
CASES += [
    ([*path, *required(command), "--unheard-of=1"], "--unheard-of")
    for path, command in {
        path: command for path, command, _ in options(parser())
    }.items()
    if path
]


def ends(arguments, capsys):
    """Exit status, standard output and the lines on standard error."""
    try:
        status = main(arguments)
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr()
    return status, captured.out, captured.err.splitlines()


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    """All cases are read by one parser, which takes longer to make than to read a line."""
    monkeypatch.setattr(command_line, "parser", cache(command_line.parser))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def failures(cases, capsys):
    """Commands that do not end with status 2 and one line that has a text: (command, lines)."""
    found = []
    for arguments, *texts in cases:
        status, out, lines = ends(arguments, capsys)
        said = len(lines) == 1 and all(text in lines[0] for text in texts)
        if (status, out) != (2, "") or not said:
            found.append((arguments, status, out, lines))
    return found


def test_nonsense_for_every_option(capsys, tmp_path):
    assert failures(((*case, ": error: ") for case in CASES), capsys) == []
    assert list(tmp_path.iterdir()) == []
    assert len(CASES) >= 600


def test_commands_that_are_none(capsys):
    bare = [command for command in COMMANDS if command != "lab"]  # it has an example
    texts = [
        "", "junk", " ", "SOLVE", *bare, "solve junk", "path Lshape", "study junk",
        "solve lshape wrench", "lab junk",
    ]  # fmt: skip
    words = [text.split() for text in texts]
    words += [
        [""],
        *([command, ""] for command in ("solve", "study", "notebooks", "report")),
    ]
    assert failures(((arguments, "error: ") for arguments in words), capsys) == []


WORK = {
    "no such port": (["lab", "--port", "65536", "--no-browser"], "port=65536"),
    "no such mesh": (["solve", "lshape", "--nodes", "800"], "nodes=800"),
    "too many nodes": (
        ["solve", "wrench", "--nodes", "99999999999"],
        "nodes=99999999999",
    ),
    "mesh too fine": (["solve", "lshape", "--maxh", "1e-9"], "maxh=1e-09"),
    "mesh width too small": (["path", "wrench", "--maxh", "1e-9"], "maxh=1e-09"),
    "tolerance below rounding": (
        ["solve", "lshape", "--tolerance", "1e-300"],
        "tolerance=1e-300",
    ),
    "no such start": (["solve", "lshape", "--start", "warm"], "--start warm"),
    "no run to start from": (
        ["solve", "lshape", "--start", "none.npz"],
        "--start none.npz",
    ),
    "gamma for the primal method": (
        ["solve", "lshape", "--method", "primal", "--gamma", "3"],
        "--gamma 3",
    ),
    "growth that does not grow": (["path", "lshape", "--growth", "1"], "growth=1.0"),
    "path backwards": (["path", "lshape", "--gamma-end", "1"], "gamma_end=1.0"),
    "both ends of a path": (
        ["path", "lshape", "--gamma-end", "100", "--residual-tolerance", "1"],
        "give one of them",
    ),
    "a mesh twice": (
        ["solve", "lshape", "--nodes", "833", "--maxh", "0.1"],
        "nodes=833 and maxh",
    ),
    "levels of table 1": (["study", "table1", "--levels", "7"], "levels=7"),
    "rows of table 1": (["study", "table1", "--rows", "junk"], "1e0"),
    "rows of table 2": (["study", "table2", "--rows", "1e0"], "rows"),
    "levels of table 2": (["study", "table2", "--levels", "99"], "levels=99"),
    "levels of table 3": (["study", "table3", "--levels", "99"], "levels=99"),
    "levels of figure 4": (["study", "figure4", "--levels", "99"], "levels=99"),
    "levels of step-42": (["study", "step42", "--levels", "99"], "levels=99"),
    "levels of counts": (["study", "counts", "--levels", "7"], "levels=7"),
    "levels of locking": (["study", "locking", "--levels", "5"], "levels=5"),
    "levels of cost": (["study", "cost", "--levels", "99"], "levels=99"),
    "nodes of a figure": (["study", "figures", "--lshape-nodes", "5"], "nodes=5"),
    "nodes of the gap": (["study", "duality", "--wrench-nodes", "5"], "nodes=5"),
    "nodes without a term": (["study", "without_tichonov", "--nodes", "5"], "nodes=5"),
    "levels of the norm gap": (
        ["study", "differentiability", "--levels", "99"],
        "levels=99",
    ),
    "a row of the benchmarks": (
        ["study", "benchmarks", "--rows", "junk"],
        "rows=['junk']",
    ),
    "no run to report": (["report", "none.npz"], "no such run"),
}


@pytest.mark.parametrize("command", ["solve", "path", "study", "report"])
def test_what_only_the_work_can_tell_is_told_first(command, capsys):
    cases = [
        (words, message) for words, message in WORK.values() if words[0] == command
    ]
    assert cases
    assert failures(cases, capsys) == []


def test_refused_work_leaves_no_folder(tmp_path, capsys):
    (tmp_path / "mine").mkdir()
    for words, _ in WORK.values():
        if words[0] == "study":
            for folder in ("new/results", "mine"):
                ends([*words, "--out", str(tmp_path / folder)], capsys)
            assert [path.name for path in tmp_path.iterdir()] == ["mine"], words


def test_refused_solve_leaves_no_folder(tmp_path, capsys):
    words = ["solve", "lshape", "--nodes", "5"]
    for option, place in (
        ("--json", "a/run.json"),
        ("--save", "b/c/run"),
        ("--figures", "d"),
    ):
        ends([*words, option, str(tmp_path / place)], capsys)
    assert list(tmp_path.iterdir()) == []


WRITERS = [
    *(["study", study, "--out"] for study in STUDIES),
    ["solve", "lshape", "--nodes", "24833", "--json"],
    ["solve", "lshape", "--nodes", "24833", "--save"],
    ["solve", "lshape", "--nodes", "24833", "--figures"],
    ["path", "lshape", "--nodes", "24833", "--json"],
    ["path", "lshape", "--nodes", "33", "--checkpoint"],
    ["notebooks"],
]


@pytest.mark.parametrize("place", ["file/below", "/proc/none/below"])
def test_results_that_cannot_be_written_are_refused_before_the_work(place, capsys):
    Path("file").write_text("x")
    cases = [([*writer, place], place.split("/")[-2]) for writer in WRITERS]
    assert failures(cases, capsys) == []
