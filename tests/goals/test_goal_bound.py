"""Intervals of goals: the supremum against random strains, and fine values inside."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from campaigns.crossings import finer
from campaigns.intervals import drawn
from netgen.geom2d import SplineGeometry
from ngsolve import CF, Integrate, Mesh, x, y

from ngepc import (
    ContactForceOn,
    Coulomb,
    DisplacementAt,
    LoadWork,
    Material,
    MeanDisplacement,
    Problem,
    Reaction,
    confidence,
    contact_force_bracket,
    displacement_bracket,
    goal_bound,
    semismooth_newton,
    solve_to,
)
from ngepc.bounds.of_state import bound_data_of
from ngepc.bounds.quadrilaterals import cut_into_triangles
from ngepc.geometries import block
from ngepc.goals.adjoint import AdjointProblem
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.goal_terms import terms_of
from ngepc.goals.kinds import cells_within
from ngepc.goals.pieces import dots
from ngepc.goals.sides import LawOnCells, ResultOnCells, Sides
from ngepc.studies.bounds import bounded_example
from ngepc.studies.examples import example

MATERIAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)
TWO_MU = 2e3
BETA = 5.0
BULK = 3e3


class Stresses(NamedTuple):
    """Stresses and strains at points: means (n,) and deviators (n, d)."""

    mean: np.ndarray
    deviator: np.ndarray


class Points:
    """Random data at points, near the tangent's."""

    def __init__(self, d, hardening, count=200):
        rng = np.random.default_rng(d)
        self.hardening = hardening
        self.back = rng.normal(size=(count, d))
        e = rng.normal(size=(count, d)) * 10 ** rng.uniform(-4, -2, (count, 1))
        self.trial = TWO_MU * e - self.back
        self.volume = 1e-3 * rng.normal(size=count)
        self.stress = self.law(self.trial)
        wrong = 10 ** rng.uniform(-3, 0, (count, 1))
        self.strain = Stresses(
            1e-3 * rng.normal(size=count), 1e-3 * rng.normal(size=(count, d))
        )
        change = 1 + wrong * rng.normal(size=(count, d))
        self.tau = Stresses(
            BULK * self.strain.mean, TWO_MU * self.strain.deviator * change
        )
        self.sigma = Stresses(
            BULK * self.volume + wrong[:, 0] * rng.normal(size=count),
            self.stress + wrong * rng.normal(size=(count, d)),
        )

    def law(self, trial):
        """The stress of the radial return."""
        size = np.linalg.norm(trial, axis=1, keepdims=True)
        inside = trial * np.minimum(1, BETA / np.maximum(size, 1e-300))
        M = TWO_MU + self.hardening
        return (self.hardening * trial + TWO_MU * inside) / M + self.back

    def integrand(self, volume, e, factor):
        """What the supremum is of."""
        rise = self.law(self.trial + TWO_MU * e) - self.stress
        left = self.stress + rise - self.sigma.deviator
        value = self.tau.mean * volume + (self.tau.deviator * e).sum(axis=1)
        value -= BULK * self.strain.mean * volume
        value -= (self.strain.deviator * rise).sum(axis=1)
        mean = BULK * (self.volume + volume) - self.sigma.mean
        return value - factor * (mean * volume + (left * e).sum(axis=1))


def suprema(points, factor):
    """Upper bound of the supremum at each point, (n,): integrals over cells of size one."""

    def constant(values):
        """Coefficients on cells (n, 3, .) of functions that are constant there."""
        return np.repeat(values[:, None], 3, axis=1)

    one = np.ones(len(points.volume))
    law = LawOnCells(TWO_MU * one, points.hardening * one, BETA * one)
    half = 1 / (2 * np.sqrt(BULK))
    result = ResultOnCells(
        constant((points.sigma.deviator - points.back) / TWO_MU),
        points.trial[:, None] / TWO_MU,
        constant(half * (points.sigma.mean - BULK * points.volume)),
        law,
        one,
    )
    sides = Sides.of_adjoint(
        result,
        constant(points.tau.deviator / TWO_MU),
        points.strain.deviator[:, None],
        constant(half * (points.tau.mean - BULK * points.strain.mean)),
        dots(points.stress - points.back, points.strain.deviator),
    )
    return sides.integrals(1.0, factor)


