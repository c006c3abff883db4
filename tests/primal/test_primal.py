"""The primal solver: closed forms, identities, step-42, counts, statuses."""

import dataclasses
import math
import re

import numpy as np
import pytest
from bodies import FLAT
from campaigns.random_problems import Draw, build
from ngsolve import (
    CF,
    H1,
    GridFunction,
    IfPos,
    Integrate,
    Norm,
    Parameter,
    dx,
    specialcf,
    sqrt,
    x,
    y,
)
from pairs import in_turn
from witness import balance_residual

from ngepc import lshape_problem, semismooth_newton
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.points import interpolated
from ngepc.discretisation.rows import contact_rows
from ngepc.discretisation.spaces import nodal
from ngepc.discretisation.supports import Supports
from ngepc.geometries import block, lshape, ring
from ngepc.linalg.linesearch import nearly_flat
from ngepc.model.elements import plastic_points
from ngepc.model.hardening import Voce
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.model.tensile import lame_parameters
from ngepc.primal.energy import PrimalState, ReducedEnergy
from ngepc.primal.solver import PrimalOptions, primal_newton
from ngepc.results.outcome import SolverError, Status

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
TRACE_FREE = CF((1e-3 * x, 2e-3, 2e-3, -1e-3 * x), dims=(2, 2))


def example_a(mesh, **changes):
    data = {
        "contact": "contact",
        "gap": 0.1,
        "traction": {"load": -10 * specialcf.normal(2)},
        **changes,
    }
    return Problem(mesh, STEEL, kinematics="two-dimensional", **data)


def bar(material, load, n=2, **changes):
    """A unit square on rollers, pulled at the right: one homogeneous stress diag(load, 0)."""
    rollers = {"left": (0, None), "clamped": (None, 0)}
    traction = {"right": (load, 0)}
    data = {"clamped": None, "prescribed": rollers, "traction": traction, **changes}
    return Problem(
        block.structured_mesh(n, n), material, kinematics="two-dimensional", **data
    )


def loaded_everyhow(mesh):
    return example_a(
        mesh,
        traction={"load": (3.0, 9.0), "free": (0.5, y)},
        body_force=(1.0, x),
        gap=0.05 + 0.1 * x * x,
        initial_plastic_strain=TRACE_FREE,
        initial_hardening=0.2 * STEEL.hardening * TRACE_FREE,
    )


def step_42(n):
    """The body of deal.II's tutorial step-42 on n x n x n hexahedra."""
    lame_lambda, lame_mu = lame_parameters(2e5, 0.3)
    g, bound = 0.01, 400.0
    material = Material.isotropic(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=bound,
        hardening_modulus=1 / bound,
        hardening_stiffness=2 * lame_mu * g / (1 - g),
    )
    under = 0.36 - (x - 0.5) ** 2 - (y - 0.5) ** 2
    gap = IfPos(under - 1e-12, 0.59 - sqrt(IfPos(under, under, 0.0)), 1e3)
    sides = dict.fromkeys(("left", "right", "front", "back"), (0, 0, None))
    mesh = block.structured_mesh(n, n, n)
    return Problem(
        mesh,
        material,
        contact="contact",
        gap=gap,
        prescribed=sides,
        kinematics=FLAT[mesh.dim],
        order=1,
    )


def test_step_42_contact_force_is_that_of_its_documentation():
    result = primal_newton(step_42(8)).raise_for_status()
    assert result.contact_force == pytest.approx(37.3058, abs=5e-5)
    assert result.iterations <= 8
    assert np.abs(result.reaction + result.contact_resultant).max() < 1e-11 * 37


@pytest.fixture(scope="module")
def ladder():
    """Example (a), cold and nested, on the paper's meshes from 417 to 1601 nodes."""
    results, nested = {}, {}
    for nodes in (417, 833, 1601):
        problem = example_a(lshape.paper_mesh(nodes))
        results[nodes] = primal_newton(problem)
        if nodes > 417:
            coarser = list(results.values())[-2]
            nested[nodes] = primal_newton(problem, start=coarser)
    return results, nested


def test_example_a_takes_few_steps_cold_and_nested(ladder):
    cold, nested = ladder
    assert all(r.status is Status.CONVERGED for r in (*cold.values(), *nested.values()))
    assert all(r.iterations <= 16 for r in cold.values())
    assert all(r.iterations <= 8 for r in nested.values())


