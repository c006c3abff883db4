"""Intervals of goals of two bodies, and of parts that contact alone holds."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.intervals import fine_problem, value_of
from netgen.occ import Compound, MoveTo, OCCGeometry, Rectangle
from ngsolve import Mesh, x
from stacked import (
    ELASTIC,
    LEFT,
    PAIR,
    TURNED,
    blocks,
    named,
    on_a_floor,
    pressed,
    pushed,
)

from ngepc import (
    ContactForceOn,
    MeanDisplacement,
    Problem,
    Reaction,
    contact_force_bracket,
    displacement_bracket,
    goal_bound,
    semismooth_newton,
    solve_to,
    verdict,
)
from ngepc.bounds.held import RigidWorks, limited_pressure
from ngepc.bounds.of_state import bound_data_of
from ngepc.geometries import block
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.resultant import largest_resultant

MODULUS = 8e3 / 3
"""4 mu (lambda + mu) / (lambda + 2 mu): stress over strain of a column in plane strain."""
PUSHED = -0.02


def columns(order, pair, load=None):
    """One square on top of the other; it floats under a load, or its top is moved."""
    gap = 0.0 if load else 1e-3
    lower = named(Rectangle(1, 1).Face(), 0.31, "bottom", "below")
    upper = named(MoveTo(0, 1 + gap).Rectangle(1, 1).Face(), 0.17, "above", "top")
    mesh = Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=1))
    held = LEFT | {"bottom": (None, 0)}
    traction = {"top": (0, -load)} if load else None
    moved = {} if load else {"top": (None, PUSHED - gap)}
    return Problem(
        mesh,
        ELASTIC,
        None,
        traction,
        prescribed=held | moved,
        contact=pair,
        order=order,
    )


FORCE = -PUSHED * MODULUS / 2
EXACT = {
    "floating": (
        3.0,
        [
            ("contact_force", 3.0),
            (ContactForceOn("below"), 3.0),
            (Reaction("bottom", 1), 3.0),
            (MeanDisplacement("top", 1), -6 / MODULUS),
            ("work", 18 / MODULUS),
        ],
    ),
    "driven": (
        None,
        [
            ("contact_force", FORCE),
            (Reaction("bottom", 1), FORCE),
            (Reaction("top", 1), -FORCE),
        ],
    ),
}
"""Load, goals and their values."""


@pytest.mark.parametrize(("order", "pair"), [(1, TURNED), (2, PAIR)])
@pytest.mark.parametrize("name", EXACT)
def test_intervals_of_an_exact_solution_contain_it(order, pair, name):
    """They are as narrow as rounding errors allow, and not inverted by these."""
    load, goals = EXACT[name]
    goal_problem = GoalProblem(semismooth_newton(columns(order, pair, load)))
    for goal, value in goals:
        found = goal_problem.bound_of(goal)
        assert found.lower < value < found.upper
        assert found.width < 1e-5 * abs(value)
        assert found.discrete == pytest.approx(value, rel=1e-9)


def test_a_moved_boundary_moves_as_prescribed():
    """Where bodies touch, gaps between the nodes are rounding errors, of either sign."""
    goal_problem = GoalProblem(semismooth_newton(columns(2, PAIR)))
    goal_problem._adjoints.slack[:] = 0.0, 0.0, 1e-20
    found = goal_problem.bound_of(MeanDisplacement("top", 1))
    assert found.lower < PUSHED - 1e-3 < found.upper
    assert found.width < 1e-9


@pytest.mark.parametrize("order", [1, 2])
def test_a_column_on_a_rigid_floor(order):
    result = semismooth_newton(on_a_floor(order))
    for goal, value in (("contact_force", 2.0), ("work", 2e-3 + 4 / MODULUS)):
        found = goal_bound(result, goal)
        assert found.lower < value < found.upper
        assert found.width < 1e-5 * value


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("made", ["free", "clamped beside contact", "rubbed"])
def test_the_resultant_of_the_pressure_is_bounded(made):
    """By equilibrium: sharply where the solution is exact.  Not where supports or friction act."""
    changes = {
        "free": {},
        "clamped beside contact": {"prescribed": {"left": (0, 0)}},
        "rubbed": {"friction": 0.1, "prescribed": {"contact": (0, PUSHED)}},
    }
    given = {"prescribed": LEFT, "contact": "clamped", "gap": 1e-3}
    mesh = block.mesh(0.5, (1.0, 1.0))
    load = None if made == "rubbed" else {"contact": (0, -2)}
    given |= changes[made]
    problem = Problem(mesh, ELASTIC, None, load, order=1, **given)
    goal_problem = GoalProblem(semismooth_newton(problem))
    largest = largest_resultant(goal_problem.bound_data, goal_problem.bound)
    if made == "free":
        assert 2 * (1 - 1e-9) < largest < 2.001
    else:
        assert largest == np.inf


GOALS = {
    pressed: ["contact_force", "work", Reaction("bottom", 1)],
    pushed: ["contact_force", Reaction("top", 1), MeanDisplacement("left", 0)],
}


@pytest.mark.parametrize(
    ("made", "order", "pair"), list(zip(GOALS, (1, 2), (PAIR, TURNED), strict=True))
)
def test_fine_values_lie_inside(order, made, pair):
    problem = made(order, pair)
    goal_problem = GoalProblem(semismooth_newton(problem))
    fine = semismooth_newton(fine_problem(problem))
    for goal in GOALS[made]:
        found = goal_problem.bound_of(goal)
        value = value_of(fine, goal)
        assert found.guaranteed
        if goal == "contact_force":
            largest = largest_resultant(goal_problem.bound_data, goal_problem.bound)
            assert value < largest < 10 * value
        assert found.lower - 1e-8 * abs(value) < value < found.upper + 1e-8 * abs(value)
        assert found.percent < {1: 40, 2: 12}[order]


def test_indicators_belong_to_the_mesh_of_the_result():
    """The interval is computed on a copy that matches."""
    result = semismooth_newton(pressed())
    found = goal_bound(result, "work")
    assert len(found.per_cell) == result.problem.mesh.ne
    assert len(found.bound.per_cell) == result.problem.mesh.ne
    assert found.indicators.space.mesh is result.problem.mesh
    assert 2 * found.per_cell.sum() == pytest.approx(found.width, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_the_displacement_of_a_part_that_may_slide(order):
    """What its sliding does not change has an interval; other goals are refused by name."""
    result = semismooth_newton(replace(pressed(order), prescribed=None))
    force = goal_bound(result, "contact_force")
    assert force.lower < 1.0 + 1e-9
    assert force.upper > 1.0 - 1e-9
    assert force.percent < 0.1
    work = goal_bound(result, "work")
    assert work.percent < 20
    with pytest.raises(ValueError, match="goal=mean displacement of top along x"):
        goal_bound(result, MeanDisplacement("top", 0))


def test_solve_to_and_verdict():
    problem = pushed(2)
    run = solve_to(problem, goal="contact_force", percent=2)
    assert run.reached
    assert run.guaranteed
    lower, upper = run.goal.interval
    assert verdict(problem, "contact_force", at_most=1.1 * upper).outcome == "PASS"
    assert verdict(problem, "contact_force", at_least=1.1 * upper).outcome == "FAIL"
    fine = value_of(semismooth_newton(fine_problem(problem)), "contact_force")
    assert lower < fine < upper


def test_brackets():
    """That of a displacement holds the interval; that of the force is one, around its load of 1."""
    result = semismooth_newton(pressed(2))
    bracket = displacement_bracket(result, {"top": (0.0, 1.0)})
    found = goal_bound(result, MeanDisplacement("top", 1))
    assert bracket.lower < found.lower < found.upper < bracket.upper
    assert bracket.guaranteed
    force = contact_force_bracket(result)
    assert (force.lower, force.upper) == goal_bound(result, "contact_force").interval
    assert force.lower < 1.0 + 1e-9
    assert force.upper > 1.0 - 1e-9
    assert force.relative < 1e-4
    assert force.guaranteed


def rigid_works():
    """The works of pressures between a square and a block on the motions of the square."""
    problem = replace(pressed(mesh=blocks((0.5, 0.25))), prescribed=None)
    on_mesh = solve_to(problem, 0.5).result
    motions = on_mesh.discrete.floating.motions
    return RigidWorks(bound_data_of(on_mesh.discrete).contact, motions)


def test_pressures_of_adjoints_balance_loads():
    """A limited pressure with given resultant and moment, where there is one."""
    works = rigid_works()
    shape = works.along.shape[1:]
    rng = np.random.default_rng(3)
    most = rng.uniform(0.5, 1.0, shape)
    pi = np.clip(2 * rng.normal(size=shape), -most, most)
    largest = works.of(most)
    for part in (0.0, -0.7, 0.9):
        found = limited_pressure(works, pi, most, part * largest)
        assert (np.abs(found) <= most).all()
        assert works.of(found) == pytest.approx(part * largest, abs=1e-12)
    same = limited_pressure(works, pi, most, works.of(pi))
    assert np.array_equal(same, pi)
    assert limited_pressure(works, pi, most, 1.1 * largest) is None


@pytest.mark.parametrize("order", [1, 2])
def test_the_goal_of_a_result_on_meshes_that_do_not_match_is_its_own(order):
    """On the bound's copy, whose meshes match, the displacement of the result is no equilibrium."""
    problem = columns(order, PAIR, 3.0)
    problem = replace(problem, traction={"top": (0.0, -3.0 - 2.0 * x)})
    result = semismooth_newton(problem)
    for support, component in (("left", 0), ("bottom", 1)):
        force = result.equilibrium.reactions[support][component]
        found = goal_bound(result, Reaction(support, component))
        assert found.discrete == pytest.approx(force, rel=1e-9, abs=1e-9)
