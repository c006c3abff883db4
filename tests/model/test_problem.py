"""What a Problem gives: names, loads, gaps, history and the numbers h and beta of section 2."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from ngsolve import CF, Integrate, Parameter, ds, x, y, z

from ngepc import Material, Problem, lame_parameters
from ngepc.checks.arguments import (
    boundary_names,
    require_integer,
    require_number,
    sample,
)
from ngepc.geometries import block, lshape, wrench
from ngepc.model.elements import element_facets
from ngepc.model.support import (
    check_conforming,
    held_values,
    part_vertices,
    rigid_motions,
)

STEEL = Material.kinematic(
    lame_lambda=1000.0, lame_mu=800.0, yield_stress=5.0, hardening=100.0
)
SQUARE = block.structured_mesh(4, 4, simplices=True)
CUBE = block.structured_mesh(2, 2, 2)


def values(cf, mesh=SQUARE, *names):
    return sample(cf, mesh, names or None)


def test_least_problem():
    """Clamped by its default name, no contact, no load."""
    problem = Problem(SQUARE, STEEL)
    assert problem.N == 2
    assert problem.clamped_names == ("clamped",)
    assert problem.contact_names == ()
    assert problem.gaps == {}
    assert problem.tractions == {}
    assert problem.f is None
    assert problem.kinematics.name == "plane strain"
    assert problem.order == 2
    assert values(problem.p_0).shape[1] == 9
    assert not values(problem.p_0).any()
    scalar, back_stress = problem.alpha_0
    assert not values(scalar).any()
    assert not values(back_stress).any()


def test_problem_is_frozen():
    problem = Problem(SQUARE, STEEL)
    with pytest.raises(FrozenInstanceError):
        problem.gap = 0.2
    with pytest.raises(FrozenInstanceError):
        STEEL.yield_stress = 1.0


def test_the_order_follows_the_kinematics_unless_it_is_given():
    """1 for the law of the paper, 2 elsewhere; copies choose again, what is given stays."""
    problem = Problem(SQUARE, STEEL)
    paper = replace(problem, kinematics="two-dimensional")
    assert [problem.order, paper.order] == [2, 1]
    assert replace(paper, kinematics="plane strain").order == 2
    assert Problem(block.structured_mesh(1, 1, 1), STEEL).order == 2
    given = replace(problem, order=1)
    assert replace(given, kinematics="plane strain").order == 1
    assert replace(paper, order=2).order == 2


@pytest.mark.parametrize("order", [0, 3, 1.5, "2", True])
def test_other_orders_are_refused(order):
    with pytest.raises((TypeError, ValueError), match="order="):
        Problem(SQUARE, STEEL, order=order)


def test_replace_makes_another_problem():
    problem = Problem(SQUARE, STEEL, contact="contact", gap=0.1)
    other = replace(problem, gap=0.2)
    assert values(problem.psi, SQUARE, "contact") == pytest.approx(0.1)
    assert values(other.psi, SQUARE, "contact") == pytest.approx(0.2)
    with pytest.raises(ValueError, match="gap=nan"):
        replace(problem, gap=float("nan"))


@pytest.mark.parametrize(
    "names", ["left|right", ["left", "right"], ("left", "right"), "left|right|left"]
)
def test_ways_to_name_boundaries(names):
    assert boundary_names("clamped", names, SQUARE) == ("left", "right")
    assert Problem(SQUARE, STEEL, clamped=names).clamped_names == ("left", "right")


def test_tractions_by_single_name():
    g = CF((x, -y))
    problem = Problem(SQUARE, STEEL, traction={"left|right": (1, 2), "contact": g})
    assert set(problem.tractions) == {"left", "right", "contact"}
    for name in ("left", "right"):
        assert values(problem.tractions[name], SQUARE, name)[0] == pytest.approx(
            (1.0, 2.0)
        )
    assert problem.tractions["contact"] is g


def test_traction_of_components():
    p = Parameter(3.0)
    problem = Problem(SQUARE, STEEL, traction={"left": (p, np.float32(2))})
    assert values(problem.tractions["left"], SQUARE, "left")[0] == pytest.approx(
        (3.0, 2.0)
    )
    p.Set(4.0)
    assert values(problem.tractions["left"], SQUARE, "left")[0] == pytest.approx(
        (4.0, 2.0)
    )


def test_gaps_by_name_and_on_the_whole():
    problem = Problem(
        SQUARE, STEEL, "left", contact="right", gap={"right": 0.1 * y}, prescribed=None
    )
    heights = values(y, SQUARE, "right")
    assert values(problem.psi, SQUARE, "right") == pytest.approx(0.1 * heights)
    assert not values(problem.psi, SQUARE, "left", "clamped", "contact").any()


def test_one_gap_for_several_boundaries():
    mesh = lshape.paper_mesh(113)
    problem = Problem(mesh, STEEL, contact="contact|load", gap=0.3)
    total = Integrate(problem.psi * ds, mesh)
    assert total == pytest.approx(0.3 * 1.5)


def test_normal_is_outward_where_netgen_turns_it():
    """Netgen 6.2.2608 turns the contact edge of the wrench, where specialcf.normal is (0, -1)."""
    mesh = wrench.mesh(0.3)
    n = Problem(mesh, STEEL).normal
    assert values(n, mesh, "contact") == pytest.approx(
        values(CF((0.0, 1.0)), mesh, "contact"), abs=1e-14
    )


def test_initial_plastic_strain_is_kept():
    p = CF((x, y, y, -x), dims=(2, 2))
    problem = Problem(
        SQUARE, STEEL, initial_plastic_strain=p, kinematics="two-dimensional"
    )
    assert problem.p_0 is p


TENSOR = CF((3.0, 1.0, 1.0, -1.0), dims=(2, 2))


@pytest.mark.parametrize(
    ("given", "scalar", "back"),
    [
        (None, 0.0, [0, 0, 0, 0]),
        (0.5, 0.5, [0, 0, 0, 0]),
        (Parameter(0.5), 0.5, [0, 0, 0, 0]),
        (TENSOR, 0.0, [2, 1, 1, -2]),
        ((0.5, TENSOR), 0.5, [2, 1, 1, -2]),
        ((None, TENSOR), 0.0, [2, 1, 1, -2]),
        ((0.5, None), 0.5, [0, 0, 0, 0]),
    ],
)
def test_initial_hardening(given, scalar, back):
    """(alpha_1, dev alpha_2): the back stress counts by its deviator only."""
    problem = Problem(
        SQUARE, STEEL, initial_hardening=given, kinematics="two-dimensional"
    )
    alpha = problem.alpha_0
    assert values(alpha[0])[0] == pytest.approx(scalar)
    assert values(alpha[1])[0] == pytest.approx(back)


def test_effective_hardening_and_yield_bound():
    """H = k + (H sigma_y)^2 k_1 and beta = sigma_y (1 + H alpha_1)."""
    material = Material(
        lame_lambda=1.0,
        lame_mu=1.0,
        yield_stress=3.0,
        hardening=7.0,
        hardening_modulus=2.0,
        hardening_stiffness=0.5,
    )
    assert material.isotropic_hardening == pytest.approx((2 * 3) ** 2 * 0.5)
    assert material.effective_hardening == pytest.approx(7 + 18)
    assert material.yield_bound() == pytest.approx(3.0)
    assert material.yield_bound(0.25) == pytest.approx(3 * 1.5)
    problem = Problem(SQUARE, material, initial_hardening=0.25)
    assert problem.beta == pytest.approx(4.5)
    assert values(problem.effective_hardening)[0] == pytest.approx(25.0)


def test_paper_materials():
    """Example (b) of the paper: (H sigma_y)^2 k_1 = 0.4 with its data."""
    wrench = Material.isotropic(
        lame_lambda=11.5,
        lame_mu=7.69,
        yield_stress=0.2,
        hardening_modulus=1e-3,
        hardening_stiffness=1e7,
    )
    assert wrench.effective_hardening == pytest.approx(0.4)
    assert STEEL.effective_hardening == 100.0


def test_kinematic_bound_ignores_the_scalar():
    assert Problem(SQUARE, STEEL, initial_hardening=0.7).beta == 5.0


def test_materials_by_region():
    """A coefficient by region is sampled in each of them."""
    soft = replace(
        STEEL, yield_stress=SQUARE.MaterialCF({"body": 2.5}), hardening=10 + x
    )
    problem = Problem(SQUARE, soft)
    assert values(problem.beta) == pytest.approx(2.5)
    assert values(problem.effective_hardening) == pytest.approx(10 + values(x))


@pytest.mark.parametrize(
    ("young", "poisson"), [(206900.0, 0.29), (1.0, 0.0), (2e5, -0.4)]
)
def test_lame_parameters(young, poisson):
    """The inverse: E = mu (3 lambda + 2 mu) / (lambda + mu), nu = lambda / (2 (lambda + mu))."""
    lam, mu = lame_parameters(young, poisson)
    assert mu * (3 * lam + 2 * mu) / (lam + mu) == pytest.approx(young)
    assert lam / (2 * (lam + mu)) == pytest.approx(poisson)


def test_ellipticity_depends_on_the_kinematics():
    """Lambda = -0.9 mu is elliptic for 2 x 2 tensors (lambda + mu > 0), not for 3 x 3."""
    weak = replace(STEEL, lame_lambda=-720.0)
    assert Problem(SQUARE, weak, kinematics="two-dimensional").N == 2
    for mesh in (SQUARE, CUBE):
        with pytest.raises(ValueError, match="needed for 3 x 3 tensors"):
            Problem(mesh, weak)


def test_held_values():
    problem = Problem(SQUARE, STEEL, prescribed={"left": (0.5 * y, None)})
    held = held_values(problem)
    coordinates = np.asarray(SQUARE.ngmesh.Coordinates())
    bottom, left = coordinates[:, 1] == 0, coordinates[:, 0] == 0
    assert not held[bottom].any()
    assert held[left, 0] == pytest.approx(0.5 * coordinates[left, 1])
    assert np.isnan(held[left & ~bottom, 1]).all()
    assert np.isnan(held[~left & ~bottom]).all()


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_boundary_values_agree_up_to_rounding_of_the_larger_ones(size):
    """Left and bottom meet at a vertex; lengths may be in any unit."""

    def both(differ):
        bottom = (size * (x + differ), None)
        sides = {"left": (size * y, 0), "clamped": bottom}
        return Problem(SQUARE, STEEL, clamped=None, prescribed=sides)

    for differ in (1e-10, -1e-10):
        assert both(differ).N == 2
    for differ in (1e-6, -1e-6):
        with pytest.raises(ValueError, match="the values must agree"):
            both(differ)


@pytest.mark.parametrize("size", [1e-10, 1e10])
def test_rigid_motions_are_counted_in_any_unit(size):
    """A square on one roller slides along it, on two at right angles it is held."""
    mesh = block.structured_mesh(2, 2, size=(size, size))
    rollers = {"left": (0, None), "clamped": (None, 0)}
    given = {"clamped": None, "prescribed": rollers}
    assert Problem(mesh, STEEL, **given).N == 2
    for name in rollers:
        left = {name: rollers[name]}
        with pytest.raises(ValueError, match="leave 1 rigid"):
            Problem(mesh, STEEL, **{**given, "prescribed": left})


@pytest.mark.parametrize("mesh", [SQUARE, CUBE, lshape.paper_mesh(113)])
def test_one_part(mesh):
    (vertices,) = part_vertices(mesh, *check_conforming(*element_facets(mesh)))
    assert vertices.tolist() == list(range(mesh.nv))


@pytest.mark.parametrize("N", [2, 3])
def test_rigid_motions(N):
    """A rigid motion keeps all distances to first order: (u(a) - u(b)) . (a - b) = 0."""
    rng = np.random.default_rng(7)
    points = rng.normal(size=(6, N))
    motion = rng.normal(size=N * (N + 1) // 2)
    u = rigid_motions(points) @ motion
    for i in range(6):
        change = ((u - u[i]) * (points - points[i])).sum(axis=1)
        assert change == pytest.approx(0.0, abs=1e-12)


ENOUGH = {
    "clamped": {"clamped": "clamped"},
    "two rollers at right angles and a third": {
        "clamped": None,
        "prescribed": {"clamped": (None, 0), "left": (0, None)},
    },
    "a prescribed boundary": {"clamped": None, "prescribed": {"left": (0.1, 0)}},
}


@pytest.mark.parametrize("name", ENOUGH)
def test_enough_support(name):
    assert Problem(SQUARE, STEEL, **ENOUGH[name]).N == 2


def test_rollers_on_three_sides_of_a_cube():
    rollers = {
        "left": (0, None, None),
        "front": (None, 0, None),
        "clamped": (None, None, 0),
    }
    assert Problem(CUBE, STEEL, clamped=None, prescribed=rollers).N == 3
    for name in rollers:
        fewer = {k: v for k, v in rollers.items() if k != name}
        with pytest.raises(ValueError, match="leave 1 rigid"):
            Problem(CUBE, STEEL, clamped=None, prescribed=fewer)


def test_body_force():
    problem = Problem(CUBE, STEEL, body_force=(0, 0, -9.81 * z))
    assert values(problem.f, CUBE)[:, 2] == pytest.approx(-9.81 * values(z, CUBE)[:, 0])


@pytest.mark.parametrize(
    ("value", "expected"), [(3, 3), (3.0, 3), (np.int64(3), 3), (np.float64(3), 3)]
)
def test_require_integer(value, expected):
    found = require_integer("n", value, 1)
    assert found == expected
    assert type(found) is int


def test_require_number_bounds():
    assert require_number("r", 0.5, 0, strict=True, most=0.5) == 0.5
    with pytest.raises(
        ValueError, match=r"r=0\.6: a finite number > 0 and <= 0\.5 is needed"
    ):
        require_number("r", 0.6, 0, strict=True, most=0.5)