def test_nested_and_cold_starts_reach_the_same_minimum(ladder):
    cold, nested = ladder
    for nodes, result in nested.items():
        assert result.primal_energy == pytest.approx(
            cold[nodes].primal_energy, rel=1e-13
        )
        assert result.contact_force == pytest.approx(
            cold[nodes].contact_force, rel=1e-10
        )


def test_energies_fall_on_nested_meshes(ladder):
    energies = [r.primal_energy for r in ladder[0].values()]
    assert energies[0] > energies[1] > energies[2] > -0.37525


def test_energies_fall_with_every_step(ladder):
    energies = np.array(ladder[0][1601].history.energies)
    assert (np.diff(energies) <= 1e-14).all()


@pytest.mark.parametrize("make", [example_a, loaded_everyhow])
def test_minimum_satisfies_the_energy_identity_to_round_off(make):
    result = primal_newton(make(lshape.paper_mesh(225))).raise_for_status()
    assert abs(result.primal_energy + result.dual_energy) < 1e-13 * abs(
        result.primal_energy
    )


def test_energy_identity_written_out():
    problem = example_a(lshape.paper_mesh(225))
    result = primal_newton(problem)
    nodal_energy = ReducedEnergy(problem)
    on_points = dx(intrules=nodal_energy.rules)
    dissipation = Integrate(
        problem.beta * Norm(result.plastic_increment) * on_points, problem.mesh
    )
    load = np.vdot(nodal_energy.load, result.state.u)
    gap_work = 0.1 * result.contact_force
    assert result.primal_energy == pytest.approx(
        (dissipation - load - gap_work) / 2, rel=1e-13
    )


def test_prescribed_displacements_enter_the_identity():
    sides = {"left": (0, None), "right": (0.01, None)}
    problem = bar(STEEL, 0.0, prescribed={**sides, "clamped": (None, 0)}, traction=None)
    result = primal_newton(problem).raise_for_status()
    assert result.primal_energy > 0
    assert result.dual_energy == pytest.approx(-result.primal_energy, rel=1e-13)


@pytest.mark.parametrize("make", [example_a, loaded_everyhow])
def test_forces_are_in_equilibrium(make):
    result = primal_newton(
        make(lshape.mesh(0.1)), options=PrimalOptions(tolerance=1e-12)
    )
    total = result.applied_force + result.contact_resultant + result.reaction
    assert np.abs(total).max() < 1e-11 * np.abs(result.applied_force).max()
    assert result.contact_force > 0.1
    assert result.contact_resultant == pytest.approx(
        [0, -result.contact_force], abs=1e-12
    )


def test_contact_pressure_integrates_to_the_contact_force():
    problem = example_a(lshape.paper_mesh(225))
    result = primal_newton(problem)
    on_contact = problem.mesh.Boundaries("contact")
    total = Integrate(result.contact_pressure, problem.mesh, definedon=on_contact)
    assert total == pytest.approx(result.contact_force, rel=1e-12)


def test_complementarity_holds_at_the_nodes():
    result = primal_newton(loaded_everyhow(lshape.paper_mesh(225)))
    gap, u = (
        result.rows.gaps,
        nodal(result.displacement.vec.FV().NumPy(), result.problem),
    )
    gap = gap - result.rows.normal @ u.ravel()
    forces = result.nodal_contact_forces
    assert gap.min() > -1e-14
    assert forces.min() >= 0
    assert np.abs(gap * forces).max() < 1e-14
    assert 0 < np.count_nonzero(forces) < len(forces)


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("load", [1.0, -4.0])
def test_bar_on_rollers_matches_the_closed_form(n, load):
    result = primal_newton(bar(STEEL, load, n)).raise_for_status()
    p = max(abs(load) / math.sqrt(2) - 1.25, 0.0) / 100.0 * np.sign(load)
    elongation = load / 8e3 + load / 4e3 + p / math.sqrt(2)
    end = result.displacement(result.problem.mesh(1.0, 0.4))
    assert end[0] == pytest.approx(elongation, rel=1e-12)
    assert end[1] == pytest.approx(
        (load / 8e3 - load / 4e3 - p / math.sqrt(2)) * 0.4, rel=1e-12
    )
    assert result.yield_function(result.problem.mesh(0.3, 0.3)) < 1e-12
    assert result.plastic_strain(result.problem.mesh(0.6, 0.3))[0] == pytest.approx(
        p / 2**0.5
    )


