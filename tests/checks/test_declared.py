"""What a field declares in its hint is what it accepts: ranges from their ends, kept as checked."""

import math
from dataclasses import dataclass, fields

import numpy as np
import pytest
from ngsolve import x

from ngepc import Material
from ngepc.checks.declared import (
    Count,
    Datum,
    Declared,
    Flag,
    Fraction,
    Positive,
    Text,
    Vector,
    declared_checks,
)


@dataclass(frozen=True)
class Everything(Declared):
    part: Fraction = 0.5
    size: Positive = 1.0
    steps: Count = 1
    where: Vector = (0.0, 0.0)
    name: Text = ""
    still: Flag = True
    value: Datum = 0.0
    whatever: object = None


ENDS = {
    "part": (
        [1e-9, 1 - 1e-9],
        [0, 1, -1, math.nan],
        "a finite number > 0 and < 1 is needed",
    ),
    "size": ([1e-300, 1e300], [0, -1, math.inf], "a finite number > 0 is needed"),
    "steps": ([1, 10**6], [0, -3], "an integer >= 1 is needed"),
    "where": ([(1, 2), (1, 2, 3)], [(1,), (1, 2, 3, 4)], "2 or 3 numbers are needed"),
}


@pytest.mark.parametrize("name", ENDS)
def test_ranges_end_where_they_say(name):
    legal, illegal, needed = ENDS[name]
    for value in legal:
        assert getattr(Everything(**{name: value}), name) == value
    for value in illegal:
        with pytest.raises(ValueError, match=f"{name}=.*{needed}"):
            Everything(**{name: value})


@pytest.mark.parametrize("value", [None, "1", 1j, True])
def test_other_types_are_refused_by_name(value):
    legal = {str: "name", bool: "still"}.get(type(value))
    for name in {*ENDS, "value", "name", "still"} - {legal}:
        with pytest.raises(TypeError, match=f"{name}="):
            Everything(**{name: value})


def test_values_are_kept_as_the_check_returns_them():
    made = Everything(size=np.float32(2), where=np.ones(2), steps=np.int64(3), value=x)
    assert (made.size, made.where, made.steps) == (2.0, (1.0, 1.0), 3)
    assert [type(v) for v in (made.size, made.where, made.steps)] == [float, tuple, int]
    assert made.value is x
    assert set(declared_checks(Everything)) == {f.name for f in fields(made)} - {
        "whatever"
    }


def test_a_range_is_said_in_the_hint():
    said = {name: repr(check) for name, check in declared_checks(Material).items()}
    assert said["lame_mu"] == "require_datum(least=0, strict=True)"
    assert said["lame_lambda"] == "require_datum()"
