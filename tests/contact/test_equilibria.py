"""Random blocks with friction on few rows, beside an enumeration of all contact states."""

from dataclasses import replace
from functools import cache

import pytest
from campaigns.equilibria import LAWS, judged, random_problem
from ngsolve import sin, x

from ngepc import Coulomb, Material, Problem, Status, semismooth_newton
from ngepc.geometries import block


@pytest.mark.parametrize(("law", "seed"), list(zip(LAWS, (3, 8, 3), strict=True)))
def test_statuses_say_how_many_equilibria_there_are(law, seed):
    """A problem of each law; the campaign of equilibria judges hundreds."""
    wrong, _ = judged(random_problem(seed, law))
    assert wrong == []


def test_several_equilibria_are_not_missed():
    wrong, count = judged(random_problem(53, "Coulomb"))
    assert count == 3
    assert wrong == []


def block_on_five_rows():
    """It has three equilibria; one start found one of them and called it converged."""
    nu = 0.49
    metal = Material.kinematic(
        lame_lambda=2 * nu / (1 - 2 * nu), lame_mu=1.0, yield_stress=1e6, hardening=1.0
    )
    return Problem(
        block.structured_mesh(4, 8, size=(1, 2.0), simplices=True),
        metal,
        "clamped",
        {"right": (0.000961, -0.00010294)},
        "contact",
        -0.000877 + 0.000582 * sin(5 * x + 4.72),
        friction=Coulomb(2.748),
        body_force=(0.00241326, -0.00100887),
        order=1,
    )


@cache
def cold(order):
    """The result from a cold start."""
    return semismooth_newton(replace(block_on_five_rows(), order=order))


@pytest.mark.parametrize("factor", [0.5, 0.8, 1.25, 2.0])
def test_three_equilibria_whatever_the_start(factor):
    problem = cold(1).problem
    near = semismooth_newton(replace(problem, friction=Coulomb(2.748 * factor)))
    assert cold(1).status is Status.NOT_UNIQUE
    assert semismooth_newton(problem, start=near).status is Status.NOT_UNIQUE


@pytest.mark.parametrize(
    ("moved", "order"), [(-0.01, 1), (-0.001, 1), (0.01, 1), (-0.001, 2)]
)
def test_a_start_under_another_gap_does_no_harm(order, moved):
    """Its contact forces led nowhere for a gap that is smaller by 0.001."""
    problem = cold(order).problem
    other = semismooth_newton(replace(problem, gap=problem.gap + moved))
    warm = semismooth_newton(problem, start=other)
    assert cold(order).status is Status.NOT_UNIQUE
    assert warm.status is cold(order).status