@pytest.mark.parametrize("push", [0.0005, 0.02])
@pytest.mark.parametrize("simplices", [True, False])
def test_column_pushed_by_an_obstacle_matches_the_closed_form(push, simplices):
    mesh = block.structured_mesh(2, 3, size=(2.0, 1.0), simplices=simplices)
    sides = {"left": (0, None), "right": (0, None)}
    flat = {"kinematics": "two-dimensional", "prescribed": sides}
    problem = Problem(mesh, STEEL, contact="contact", gap=-push, **flat)
    result = primal_newton(problem).raise_for_status()
    s = 2e3 * push / math.sqrt(2)
    p = max(s - 1.25, 0.0) / 2100.0
    pressure = 2e3 * push + (s - 2e3 * p) / math.sqrt(2)
    assert result.contact_force == pytest.approx(2.0 * pressure, rel=1e-12)
    assert result.contact_pressure(mesh(0.7, 1.0)) == pytest.approx(pressure, rel=1e-12)


def test_block_of_tetrahedra_yields_like_a_bar():
    mesh = block.mesh(0.5)
    rollers = {
        "left": (0, None, None),
        "clamped": (None, None, 0),
        "front": (None, 0, None),
    }
    traction = {"right": (4.0, 0, 0)}
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        prescribed=rollers,
        traction=traction,
        kinematics=FLAT[mesh.dim],
    )
    result = primal_newton(problem).raise_for_status()
    p = (4.0 * math.sqrt(2 / 3) - 1.25) / 100.0
    elongation = 4.0 / 2.5e3 + p * math.sqrt(2 / 3)
    assert result.displacement(mesh(1.0, 0.3, 0.3))[0] == pytest.approx(
        elongation, rel=1e-10
    )


def test_isotropic_and_kinematic_hardening_agree_in_one_step():
    mesh = lshape.paper_mesh(113)
    isotropic = Material.isotropic(
        lame_lambda=1e3,
        lame_mu=1e3,
        yield_stress=1.25,
        hardening_modulus=2.0,
        hardening_stiffness=16.0,
    )
    problem = example_a(mesh)
    a = primal_newton(problem)
    b = primal_newton(dataclasses.replace(problem, material=isotropic))
    assert b.primal_energy == pytest.approx(a.primal_energy, rel=1e-13)


def test_one_step_below_the_yield_stress():
    result = primal_newton(
        example_a(lshape.paper_mesh(113), traction={"load": (0.0, 0.05)})
    )
    assert result.status is Status.CONVERGED
    assert result.iterations == 1
    assert Integrate(Norm(result.plastic_increment), result.problem.mesh) == 0.0


def test_scaling_of_units_leaves_displacements():
    problem = example_a(lshape.paper_mesh(113))
    scaled = dataclasses.replace(
        problem,
        material=Material.kinematic(
            lame_lambda=1e9, lame_mu=1e9, yield_stress=1.25e6, hardening=1e8
        ),
        traction={"load": (0.0, 1e7)},
    )
    a, b = primal_newton(problem), primal_newton(scaled)
    assert a.iterations == b.iterations
    difference = a.displacement.vec.FV().NumPy() - b.displacement.vec.FV().NumPy()
    assert np.abs(difference).max() < 1e-13


@pytest.mark.parametrize(
    "mesh", [lshape.paper_mesh(65), block.structured_mesh(3, 3, 2)]
)
def test_derivatives_match_central_differences(mesh):
    N = mesh.dim
    loads = {"traction": {"contact": (0.3,) * N}}
    if N == 2:
        loads |= {
            "initial_plastic_strain": TRACE_FREE,
            "initial_hardening": 30 * TRACE_FREE,
        }
    energy = ReducedEnergy(Problem(mesh, STEEL, **loads, kinematics=FLAT[mesh.dim]))
    rng = np.random.default_rng(5)
    u, d = np.where(energy.free, rng.normal(size=(2, *energy.free.shape)), 0.0) * 2e-4
    t, nothing = 1e-6, np.zeros(len(energy.contact))
    before, here, after = (
        PrimalState(energy, u + k * t * d, nothing) for k in (-1, 0, 1)
    )
    assert 0 < here.plastic_measure < Integrate(CF(1), mesh)
    slope = np.vdot(here.internal_forces - energy.load, d)
    assert (after.energy - before.energy) / (2 * t) == pytest.approx(slope, rel=1e-7)
    change = (after.internal_forces - before.internal_forces) / (2 * t)
    tangent = Factors(energy, "sparsecholesky")
    tangent.linearise(here)
    assert np.abs(tangent.solve(change) - d).max() < 1e-6 * np.abs(d).max()


