"""Meshes that follow the bound, and what is carried from one to the next."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import CF, L2, GridFunction, Integrate, Mesh, VectorValued, x, y

from ngepc import (
    ContactForceOn,
    Material,
    MeanDisplacement,
    Problem,
    Reaction,
    Roller,
    Voce,
    confidence,
    goal_bound,
    lshape_problem,
    semismooth_newton,
    verdict,
    write_receipt,
)
from ngepc.bounds.bound import error_bound
from ngepc.bounds.copies import bisected, bisected_to
from ngepc.bounds.simplices import marked
from ngepc.bounds.transfer import carried_state, on_mesh
from ngepc.checks.sentences import outward
from ngepc.geometries import block, lshape
from ngepc.goals import adaptive, ends, one_mesh
from ngepc.goals.adaptive import solve_to
from ngepc.goals.planning import refined_mesh
from ngepc.goals.refinement import MeshRecord, Refinement
from ngepc.local.system import DiscreteProblem
from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.studies.bounds import LIMITS

LIMIT = LIMITS["lshape"]
MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
)


@pytest.fixture(scope="module")
def lshaped():
    return solve_to(lshape_problem(lshape.paper_mesh(65)), 0.02)


def test_meshes_follow_friction():
    """A plate presses the block and drags: from mesh to mesh it sticks and slides."""
    problem = Problem(
        block.mesh(0.5, (1.0, 1.0)),
        MATERIAL,
        traction={"right": (0.4, 0.0)},
        contact="contact",
        gap=-2e-3,
        friction=0.3,
    )
    solved = solve_to(problem, 0.02)
    assert solved.reached
    assert solved.result.state.sliding.any()
    assert not solved.result.state.sliding.all()
    lower = [record.energy - record.total for record in solved.records]
    assert max(lower) <= min(record.energy for record in solved.records)


def test_what_is_asked_for_is_reached(lshaped):
    assert lshaped.reached
    assert lshaped.message == ""
    assert lshaped.bound.relative <= 0.02
    said = outward(0.0, lshaped.bound.relative, 3)[1]
    assert 0 <= float(said) - lshaped.bound.relative < 1e-4
    error = f"relative error of the energy at most {said} (guaranteed)"
    assert f"{error}, tolerance 0.02" in repr(lshaped)
    fresh = error_bound(lshaped.result)  # its stress starts from another tangent
    assert fresh.energy == pytest.approx(lshaped.bound.energy, rel=1e-12)
    # its mesh may be bisected once more at corners
    assert fresh.total == pytest.approx(lshaped.bound.total, rel=0.03)


def test_bounds_are_sharp_and_newton_ends_early(lshaped):
    for record in lshaped.records:
        assert record.algebraic <= 0.1 * record.total
        assert record.total >= record.energy - LIMIT
        if record.nodes > 400:
            assert record.total <= 1.15 * (record.energy - LIMIT)
    assert lshaped.iterations <= 4 * len(lshaped.records)


def test_the_error_falls_as_fast_as_the_nodes_grow(lshaped):
    records = [r for r in lshaped.records if r.nodes > 90]
    rate = np.polyfit(
        np.log([r.nodes for r in records]),
        np.log([r.energy - LIMIT for r in records]),
        1,
    )[0]
    assert rate <= -0.95


@pytest.mark.parametrize("left", [0.9, 0.5, 0.2])
def test_bisections_leave_what_they_should_where_indicators_fall_with_the_square_of_the_area(
    left,
):
    mesh, random = lshape.paper_mesh(225), np.random.default_rng(3)
    indicators = random.random(mesh.ne) ** 4
    finer, parent = bisected_to(mesh, indicators, 0.25, left)
    areas = [np.array(Integrate(CF(1), m, element_wise=True)) for m in (mesh, finer)]
    expected = indicators[parent] * (areas[1] / areas[0][parent]) ** 2
    assert 0.85 * left <= expected.sum() / indicators.sum() <= 1.03 * left
    assert np.bincount(parent, areas[1]) == pytest.approx(areas[0])


def test_the_mesh_of_the_problem_stays_what_it_is():
    problem = lshape_problem(lshape.paper_mesh(21))
    solved = solve_to(problem, 0.2)
    assert problem.mesh.nv == 21 < solved.result.problem.mesh.nv


def test_limits_and_monitors_end_a_run_and_say_so():
    problem = lshape_problem(lshape.paper_mesh(21))
    stopped = solve_to(problem, 1e-3, Refinement(max_nodes=60))
    assert not stopped.reached
    assert "max_nodes=60" in stopped.message
    seen = []

    def monitor(record):
        seen.append(record)
        if len(seen) == 2:
            raise StopIteration

    ended = solve_to(problem, 1e-3, monitor=monitor)
    assert ended.records == seen
    assert "monitor" in ended.message


def test_newton_that_fails_is_said():
    problem = lshape_problem(lshape.paper_mesh(65))
    failed = solve_to(problem, 1e-3, Refinement(max_iterations=2))
    assert len(failed.records) == 1
    assert "2 steps" in failed.message
    assert str(failed) == f"{failed!r}\n{failed.message}"


def test_newton_does_not_go_on_for_what_clearing_a_curved_obstacle_costs():
    """Most of the bound on the first meshes, which no step removes: up to seven in vain."""
    gap = 2 * (x - 0.5) ** 2 - 5e-3
    square = block.mesh(0.3, (1.0, 1.0))
    problem = Problem(square, MATERIAL, contact="contact", gap=gap, order=1)
    solved = solve_to(problem, 0.04)
    assert solved.reached
    assert solved.records[2].algebraic > 0.5 * solved.records[2].total
    assert max(record.iterations for record in solved.records[1:]) <= 3


def test_the_bound_is_that_of_the_result_however_long_newton_goes_on(monkeypatch):
    """After a pause that was too early, to the end: with the bound of the pause it was larger."""
    monkeypatch.setattr(one_mesh, "ALGEBRAIC_SHARE", -1.0)
    solved = solve_to(lshape_problem(lshape.paper_mesh(65)), 0.05)
    assert solved.result.status.label == "converged"
    energy = error_bound(solved.result).energy
    assert solved.bound.energy == pytest.approx(energy, rel=1e-12)


def test_doerfler_marking_takes_the_fewest():
    eta = np.array([1.0, 5.0, 0.5, 3.0, -1e-18])
    assert marked(eta, 0.5).tolist() == [False, True, False, False, False]
    assert marked(eta, 0.8).tolist() == [False, True, False, True, False]
    assert marked(eta, 1.0)[:4].all()


def refined_twice(mesh):
    """A mesh that NGSolve has refined: spaces on it used to transfer wrongly."""
    mesh = Mesh(mesh.ngmesh.Copy())
    for _ in range(2):
        mesh.Refine()
    return mesh


def test_piecewise_constants_are_carried_exactly():
    mesh = refined_twice(block.mesh(0.4, (1.0, 1.0)))
    random = np.random.default_rng(0)
    function = GridFunction(VectorValued(L2(mesh, order=0), 3))
    function.vec.FV().NumPy()[:] = random.random(3 * mesh.ne)
    a, b, c = (function[i] for i in range(3))
    material = replace(MATERIAL, yield_stress=1 + c)
    deviator = CF((a, b, b, -a), dims=(2, 2))
    history = {"initial_plastic_strain": deviator, "initial_hardening": 3 * deviator}
    old = Problem(
        mesh, material, kinematics="two-dimensional", body_force=(a, c), **history
    )
    chosen = random.random(mesh.ne) < 0.3
    new = everywhere(on_mesh(old, *bisected(mesh, chosen)))
    for weight in (1, x, y * y):
        before, after = (
            [
                Integrate(weight * part * part, problem.mesh)
                for tensor in (problem.p_0, problem.alpha_0[1], problem.f, problem.beta)
                for part in (
                    [tensor[i] for i in range(tensor.dim)]
                    if tensor.dim > 1
                    else [tensor]
                )
            ]
            for problem in (old, new)
        )
        assert after == pytest.approx(before, rel=1e-12)
        assert len(after) == 11


def test_parents_are_those_that_elements_lie_in_however_small_they_are():
    """Towards a vertex, where a search by coordinates finds neighbours below 1e-6."""
    coarse = block.mesh(0.5, (1.0, 1.0))
    mesh, parents = coarse, np.arange(coarse.ne)
    inner = int(np.abs(vertex_coordinates(coarse) - 0.5).sum(axis=1).argmin())
    for _ in range(25):
        there = (element_nodes(mesh)[:, :3] == inner).any(axis=1)
        mesh, numbers = bisected(mesh, there)
        parents = parents[numbers]
    corners = vertex_coordinates(coarse)[element_nodes(coarse)[:, :3]][parents]
    centres = vertex_coordinates(mesh)[element_nodes(mesh)[:, :3]].mean(axis=1)
    frames = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    share = np.linalg.solve(frames, (centres - corners[:, 0])[:, :, None])[:, :, 0]
    assert Integrate(CF(1), mesh, element_wise=True).NumPy().min() < 1e-13
    assert np.minimum(share.min(axis=1), 1 - share.sum(axis=1)).min() > 1e-12


def test_states_are_carried_exactly():
    problem = lshape_problem(lshape.paper_mesh(113))
    old = semismooth_newton(problem)
    mesh, parents = bisected(problem.mesh, np.arange(problem.mesh.ne) % 3 == 0)
    new = carried_state(old, DiscreteProblem(on_mesh(problem, mesh, parents)), parents)
    assert new.energy == pytest.approx(old.primal_energy, rel=1e-12)
    assert new.penetration <= new.touching_distance
    assert new.multipliers.sum() == pytest.approx(old.contact_force, rel=0.3)


def test_histories_are_carried():
    """A second step from p_0 and alpha_0 on L2 functions, on finer meshes."""
    mesh = block.mesh(0.4, (1.0, 1.0))
    loaded = Problem(
        mesh, MATERIAL, traction={"right": (4.0, 0.0)}, kinematics="two-dimensional"
    )
    first = semismooth_newton(loaded)
    p = first.fields.plastic_strain
    again = Problem(
        mesh,
        MATERIAL,
        traction={"right": (4.0, 0.0)},
        initial_plastic_strain=p,
        initial_hardening=100.0 * p,
        kinematics="two-dimensional",
    )
    solved = solve_to(again, 0.05, Refinement(max_nodes=600))
    fine = semismooth_newton(everywhere(solved.result.problem))
    assert solved.bound.least_energy <= fine.primal_energy <= solved.bound.energy
    assert solved.bound.total <= 0.3 * solved.records[0].total


def everywhere(problem):
    return on_mesh(
        problem, *bisected(problem.mesh, np.ones(problem.mesh.ne, dtype=bool))
    )


def test_boundary_data_of_finite_elements_are_refused():
    mesh = block.mesh(0.5, (1.0, 1.0))
    gap = GridFunction(L2(mesh, order=0))
    gap.Set(0.1)
    problem = Problem(mesh, MATERIAL, contact="contact", gap=1.0 * gap)
    with pytest.raises(ValueError, match="gap"):
        solve_to(problem)


def test_arguments_are_checked():
    problem = lshape_problem(lshape.paper_mesh(21))
    with pytest.raises(ValueError, match="relative_error=0"):
        solve_to(problem, 0)
    with pytest.raises(
        ValueError, match=r"relative_error=0\.05: .* of a goal it is percent"
    ):
        solve_to(problem, 0.05, goal="contact_force")
    with pytest.raises(TypeError, match="problem"):
        solve_to(3)
    with pytest.raises(ValueError, match="marking=2"):
        Refinement(marking=2)
    with pytest.raises(TypeError, match="options"):
        solve_to(problem, options=0.5)


def test_a_goal_that_is_zero_ends_at_the_second_mesh():
    """A body that never touches has the contact force 0; one interval would be no reason."""
    problem = replace(lshape_problem(lshape.paper_mesh(33)), gap=10.0)
    run = solve_to(problem, goal="contact_force")
    assert not run.reached
    assert len(run.records) == 2
    assert run.goal.lower == 0.0 < run.goal.upper
    assert run.goal.proved[0] < 0.0
    assert "The contact force is about 0" in run.message


@pytest.mark.parametrize(
    "supports",
    [
        {"prescribed": {"clamped": (0.01, 0.02)}},
        {"prescribed": {"clamped": (-0.3 * y, 0.3 * x)}},
        {
            "prescribed": {"clamped": (0, 0), "contact": Roller((0.3, 1.0))},
            "traction": {"contact": (0.3, 1.0)},
        },
    ],
    ids=["a translation", "a rotation", "a load that a roller takes"],
)
def test_a_body_that_only_rounding_errors_strain_ends_at_the_first_mesh(supports):
    """Its strain energy is a rounding error, and so is the bound: their ratio is no error."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    problem = Problem(mesh, MATERIAL, None, **supports)
    run = solve_to(problem, options=Refinement(max_nodes=100))
    assert len(run.records) == 1
    assert not run.reached
    assert "free of stress, up to rounding errors" in run.message
    assert "the body is free of stress" in confidence(run.result)