@pytest.mark.parametrize(("d", "hardening"), [(2, 20.0), (3, 1e3), (5, 20.0)])
def test_no_strain_exceeds_the_supremum(d, hardening):
    points = Points(d, hardening)
    rng = np.random.default_rng(7)
    for factor in (0.1, 2.0):
        most = suprema(points, factor)
        best = np.full(len(most), -np.inf)
        where = np.zeros((len(most), d + 1))
        for round_ in range(2500):
            step = 10 ** rng.uniform(-6, 0, (len(most), 1))
            trial = step * rng.normal(size=where.shape)
            if round_ > 400:
                trial += where
            value = points.integrand(trial[:, 0], trial[:, 1:], factor)
            better = value > best
            best[better] = value[better]
            where[better] = trial[better]
        assert (best <= most * (1 + 1e-9)).all()
        assert np.sum(most) < 1.15 * np.sum(best)


def work_on(result, name, load):
    """The work of a traction on one side."""
    mesh = result.problem.mesh
    return Integrate(
        CF(load) * result.displacement, mesh, definedon=mesh.Boundaries(name)
    )


def fine_value(problem, functional, bisections=4):
    """A functional on a mesh bisected several times, order two where it can be."""
    order = 2 if problem.N == 2 else 1
    fine = finer(replace(problem, order=order), bisections)
    return functional(semismooth_newton(fine))


@pytest.mark.parametrize("order", [1, 2])
def test_the_contact_force_of_the_l_shape(order):
    """The fine value is between 2.7408 and 2.7432, from order two on 6273 nodes."""
    problem = replace(example("lshape", 417), order=order)
    found = goal_bound(semismooth_newton(problem), "contact_force")
    assert found.lower < 2.7408
    assert found.upper > 2.7432
    assert found.percent < {1: 4.5, 2: 2.2}[order]
    assert found.per_cell.min() > -1e-9 * found.width
    assert found.estimate < found.width / 2


@pytest.mark.parametrize("order", [1, 2])
def test_the_work_of_the_load_of_the_wrench(order):
    problem = replace(example("wrench", 245), order=order)
    found = goal_bound(semismooth_newton(problem), "work")
    assert found.lower < 0.004996
    assert found.upper > 0.004996
    assert found.percent < {1: 60, 2: 12}[order]
    assert 0 < found.estimate < found.width / 2


def test_several_goals_share_factors_and_what_rows_have_taught():
    """The tangent is factorised once, and an adjoint takes few solves with it."""
    problem = replace(example("lshape", 833), order=1)
    goals = GoalProblem(semismooth_newton(problem))
    tangent = goals._adjoints.tangent
    moduli = tangent.moduli
    solves = []
    for goal in ("work", "contact_force"):
        before = tangent.back_substitutions
        goals.bound_of(goal)
        solves.append(tangent.back_substitutions - before)
    assert tangent.moduli is moduli
    assert max(solves) < 15
    alone = GoalProblem(semismooth_newton(problem))
    assert alone.bound_of("contact_force").percent == pytest.approx(
        goals.bound_of("contact_force").percent, rel=0.02
    )


def test_the_reaction_balances_the_load():
    problem = Problem(
        block.mesh(0.2, (1.0, 0.7)), MATERIAL, traction={"contact": (1.0, -3.0)}
    )
    result = semismooth_newton(problem)
    for component, value in ((0, -1.0), (1, 3.0)):
        found = goal_bound(result, Reaction("clamped", component))
        assert found.lower - 1e-9 <= value <= found.upper + 1e-9
        assert found.discrete == pytest.approx(value, rel=1e-6)


def test_reactions_of_supports_that_meet_add_up():
    """Both hold the corner: each gets half of its force, as in ``equilibrium.reactions``."""
    problem = Problem(
        block.structured_mesh(3, 3, simplices=True),
        MATERIAL,
        "left|clamped",
        {"right": (1.0, -3.0)},
    )
    result = semismooth_newton(problem)
    for component, value in ((0, -1.0), (1, 3.0)):
        found = [
            goal_bound(result, Reaction(name, component))
            for name in ("left", "clamped")
        ]
        assert sum(each.discrete for each in found) == pytest.approx(value, rel=1e-9)
        for name, each in zip(("left", "clamped"), found, strict=True):
            force = result.equilibrium.reactions[name][component]
            assert each.discrete == pytest.approx(force, rel=1e-9)
            assert "Where supports meet" in each.message
        both = goal_bound(result, Reaction("left|clamped", component))
        assert both.lower <= value <= both.upper
        assert both.width < 1e-6
        assert both.message == ""
    with pytest.raises(ValueError, match="support='right'"):
        goal_bound(result, Reaction("right", 0))  # two of its vertices are held