def test_a_point_of_the_energy_is_a_value():
    """What is computed at one displacement does not change what was or will be at another."""
    metal = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=Voce(1.5, 1.0, 20.0))
    problem = dataclasses.replace(example_a(lshape.paper_mesh(65)), material=metal)
    energy = ReducedEnergy(problem)
    rng = np.random.default_rng(8)
    u, w = np.where(energy.free, rng.normal(size=(2, *energy.free.shape)), 0.0) * 1e-3
    here = energy.at(u)
    numbers = ("value", "gradient", "plastic_measure", "flowing")
    found = []
    for name in numbers:
        energy.at(w).value, energy.at(w).gradient, energy.at(w).matrix
        found.append(getattr(here, name))
    alone = ReducedEnergy(problem).at(u)
    for name, value in zip(numbers, found, strict=True):
        assert np.array_equal(value, getattr(alone, name))
    assert abs(here.matrix - alone.matrix).max() == 0
    increment = here.mapping.plastic_increment
    before = interpolated(problem, increment).vec.FV().NumPy().copy()
    energy.at(w).value, energy.at(w).mapping
    assert np.array_equal(interpolated(problem, increment).vec.FV().NumPy(), before)


def test_the_matrix_is_the_derivative_of_the_gradient():
    energy = ReducedEnergy(example_a(lshape.paper_mesh(65)))
    rng = np.random.default_rng(8)
    u, d = np.where(energy.free, rng.normal(size=(2, *energy.free.shape)), 0.0) * 1e-3
    step = 1e-6
    change = energy.at(u + step * d).gradient - energy.at(u - step * d).gradient
    change = np.where(energy.free, change, 0.0).ravel() / (2 * step)
    predicted = energy.at(u).matrix @ d.ravel()
    assert np.abs(predicted - change).max() < 1e-6 * np.abs(change).max()


def test_eliminated_plastic_strain_minimises_the_energy():
    problem = example_a(lshape.paper_mesh(65), initial_plastic_strain=TRACE_FREE)
    energy = ReducedEnergy(problem)
    rng = np.random.default_rng(3)
    u = np.where(energy.free, rng.normal(size=energy.free.shape), 0.0) * 1e-3
    state = PrimalState(energy, u, np.zeros(len(energy.contact)))
    least = state.energy + np.vdot(energy.load, u)
    p = interpolated(problem, state.here.mapping.plastic_increment)

    def energy_of(q):
        e = state.here.mapping.elastic_strain_trial - problem.kinematics.tensor(q)
        stored = 0.5 * (1e3 * (e[0, 0] + e[1, 1]) ** 2 + 2e3 * Norm(e) ** 2)
        constant = 1e3 * Norm(TRACE_FREE) ** 2
        density = stored + 50.0 * Norm(q) ** 2 + 1.25 * Norm(q) - constant
        return Integrate(density * dx(intrules=energy.rules), problem.mesh)

    assert energy_of(p) == pytest.approx(least, rel=1e-13)
    for factor in (0.9, 0.999, 1.001, 1.1):
        assert energy_of(factor * p) > least


@pytest.mark.parametrize(
    "mesh", [block.structured_mesh(2, 2, 2), block.structured_mesh(3, 3)]
)
def test_interpolated_takes_the_values_at_the_plastic_points(mesh):
    problem = Problem(
        mesh,
        STEEL,
        traction={"contact": (1.0,) * mesh.dim},
        kinematics=FLAT[mesh.dim],
        order=1,
    )
    value = CF((x * x * y, IfPos(x - 0.3, 1.0, 2.0)))
    points = mesh.MapToAllElements(plastic_points(mesh, 1), mesh.Materials(".*"))
    assert np.abs(interpolated(problem, value)(points) - value(points)).max() < 1e-13


def test_normals_on_a_circle_point_outward_along_the_radius():
    problem = Problem(
        ring.mesh(0.2),
        STEEL,
        clamped="inner",
        contact="outer",
        gap=0.1,
        traction=None,
        kinematics="two-dimensional",
    )
    contact = contact_rows(problem, Supports(problem))
    points = np.asarray(problem.mesh.ngmesh.Coordinates())[contact.nodes, :2]
    radial = points / np.linalg.norm(points, axis=1, keepdims=True)
    assert len(contact) == len(np.unique(contact.nodes)) > 20
    assert np.abs(contact.normals - radial).max() < 0.01


