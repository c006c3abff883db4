"""Histories whose meshes follow the bound of each step."""

from dataclasses import replace

import numpy as np
import pytest
from featured import problem_with
from ngsolve import Integrate, Mesh, y

from ngepc import Material, Problem, Voce, evolve, load_cycle, semismooth_newton
from ngepc.bounds.bound import error_bound
from ngepc.bounds.copies import bisected
from ngepc.bounds.transfer import on_mesh
from ngepc.evolution.memory import Memory
from ngepc.geometries import block
from ngepc.goals.refinement import Refinement
from ngepc.sensitivity.gradient import states_of

MATERIAL = Material(
    lame_lambda=1e3,
    lame_mu=1e3,
    yield_stress=1.25,
    hardening=60.0,
    hardening_modulus=2.0,
    hardening_stiffness=6.0,
)


KINEMATIC = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=120.0
)
MATERIALS = {1: MATERIAL, 2: KINEMATIC}
BUDGETS = {1: 0.12, 2: 0.03}


def pulled(order=1, **data):
    mesh = Mesh(block.mesh(0.5, (1.0, 1.0)).ngmesh.Copy())
    mesh.Refine()  # transfer from meshes that Netgen had refined used to be wrong
    traction = {"right": (4.0, 0.0)}
    return Problem(mesh, MATERIALS[order], traction=traction, order=order, **data)


@pytest.fixture(scope="module", params=[1, 2])
def cycle(request):
    order = request.param
    problem = pulled(order, contact="contact", gap=1e-3)
    return evolve(
        problem, load_cycle(problem, [1, -0.5], steps=2), error=BUDGETS[order]
    )


def test_each_step_keeps_its_budget_and_says_so(cycle):
    assert cycle.status.label == "converged"
    nodes, bounds = cycle.column("nodes"), cycle.column("error_bound")
    assert max(bounds) <= BUDGETS[cycle.problem.order]
    assert nodes == sorted(nodes)
    assert nodes[-1] > cycle.problem.mesh.nv
    assert [step.problem.mesh.nv for step in cycle.steps] == nodes


def test_each_step_starts_from_the_history_of_the_last_one(cycle):
    """p_0 of a step is p of the step before it, whatever the meshes: integrals agree."""
    for before, after in zip(cycle.steps, cycle.steps[1:], strict=False):
        p, p_0 = before.fields.plastic_strain, after.problem.p_0
        for i, j in ((0, 0), (0, 1), (2, 2)):
            left = Integrate((1 + y) * p[i, j] ** 2, before.problem.mesh)
            right = Integrate((1 + y) * p_0[i, j] ** 2, after.problem.mesh)
            assert right == pytest.approx(left, rel=1e-12, abs=1e-20)


def test_steps_are_those_of_a_single_step_on_their_meshes(cycle):
    step = cycle.steps[-1]
    again = semismooth_newton(step.problem)
    assert again.primal_energy == pytest.approx(step.record.primal_energy, rel=1e-9)
    assert error_bound(again).relative == pytest.approx(
        step.record.error_bound, rel=1e-6
    )


def test_derivatives_need_one_mesh(cycle):
    with pytest.raises(ValueError, match="several meshes"):
        states_of(cycle)


@pytest.mark.parametrize("order", [1, 2])
def test_memory_is_carried_to_children_exactly(order):
    problem = pulled(order)
    random = np.random.default_rng(0)
    memory = Memory.initial(problem)
    p = memory.functions.points.at(semismooth_newton(problem).plastic_increment)
    memory = memory.after(problem.material, p)
    finer, parents = bisected(problem.mesh, random.random(problem.mesh.ne) < 0.4)
    carried = memory.on(on_mesh(problem, finer, parents), parents)
    before, after = memory.functions, carried.functions
    arrays = memory.arrays
    if order == 2:
        del arrays["accumulated"]  # which must not be negative
    for name, values in arrays.items():
        old, new = before.function(values), after.function(carried.arrays[name])
        for weight in (1, y * y):
            for a, b in zip(
                old.components or [old], new.components or [new], strict=True
            ):
                left, right = (
                    Integrate(weight * a * a, problem.mesh),
                    Integrate(weight * b * b, finer),
                )
                assert right == pytest.approx(left, rel=1e-12, abs=1e-20)


ELASTIC = {"lame_lambda": 1e3, "lame_mu": 1e3}
HARDENING = {
    "hardening_variable": Material(
        **ELASTIC,
        yield_stress=1.25,
        hardening=60.0,
        hardening_modulus=2.0,
        hardening_stiffness=6.0,
    ),
    "accumulated": Material.with_law(
        **ELASTIC, hardening=60.0, law=Voce(yield_stress=1.5, saturation=0.5, rate=40.0)
    ),
}