@pytest.mark.parametrize(("size", "order"), [((3, 3), 2), ((2, 1, 1), 1)])
def test_the_goal_of_a_result_is_its_own_number(size, order):
    """Quadrilaterals and hexahedra are cut for the interval, not for what the result says."""
    N = len(size)
    force = (*(N - 1) * (0.0,), -3.0)
    problem = Problem(
        block.structured_mesh(*size),
        MATERIAL,
        "clamped",
        {"right": force},
        contact="contact",
        gap=-1e-3,
        initial_strain=1e-3,
        order=order,
    )
    result = semismooth_newton(problem)
    right = problem.mesh.Boundaries("right")
    work = Integrate(CF(force) * result.displacement, problem.mesh, definedon=right)
    values = {
        "contact_force": result.contact_force,
        ContactForceOn("contact"): result.contact_force,
        Reaction("clamped", N - 1): result.reaction[N - 1],
        "work": work,
    }
    for goal, value in values.items():
        assert goal_bound(result, goal).discrete == pytest.approx(value, rel=1e-10)


@pytest.mark.parametrize("order", [1, 2])
def test_the_goal_of_a_result_that_the_bound_clears_of_the_obstacle_is_its_own(order):
    """A round obstacle between the nodes: the bound is that of a displacement moved clear of it."""
    disc = 2 - (4 - (x - 0.5) * (x - 0.5)) ** 0.5 - 3e-3
    square = block.structured_mesh(3, 3, simplices=True)
    pressed = {"contact": "contact", "gap": disc, "order": order}
    result = semismooth_newton(Problem(square, MATERIAL, "clamped", **pressed))
    top = square.Boundaries("contact")
    mean = Integrate(result.displacement[1], square, definedon=top)
    found = goal_bound(result, MeanDisplacement("contact", 1))
    assert found.bound.moved > 0.01 * abs(mean)
    assert found.discrete == pytest.approx(mean, rel=1e-9)
    run = solve_to(result.problem, goal=MeanDisplacement("contact", 1), percent=1e9)
    of_run = Integrate(run.result.displacement[1], square, definedon=top)
    assert run.goal.discrete == pytest.approx(of_run, rel=1e-9)


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_a_reaction_that_no_load_moves_where_the_law_ends(size):
    """Its adjoint is a rigid motion, in bodies of every size; suprema need a lambda for rounding.

    The interval was infinite where the curve is constant beyond its last point.
    """
    curve = [(1e-3, 200.0), (1e-2, 320.0), (5e-2, 400.0), (0.2, 430.0)]
    metal = Material.metal(young=200e3, poisson=0.29, curve=curve)
    widths = size * np.append(0.0, np.geomspace(0.01, 1.0, 9))
    mesh = block.structured_mesh(9, 4, size=(size, size), simplices=True)
    for point in mesh.ngmesh.Points():
        point[0] = np.interp(point.p[0], np.linspace(0, size, 10), widths)
    gap = 1e-4 * (size + x)
    given = {"contact": "clamped", "gap": gap, "order": 2}
    pushed = {"contact": (0.0, -150.0)}
    problem = Problem(Mesh(mesh.ngmesh), metal, "right", pushed, **given)
    found = goal_bound(semismooth_newton(problem), Reaction("right", 0))
    assert found.lower <= 0 <= found.upper
    assert found.width < 1e-6 * 150.0 * size


def test_a_reaction_on_needles():
    """The support of a plate of 0.001 x 0.7 moves by one; the forces of that cancel."""
    mesh = block.mesh(0.4, (1.0, 0.7))
    for point in mesh.ngmesh.Points():
        point[0] = 0.001 * point.p[0]
    problem = Problem(
        Mesh(mesh.ngmesh), MATERIAL, "left", {"contact": (0.3, 0.2)}, order=1
    )
    result = semismooth_newton(problem)
    for component, force in enumerate((0.3, 0.2)):
        found = goal_bound(result, Reaction("left", component))
        assert found.lower <= -0.001 * force <= found.upper
        assert found.percent < 0.1