def test_a_corner_between_two_obstacles_touches_both():
    mesh = block.structured_mesh(2, 2)
    rollers = {"left": (0, None), "clamped": (None, 0)}
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        prescribed=rollers,
        contact="contact|right",
        gap={"contact": -0.02, "right": -0.01},
        kinematics=FLAT[mesh.dim],
    )
    result = primal_newton(problem).raise_for_status()
    assert result.displacement(mesh(1.0, 1.0)) == pytest.approx(
        (-0.01, -0.02), rel=1e-12
    )
    assert len(result.rows) == 6
    assert np.abs(result.reaction + result.contact_resultant).max() < 1e-10


def test_random_problems_converge_with_exact_complementarity():
    rng = np.random.default_rng(2)
    meshes = [
        block.mesh(0.2, (1.0, 1.0)),
        lshape.paper_mesh(113),
        block.structured_mesh(3, 3, 3),
    ]
    for k in range(9):
        mesh = meshes[k % 3]
        mu = 10 ** rng.uniform(-2, 4)
        bound = mu * 10 ** rng.uniform(-4, -1.5)
        material = Material.kinematic(
            lame_lambda=mu * rng.uniform(0, 10),
            lame_mu=mu,
            yield_stress=bound,
            hardening=mu * 10 ** rng.uniform(-3, 1),
        )
        side = "load" if k % 3 == 1 else "left"
        force = rng.normal(size=mesh.dim) * bound * 10 ** rng.uniform(-1, 1)
        problem = Problem(
            mesh,
            material,
            contact="contact",
            gap=float(rng.choice([-0.01, 0.0, 0.001, 0.01])),
            traction={side: tuple(force.tolist())},
            kinematics=FLAT[mesh.dim],
        )
        result = primal_newton(problem).raise_for_status()
        scale = max(abs(result.primal_energy), abs(result.dual_energy))
        assert abs(result.primal_energy + result.dual_energy) < 1e-9 * scale
        assert result.penetration < 1e-12


def test_iteration_limit_is_named_and_can_raise():
    problem = example_a(lshape.paper_mesh(113))
    result = primal_newton(problem, options=PrimalOptions(max_iterations=2))
    assert result.status is Status.ITERATION_LIMIT
    assert result.iterations == 2
    with pytest.raises(SolverError, match="2 steps") as caught:
        result.raise_for_status()
    assert caught.value.result is result


def test_monitor_sees_every_iterate_and_can_stop():
    seen = []

    def monitor(record):
        seen.append(record.iteration)
        if record.iteration == 3:
            raise StopIteration

    result = primal_newton(example_a(lshape.paper_mesh(113)), monitor=monitor)
    assert seen == [0, 1, 2, 3]
    assert result.status is Status.STOPPED
    assert result.iterations == 3


def test_nan_in_mid_run_is_named():
    poison = Parameter(10.0)
    problem = example_a(lshape.paper_mesh(113), traction={"load": (0.0, poison)})
    poison.Set(float("nan"))
    result = primal_newton(problem)
    assert result.status is Status.NONFINITE


def test_unreachable_tolerance_is_named():
    problem = example_a(lshape.paper_mesh(833))
    result = primal_newton(problem, options=PrimalOptions(tolerance=1e-13))
    assert result.status is Status.STAGNATED
    assert result.residual_norm < 1e-11


@pytest.mark.parametrize(
    ("name", "value"), [("tolerance", 1e-20), ("max_iterations", 0), ("tolerance", 1.0)]
)
def test_options_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=name):
        PrimalOptions(**{name: value})


def test_bad_starts_are_refused():
    problem = example_a(lshape.paper_mesh(33))
    with pytest.raises(TypeError, match="start"):
        primal_newton(problem, start=3.0)
    with pytest.raises(ValueError, match="displacement of 2"):
        primal_newton(problem, start=GridFunction(H1(problem.mesh)))


@pytest.mark.parametrize(
    ("solve", "nodes"), in_turn([primal_newton, semismooth_newton], [113, 225, 417])
)
def test_a_displacement_that_solves_the_problem_is_a_good_start(nodes, solve):
    """A displacement has no forces of contact: the step that finds them moves nothing."""
    problem = lshape_problem(lshape.paper_mesh(nodes))
    solution = solve(problem).raise_for_status()
    again = solve(problem, start=solution.displacement)
    assert again.status is Status.CONVERGED
    assert again.iterations <= 2
    assert again.contact_force == pytest.approx(solution.contact_force, rel=1e-9)


