"""Contact forces at a corner of two walls with friction, whose shares are not determined."""

import numpy as np
import pytest

from ngepc import Coulomb, Material, Problem, RepeatedSolver, semismooth_newton
from ngepc.discretisation.shared_forces import range_of_force
from ngepc.geometries import block

MU = 0.3
METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
)


def pressed(n, **data):
    """A square on its base under a plate and beside a wall; its upper corner touches both."""
    return Problem(
        block.structured_mesh(n, n, simplices=True),
        METAL,
        contact=("contact", "right"),
        gap={"contact": -1e-3, "right": 0.0},
        **{"friction": Coulomb(MU), **data},
    )


@pytest.mark.parametrize("order", [1, 2])
def test_the_range_at_a_right_angle(order):
    """The corner slips down along the wall, t_2 = -mu n_2, and sticks to the plate.

    n_1 + t_2 = f_y and n_2 + t_1 = f_x with |t_1| <= mu n_1.
    """
    result = semismooth_newton(pressed(3, order=order))
    state = result.state
    rows = state.body.rows
    there = rows.nodes == np.argmax(np.bincount(rows.nodes))
    others = state.multipliers[~there].sum()
    along = np.einsum("md,mdj->mj", state.tangential_forces, rows.tangents)
    forces = state.multipliers[:, None] * rows.normals + along
    x, y = forces[there].sum(axis=0)
    on_the_wall = [(x + s * MU * y) / (1 - s * MU**2) for s in (-1, 1)]
    ends = [others + y + (1 + MU) * n for n in on_the_wall]
    low, high = range_of_force(state)
    assert (low, high) == pytest.approx(ends, rel=1e-6)
    assert f"one of {low:.5g} to {high:.5g}" in result.message


@pytest.mark.parametrize("order", [1, 2])
def test_every_solver_ends_in_the_range(order):
    """The first compliance decides which forces are found; displacements are the same."""
    problem = pressed(2, order=order)
    one, other = semismooth_newton(problem), RepeatedSolver()(problem)
    distance = np.abs(one.state.u - other.state.u).max()
    assert distance < 1e-9 * np.abs(one.state.u).max()
    assert abs(one.contact_force - other.contact_force) > 1e-4
    low, high = range_of_force(one.state)
    for result in (one, other):
        assert low * (1 - 1e-6) <= result.contact_force <= high * (1 + 1e-6)


def test_the_limit_of_friction_bounds_the_range():
    """Tresca's bounds F: the tangential forces of the corner differ by at most 2 F each."""
    bound = 1e-2
    state = semismooth_newton(pressed(3, friction=bound, order=1)).state
    low, high = range_of_force(state)
    corner = np.argmax(np.bincount(state.body.rows.nodes))
    there = state.body.rows.nodes == corner
    most = state.body.contact.bound(state.contact)[there].sum()
    assert 0 < high - low <= 2 * most * (1 + 1e-6)


@pytest.mark.parametrize("data", [{"friction": None}, {"contact": "contact"}])
def test_determined_forces_have_no_range(data):
    problem = pressed(3, order=1)
    if "contact" in data:
        data = {**data, "gap": -1e-3}
    result = semismooth_newton(problem.changed(**data))
    assert range_of_force(result.state) == (result.contact_force,) * 2
    assert "many divisions" not in result.message