def test_a_small_load_beside_one_that_a_support_takes_is_not_lost():
    """Strains of 1e-9 of those of the load on the roller are no rounding errors."""
    problem = Problem(
        block.structured_mesh(3, 3, simplices=True),
        MATERIAL,
        None,
        prescribed={"clamped": (0, 0), "contact": Roller((0.3, 1.0))},
        traction={"contact": (0.3, 1.0), "right": (1e-9, 0.0)},
    )
    run = solve_to(problem, 0.05)
    assert run.reached
    assert run.message == ""


@pytest.mark.parametrize("gap", [0.0, 0.1])
def test_goals_of_a_body_at_rest_are_known_exactly(gap):
    """Nothing loads or moves it: forces and displacements are zero."""
    problem = replace(
        lshape_problem(lshape.paper_mesh(33)), pressure=None, traction=None, gap=gap
    )
    result = semismooth_newton(problem)
    at_top = MeanDisplacement("contact", 1)
    for goal in ("contact_force", "work", at_top, Reaction("clamped", 0)):
        assert goal_bound(result, goal).interval == (0.0, 0.0)
    assert verdict(problem, "contact_force", at_most=0.0).outcome == "PASS"
    run = solve_to(problem, goal="contact_force", percent=1)
    assert run.reached
    assert len(run.records) == 1


