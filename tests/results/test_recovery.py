"""Recovered fields and forces: one contract for both methods, equilibrium of forces and moments."""

import inspect
from dataclasses import replace

import numpy as np
import pytest
from coordinates import deviator, tensor
from ngsolve import CF, GridFunction, Id, IfPos, Integrate, Norm, VectorH1, ds, x, y, z
from pairs import in_turn

from ngepc import (
    Material,
    Problem,
    follow_path,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.dual.blocks import primal_energy
from ngepc.geometries import block, lshape, ring, wrench
from ngepc.primal.solver import PrimalOptions, primal_newton
from ngepc.results.fields import Fields
from ngepc.results.outcome import SolverError, Status
from ngepc.results.remarks import large_motion, large_part
from ngepc.results.result import Result

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
METHODS = ("primal", "dual")


def solved(method, problem):
    if method == "primal":
        return primal_newton(
            problem, options=PrimalOptions(tolerance=1e-12)
        ).raise_for_status()
    return semismooth_newton(problem)


def pushed_everywhere():
    """A square on rollers that move, body force, shear, two obstacles."""
    return Problem(
        block.structured_mesh(6, 6, simplices=True),
        STEEL,
        clamped=None,
        prescribed={"clamped": (None, 0.001 * x), "left": (0.002 * y, None)},
        traction={"contact": (0.5, 1.0), "right": (0.0, y)},
        contact="contact|right",
        gap={"contact": -0.001, "right": 0.0005},
        body_force=(x, 2.0 - y),
    )


def pressed_ring(curved=False):
    """A ring on a clamped bore, pushed into a rigid wall on one side."""
    mesh = ring.mesh(0.45)
    if curved:
        mesh.Curve(2)
    return Problem(
        mesh,
        STEEL,
        "inner",
        contact="outer",
        gap=0.001 - 0.003 * x,
        body_force=(0.3, 0.1),
    )


def shaken_block():
    """A cube with memory, two obstacles, three supports and loads in all directions."""
    p_0 = deviator(CF((1e-3, 5e-4 * x, 0, 5e-4 * x, -1e-3, 0, 0, 0, 0), dims=(3, 3)), 3)
    return Problem(
        block.structured_mesh(3, 3, 3, simplices=True),
        STEEL,
        clamped=None,
        contact="contact|left",
        gap={"contact": -0.004 + 0.002 * x, "left": 1e-4},
        traction={"right": (-1.0, 0.2, 0.4 * z), "back": (0.1, -0.5, 0.0)},
        prescribed={
            "clamped": (None, 0.0, 0.0),
            "front": (None, 0.001 * z, None),
            "right": (-0.001, None, None),
        },
        body_force=(0.1, -0.2, z),
        initial_plastic_strain=p_0,
        initial_hardening=100.0 * p_0,
    )


def holed_plate():
    """A plate with the hole as third obstacle, no support beyond two rollers."""
    return Problem(
        block.with_hole(0.4, (2.0, 2.0)),
        STEEL,
        clamped=None,
        prescribed={"left": (0, None), "clamped": (None, 0)},
        contact="hole|contact",
        gap={"hole": 0.002 * (y - 1) - 0.001, "contact": 0.0},
        traction={"right": (-1.5, 0.1)},
    )


CASES = {
    "pushed": pushed_everywhere,
    "ring": pressed_ring,
    "curved": lambda: pressed_ring(curved=True),
    "shaken": shaken_block,
    "hole": holed_plate,
}


@pytest.fixture(scope="module")
def results():
    return {
        (name, method): solved(method, make())
        for name, make in CASES.items()
        for method in METHODS
    }


@pytest.mark.parametrize(("method", "case"), in_turn(METHODS, CASES))
def test_forces_and_moments_of_loads_obstacles_and_supports_vanish_together(
    results, case, method
):
    result = results[case, method]
    assert result.status is Status.CONVERGED
    forces = result.applied_force + result.contact_resultant + result.reaction
    size = max(np.abs(result.reaction).max(), result.contact_force)
    assert np.abs(forces).max() < 1e-10 * size
    at = result.equilibrium
    total = at.applied + at.contact + at.reaction
    moment = at.moment(total, (0.3,) * result.problem.N)
    straight = result.problem.mesh.GetCurveOrder() == 1
    assert np.abs(moment).max() < (1e-10 if straight else 1e-3) * size
    assert np.abs(at.free_residual).max() < 1e-10 * size
    assert result.contact_force > 0.05


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", CASES)
def test_applied_force_is_the_integral_of_the_loads(results, case, method):
    result = results[case, method]
    problem = result.problem
    for i, force in enumerate(result.applied_force):
        total = Integrate(problem.f[i], problem.mesh) if problem.f is not None else 0.0
        total += sum(
            Integrate(g[i] * ds(name), problem.mesh)
            for name, g in problem.tractions.items()
        )
        assert force == pytest.approx(total, abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", CASES)
def test_reactions_of_the_supports_add_up(results, case, method):
    result = results[case, method]
    reactions = result.equilibrium.reactions
    names = set(result.problem.clamped_names) | set(result.problem.prescribed or {})
    assert set(reactions) == names
    assert sum(reactions.values()) == pytest.approx(result.reaction, abs=1e-12)


@pytest.mark.parametrize("order", [1, 2])
def test_the_axis_of_a_ring_is_no_support(order):
    """What keeps its nodes there is no reaction, unless a support has them."""
    mesh = block.structured_mesh(4, 4, simplices=True)
    pressed = {"contact": "contact", "gap": -0.005, "order": order}
    for held in (None, {"left": (0, None)}):
        ring = Problem(
            mesh, STEEL, prescribed=held, kinematics="axisymmetric", **pressed
        )
        result = semismooth_newton(ring)
        reactions = result.equilibrium.reactions
        assert sum(reactions.values()) == pytest.approx(result.reaction, rel=1e-12)
        assert abs(result.reaction[0]) > 1e-2 * result.contact_force


def test_contact_resultant_is_the_sum_of_the_row_forces(results):
    for case in CASES:
        result = results[case, "dual"]
        rows = result.discrete.rows
        nv, N = result.problem.mesh.nv, result.problem.N
        forces = rows.normal.T @ result.nodal_contact_forces
        total = -forces.reshape(-1, N)[:nv].sum(axis=0)
        assert result.contact_resultant == pytest.approx(total, rel=1e-12, abs=1e-14)


def test_rollers_carry_only_their_own_component():
    """A square pulled to the right between two rollers that hold one component each."""
    problem = Problem(
        block.structured_mesh(2, 2),
        STEEL,
        clamped=None,
        prescribed={"left": (0, None), "clamped": (None, 0)},
        traction={"right": (1.0, 0.0), "contact": (0.0, 3.0)},
    )
    for method in METHODS:
        reactions = solved(method, problem).equilibrium.reactions
        assert reactions["left"] == pytest.approx([-1.0, 0.0], abs=1e-11)
        assert reactions["clamped"] == pytest.approx([0.0, -3.0], abs=1e-11)


def test_moment_of_a_couple():
    """Two opposite forces at distance 1 from each other, about any point."""
    result = solved("primal", pushed_everywhere())
    points = np.asarray(result.problem.mesh.ngmesh.Coordinates())[:, :2]
    forces = np.zeros((2, len(points)))
    forces[1, np.linalg.norm(points - (1, 0), axis=1) < 1e-9] = 2.0
    forces[1, np.linalg.norm(points, axis=1) < 1e-9] = -2.0
    for about in (None, (5.0, -3.0)):
        assert result.equilibrium.moment(forces, about) == pytest.approx([2.0])
    for sums in (result.equilibrium.moment, result.equilibrium.resultant):
        with pytest.raises(ValueError, match=r"forces=.*those of all nodes are needed"):
            sums(result.reaction)


def test_the_two_methods_agree_on_forces():
    problem = lshape_problem(lshape.paper_mesh(417))
    primal, dual = solved("primal", problem), solved("dual", problem)
    assert dual.reaction == pytest.approx(primal.reaction, abs=1e-11)
    assert dual.contact_force == pytest.approx(primal.contact_force, rel=1e-11)


@pytest.mark.parametrize("method", METHODS)
def test_results_keep_the_contract(results, method):
    result = results["pushed", method]
    promised = set(Result.__annotations__) | {
        name
        for name, value in vars(Result).items()
        if inspect.isfunction(value) and name[0] != "_"
    }
    assert not [name for name in promised if not hasattr(result, name)]
    assert result.raise_for_status() is result


@pytest.mark.parametrize("method", METHODS)
def test_recovered_fields_are_those_of_the_formulas(results, method):
    result = results["shaken", method]
    problem, mesh = result.problem, result.problem.mesh
    point = mesh(0.41, 0.37, 0.83)
    of_stress = result.plastic_increment
    elastic = result.strain - problem.p_0 - tensor(of_stress, 3)
    sigma = 1e3 * (elastic[0] + elastic[4] + elastic[8]) * Id(3) + 2e3 * elastic
    assert result.stress(point) == pytest.approx(sigma(point), rel=1e-12)
    trace = sum(result.deviatoric_stress(point)[i] for i in (0, 4, 8))
    assert trace == pytest.approx(0.0, abs=1e-12)
    gained = result.plastic_strain - problem.p_0
    back = problem.alpha_0[1] + 100.0 * gained
    assert result.back_stress(point) == pytest.approx(back(point), abs=1e-12)
    size = np.linalg.norm(result.plastic_strain(point))
    assert result.equivalent_plastic_strain(point) == pytest.approx(size, rel=1e-12)
    assert result.plastic_zone(0.5 * size)(point) == 1.0
    assert result.plastic_zone(2.0 * size)(point) == 0.0
    assert Integrate(Norm(result.plastic_increment), mesh) > 0


@pytest.mark.parametrize("method", METHODS)
def test_pressure_is_where_the_obstacle_pushes(results, method):
    """It leaves the left part of the top alone and pushes the rest in."""
    problem = Problem(
        block.structured_mesh(8, 8, simplices=True),
        STEEL,
        contact="contact",
        gap=0.001 - 0.004 * x,
    )
    pressure, mesh = solved(method, problem).contact_pressure, problem.mesh
    assert pressure(mesh(0.07, 1.0)) < 1e-3
    assert pressure(mesh(0.83, 1.0)) > 1e-3


def test_a_run_that_is_stopped_raises_on_request():
    def stop(record):
        raise StopIteration

    result = semismooth_newton(pushed_everywhere(), 1e3, monitor=stop)
    with pytest.raises(SolverError, match="stopped") as caught:
        result.raise_for_status()
    assert caught.value.result is result


def test_displacements_of_order_one_are_named_unless_the_law_is_the_paper_s():
    problem = Problem(
        block.structured_mesh(2, 2), STEEL, traction={"contact": (0.0, 0.1)}
    )
    note = "Displacements are of order 1"
    assert semismooth_newton(problem).message == ""
    assert note in semismooth_newton(replace(problem, order=1)).message
    flat = replace(problem, kinematics="two-dimensional")
    assert semismooth_newton(flat).message == ""


@pytest.mark.parametrize(
    ("gradient", "strain", "rotation"),
    [
        (((0.0, -0.06), (0.06, 0.0)), 0.0, 0.06),
        (((0.04, 0.0), (0.0, 0.0)), 0.04, 0.0),
        (((0.02, -0.04), (0.04, 0.0)), 0.02, 0.04),
    ],
)
def test_large_strains_and_rotations_are_said_with_what_is_off(
    gradient, strain, rotation
):
    """An affine motion of the whole boundary: strain and rotation are known."""
    mesh = block.structured_mesh(2, 2)
    (a, b), (c, d) = gradient
    motion = (a * x + b * y, c * x + d * y)
    held = dict.fromkeys(("left", "clamped", "right", "contact"), motion)
    result = semismooth_newton(Problem(mesh, STEEL, None, prescribed=held))
    assert result.largest_strain == pytest.approx(strain, abs=1e-9)
    assert result.largest_rotation == pytest.approx(rotation, abs=1e-9)
    said = "the model is for small ones" in result.message
    assert said == (strain > 0.03 or rotation > 0.05)
    if rotation > 0.05:
        assert "takes for a strain of 0.18 percent" in result.message
    assert ("rotations" in result.message) == (said and rotation > 0)


@pytest.mark.parametrize(
    ("slope", "part"),
    [
        ((0.031, 0.0), 0.25),
        ((0.029, 0.0), 0.0),
        ((0.0, 0.11), 0.25),
        ((0.0, 0.02), 0.0),
    ],
)
@pytest.mark.parametrize("kinematics", ["plane strain", "axisymmetric"])
def test_large_strains_are_said_with_the_part_of_the_volume(slope, part, kinematics):
    """Strained or sheared beyond x = 3/4; of a ring that is 1 - (3/4)^2 of the volume."""
    mesh = block.structured_mesh(4, 1)
    problem = Problem(mesh, STEEL, "clamped", kinematics=kinematics)
    u = GridFunction(VectorH1(mesh, order=2))
    beyond = IfPos(x - 0.75, x - 0.75, 0.0)
    u.Set(CF((slope[0] * beyond, slope[1] * beyond)))
    fields = Fields(problem, u, CF((0.0,) * problem.kinematics.d))
    found = large_part(fields)
    if kinematics == "axisymmetric":
        part *= 1.75
    assert found == pytest.approx(part, abs=1e-12)


@pytest.mark.parametrize(
    ("part", "words"),
    [(0.25, "in 25 percent of the body"), (0.0034, "0.34 percent of")],
)
def test_large_strains_at_a_corner_are_called_local(part, words):
    said = large_motion(0.71, 0.81, part)
    assert words in said
    assert ("the model is for small ones" in said) == (part > 0.01)
    assert ("with every refinement" in said) == (part < 0.01)


def test_gamma_takes_order_one_where_no_order_is_given_and_says_so():
    problem = Problem(
        block.structured_mesh(2, 2), STEEL, traction={"contact": (0.0, 0.1)}
    )
    result = semismooth_newton(problem, gamma=1e3)
    assert problem.order == 2
    assert result.problem.order == 1
    assert "order 1, as the regularised method needs them" in result.message
    assert result.message == follow_path(problem).message
    with pytest.raises(ValueError, match=r"order=2: .* needs .*order=1"):
        semismooth_newton(replace(problem, order=2), gamma=1e3)


@pytest.fixture(scope="module")
def turned():
    """Example (b), where P1 functions q miss most of the constant strains on the handle."""
    problem = wrench_problem(wrench.paper_mesh(873))
    return solved("dual", problem), solved("primal", problem)


def test_plastic_strain_of_the_dual_method_is_the_one_of_least_energy(turned):
    """For the displacement at hand any other p costs more."""
    dual, primal = turned
    problem, u, p = dual.problem, dual.displacement, dual.plastic_increment
    least = primal_energy(problem, u, p)
    generator = np.random.default_rng(3)
    for size in (1e-5, 1e-3):
        other = GridFunction(p.space)
        other.vec.FV().NumPy()[:] = p.vec.FV().NumPy()
        other.vec.FV().NumPy()[:] += size * generator.standard_normal(len(p.vec))
        assert primal_energy(problem, u, other) > least
    worth = primal.primal_energy
    assert least == pytest.approx(worth, rel=1e-12)
    assert dual.primal_energy == pytest.approx(worth, rel=1e-12)
    returned = Fields(problem, u, p)
    assert (
        Integrate(IfPos(returned.yield_function - 1e-12, 1.0, 0.0), problem.mesh) == 0.0
    )


def test_plastic_strain_of_the_dual_method_is_close_to_the_primal_one(turned):
    """In L2 and in the dissipation."""
    dual, primal = turned
    mesh, q = dual.problem.mesh, primal.plastic_increment

    def distance(p):
        return (Integrate((p - q) * (p - q), mesh) / Integrate(q * q, mesh)) ** 0.5

    assert distance(dual.plastic_increment) < 1e-10
    lengths = [Integrate(Norm(p), mesh) for p in (dual.plastic_increment, q)]
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-10)
