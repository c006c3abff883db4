"""``RepeatedSolver`` gives what ``semismooth_newton`` gives, whatever changes in between."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import x

from ngepc import (
    Coulomb,
    Material,
    Problem,
    Roller,
    Status,
    evolve,
    load_cycle,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.local.solver import RepeatedSolver
from ngepc.local.warm import WarmSolver

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
)
SOFTER = Material.kinematic(
    lame_lambda=1e3, lame_mu=5e2, yield_stress=1.0, hardening=20.0
)

CHANGES = (
    {},
    {"gap": -0.003},
    {"gap": 0.1 * (x - 0.3) ** 2 - 0.004},
    {"traction": {"left": (1.0, 0.0)}},
    {"prescribed": {"clamped": (0.0, 0.001)}, "clamped": None},
    {"prescribed": {"clamped": (0.0, 0.002)}},
    {"prescribed": {"clamped": (0.0, 0.0), "right": Roller((1.0, 0.1), 0.0)}},
    {"prescribed": {"clamped": (0.0, 0.0), "right": Roller((1.0, 0.2), 0.0)}},
    {"prescribed": None, "clamped": "clamped", "friction": Coulomb(0.2)},
    {"friction": None, "springs": {"right": 100.0}},
    {"springs": None, "material": SOFTER},
    {"order": 2},
    {"gap": {"contact": 0.2 * (x - 0.6) ** 2 - 0.003}},
    {"kinematics": "two-dimensional", "order": 1},
)


def same(one, other):
    u = one.displacement.vec.FV().NumPy()
    v = other.displacement.vec.FV().NumPy()
    assert one.status is other.status
    assert one.iterations == other.iterations
    assert one.primal_energy == pytest.approx(other.primal_energy, rel=1e-13)
    assert np.abs(u - v).max() <= 1e-12 * np.abs(v).max()
    assert one.contact_force == pytest.approx(other.contact_force, rel=1e-11)


def test_one_problem_after_the_other():
    mesh = block.structured_mesh(4, 4, simplices=True)
    problem = Problem(mesh, METAL, contact="contact", gap=-0.002, order=1)
    solver = RepeatedSolver()
    before = None
    for change in CHANGES:
        problem = replace(problem, **change)
        result = solver(problem)
        same(result, semismooth_newton(problem))
        if before is not None:  # what an earlier result has is left alone
            assert before[0].primal_energy == before[1]
            assert before[0].contact_force == before[2]
        before = result, result.primal_energy, result.contact_force


def test_what_is_kept():
    mesh = block.structured_mesh(4, 4, simplices=True)
    first = Problem(mesh, METAL, contact="contact", gap=-0.002, order=1)
    solver = RepeatedSolver()
    one = solver(first).discrete
    two = solver(replace(first, traction={"left": (1.0, 0.0)})).discrete
    three = solver(replace(first, gap=-0.003)).discrete
    assert two.points is one.points
    assert two.supports is one.supports
    assert two.rows is one.rows
    assert two.stiffness is one.stiffness
    assert three.supports is one.supports
    assert three.rows is not one.rows
    assert three.contact.matrix is one.contact.matrix


def rubbed(mesh, **changes):
    """A block that is pressed against an obstacle with friction."""
    given = {"contact": "contact", "gap": -0.01, "friction": Coulomb(0.3), "order": 1}
    return Problem(mesh, METAL, **(given | changes))


def test_compliance_of_the_elastic_body():
    """Against a solve with the dense stiffness; kept while the body is the same."""
    solver = RepeatedSolver()
    mesh = block.structured_mesh(4, 4, simplices=True)
    first = rubbed(mesh)
    one = solver(first).discrete
    free = one.free.ravel()
    unit = np.eye(free.size)[free]
    tangent = one.elastic
    K = np.array([tangent.multiply(e.reshape(one.free.shape)).ravel() for e in unit])
    R = one.contact.matrix.toarray()[:, free]
    S = R @ np.linalg.solve(K[:, free], R.T)
    found = one.elastic_compliance.block(np.arange(len(S)))
    moves = np.ix_(S.diagonal() > 0, S.diagonal() > 0)
    assert found[moves] == pytest.approx(S[moves], abs=1e-12 * S.max())

    lifted = solver(replace(first, gap=-0.009)).discrete
    assert lifted.elastic_compliance is one.elastic_compliance
    softer = solver(replace(first, material=SOFTER)).discrete
    assert softer.elastic_compliance is not one.elastic_compliance


def test_compliance_of_the_elastic_body_saves_solves():
    """In a body that has begun to yield: fewer solves for the contact rows, the same solution."""
    mesh = block.structured_mesh(16, 8, size=(2, 1), simplices=True)
    pressed = rubbed(mesh, gap=-0.0005)
    deeper = replace(pressed, gap=-0.0006)
    solver = RepeatedSolver()
    start = solver(pressed)
    repeated = solver(deeper, start.displacement)
    alone = semismooth_newton(deeper, start=start.displacement)
    same(repeated, alone)
    assert repeated.state.plastic_measure > 0
    solves = [
        sum(result.history.column("back_substitutions")[1:])
        for result in (repeated, alone)
    ]
    assert solves[0] <= 0.7 * solves[1]


def test_what_is_learned_of_the_compliance_is_not_kept():
    """The digits of a solution do not depend on the problems that were solved before."""
    mesh = block.structured_mesh(8, 4, size=(2, 1), simplices=True)
    solver = RepeatedSolver()
    solver(rubbed(mesh))
    second = solver(rubbed(mesh, gap=-0.012))
    first = RepeatedSolver()(rubbed(mesh, gap=-0.012))
    u = second.displacement.vec.FV().NumPy()
    np.testing.assert_array_equal(u, first.displacement.vec.FV().NumPy())
    np.testing.assert_array_equal(second.state.contact, first.state.contact)


def test_each_load_is_asked_whether_contact_can_hold_it():
    """The answer for the first load was that for all: solvable steps were ``unheld``."""
    rests = Problem(
        block.structured_mesh(2, 2, simplices=True),
        METAL,
        None,
        prescribed={"left": (0, None)},
        contact="clamped",
        gap=0.0,
        body_force=(0.0, -0.1),
    )
    lifted = rests.changed(body_force=(0.0, 0.1))
    expected = [(rests, Status.CONVERGED), (lifted, Status.UNHELD)]
    for sequence in (expected, expected[::-1]):
        solver = RepeatedSolver()
        for body, status in sequence:
            assert solver(body).status is status


@pytest.mark.parametrize("solver", [None, primal_newton])
@pytest.mark.parametrize("friction", [None, Coulomb(0.3)])
@pytest.mark.parametrize("contact", ["contact", ("contact", "right")])
def test_unloading_an_elastic_body_takes_few_steps(contact, friction, solver):
    """Steps went on until numbers underflow, 11 to 108, to no solution with Coulomb's law."""
    pulled = Problem(
        block.structured_mesh(4, 4, simplices=True),
        METAL,
        traction={"left": (-0.1, 0.1)},
        contact=contact,
        gap=0.0,
        friction=friction,
        order=1,
    )
    cycle = load_cycle(pulled, [1.0, -1.0, 0.0], 1)
    first, *_, last = evolve(pulled, cycle, solver).raise_for_status().steps
    forward, back = (
        step.fields.displacement.vec.FV().NumPy() for step in (first, last)
    )
    assert np.abs(back).max() < 1e-12 * np.abs(forward).max()
    assert last.record.iterations <= (1 if friction is None else 5)


