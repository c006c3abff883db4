"""Walks through the rooms: which functions of the package a call runs, and where they go up.

``python tests/house/walk.py`` prints a row for each of a load, a gamma, a bound and a gradient.

A function is counted once, where it is first called, and so is a pair of caller and called one.  A
pair that stays in its room is a stay; one that leaves it, but for a lower floor, is a climb.  In
the order of first calls, each time that a room is entered again is a return.
"""

import sys
from pathlib import Path

from test_rooms import FLOOR

import ngepc
from ngepc import error_bound, gradient, lshape_problem, semismooth_newton
from ngepc.geometries import lshape

PACKAGE = Path(ngepc.__file__).resolve().parent


def room_of(code):
    """The room of a function, None outside of the package."""
    path = Path(code.co_filename)
    if not path.is_relative_to(PACKAGE):
        return None
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 and parts[0] in FLOOR else None


class Walk:
    """The functions that a call runs, in the order of their first calls, and who calls whom."""

    def __init__(self, work):
        self.functions = {}
        self.pairs = {}
        before = sys.getprofile()
        sys.setprofile(self._see)
        try:
            work()
        finally:
            sys.setprofile(before)

    def _see(self, frame, event, argument):
        if event != "call":
            return
        here = room_of(frame.f_code)
        if here is None:
            return
        self.functions.setdefault(frame.f_code, here)
        outer = frame.f_back
        while outer is not None and room_of(outer.f_code) is None:
            outer = outer.f_back
        if outer is not None:
            pair = outer.f_code, frame.f_code
            self.pairs.setdefault(pair, (room_of(outer.f_code), here))

    @property
    def rooms(self):
        """The rooms in the order in which they are entered."""
        entered = []
        for here in self.functions.values():
            if not entered or entered[-1] != here:
                entered.append(here)
        return entered

    @property
    def stays(self):
        """Pairs inside a room."""
        return sum(a == b for a, b in self.pairs.values())

    @property
    def climbs(self):
        """(caller, called) where a call leaves a room, but not downwards."""
        return {
            (f"{a}.{outer.co_name}", f"{b}.{inner.co_name}")
            for (outer, inner), (a, b) in self.pairs.items()
            if a != b and FLOOR[b] >= FLOOR[a]
        }

    @property
    def returns(self):
        """How often a room is entered again."""
        return len(self.rooms) - len(set(self.rooms))


def walks():
    """Name -> walk of a load, a gamma, a bound and a gradient through a small L-shape."""
    problem = lshape_problem(lshape.paper_mesh(65))
    result = semismooth_newton(problem)
    return {
        "a load": Walk(lambda: semismooth_newton(problem)),
        "a gamma": Walk(lambda: semismooth_newton(problem, gamma=1e3)),
        "a bound": Walk(lambda: error_bound(result)),
        "a gradient": Walk(lambda: gradient(result, "contact_force", ["traction"])),
    }


if __name__ == "__main__":
    for name, walk in walks().items():
        numbers = len(walk.functions), len(set(walk.rooms)), walk.stays
        print(name, *numbers, len(walk.climbs), walk.returns)
        print("   ", sorted(walk.climbs))