def test_a_reaction_whose_adjoint_is_nearly_a_rigid_motion():
    """Where all yields, nearly incompressible, one solve leaves 3e-13 of the forces."""
    problem, _ = drawn(2, "order 2", 50)
    found = goal_bound(semismooth_newton(problem), Reaction("clamped", 0))
    assert found.lower <= found.discrete <= found.upper
    assert found.percent < 1e-3


@pytest.mark.parametrize("order", [1, 2])
def test_forces_on_two_sides_are_those_of_their_rows(order):
    gaps = {"contact": 1e-4, "left": 1e-4}
    square = block.structured_mesh(3, 3, simplices=True)
    pushed = {"right": (-2.0, 1.0)}
    given = {"contact": "contact|left", "gap": gaps, "order": order}
    result = semismooth_newton(Problem(square, MATERIAL, traction=pushed, **given))
    upward = result.rows.normals[:, 1] > 0.5
    for name, rows in {"contact": upward, "left": ~upward}.items():
        force = result.nodal_contact_forces[rows].sum()
        assert force > 0.1
        found = goal_bound(result, ContactForceOn(name))
        assert found.discrete == pytest.approx(force, rel=1e-9)


@pytest.mark.parametrize(("order", "gap"), [(2, 0.0), (1, 3e-4)])
def test_contact_that_meets_a_clamp(order, gap):
    """The gap is open at the corner or closed; a force needs an adjoint that can move there."""
    traction = {"right": (1.0, 2.5)}
    given = {"clamped": "left", "contact": "contact", "gap": gap, "order": order}
    square = block.structured_mesh(3, 3, simplices=True)
    problem = Problem(square, MATERIAL, traction=traction, **given)
    result = semismooth_newton(problem)
    fine = semismooth_newton(finer(replace(problem, order=2), 2))
    work = goal_bound(result, "work")
    assert work.guaranteed
    assert work.lower < work_on(fine, "right", traction["right"]) < work.upper
    if gap == 0:
        refused = "a support holds a vertex that touches .* end the contact boundary"
        with pytest.raises(RuntimeError, match=refused):
            contact_force_bracket(result)
        return
    force = contact_force_bracket(result)
    assert 0 <= force.lower <= fine.contact_force <= force.upper


def test_displacements_of_a_block():
    problem = Problem(
        block.mesh(0.3, (1.0, 0.7)), MATERIAL, traction={"contact": (1.0, -4.0)}
    )
    result = semismooth_newton(problem)
    mean = goal_bound(result, MeanDisplacement("contact", 1))
    work = goal_bound(result, LoadWork({"contact": (0.0, 1.0)}))
    assert work.lower == pytest.approx(mean.lower, rel=1e-6)
    assert mean.guaranteed or not mean.exact
    there = goal_bound(result, DisplacementAt((0.5, 0.4), 1))
    assert there.lower <= there.discrete <= there.upper
    assert "mean over the element" in there.message

    def wanted(fine):
        return goal_bound(fine, MeanDisplacement("contact", 1)).discrete

    assert mean.lower <= fine_value(problem, wanted) <= mean.upper


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_displacement_at_a_point_is_the_mean_over_the_element_of_the_mesh(dimension):
    """Of a quadrilateral or hexahedron, though bounds cut it: u_N is linear in a pulled block."""
    axes = ("left", "clamped") if dimension == 2 else ("left", "front", "clamped")
    supports = {
        side: tuple(0 if i == axis else None for i in range(dimension))
        for axis, side in enumerate(axes)
    }
    pull = (*(0.0,) * (dimension - 1), 1.0)
    mesh = block.structured_mesh(*(2,) * dimension)
    problem = Problem(mesh, MATERIAL, None, {"contact": pull}, prescribed=supports)
    result = semismooth_newton(problem)
    at = (0.3,) * dimension
    found = goal_bound(result, DisplacementAt(at, dimension - 1))
    middle = 0.25 * result.strain(mesh(*at))[4 * (dimension - 1)]
    assert found.lower <= middle <= found.upper
    assert found.width < 1e-5 * middle
    assert found.discrete == pytest.approx(middle, rel=1e-9)


