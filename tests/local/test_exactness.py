"""The discrete problem is solved: J + J* = 0, both methods agree, everything is in balance."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import CASES, pressed_body
from campaigns.robustness import Case, extreme_problem
from ngsolve import Norm, x
from pairs import in_turn

from ngepc import (
    NewtonOptions,
    Problem,
    Status,
    lshape_problem,
    primal_newton,
    semismooth_newton,
    wrench_problem,
)
from ngepc.geometries import block, lshape, wrench
from ngepc.model.material import Material
from ngepc.primal.solver import PrimalOptions

every_case = pytest.mark.parametrize(("shape", "kinematics", "order"), CASES)


@cache
def both(shape, kinematics, order):
    """The results of the two methods for ``pressed_body``."""
    problem = pressed_body(shape, kinematics, order)
    exact = semismooth_newton(problem, options=NewtonOptions(tolerance=1e-12))
    primal = primal_newton(problem, options=PrimalOptions(tolerance=1e-12))
    return exact.raise_for_status(), primal.raise_for_status()


def distance(a, b):
    return np.abs(a - b).max(initial=0.0) / max(np.abs(b).max(initial=0.0), 1e-300)


def gap_of_duality(result):
    return abs(result.primal_energy + result.dual_energy) / abs(result.primal_energy)


@every_case
def test_duality_gap_is_rounding(shape, kinematics, order):
    assert gap_of_duality(both(shape, kinematics, order)[0]) < 1e-12


@every_case
def test_both_methods_find_the_same_solution(shape, kinematics, order):
    exact, primal = both(shape, kinematics, order)
    assert exact.history.records[-1].plastic_active > 0
    assert exact.contact_force > 0
    assert distance(exact.state.u, primal.state.u) < 1e-9
    p, expected = (r.plastic_increment.vec.FV().NumPy() for r in (exact, primal))
    assert distance(p, expected) < 1e-9
    assert distance(exact.nodal_contact_forces, primal.nodal_contact_forces) < 1e-9
    assert exact.primal_energy == pytest.approx(primal.primal_energy, rel=1e-12)
    assert exact.contact_facets == primal.contact_facets
    assert exact.contact_area == pytest.approx(primal.contact_area)


@every_case
def test_forces_are_in_balance(shape, kinematics, order):
    """The stress balances the loads at free nodes; reactions + loads + contact = 0."""
    result = both(shape, kinematics, order)[0]
    scale = np.linalg.norm(result.equilibrium.applied)
    assert np.abs(result.equilibrium.free_residual).max() < 1e-10 * scale
    total = result.applied_force + result.contact_resultant + result.reaction
    axial = (
        slice(1, 2) if kinematics == "axisymmetric" else slice(None)
    )  # hoop stress pulls inward
    assert np.abs(total[axial]).max() < 1e-10 * scale


@every_case
def test_stress_is_admissible_and_flows_where_it_yields(shape, kinematics, order):
    result = both(shape, kinematics, order)[0]
    mesh, points = result.problem.mesh, result.discrete.points
    at = mesh.MapToAllElements(points.rules, mesh.Materials(".*"))
    excess = np.ravel(result.yield_function(at))
    grown = np.ravel(Norm(result.plastic_increment)(at))
    beta = 1.25
    assert excess.max() < 1e-10 * beta
    assert np.abs(excess[grown > 1e-9]).max() < 1e-10 * beta


@every_case
def test_contact_conditions_hold_on_every_row(shape, kinematics, order):
    result = both(shape, kinematics, order)[0]
    forces, gap = result.nodal_contact_forces, result.open_gap
    assert result.state.penetration <= 1e-12 * np.abs(result.state.u).max()
    assert forces.min() >= 0
    assert (
        np.abs(forces * gap).max()
        <= 1e-12 * forces.max() * np.abs(result.state.u).max()
    )


@pytest.mark.parametrize("problem_of", [lshape_problem, wrench_problem])
def test_duality_gap_on_the_meshes_of_the_paper(problem_of):
    geometry, sizes = {
        lshape_problem: (lshape, (113, 833)),
        wrench_problem: (wrench, (873,)),
    }[problem_of]
    for nodes in sizes:
        problem = problem_of(geometry.paper_mesh(nodes))
        result = semismooth_newton(problem).raise_for_status()
        assert gap_of_duality(result) < 1e-12
        primal = primal_newton(problem).raise_for_status()
        assert distance(result.state.u, primal.state.u) < 1e-9
        assert distance(result.nodal_contact_forces, primal.nodal_contact_forces) < 1e-9


@pytest.mark.parametrize("method", [semismooth_newton, primal_newton])
def test_a_contact_between_two_nodes_of_a_coarse_mesh_is_seen(method):
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
    )
    mesh = block.structured_mesh(4, 4, simplices=True)
    problem = Problem(
        mesh,
        steel,
        contact="contact",
        gap=(x - 0.5) ** 2 - 0.01,
        kinematics="two-dimensional",
    )
    result = method(problem).raise_for_status()
    assert result.contact_force == pytest.approx(2.69, abs=0.005)
    assert "whole facets" in result.message


@pytest.mark.parametrize(
    ("change", "carried"),
    in_turn([-1e-3, -3e-8, 3e-8, 1e-3], ["displacement", "contact forces too"]),
)
def test_a_start_whose_gap_has_changed(change, carried):
    problem = lshape_problem(lshape.paper_mesh(113))
    result = semismooth_newton(problem)
    start = result.displacement if carried == "displacement" else result
    other = semismooth_newton(replace(problem, gap=problem.gap + change), start=start)
    cold = semismooth_newton(replace(problem, gap=problem.gap + change))
    assert other.raise_for_status().contact_force == pytest.approx(
        cold.contact_force, rel=1e-8
    )


@pytest.mark.parametrize("hardening", [1e-5, 2e-6])
def test_nearly_incompressible_bodies_that_hardly_harden(hardening):
    """Blocks on the diagonal are too badly conditioned there: numbers are eliminated one by one."""
    problem = extreme_problem(Case(poisson=0.4999, hardening=hardening))
    result, primal = semismooth_newton(problem), primal_newton(problem)
    assert result.status is Status.STAGNATED
    assert result.residual_norm < 2e-6
    assert result.primal_energy == pytest.approx(primal.primal_energy, rel=1e-10)
    reach = NewtonOptions(tolerance=1.2 * result.state.rounding)
    assert semismooth_newton(problem, options=reach).status is Status.CONVERGED
