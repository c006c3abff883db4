"""Numbers and values in sentences: short, and what is an upper bound is rounded up."""

import math

import numpy as np
import pytest
from ngsolve import CF, x

from ngepc import Material, Norton, Problem, Tabulated
from ngepc.checks.arguments import require_number
from ngepc.checks.sentences import (
    at_most_percent,
    counted,
    in_percent,
    in_words,
    interval_in_words,
    outward,
)
from ngepc.geometries import block


@pytest.mark.parametrize(
    ("part", "nearest", "above"),
    [
        (1.94, "190 percent", "200 percent"),
        (0.0342, "3.4 percent", "3.5 percent"),
        (0.5, "50 percent", "50 percent"),
        (0.0, "0 percent", "1e-12 percent"),
        (270.0, "27000 percent", "27000 percent"),
        (math.inf, "inf percent", "inf percent"),
    ],
)
def test_two_digits_without_an_exponent(part, nearest, above):
    assert in_percent(part) == nearest
    assert at_most_percent(part) == above


def test_one_is_singular():
    assert [counted(n, "node") for n in range(3)] == ["0 nodes", "1 node", "2 nodes"]
    assert counted(1, "mesh", "meshes") == "1 mesh"
    assert counted(3, "mesh", "meshes") == "3 meshes"


def test_more_digits():
    assert in_percent(0.012345, 3) == "1.23 percent"
    assert at_most_percent(0.012345, 3) == "1.24 percent"


def test_a_printed_interval_contains_the_interval():
    lower, upper = outward(0.12345678, 5.1234511)
    assert (lower, upper) == ("0.123456", "5.12346")
    lower, upper = outward(-0.12345678, -1e-3)
    assert (lower, upper) == ("-0.123457", "-0.001")
    assert outward(-math.inf, math.inf) == ("-inf", "inf")


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ((2.7185, 2.795), "2.757 +- 1.4 percent (between 2.7185 and 2.795, proved)"),
        ((-4.0, -2.0), "-3 +- 34 percent (between -4 and -2, proved)"),
        ((-1.0, 2.0), "between -1 and 2 (proved)"),
        ((0.5, math.inf), "between 0.5 and inf (proved)"),
        ((1.0, 1.0), "1 +- 0 percent (between 1 and 1, proved)"),
    ],
)
def test_an_interval_is_a_number_and_its_deviation(ends, words):
    assert interval_in_words(*ends, "proved") == words


def test_a_material_is_shown_by_the_data_that_were_given():
    curve = [(0.001, 200.0), (0.003, 300.0), (0.01, 400.0)]
    metal = Material.cyclic(young=210e3, poisson=0.3, curve=curve)
    points = "[(0.001, 200.0), (0.003, 300.0), (0.01, 400.0)]"
    assert in_words(metal) == (
        f"Material.cyclic(young=210000.0, poisson=0.3, curve={points})"
    )
    assert in_words(metal.overlay) == (
        "Overlay(shares=(0.792, 0.148503), bounds=(163.299, 555.846))"
    )


def test_laws_have_six_digits_and_no_defaults():
    law = Tabulated([0.0, 1 / 3], [1.0, 2 / 3 + 1])
    assert in_words(law) == (
        "Tabulated(plastic_strain=(0.0, 0.333333), stress_there=(1.0, 1.66667))"
    )
    assert in_words(Norton(300.0, 5.0)) == "Norton(overstress=300.0, exponent=5.0)"
    plain = Material.kinematic(
        lame_lambda=1e3 / 3, lame_mu=1 + x, yield_stress=1.0, hardening=0.1
    )
    assert in_words(plain) == (
        "Material(lame_lambda=333.333, lame_mu=<coefficient>, yield_stress=1.0, "
        "hardening=0.1)"
    )


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (CF((x, 1)), "<coefficient>"),
        ({"top": CF(1.0)}, "{'top': <coefficient>}"),
        ([x, 1 / 3], "[<coefficient>, 0.333333]"),
        (block.structured_mesh(2, 2, simplices=True), "<mesh, 2D, 8 elements>"),
        (object(), "<object>"),
        (in_words, "<function in_words>"),
        (np.zeros((100, 3)), "array of shape (100, 3)"),
        (tuple(range(100)), f"({', '.join(map(str, range(12)))}, ... 100 in all)"),
        ((1.0,), "(1.0,)"),
        ("left", "'left'"),
        (1 / 3, "0.3333333333333333"),
        (np.float64(0.5), "0.5"),
    ],
    ids=lambda value: value if isinstance(value, str) else type(value).__name__,
)
def test_values_of_arguments_are_short_in_messages(value, words):
    assert in_words(value) == words


def test_a_problem_is_one_short_line():
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.metal(
        young=210e3, poisson=0.3, yield_stress=235.0, plastic_modulus=1e3
    )
    problem = Problem(mesh, metal, "left", pressure={"right": 1 / 3 * x})
    with pytest.raises(TypeError) as found:
        require_number("length", problem)
    assert "pressure={'right': <coefficient>}" in str(found.value)
    assert " at 0x" not in str(found.value)