@pytest.mark.parametrize("gap", [0.0, 0.01])
@pytest.mark.parametrize("friction", [None, Coulomb(0.3)])
def test_a_block_that_only_the_floor_holds_is_unloaded(gap, friction):
    """Rounding errors of its motion took up to 89 steps, or were other equilibria."""
    standing = Problem(
        block.structured_mesh(2, 2, simplices=True),
        METAL,
        None,
        {"contact": (0.0, -0.1)},
        prescribed={"left": (0, None)},
        contact="clamped",
        gap=gap,
        friction=friction,
        order=1,
    )
    found = evolve(standing, load_cycle(standing, [1.0, 0.5, 0.0], 1))
    assert found.status is Status.CONVERGED
    assert found.steps[-1].record.iterations <= 6


def test_a_body_at_rest_has_no_tangent_to_predict_with():
    """The laboratory ended with an AttributeError when the first load was moved."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    rest = Problem(mesh, METAL, contact="contact", gap=0.0, order=1)
    pushed = rest.changed(gap=-1e-3)
    solver = WarmSolver()
    assert solver.solve(rest).iterations == 0
    assert solver.predict(pushed) is None
    same(solver.solve(pushed), semismooth_newton(pushed))


def test_a_slider_keeps_what_solves_without_a_prediction_have_learned():
    """Other supports allow no prediction; the compliance of the contact rows is still known."""
    mesh = block.structured_mesh(8, 4, simplices=True)
    pressed = Problem(mesh, METAL, contact="contact", gap=-2e-3, order=1)
    guesses = []

    class Watched(WarmSolver):
        def solve_from(self, state, monitor=None, compliance=None):
            guesses.append(compliance())
            return super().solve_from(state, monitor, compliance)

    solver = Watched()
    for moved in (0.0, 1e-3):
        problem = pressed.changed(prescribed={"clamped": (moved, 0.0)}, clamped=None)
        found = solver.solve(problem)
        assert found.status is Status.CONVERGED
        force = semismooth_newton(problem).contact_force
        assert found.contact_force == pytest.approx(force)
    assert guesses[0] is guesses[1]