def test_cells_of_a_finer_mesh_make_up_an_element():
    coarse = block.structured_mesh(3, 2)
    fine = Mesh(cut_into_triangles(coarse).mesh.ngmesh.Copy())
    fine.Refine()
    numbers = [cells_within(fine, coarse, k) for k in range(coarse.ne)]
    assert sorted(np.concatenate(numbers)) == list(range(fine.ne))
    assert {len(cells) for cells in numbers} == {8}


@pytest.mark.parametrize(("dimension", "order"), [(2, 1), (2, 2), (3, 1)])
def test_the_mean_displacement_of_a_side_that_is_pressed_everywhere(dimension, order):
    """It is that of the obstacle: the contact pressure of the adjoint balances the goal's load."""
    axes = ("left", "clamped") if dimension == 2 else ("left", "front", "clamped")
    supports = {
        side: tuple(0 if i == axis else None for i in range(dimension))
        for axis, side in enumerate(axes)
    }
    problem = Problem(
        block.structured_mesh(*(2,) * dimension, simplices=True),
        MATERIAL,
        None,
        prescribed=supports,
        contact="contact",
        gap=-0.01,
        order=order,
    )
    found = goal_bound(
        semismooth_newton(problem), MeanDisplacement("contact", dimension - 1)
    )
    assert found.guaranteed
    assert found.lower <= -0.01 <= found.upper
    assert found.width < 1e-7


def test_a_displacement_in_space():
    problem = Problem(
        block.mesh(0.5), MATERIAL, order=1, traction={"contact": (1.0, 0.0, -2.0)}
    )
    found = goal_bound(semismooth_newton(problem), "work")
    load = problem.tractions["contact"]
    fine = fine_value(problem, lambda r: work_on(r, "contact", load), 3)
    assert found.guaranteed
    assert found.lower <= fine <= found.upper
    assert found.percent < 60


def test_one_of_two_obstacles():
    """The forces on both are the whole."""
    problem = replace(example("lshape", 417), order=1)
    result = semismooth_newton(problem)
    names = problem.contact_names
    one = goal_bound(result, ContactForceOn("|".join(names)))
    both = goal_bound(result, "contact_force")
    assert one.lower == pytest.approx(both.lower, rel=1e-9)


@pytest.mark.parametrize(
    ("goal", "word"),
    [
        (
            "force",
            r"goal='force': 'contact_force', 'work', .*MeanDisplacement\(\.\.\.\)",
        ),
        (3, "goal="),
        ("contact_force", "contact"),
        (Reaction("contact", 0), "support"),
        (DisplacementAt((9.0, 9.0), 0), "point"),
    ],
)
def test_what_is_no_goal_is_refused(goal, word):
    problem = Problem(
        block.mesh(0.5, (1.0, 0.7)), MATERIAL, traction={"contact": (1.0, 0.0)}
    )
    result = semismooth_newton(problem)
    with pytest.raises((TypeError, ValueError), match=word):
        goal_bound(result, goal)


def test_what_a_refusal_advises_covers_the_problem():
    mesh = block.structured_mesh(3, 3, simplices=True)
    held = {"pressure": {"right": y**3}, "order": 2}
    result = semismooth_newton(Problem(mesh, MATERIAL, **held))
    with pytest.raises(ValueError, match=r"; displacement_bracket\(result, \.\.\.\)"):
        goal_bound(result, "work")
    found = displacement_bracket(result, {"right": (1.0, 0.0)})
    assert np.isfinite(found.upper - found.lower)

    ring = Problem(mesh, MATERIAL, pressure={"right": 1.0}, kinematics="axisymmetric")
    with pytest.raises(ValueError, match=r"; confidence\(result\)"):
        goal_bound(semismooth_newton(ring), "work")
    assert confidence(semismooth_newton(ring)).startswith("Guaranteed")
    with pytest.raises(ValueError, match=r"; solve_to\(problem, relative_error\)"):
        solve_to(ring, goal="work")
    assert solve_to(ring, 0.3).reached


