"""What is known from samples is said, and obstacles between nodes are found."""

import pytest
from ngsolve import CF, BSpline, IfPos, exp, sin, sqrt, x, y

from ngepc import Coulomb, Material, Problem, semismooth_newton
from ngepc.discretisation.sampled import sampled_data, what_is_unseen
from ngepc.geometries import block

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1e3
)
SPLINE = BSpline(2, [-1, -1, 0, 1, 2, 2], [0.0, 1.0, 1.4, 1.8, 2.0])
HALF = 0.004
"""Half of the width of a spike, a sixtieth of a facet."""


def problem(**data):
    return Problem(block.structured_mesh(4, 4, simplices=True), MATERIAL, **data)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"body_force": (0, sin(x))}, "body_force (at 1/96 of each edge"),
        ({"traction": {"contact": (0, sin(x))}}, "traction (at 1/128 of each edge"),
        ({"pressure": {"contact": sin(x)}}, "pressure (at 1/128 of each edge"),
        ({"contact": "contact", "gap": SPLINE(x)}, "gap (at 1/128 of each edge"),
        (
            {"contact": "contact", "gap": 0.1, "friction": Coulomb(1 / (1 + x))},
            "friction (at nodes)",
        ),
        ({"initial_strain": 1e-3 * sin(y)}, "initial_strain (at 1/48 of each edge"),
        ({"springs": {"right": 10 + sin(y)}}, "springs (at integration points)"),
    ],
)
def test_what_is_sampled_is_said(data, said):
    found = problem(**data)
    assert sampled_data(found) == [said.partition(" ")[0]]
    assert said in what_is_unseen(found)
    assert said in semismooth_newton(found).message


def test_polynomials_need_no_words():
    load = {"contact": (0.0, -1.0 - x * y)}
    found = problem(traction=load, body_force=CF((x, 2.0)))
    assert what_is_unseen(found) == ""
    assert semismooth_newton(found).message == ""


@pytest.mark.parametrize("kind", ["kinematic", "isotropic", "mixed"])
def test_materials_of_parts_need_no_words(kind):
    """Their hardening has quotients of numbers that are constant in each part."""
    mesh = block.structured_mesh(4, 4, simplices=True)
    share = {"kinematic_share": 0.5} if kind == "mixed" else {}
    metal = Material.metal(
        young=mesh.MaterialCF({".*": 2.5e3}),
        poisson=0.25,
        yield_stress=mesh.MaterialCF({".*": 5.0}),
        tangent_modulus=150.0,
        kind=kind,
        **share,
    )
    assert what_is_unseen(Problem(mesh, metal, pressure={"contact": 1.0})) == ""


@pytest.mark.parametrize("gap", [sqrt(1 + x), 0.1 * sin(3 * x), 1 / (1 + x)])
def test_formulas_of_gaps_need_no_words(gap):
    found = problem(contact="contact", gap=gap)
    assert sampled_data(found) == []
    assert "samples" not in semismooth_newton(found).message


def test_bounds_of_bodies_of_revolution_need_polynomials():
    data = {"contact": "contact", "gap": sqrt(1 + x)}
    assert sampled_data(problem(kinematics="axisymmetric", **data)) == ["gap"]


@pytest.mark.parametrize(
    "gap",
    [
        1 - 0.5 * exp(-(((x - 0.6) / 1e-4) ** 2)),
        IfPos(HALF - sqrt((x - 0.6) ** 2), 0.5, 1.0),
    ],
)
def test_a_formula_may_hide_a_spike_from_the_solver_but_not_from_bounds(gap):
    found = problem(contact="contact", gap=gap)
    assert sampled_data(found) == []
    assert "gap (at 1/128 of each edge" in what_is_unseen(found)


def test_the_paper_s_method_says_it_too():
    found = problem(order=1, traction={"contact": (0, sin(x))})
    assert "known from samples only: traction" in semismooth_newton(found, 1e3).message


def test_an_obstacle_between_nodes_is_said():
    """A spike is cleared; a step from 0.02 inside the body to a high place is not."""
    away = sqrt((x - 0.6) ** 2)
    spike = IfPos(HALF - away, 1 - away / HALF, 0.0)
    cleared = semismooth_newton(problem(contact="contact", gap=0.01 - 0.03 * spike))
    assert cleared.penetration <= 1e-12
    assert "An obstacle stands nearer between nodes by up to 0.0" in cleared.message

    step = problem(contact="contact", gap=IfPos(x - 0.6, 0.1, -0.02), order=1)
    result = semismooth_newton(step)
    assert result.penetration > 0.004
    assert "Between nodes the body overlaps an obstacle by up to 0.0" in result.message