def test_a_goal_where_the_first_mesh_cannot_move():
    """All its vertices are clamped; the bound is not zero, and finer meshes move."""
    problem = Problem(
        block.structured_mesh(1, 1, simplices=True),
        MATERIAL,
        "clamped|left|right|contact",
        body_force=(0.0, -5.0),
        order=1,
    )
    run = solve_to(problem, goal="work", percent=20)
    assert run.reached
    for record in run.records:
        assert record.lower < run.goal.middle < record.upper


def test_one_interval_around_zero_does_not_end_a_run():
    wide = SimpleNamespace(name="work", proved=(-1.0, 1.0001))
    narrow = SimpleNamespace(name="work", proved=(0.5, 0.6))
    infinite = SimpleNamespace(name="work", proved=(-math.inf, math.inf))
    assert not adaptive.about_zero(None, wide)
    assert not adaptive.about_zero(narrow, wide)
    assert not adaptive.about_zero(infinite, infinite)
    assert not adaptive.about_zero(None, None)
    assert "The work is about 0" in adaptive.about_zero(wide, wide)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("others", "one"), [(1.0, math.inf), (0.0, 0.0), (0.0, -1e-9)])
def test_indicators_that_say_nothing_divide_all_elements(others, one):
    """A law that saturates below a stress: meshes become finer everywhere, not one element.

    And goals that are zero up to rounding.
    """
    problem = lshape_problem(lshape.paper_mesh(33))
    per_cell = np.full(problem.mesh.ne, others)
    per_cell[3] = one
    finer, parents = refined_mesh(problem, per_cell, 0.45, 0.25)
    assert len(parents) == finer.ne
    assert np.bincount(parents).mean() > 1.9