@pytest.mark.parametrize("last", [0.1, 1.0])
def test_a_curve_that_ends_leaves_no_interval_but_a_bracket(last):
    """A beam that yields: with hardening that goes on there is an interval, too."""
    mesh = block.structured_mesh(10, 2, size=(100.0, 20.0), simplices=True)
    curve = [(355 / 210e3, 355.0), (0.02, 420.0), (last, 500.0 * last / 0.1)]
    metal = Material.metal(young=210e3, poisson=0.3, curve=curve)
    result = semismooth_newton(
        Problem(mesh, metal, clamped="left", traction={"right": (0.0, -20.0)})
    )
    found = goal_bound(result, MeanDisplacement("right", 1))
    assert np.isfinite(found.width) == (last > 0.1)
    assert ("displacement_bracket" in found.message) == (last == 0.1)
    bracket = displacement_bracket(result, {"right": (0.0, 1 / 20)})
    assert np.isfinite(bracket.upper - bracket.lower)


def test_components_have_numbers():
    with pytest.raises(TypeError, match="'y': 0 for x or 1 for y or 2 for z is needed"):
        MeanDisplacement("top", "y")
    with pytest.raises(ValueError, match="component=3"):
        DisplacementAt((0.0, 0.0, 0.0), 3)
    mesh = block.structured_mesh(2, 2, simplices=True)
    result = semismooth_newton(Problem(mesh, MATERIAL, pressure={"right": 1.0}))
    with pytest.raises(ValueError, match="component=2: 0 for x or 1 for y is needed"):
        goal_bound(result, MeanDisplacement("right", 2))


def test_a_work_of_a_load_that_is_no_vector_is_refused():
    with pytest.raises(TypeError, match="body_force"):
        LoadWork(body_force=(lambda: 1,))


@pytest.mark.parametrize("traction", [None, {}])
def test_the_work_of_no_load_is_refused(traction):
    refusal = "LoadWork needs one of them|traction={}: at least one entry"
    with pytest.raises(ValueError, match=refusal):
        LoadWork(traction)


def test_friction_of_coulomb_is_refused():
    problem = Problem(
        block.mesh(0.5, (1.0, 0.7)),
        MATERIAL,
        contact="contact",
        gap=-0.01,
        friction=Coulomb(0.1),
    )
    with pytest.raises(ValueError, match="friction"):
        goal_bound(semismooth_newton(problem), "contact_force")


def test_facets_with_different_room_do_not_undo_each_other():
    """Below a ball each facet around a vertex leaves another gap: the least one counts.

    The condition on the adjoint holds for a moderate lambda, else intervals are useless.
    """
    result = semismooth_newton(bounded_example("sphere", "uniform", 281))
    goal = GoalProblem(result)
    adjoints = AdjointProblem(goal.bound_data, goal.bound.state, goal.bound.pressure)
    terms = terms_of("contact_force", goal.bound_data)
    z, least = adjoints.repaired(terms, np.zeros_like(goal.bound.state.u), 10.0)
    assert least == 10.0
    mismatch = np.abs(adjoints.mismatch(terms, z))
    assert (mismatch <= 10.0 * adjoints.slack + 1e-6).all()


def in_units(length, stress):
    """A block below a parabola, in other units of length and stress."""
    metal = Material.kinematic(
        lame_lambda=1.5e3 * stress,
        lame_mu=1e3 * stress,
        yield_stress=5.0 * stress,
        hardening=1e2 * stress,
    )
    mesh = block.structured_mesh(4, 4, size=(length, length), simplices=True)
    gap = length * (0.1 * (x / length - 0.4) ** 2 - 4e-3)
    traction = {"right": (2.0 * stress, 0)}
    return Problem(mesh, metal, contact="contact", gap=gap, traction=traction)


def just_touching(length, stress):
    """A longer block that touches the parabola at few nodes."""
    size = (2 * length, length)
    return replace(
        in_units(length, stress),
        mesh=block.structured_mesh(8, 4, size=size, simplices=True),
        gap=length * ((x / length - 0.9) ** 2 / 6 - 1.2e-3),
        traction={"right": (0.3 * stress, -0.1 * stress)},
    )


@pytest.mark.parametrize(("length", "stress"), [(1e3, 1.0), (1.0, 1e6), (1e-3, 1e11)])
def test_intervals_do_not_depend_on_units(length, stress):
    """Conditions on contact hold up to rounding in every unit: none is lost where z is small."""
    one = GoalProblem(semismooth_newton(just_touching(1.0, 1.0)))
    other = GoalProblem(semismooth_newton(just_touching(length, stress)))
    where = [DisplacementAt((0.9 * a, 0.9 * a), 1) for a in (1.0, length)]
    goals = [
        ("contact_force", "contact_force", length * stress),
        (MeanDisplacement("right", 1), MeanDisplacement("right", 1), length),
        (*where, length),
    ]
    for goal, same, unit in goals:
        first = one.bound_of(goal)
        ends = np.array(other.bound_of(same).interval) / unit
        assert ends == pytest.approx(first.interval, abs=1e-5 * first.width)