def test_initial_strains_may_be_functions_on_another_mesh():
    """NGSolve evaluates them one point at a time, and not in every form."""
    before = semismooth_newton(lshape_problem(lshape.paper_mesh(113)))
    problem = dataclasses.replace(
        lshape_problem(lshape.paper_mesh(113)),
        initial_plastic_strain=before.plastic_strain,
        initial_hardening=before.fields.back_stress,
    )
    primal, exact = primal_newton(problem), semismooth_newton(problem)
    assert primal.status is exact.status is Status.CONVERGED
    assert primal.primal_energy == pytest.approx(exact.primal_energy, rel=1e-12)


def test_a_start_follows_its_mesh_through_refinement():
    problem = example_a(lshape.paper_mesh(33))
    coarse = primal_newton(problem)
    before = coarse.displacement(problem.mesh(0.1, 0.8))
    problem.mesh.Refine()
    assert coarse.displacement(problem.mesh(0.1, 0.8)) == pytest.approx(
        before, rel=1e-12
    )
    fine = primal_newton(example_a(problem.mesh), start=coarse).raise_for_status()
    assert fine.primal_energy < coarse.primal_energy


SOFT_CORNER = Draw(  # one plastic element held by its contact force alone
    body="strip",
    maxh=0.14146355695226748,
    stress_unit=2.1306228016269007,
    length_unit=0.16150178723784236,
    poisson=0.4999,
    yield_bound=-3.8891792267627734,
    hardening=math.log10(2e-6),
    kind="isotropic",
    load=8.21834012881301,
    angle=0.9130592570624303,
    gap="near",
    gap_size=4.16761373643151,
    history=0.0,
)
JUMPING_SLOPE = Draw(  # soft plastic elements turn elastic in the middle of a step
    body="wrench",
    maxh=0.10606787656652866,
    stress_unit=-1.8023393691179104,
    length_unit=-1.1345791196262573,
    poisson=0.4999,
    yield_bound=-2.0870908785440587,
    hardening=math.log10(2e-6),
    kind="isotropic",
    load=0.39270523905240245,
    angle=5.952805560886258,
    gap="touching",
    gap_size=0.1265114747103373,
    history=1.0480462305880969,
)


def test_nearly_perfect_plasticity_and_nearly_incompressible():
    """h/mu = 2e-6 and nu = 0.4999: what random problems found, kept."""
    assert primal_newton(build(SOFT_CORNER)).status is Status.CONVERGED
    problem = build(JUMPING_SLOPE)
    drowned = primal_newton(problem)
    assert drowned.status is Status.STAGNATED
    reach = float(re.search(r"tolerance above (\S+) can be met", drowned.message)[1])
    assert 1e-10 < reach < 1e-5
    result = primal_newton(problem, options=PrimalOptions(tolerance=2 * reach))
    assert result.status is Status.CONVERGED
    assert balance_residual(result) < 4 * reach


def test_trials_close_in_on_a_jump_of_the_slope():
    """Slope -1 before 1e-3, 0.5 after it: what is left is the end below the jump."""
    length, _ = nearly_flat(lambda t: -1.0 if t < 1e-3 else 0.5, 0.0)
    assert 1e-3 - 1e-4 < length < 1e-3


@pytest.mark.parametrize("accumulated", [0.0, 0.02])
def test_the_energy_with_a_law_of_hardening_is_that_of_the_exact_method(accumulated):
    """Also after a history: the energy of hardening is counted from there on."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    moduli = {"lame_lambda": 1e3, "lame_mu": 1e3, "hardening": 40.0}
    material = Material.with_law(**moduli, law=Voce(1.5, 1.0, 50.0))
    problem = Problem(
        mesh,
        material,
        traction={"right": (2.4, 0.3)},
        initial_accumulated=accumulated,
        order=1,
    )
    exact = semismooth_newton(problem).raise_for_status()
    primal = primal_newton(problem).raise_for_status()
    assert np.abs(exact.plastic_increment.vec.FV().NumPy()).max() > 1e-4
    assert primal.primal_energy == pytest.approx(exact.primal_energy, rel=1e-10)
    assert primal.dual_energy == pytest.approx(-primal.primal_energy, rel=1e-8)
    assert primal.iterations <= exact.iterations  # the tangent is the derivative