def saturating(load):
    """A plate on rollers under a law that saturates, pulled most at the corner of its side."""
    return Problem(
        block.structured_mesh(1, 1, size=(1.0, 1.0), simplices=True),
        Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=Voce(1.5, 1.0, 50.0)),
        None,
        prescribed={"left": (0.0, None), "clamped": (None, 0.0)},
        traction={"right": (load * y, 0.0)},
        order=1,
    )


def test_a_finer_mesh_may_have_a_bound():
    """On two meshes no stress of the law is in equilibrium, on the third one there is one."""
    problem = saturating(2.8)
    goal = MeanDisplacement("right", 0)
    run = solve_to(problem, goal=goal, percent=30.0)
    assert (run.records[0].lower, run.records[0].upper) == (-math.inf, math.inf)
    assert not math.isfinite(run.records[0].total)
    assert run.reached
    found = verdict(problem, goal, at_most=2 * run.goal.upper)
    assert found.outcome == "PASS"


def test_a_bound_that_stays_infinite_ends_the_run():
    """At the limit of what the law carries: the run says so, and the verdict is undecided."""
    problem = saturating(3.0)
    few = Refinement(max_nodes=40)
    run = solve_to(problem, 0.1, few)
    assert not run.reached
    with pytest.raises(RuntimeError, match="The error bound is infinite: the stress"):
        goal_bound(run.result, MeanDisplacement("right", 0))
    assert ends.NO_BOUND in run.message
    assert "no bound of the relative error of the energy" in repr(run)
    found = verdict(problem, MeanDisplacement("right", 0), at_most=1.0, options=few)
    assert found.outcome == "UNDECIDED"
    assert found.goal is None
    assert not found.guaranteed
    assert str(found).startswith("UNDECIDED: no interval, required: at most 1. The err")
    beyond = verdict(
        saturating(3.5), MeanDisplacement("right", 0), at_most=1.0, options=few
    )
    assert str(beyond).endswith("limit load, which limit_load(problem) bounds.")


