"""Records, stored arrays, fingerprints and messages beside plain statements."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from netgen.occ import OCCGeometry, WorkPlane
from ngsolve import CF, Mesh, y
from solved import lshape_primal
from teams import Jacobi

from ngepc import (
    Coulomb,
    Material,
    NewtonOptions,
    Problem,
    Status,
    evolve,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.local.result import ExactResult
from ngepc.model.elements import largest_slenderness
from ngepc.model.obstacles import Disc
from ngepc.results.checkpoint import problem_fingerprint
from ngepc.results.ending import keeps_falling
from ngepc.results.outcome import History
from ngepc.results.records import FIELDS, checked, provenance, solve_record
from ngepc.results.stored import array_of, value_of

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
)


@pytest.fixture
def record():
    """The record of a solve, as it is stored."""
    found = solve_record("lshape", lshape_primal(), 1.5)
    extra = {"method": "primal", "gamma": None, "start": "zero", "error_asked": None}
    extra |= {"error_bound": None, "guaranteed": None}
    extra |= {"goal_lower": None, "goal_upper": None}
    return found | extra | provenance()


def test_a_record_has_all_fields_and_no_others(record):
    assert checked(record) == record
    assert set(record) == set(FIELDS)
    for name in FIELDS:
        rest = {key: value for key, value in record.items() if key != name}
        with pytest.raises(KeyError, match=name):
            checked(rest)
    with pytest.raises(KeyError, match="colour is no field"):
        checked(record | {"colour": "red"})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("version", 1.0),
        ("command", None),
        ("message", ["none"]),
        ("nodes", 2.5),
        ("iterations", -1),
        ("residual_norms", [1.0, None]),
        ("guaranteed", "yes"),
        ("wall_time_s", "long"),
    ],
)
def test_a_field_of_another_kind_is_named(name, value, record):
    assert name in FIELDS
    with pytest.raises(TypeError, match=name):
        checked(record | {name: value})


@pytest.mark.parametrize(
    "found",
    [
        None,
        np.arange(3),
        np.ones(3, dtype=np.float32),
        np.ones((3, 1)),
        np.array([1.0, np.nan, 2.0]),
    ],
)
def test_stored_arrays_are_finite_real_numbers_of_one_shape(found):
    good = np.array([1.0, 2.0, 3.0])
    assert array_of(Path("run.npz"), {"u": good}, "u", 3) is good
    with pytest.raises(ValueError, match=r"run\.npz is damaged: 'u'"):
        array_of(Path("run.npz"), {} if found is None else {"u": found}, "u", 3)


def test_loads_that_differ_between_vertices_have_other_fingerprints():
    """The cubic vanishes at all vertices."""
    mesh = block.structured_mesh(2, 2)

    def fingerprint(size):
        wave = CF((0.0, size * y * (y - 0.5) * (y - 1)))
        return problem_fingerprint(Problem(mesh, METAL, traction={"right": wave}))

    assert fingerprint(1.0) == fingerprint(1.0)
    assert fingerprint(1.0) != fingerprint(2.0)


def test_a_body_at_rest_overlaps_nothing():
    mesh = block.structured_mesh(2, 2)
    rest = semismooth_newton(Problem(mesh, METAL, contact="contact", gap=0.5))
    assert rest.status is Status.CONVERGED
    assert "overlaps" not in rest.message


def test_the_largest_strain_is_the_frobenius_norm():
    """Of a body that is stretched and sheared uniformly."""
    mesh = block.structured_mesh(2, 2, size=(1.0, 1.0))
    sides = "|".join(sorted(set(mesh.GetBoundaries())))
    moved = {sides: (3e-4 * y, -2e-4 * y)}
    result = semismooth_newton(Problem(mesh, METAL, None, prescribed=moved))
    strain = np.array([[0.0, 1.5e-4], [1.5e-4, -2e-4]])
    assert result.largest_strain == pytest.approx(np.linalg.norm(strain), rel=1e-9)


def test_a_linear_solver_that_was_asked_for_is_not_exchanged():
    """One step of conjugate gradients is too few: the run says so, and ends."""
    problem = Problem(block.structured_mesh(4, 4), METAL, traction={"right": (1.0, 0)})
    options = NewtonOptions(inverse=Jacobi(max_iterations=1))
    result = semismooth_newton(problem, options=options)
    assert result.status is Status.NONFINITE
    assert "1 iteration, as on thin plates" in result.message
    assert "leave inverse out" in result.message
    assert "linear solver failed" in result.status.value


def test_equilibrium_is_shown_by_its_resultants():
    problem = Problem(
        block.structured_mesh(1, 1), METAL, "clamped", traction={"right": (0.5, -1.0)}
    )
    shown = repr(semismooth_newton(problem).equilibrium)
    assert shown.startswith("<Equilibrium: applied (0.5, -1), contact (")
    assert "reaction (-0.5, 1)" in shown


def test_the_worst_remark_comes_first():
    """Strains outside of the model, before contact that a finer mesh resolves."""
    problem = Problem(
        block.structured_mesh(2, 2), METAL, contact="contact", gap=-0.2, order=1
    )
    message = semismooth_newton(problem).message
    assert message.startswith("Strains reach ")
    assert "whole facets, 3 nodes)" in message


def test_nothing_is_said_about_displacements_that_are_no_numbers():
    """Strains of nan percent in a part of the body, and overlaps by up to 0."""
    mesh = block.structured_mesh(2, 2)
    given = semismooth_newton(Problem(mesh, METAL, contact="contact", gap=0.5))
    lost = given.discrete.state(np.full_like(given.state.u, np.nan))
    assert ExactResult(lost, Status.NONFINITE, "", History()).message == ""


def test_a_body_without_loads_says_so():
    mesh = block.structured_mesh(2, 2)
    idle = semismooth_newton(Problem(mesh, METAL)).message
    assert idle == "Nothing loads or moves the body: its displacements are zero."
    pulled = Problem(mesh, METAL, traction={"right": (1e-12, 0.0)})
    assert semismooth_newton(pulled).message == ""


def bent(length):
    """A bar of thickness 0.1, two cells each way, under a load with the same slopes."""
    mesh = block.structured_mesh(2, 2, size=(length, 0.1), simplices=True)
    load = {"contact": (0.0, -1e-8 / length**3)}
    result = semismooth_newton(Problem(mesh, METAL, "left", load, order=2))
    return result, result.displacement(mesh(length, 0.05))[1] / length


@pytest.mark.parametrize(
    ("length", "status"), [(300.0, Status.CONVERGED), (3000.0, Status.STAGNATED)]
)
def test_where_rounding_changes_a_deflection_status_and_message_say_so(length, status):
    """The slope of a slender beam is that of any other one; the residual is always small."""
    (_, known), (result, slope) = bent(10.0), bent(length)
    assert result.history.records[-1].residual_norm < 1e-10
    assert result.status is status
    wrong = status is Status.STAGNATED
    assert (abs(slope / known - 1) > 1e-3) is wrong
    assert ("Loads and reactions are out of balance" in result.message) is wrong
    assert ("A tolerance above" in result.message) is False


def test_deflection_of_a_beam_five_thousand_times_as_long_as_thick():
    """q L^4 / 8 E' I with E' = E / (1 - nu^2); one solve with the factors is percents off."""
    L, t = 500.0, 0.1
    elastic = METAL.young / (1 - METAL.poisson**2)
    force = 1e-4 * 8 * elastic * (t**3 / 12) / L**3
    mesh = block.structured_mesh(500, 1, size=(L, t))
    load = {"contact": (0.0, -force)}
    result = semismooth_newton(Problem(mesh, METAL, "left", load, order=2))
    assert result.status is Status.CONVERGED
    assert result.message == ""
    assert result.displacement(mesh(L, t / 2))[1] == pytest.approx(-1e-4 * L, rel=1e-3)


@pytest.mark.parametrize(
    ("ratio", "last", "keeps"), [(0.9, 300, False), (0.99, 300, True)]
)
def test_falls_of_the_energy_continue_as_a_geometric_sequence(ratio, last, keeps):
    """Energies 1 + r^k fall by (1 - r) r^k: below 1e-8 before 300 steps, or not."""
    start = lshape_primal().history.records[0]
    steps = [replace(start, iteration=k, energy=1 + ratio**k) for k in range(10)]
    assert keeps_falling(History(steps), last) is keeps
    assert keeps_falling(History(steps), 3000) is False
    assert keeps_falling(History(steps[:3]), last) is False


def test_a_run_ends_soon_where_factors_hardly_lower_the_energy():
    mesh = block.structured_mesh(500, 1, size=(3000.0, 0.1))
    load = {"contact": (0.0, -1e-18)}
    result = semismooth_newton(Problem(mesh, METAL, "left", load, order=2))
    assert result.status in (Status.STAGNATED, Status.LINESEARCH_FAILED)
    assert result.iterations < 20
    assert "A tolerance above" not in result.message


def test_slender_elements_are_named_where_they_stop_the_solver():
    result, _ = bent(1e4)
    assert not result.status.is_success
    assert "Elements are up to 1.2e+05 times as long as thick" in result.message


@pytest.mark.parametrize("N", [2, 3])
def test_slenderness_of_elements(N):
    """Of cubes and of bricks that are stretched; of a regular triangle."""
    size = (1.0, 2.0, 7.0)[:N]
    assert largest_slenderness(block.structured_mesh(*[2] * N)) == pytest.approx(1)
    bricks = block.structured_mesh(*[2] * N, size=size)
    assert largest_slenderness(bricks) == pytest.approx(size[-1])
    triangle = WorkPlane().MoveTo(0, 0).LineTo(1, 0).LineTo(0.5, 0.75**0.5).Close()
    regular = OCCGeometry(triangle.Face(), dim=2).GenerateMesh(maxh=2)
    assert largest_slenderness(Mesh(regular)) == pytest.approx(1)


@pytest.mark.parametrize(
    ("hint", "value"),
    [
        (bool, True),
        (str, "a"),
        (int, 0),
        (float, -1.5),
        (float, 2),
        (float | None, None),
        (float | None, 1.0),
        (list[float], [1.0, 2]),
        (list[float], []),
        (dict[str, int], {"a": 1}),
        (Status, Status.CONVERGED),
    ],
)
def test_values_are_those_of_their_hints(hint, value):
    """Members of an Enum are stored by their names."""
    stored = value.name if hint is Status else value
    found = value_of("it", hint, stored)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("hint", "value"),
    [
        (bool, 1),
        (str, 1),
        (int, -1),
        (int, 1.0),
        (int, True),
        (float, True),
        (float, float("nan")),
        (float, float("inf")),
        (float, None),
        (float, "1"),
        (list[float], ""),
        (list[float], {}),
        (list[float], ["a"]),
        (dict[str, int], []),
        (dict[str, int], {"a": 0.5}),
        (Status, 1),
    ],
)
def test_values_of_other_types_are_named(hint, value):
    with pytest.raises(TypeError, match=r"^it="):
        value_of("it", hint, value)
    hole = value_of("it", float, float("nan"), holes=True)
    assert hole != hole


def test_an_obstacle_beside_the_body_is_said():
    """Rays along the normals miss it; above the body it is as far as the message says."""
    mesh = block.structured_mesh(2, 2)
    for place, missed in ((5.0, True), (0.5, False)):
        gap = Disc(centre=(place, 1.5), radius=0.4).gap(mesh)
        body = Problem(mesh, METAL, "left", contact="contact", gap=gap)
        message = semismooth_newton(body).message
        assert ("no obstacle lies along the normals" in message) == missed
        assert ("the smallest gap left is 0.1 at (0.5, 1.0)." in message) != missed


def test_only_solutions_say_that_nothing_touches():
    """A step that is not finished, or that penetrates, says nothing about contact."""
    problem = Problem(
        block.structured_mesh(2, 2),
        METAL,
        traction={"right": (0.5, 0.0)},
        contact="contact",
        gap=1.0,
    )
    solved = semismooth_newton(problem)
    said = "Nothing touches the obstacle"
    assert said in solved.message
    for status in Status:
        other = replace(solved, status=status, ending="")
        assert (said in other.message) == status.is_solution
    assert Status.MESH_LIMIT.is_solution
    assert not Status.NONFINITE.is_solution
    discrete = replace(problem, gap=-0.1)
    inside = semismooth_newton(discrete, options=NewtonOptions(max_iterations=1))
    inside = replace(inside, status=Status.STAGNATED)
    assert inside.open_gap.min() < 0 or inside.contact_force > 0
    assert said not in inside.message


@pytest.mark.parametrize("order", [1, 2])
def test_the_gap_left_is_that_of_the_obstacle_also_where_nodes_are_far_apart(order):
    """A disc 1.2 above a block with two edges on top: rows of order two are as near as 0.7."""
    mesh = block.structured_mesh(2, 2, size=(10, 10))
    gap = Disc(centre=(3.75, 10 + 1.2 + 5.0), radius=5.0).gap(mesh)
    result = semismooth_newton(
        Problem(mesh, METAL, contact="contact", gap=gap, order=order)
    )
    assert "the smallest gap left is 1.2 at (3.75, 10.0)." in result.message
    if order == 2:
        assert result.open_gap.min() < 1.1


def test_a_body_that_reaches_its_obstacle_without_a_force_is_not_told_that_nothing_touches():
    touching = Problem(block.structured_mesh(2, 2), METAL, contact="contact", gap=0.0)
    message = semismooth_newton(touching).message
    assert "Nothing touches" not in message
    assert "No contact force acts: the body just reaches the obstacle" in message


def test_iterates_beyond_the_limit_load_say_nothing_of_their_strains():
    """They diverge, by 1e4 percent here, which is no property of the body."""
    soft = Material.metal(young=1e3, poisson=0.3, yield_stress=5.0, tangent_modulus=0.0)
    pulled = Problem(block.structured_mesh(4, 4), soft, traction={"right": (20.0, 0.0)})
    result = semismooth_newton(pulled)
    assert result.status is Status.LIMIT_LOAD
    assert result.largest_strain > 1
    assert "Strains reach" not in result.message
    assert "limit_load(problem) bounds" in result.message


def test_steps_that_are_used_up_beyond_the_limit_load_name_it():
    """Strains of 2100 percent after ten steps are no property of the body."""
    soft = Material.metal(young=1e3, poisson=0.3, yield_stress=5.0, tangent_modulus=0.0)
    mesh = block.structured_mesh(4, 4, simplices=True)
    pushed = Problem(mesh, soft, "clamped", traction={"contact": (1.8, 0)}, order=2)
    result = semismooth_newton(pushed, options=NewtonOptions(max_iterations=10))
    assert result.status is Status.ITERATION_LIMIT
    assert result.largest_strain > 1
    assert "near the limit load or beyond it" in result.message
    assert "limit_load(problem) bounds" in result.message
    assert "Strains reach" not in result.message


@pytest.mark.parametrize(
    ("friction", "gap", "said"),
    [
        (0.2, -0.1, True),  # pressures of some 100
        (0.2, -1e-4, False),  # of 0.1
        (5.0, -0.1, False),
        (0.0, -0.1, False),
        (Coulomb(0.2), -0.1, False),
    ],
)
def test_a_bound_of_friction_that_looks_like_a_coefficient_is_named(
    friction, gap, said
):
    hard = replace(METAL, yield_stress=1e4)
    mesh = block.structured_mesh(4, 4)
    problem = Problem(mesh, hard, contact="contact", gap=gap, friction=friction)
    result = semismooth_newton(problem)
    pressure = result.contact_force / result.contact_area
    assert result.largest_pressure >= pressure > 0.1
    named = "a coefficient of friction is friction=Coulomb(0.2)"
    assert (named in result.message) is said
    history = evolve(problem, [(1.0, {})])
    assert (named in history.message) is said