@pytest.mark.parametrize("name", HARDENING)
def test_order_two_passes_hardening_on_as_means_over_elements(name):
    """Isotropic hardening: no mean is negative, the bounds are proved, the answer stays near."""
    steel = HARDENING[name]
    problem = replace(pulled(2), material=steel)
    schedule = load_cycle(problem, [1, -0.5], steps=2)
    run = evolve(problem, schedule, error=0.02).raise_for_status()
    assert max(run.column("error_bound")) <= 0.02
    assert run.column("guaranteed") == [True] * len(run.steps)
    gained = run.memory.arrays[name].reshape(run.steps[-1].problem.mesh.ne, -1)
    assert gained.min() >= 0
    assert gained.max() > 0
    assert np.ptp(gained, axis=1).max() <= 1e-15 * gained.max()
    fine = replace(problem, mesh=run.steps[-1].problem.mesh)
    as_it_is = evolve(fine, schedule).raise_for_status()
    energies = as_it_is.column("elastic_energy")
    assert run.column("elastic_energy") == pytest.approx(energies, rel=0.02)


RUBBED = {1: 0.05, 2: 0.02}


@pytest.fixture(scope="module", params=[1, 2])
def rubbed(request):
    """A block that a plate presses and drags to and fro."""
    problem = pulled(request.param, contact="contact", gap=-2e-3, friction=0.3)
    right = {"right": (0.4, 0.0)}, {"right": (-1.0, 0.5)}
    steps = [(1.0 + k, {"traction": load}) for k, load in enumerate(right)]
    error = RUBBED[request.param]
    return evolve(problem, steps, error=error).raise_for_status()


def test_friction_passes_the_slip_on_to_finer_meshes(rubbed):
    """The start of a step on a finer mesh is the displacement of the last one, as a function."""
    bounds = rubbed.column("error_bound")
    first, second = rubbed.steps
    assert max(bounds) <= RUBBED[rubbed.problem.order]
    assert rubbed.column("guaranteed") == [True, True]
    assert second.problem.mesh.nv > first.problem.mesh.nv
    assert second.solution.state.sliding.any()

    before = first.fields.displacement
    start = second.problem.initial_displacement
    for axis in range(2):
        old = Integrate(before[axis] ** 2 * (1 + y), first.problem.mesh)
        new = Integrate(start[axis] ** 2 * (1 + y), second.problem.mesh)
        assert new == pytest.approx(old, rel=1e-12)


def test_the_bound_of_a_step_with_friction_holds_from_its_start(rubbed):
    """The same step on finer meshes ends between the energies of the bound."""
    step = rubbed.steps[-1]
    bound = error_bound(step.solution)
    problem = step.problem
    for _ in range(2):
        everywhere = np.ones(problem.mesh.ne, dtype=bool)
        problem = on_mesh(problem, *bisected(problem.mesh, everywhere))
    fine = error_bound(semismooth_newton(problem))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy


def test_a_mesh_that_may_not_grow_ends_the_run():
    problem = pulled()
    few = Refinement(max_nodes=40)
    stopped = evolve(problem, load_cycle(problem, [1]), error=1e-3, refinement=few)
    assert stopped.status.label == "mesh_limit"
    assert "max_nodes=40" in stopped.message
    assert "error=0.001;" in stopped.message
    assert stopped.steps == []


def test_what_no_bound_covers_is_refused_before_any_work():
    problem = pulled()
    for option in ("error", "accuracy"):
        given = {option: 0.1, "checkpoint": "kept.npz"}
        with pytest.raises(ValueError, match=r"checkpoint='kept.npz'.*leave one out"):
            evolve(problem, load_cycle(problem, [1]), **given)


BUDGET = {"hexahedra": 0.4, "anisotropic yield": 0.2, "cyclic hardening": 0.16}
WIDER = (
    "two bodies",
    "held by contact",
    "anisotropic yield",
    "cyclic hardening",
    "axisymmetric",
)


@pytest.mark.parametrize("feature", [*WIDER, "quadrilaterals", "hexahedra"])
def test_meshes_follow_the_bound_with_every_feature_that_bounds_cover(feature):
    """Of the second step, which starts from plastic strains of the first one, too."""
    problem = problem_with(feature)
    budget = BUDGET.get(feature, 0.13)
    pairs = [(0.5, {}), (1.0, {})]
    if feature != "two bodies":
        pairs = load_cycle(problem, [1.0], steps=2)
    history = evolve(problem, pairs, error=budget)
    assert history.status.label == "converged"
    assert max(history.column("error_bound")) <= budget
    last = history.steps[-1].problem
    own = error_bound(semismooth_newton(last))
    assert own.relative == pytest.approx(history.column("error_bound")[-1], rel=1e-2)
    assert own.guaranteed
    assert last.mesh.ne > problem.mesh.ne


CONSTANT = ("anisotropic yield", "cyclic hardening", "axisymmetric")


@pytest.mark.parametrize("feature", CONSTANT)
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"order": 2}, "order=2: error=... with"),
        ({"mesh": block.structured_mesh(2, 2)}, "quadrilaterals: error=... with"),
    ],
)
def test_plastic_strains_that_vary_inside_elements_are_refused_at_once(
    feature, change, words
):
    problem = replace(problem_with(feature), **change)
    with pytest.raises(ValueError, match=words):
        evolve(problem, load_cycle(problem, [1.0]), error=0.1)
