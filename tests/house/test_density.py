"""Code that is unpacked, and walks through the rooms that climb no more than they do today."""

import pytest
from density import densest, density, texts, tokens_of, words_of
from sources import ROOT, TOP_LEVEL
from walk import Walk, walks

FOLDERS = {path.parent.name for path in (ROOT / "ngepc").glob("*/*.py")}
ROOMS = sorted(FOLDERS - set(TOP_LEVEL))
MOST_PACKED = 0.5
"""Assignments ``a, b = x, y`` for 100 lines of code."""

LONGEST_MEAN = 40.0
"""Characters of a code line, in the mean over a room."""

MOST_TOKENS = 19.0
"""Tokens on a line of code, in the mean over a function of eight lines or more."""

AS_SHORT_AS_POSSIBLE = "ngepc.goals.check_receipt."
"""The checker of receipts, whose reader reads all of it: its lines are counted."""

MOST_CLIMBS = {"a load": 34, "a gamma": 1, "a bound": 6, "a gradient": 3}
"""Calls upwards: methods that a higher room defines for a class of a lower one, and callbacks."""


@pytest.fixture(scope="module")
def found():
    return {
        name: density(modules) for name, modules in texts().items() if name != "all"
    }


@pytest.mark.parametrize("room", ROOMS)
def test_code_is_unpacked(room, found):
    assert found[room].packed_per_100_lines <= MOST_PACKED
    assert found[room].mean_line <= LONGEST_MEAN


def test_density_of_a_function_is_seen():
    assert words_of("a = b[1] + c  # sum") == 8
    assert words_of('name = "two words"') == 3
    per_line, name = densest()[0]
    assert per_line > 15
    assert name.startswith("ngepc.")


def test_no_function_is_dense():
    dense = [
        f"{per_line:.1f} {name}"
        for per_line, name in densest()
        if per_line > MOST_TOKENS and not name.startswith(AS_SHORT_AS_POSSIBLE)
    ]
    assert dense == [], "one thing on a line, and a name for each step"


def test_climbs_do_not_increase():
    found = {name: len(walk.climbs) for name, walk in walks().items()}
    assert all(found[name] <= most for name, most in MOST_CLIMBS.items()), found


def test_packed_assignments_and_tokens_are_seen():
    text = '"""Two\nlines."""\na, b = 1, 2  # packed\nc = (1, 2)\n'
    found = density([text])
    assert (found.packed, found.lines) == (1, 2)
    assert tokens_of(text) == 7 + 7
    assert found.mean_line == pytest.approx((21 + 10) / 2)
    twice = density([text, text])
    assert (twice.packed, twice.lines) == (2, 4)


def test_every_room_is_counted_and_all_are_the_whole():
    found = texts()
    whole = found.pop("all")
    assert sorted(found) == ROOMS
    assert sorted(whole) == sorted(text for room in found.values() for text in room)


def test_stays_and_returns_are_seen():
    walk = Walk(lambda: None)
    walk.functions = dict(enumerate(["model", "linalg", "model", "model", "linalg"]))
    walk.pairs = {1: ("model", "model"), 2: ("linalg", "model")}
    assert walk.rooms == ["model", "linalg", "model", "linalg"]
    assert (walk.returns, walk.stays) == (2, 1)