def test_six_meshes_without_a_bound_are_enough():
    unknown = MeshRecord(9, 1, 0.0, math.inf, 0.0, math.inf)
    known = replace(unknown, total=1.0)
    assert not ends.never_finite([unknown] * 5)
    assert not ends.never_finite([known, *[unknown] * 5])
    assert ends.never_finite([known, *[unknown] * 6]) == ends.NO_BOUND


def corner(law):
    """A square, clamped at a side and sheared at the opposite one: singular at two corners."""
    return Problem(
        block.structured_mesh(4, 4, simplices=True),
        Material.metal(young=2.5e3, poisson=0.25, **law),
        traction={"right": (0.0, 0.6)},
        order=2,
    )


def test_perfect_plasticity_has_no_bound_where_it_flows():
    """One mesh is enough to say so; a hundredth of hardening has a bound."""
    problem = corner({"yield_stress": 1.5, "plastic_modulus": 0})
    run = solve_to(problem, 0.1)
    assert len(run.records) == 1
    assert run.message == str(run.bound) == ends.FLOWS
    with pytest.raises(RuntimeError, match=re.escape(ends.FLOWS)):
        goal_bound(run.result, "work")
    found = verdict(problem, MeanDisplacement("right", 1), at_most=1.0)
    assert ends.FLOWS in str(found)
    assert solve_to(corner({"yield_stress": 1.5, "plastic_modulus": 25.0}), 0.1).reached


def test_the_last_mesh_with_a_bound_is_the_result():
    """The curve ends, and stresses in equilibrium at the corners exceed it on finer meshes."""
    run = solve_to(corner({"curve": [(6e-4, 1.5), (0.02, 2.0)]}), 0.002)
    *_, kept, lost = run.records
    assert not math.isfinite(lost.total)
    assert run.bound.total == kept.total
    assert run.result.problem.mesh.nv == kept.nodes
    assert f"The next mesh has {lost.nodes} nodes and no bound." in run.message
    assert f"{kept.nodes} nodes" in repr(run)


@pytest.mark.parametrize(
    "goal", ["nonsense", 3, MeanDisplacement("nowhere", 0), ContactForceOn("clamped")]
)
def test_goals_that_are_not_legal_are_refused_before_any_solve(goal, monkeypatch):
    def solved(*arguments):
        raise AssertionError("a solve before the goal is refused")

    monkeypatch.setattr(adaptive, "solved", solved)
    with pytest.raises((TypeError, ValueError), match=r"goal=|boundary='"):
        solve_to(lshape_problem(lshape.paper_mesh(33)), goal=goal)


def test_a_receipt_of_a_bounded_result_is_that_of_its_parts(tmp_path):
    solved = solve_to(lshape_problem(lshape.paper_mesh(33)), 0.9)
    with pytest.raises(TypeError, match=r"solved\.result.*solved\.goal"):
        write_receipt(solved, tmp_path / "receipt.npz")


def test_an_interrupt_of_newtons_method_ends_the_run(monkeypatch):
    """Ctrl-C on the second mesh is no pause."""

    class Interrupted(one_mesh.Pause):
        def __call__(self, record):
            if self._small > 0 and record.iteration > 0:
                raise KeyboardInterrupt

    monkeypatch.setattr(one_mesh, "Pause", Interrupted)
    run = solve_to(lshape_problem(lshape.paper_mesh(33)), 1e-3)
    assert len(run.records) == 2
    assert not run.reached
    assert "1 step" in run.message
