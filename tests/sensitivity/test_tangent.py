"""Directional derivatives: dual to gradients, one-sided at biactive solutions."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.random_data import functionals, once, random_problem, sizes
from ngsolve import x

from ngepc import Coulomb, Material, Problem, Roller, semismooth_newton
from ngepc.geometries import block
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.equations import INHERITED, Data
from ngepc.sensitivity.functionals import DisplacementAt, Reaction
from ngepc.sensitivity.gradient import gradient
from ngepc.sensitivity.linear import LinearStep
from ngepc.sensitivity.parameters import Direction
from ngepc.sensitivity.tangent import tangent


@pytest.mark.parametrize("seed", [2, 11, 16])
def test_backward_is_the_transpose_of_forward(seed):
    """Of the law with its data and the mesh, of contact, of what a step leaves to the next one."""
    state = once(random_problem(seed)).state
    tape, random = LinearStep(state).tape, np.random.default_rng(0)
    (many, d), n, m = state.deviator.shape, len(state.contact), len(state.multipliers)
    shapes = dict.fromkeys(("strain", "initial", "back"), (many, d))
    scalars = (
        "two_mu",
        "hardening",
        "beta",
        "bulk",
        "volume",
        "kinematic",
        "isotropic",
        "alpha_1",
    )
    shapes |= dict.fromkeys(scalars, (many,)) | dict.fromkeys(
        ("cap", "coefficient"), (m,)
    )
    shapes |= {"gaps": (n,)} | dict.fromkeys(("u", "start", "values"), state.u.shape)
    data = Data({name: random.normal(size=shape) for name, shape in shapes.items()})
    forward = tape.forward(data)
    assert 0 < state.at.yields.mean() < 1
    wanted = {"p", "stress", "mean", "given", *(f"next_{name}" for name in INHERITED)}
    found = {name for name in wanted if np.ndim(forward[name])}
    assert wanted - found == {"next_parts"}  # of overlays alone
    by = Data({name: random.normal(size=forward[name].shape) for name in found})
    assert tape.backward(by).paired(data) == pytest.approx(
        by.paired(forward), rel=1e-10
    )


@pytest.mark.parametrize("seed", [1, 5, 11, 19, 44])
def test_balance_and_the_law_of_contact(seed):
    """Order one and two, Tresca and Coulomb in 3D, two bodies: the equations, and the transpose."""
    state = once(random_problem(seed)).state
    system, random = LinearStep(state), np.random.default_rng(seed)
    conditions, free = state.discrete.contact, state.discrete.supports.free
    force, given = (
        random.normal(size=state.u.shape),
        random.normal(size=len(conditions)),
    )
    u, x = system.solve(force, given)
    balance = system.internal(u) + conditions.forces(x) - force
    assert np.abs(balance[free]).max() < 1e-10 * np.abs(force).max()
    assert not u[~free].any()
    on_u, on_x = random.normal(size=u.shape), random.normal(size=len(x))
    z, w = system.solve(on_u, on_x, transposed=True)
    expected = np.vdot(z, force) + w @ given
    assert np.vdot(on_u, u) + on_x @ x == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("seed", [1, 11, 16, 19])
def test_the_law_of_contact_has_this_derivative(seed):
    """x = P(x - k gaps) at the solution, and its change along a random change of x and of gaps."""
    state = once(random_problem(seed)).state
    contact, cone = LinearContact(state), state.discrete.contact.friction
    random, k = np.random.default_rng(seed), state.discrete.row_stiffness
    x, gaps = state.contact, state.gaps
    assert cone.projected(x - k * gaps) == pytest.approx(x, rel=1e-8, abs=1e-9)
    dx = random.normal(size=len(x)) * np.abs(x).max()
    apart = random.normal(size=len(x)) * np.abs(state.u).max()
    apart[: len(contact.closed)][contact.closed] = 0.0  # they stay closed
    t = 1e-7
    after, before = (
        cone.projected(x + s * dx - k * (gaps + s * apart)) for s in (t, -t)
    )
    expected = contact.slope @ (dx - k * apart)
    assert (after - before) / (2 * t) == pytest.approx(expected, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("seed", [0, 6, 33])
def test_tangents_are_dual_to_gradients(seed):
    problem = random_problem(seed)
    result, names = once(problem), list(sizes(problem))
    for functional in functionals(problem).values():
        slopes = gradient(result, functional, names)
        for name in names:
            found = tangent(result, name).of(functional)
            assert found == pytest.approx(slopes[name], rel=1e-8, abs=1e-12)


def test_rates_add_up():
    result = once(random_problem(1))
    both = tangent(result, {"gap": 2.0, "soft": (3.0, Direction("hardening", x))})
    one = tangent(result, "gap")
    other = tangent(result, {"soft": (1.0, Direction("hardening", x))})
    u = [found.change["u"] for found in (both, one, other)]
    assert u[0] == pytest.approx(2 * u[1] + 3 * u[2], rel=1e-9, abs=1e-12)
    assert both.contact_force == pytest.approx(
        2 * one.contact_force + 3 * other.contact_force
    )
    change = both.displacement.vec.FV().NumPy()
    assert np.abs(change).max() == pytest.approx(np.abs(u[0]).max())


def test_springs_beside_a_support_that_moves():
    """A foundation joins the edge of the support to what is free: to first order F = F' u_D."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    stiff = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=1.0
    )
    moved = {"clamped": (0.0, 1e-3)}
    problem = Problem(
        mesh, stiff, None, prescribed=moved, springs={"right|contact": (50.0, 80.0)}
    )
    result, functional = semismooth_newton(problem), Reaction("clamped", 1)
    force = functional.slope(result.state).value
    assert abs(force) > 1e-3
    assert tangent(result, "prescribed").of(functional) == pytest.approx(
        force, rel=1e-9
    )
    slopes = gradient(result, functional, "prescribed")
    assert slopes["prescribed"] == pytest.approx(force, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_oblique_rollers_that_move(order):
    """Rows that springs hold in the tangent: displacements are linear in the rollers' values."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    stiff = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=1.0
    )
    rollers = {"left": Roller((1.0, 0.5), 1e-3), "clamped": Roller(None, -2e-3)}
    problem = Problem(mesh, stiff, None, prescribed=rollers, order=order)
    result, functional = semismooth_newton(problem), DisplacementAt((0.6, 0.7), 0)
    value = functional.slope(result.state).value
    assert abs(value) > 1e-4
    for names in ("prescribed", ["prescribed:left", "prescribed:clamped"]):
        slopes = gradient(result, functional, names)
        assert sum(slopes.values()) == pytest.approx(value, rel=1e-8)
    assert tangent(result, "prescribed").of(functional) == pytest.approx(
        value, rel=1e-8
    )


MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, hardening=100.0
)


def test_contact_that_only_touches_is_one_sided():
    problem = Problem(
        block.mesh(0.4, (1.0, 1.0)), MATERIAL, "clamped", contact="contact", gap=0.0
    )
    result = semismooth_newton(problem)
    slopes = gradient(result, "contact_force", "gap")
    assert not slopes.differentiable
    assert (
        f"{len(result.discrete.rows)} contact rows and 0 points are biactive"
        in slopes.message
    )
    assert tangent(result, {"gap": 1.0}).contact_force == 0.0
    pressed = tangent(result, {"gap": -1.0})
    other = semismooth_newton(replace(problem, gap=-1e-5))
    assert pressed.contact_force == pytest.approx(other.contact_force / 1e-5, rel=1e-9)
    assert pressed.message == slopes.message


def on_the_yield_surface(factor: float = 1.0) -> Problem:
    """Uniaxial strain c with |dev sigma| = 2 mu (2/3)^(1/2) c = beta."""
    c = factor * MATERIAL.yield_stress / (2 * MATERIAL.lame_mu * np.sqrt(2 / 3))
    held = {"left|right": (0.0, None), "contact": (None, c)}
    return Problem(
        block.mesh(0.4, (1.0, 1.0)),
        MATERIAL,
        "clamped",
        prescribed=held,
        kinematics="plane strain",
    )


def test_points_on_the_yield_surface_are_one_sided():
    result, reaction = semismooth_newton(on_the_yield_surface()), Reaction("contact", 1)
    slopes = gradient(result, reaction, "prescribed")
    points = len(result.discrete.points)
    assert f"0 contact rows and {points} points are biactive" in slopes.message
    loading, unloading = (tangent(result, {"prescribed": rate}) for rate in (1.0, -1.0))
    assert loading.state.at.yields.all()
    assert not unloading.state.at.yields.any()
    for found, step in ((loading, 1e-5), (unloading, -1e-5)):
        other = semismooth_newton(on_the_yield_surface(1 + step))
        before, after = (reaction.slope(r.state).value for r in (result, other))
        assert found.of(reaction) == pytest.approx(
            (after - before) / abs(step), rel=1e-6
        )
    assert abs(loading.of(reaction)) < 0.8 * abs(unloading.of(reaction))


def test_friction_at_its_bound_is_one_sided():
    """With mu = max |t|/n of a body that sticks, less friction makes one row slip."""

    def pressed(mu: float) -> Problem:
        mesh = block.structured_mesh(6, 4, size=(1.5, 1), simplices=True)
        return Problem(
            mesh, MATERIAL, contact="contact", gap=-0.01, friction=Coulomb(mu)
        )

    stuck = semismooth_newton(pressed(5.0)).raise_for_status()
    mu = (np.abs(stuck.nodal_friction_forces[:, 0]) / stuck.nodal_contact_forces).max()
    result = semismooth_newton(pressed(mu)).raise_for_status()
    slopes = gradient(result, "contact_force", "friction")
    assert "1 contact row and 0 points are biactive" in slopes.message
    more, less = (tangent(result, {"friction": rate}) for rate in (1.0, -1.0))
    assert more.contact_force == pytest.approx(0.0, abs=1e-9)
    other = semismooth_newton(pressed(mu - 1e-6)).raise_for_status()
    change = (other.contact_force - result.contact_force) / 1e-6
    assert change < -0.01
    assert less.contact_force == pytest.approx(change, rel=1e-4)