@pytest.mark.parametrize("gap", [0.02, 0.04])
def test_without_contact_the_interval_of_the_force_is_short(gap):
    """z = 0 suffices for a large lambda, and the interval is that times the error bound."""
    problem = replace(in_units(1.0, 1.0), gap=gap)
    force = goal_bound(semismooth_newton(problem), "contact_force")
    assert force.discrete == 0.0
    assert force.lower == 0.0
    lower, upper = force.proved
    assert lower < 0.0
    assert upper - lower <= 2.2 * force.bound.total / (0.9 * gap)


def test_without_hardening_lambda_grows_until_the_interval_is_finite():
    """The first lambda leaves strains unlimited, although nothing yields."""
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=2.0, plastic_modulus=0.0
    )
    problem = Problem(
        block.structured_mesh(2, 2, simplices=True),
        metal,
        body_force=(0.3, -0.8),
        order=1,
    )
    goal = goal_bound(semismooth_newton(problem), MeanDisplacement("contact", 1))
    assert goal.percent < 20
    assert goal.message == ""


@pytest.mark.parametrize("order", [1, 2])
def test_an_exact_adjoint_has_a_narrow_interval(order):
    """The adjoint of the mean of a side is linear: lambda must not go to zero with its error.

    A body on rollers yields under a traction that varies; the interval was a billion wide.
    """
    metal = Material.kinematic(
        lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
    )
    problem = Problem(
        block.mesh(0.25, (1.0, 0.7)),
        metal,
        clamped=None,
        prescribed={"left": (0.0, None), "clamped": (None, 0.0)},
        traction={"right": (6.0 + y, 1.0)},
        order=order,
    )
    goal = MeanDisplacement("right", 0)
    interval = goal_bound(semismooth_newton(problem), goal)
    fine = semismooth_newton(finer(replace(problem, order=2), 2))
    bound_data = bound_data_of(fine.discrete)
    value = terms_of(goal, bound_data).value(bound_data, fine.state)
    assert interval.adjoint < 1e-12 * interval.bound.total * interval.factor**2
    assert interval.lower < value < interval.upper
    assert interval.percent < 4


@pytest.fixture(scope="module")
def touching():
    return semismooth_newton(just_touching(1.0, 1.0))


def test_the_mean_displacement_of_a_clamped_boundary_is_refused(touching):
    with pytest.raises(ValueError, match="'clamped' is clamped and does not move"):
        goal_bound(touching, MeanDisplacement("clamped", 0))


@pytest.mark.parametrize(
    "goal",
    [MeanDisplacement("joint", 0), LoadWork({"joint": (1.0, 0.0)})],
    ids=["mean", "work"],
)
def test_goals_on_a_line_inside_the_body_are_refused(goal):
    """By the boundary of the goal, not by a load of the problem."""
    square = SplineGeometry()
    corners = ((0, 0), (1, 0), (1, 0.5), (1, 1), (0, 1), (0, 0.5))
    points = [square.AppendPoint(*corner) for corner in corners]
    names = ("clamped", "side", "side", "top", "side", "side")
    layers = (1, 1, 2, 2, 2, 1)
    for k, name in enumerate(names):
        ends = points[k], points[(k + 1) % 6]
        square.Append(["line", *ends], bc=name, leftdomain=layers[k], rightdomain=0)
    ends = points[5], points[2]
    square.Append(["line", *ends], bc="joint", leftdomain=2, rightdomain=1)
    mesh = Mesh(square.GenerateMesh(maxh=0.6))
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, hardening=100.0
    )
    result = semismooth_newton(
        Problem(mesh, steel, "clamped", traction={"top": (0.1, 0.0)})
    )
    with pytest.raises(ValueError, match=r"'joint' of the goal: .* outer boundary"):
        goal_bound(result, goal)
    assert goal_bound(result, MeanDisplacement("top", 0)).lower > 0


def test_a_printed_goal_says_its_component(touching):
    found = goal_bound(touching, Reaction("clamped", 1))
    assert str(found).startswith("reaction of clamped along y: ")
