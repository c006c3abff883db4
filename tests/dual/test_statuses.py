"""Honest statuses: CONVERGED is earned, everything else is named, explained and keeps a state."""

import dataclasses
import math
import re

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import CF, Integrate, Norm, Parameter, y
from samples import state_of
from witness import balance_residual, dual_residual

from ngepc import (
    Coupled,
    FullProduct,
    Material,
    NewtonOptions,
    SolverError,
    Status,
    lshape_problem,
    semismooth_newton,
)
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.stiffness import Stiffness
from ngepc.dual.algorithm import NewtonSystem
from ngepc.dual.path import PathOptions, follow_path
from ngepc.dual.stopping import ADVICE
from ngepc.evolution.solver import evolve
from ngepc.geometries import block, lshape
from ngepc.methods import newton
from ngepc.primal.solver import PrimalOptions, primal_newton

NAN = math.nan


@pytest.fixture(scope="module")
def small():
    return lshape_problem(lshape.paper_mesh(113))


REGULARISATIONS = {
    "coupled": Coupled(1e3),
    "coupled 1e4": Coupled(1e4),
    "full product": Coupled(1e2, tichonov=FullProduct()),
    "weak Tichonov term": Coupled(1e2, tichonov=FullProduct(), gamma_tichonov=1e5),
}


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [(name, (1e-4, 1e-10)[k % 2]) for k, name in enumerate(REGULARISATIONS)],
)
def test_converged_means_an_independent_residual_below_the_tolerance(
    small, name, tolerance
):
    """Assembled with 400 points on every element and solved by another direct solver."""
    options = NewtonOptions(tolerance=tolerance)
    result = semismooth_newton(
        small, regularisation=REGULARISATIONS[name], options=options
    )
    witness = dual_residual(result)
    assert result.status is Status.CONVERGED
    assert re.fullmatch(r"Strains reach .* may be wrong by as much\.", result.message)
    assert witness.rounding < 1e-11
    assert witness.norm < tolerance + witness.rounding
    assert result.residual_norm == pytest.approx(witness.norm, rel=1e-4, abs=1e-11)


def test_a_run_that_did_not_converge_reports_its_true_residual(small):
    options = NewtonOptions(max_iterations=4)
    result = semismooth_newton(small, 1e4, options=options)
    assert result.status is Status.ITERATION_LIMIT
    assert result.residual_norm == pytest.approx(dual_residual(result).norm, rel=1e-6)
    assert result.residual_norm > 1e-3


@pytest.mark.parametrize("tolerance", [1e-4, 1e-10])
def test_primal_converged_means_the_same(small, tolerance):
    result = primal_newton(small, options=PrimalOptions(tolerance=tolerance))
    assert result.status is Status.CONVERGED
    assert balance_residual(result) < 2 * tolerance
    assert result.residual_norm < tolerance


def test_an_inverse_that_lies_does_not_make_a_run_converge(small, monkeypatch):
    """Steps that are wrong by a tenth: the run takes longer or says so, the residual decides."""
    solve = NewtonSystem.solve

    def crooked(self, *arguments):
        dy, dv = solve(self, *arguments)
        dy *= 0.9
        dv *= 0.9
        return dy, dv

    monkeypatch.setattr(NewtonSystem, "solve", crooked)
    result = semismooth_newton(small, 1e3, options=NewtonOptions(max_iterations=40))
    residual = dual_residual(result).norm
    assert (result.status is Status.CONVERGED) == (residual < 1e-10)


# Poison in mid-run


def poisoned(problem, name):
    """The problem with one datum as a Parameter, and that Parameter."""
    datum = Parameter(getattr(problem.material, name))
    material = dataclasses.replace(problem.material, **{name: datum})
    return dataclasses.replace(problem, material=material), datum


@pytest.mark.parametrize("regularisation", ["coupled", "coupled 1e4"])
def test_coefficient_that_turns_bad_in_mid_run_is_named_and_the_last_good_state_stays(
    small, monkeypatch, regularisation
):
    monkeypatch.setattr(newton, "own_copy", lambda problem: problem)
    problem, bound = poisoned(small, "yield_stress")

    def monitor(record):
        if record.iteration == 3:
            bound.Set(NAN)

    R = REGULARISATIONS[regularisation]
    result = semismooth_newton(problem, regularisation=R, monitor=monitor)
    bound.Set(small.material.yield_stress)
    assert result.status is Status.NONFINITE
    assert result.iterations == 3
    assert "Check loads and coefficients" in result.message
    assert np.isfinite(state_of(result)).all()
    assert result.dual_energy < result.history.energies[0]


def regularised(problem, monitor=None):
    return semismooth_newton(problem, 1e3, monitor=monitor)


@pytest.mark.parametrize("solve", [primal_newton, semismooth_newton, regularised])
def test_methods_keep_the_data_that_they_began_with(small, solve):
    problem, bound = poisoned(small, "yield_stress")

    def monitor(record):
        if record.iteration == 3:
            bound.Set(NAN)

    result = solve(problem, monitor=monitor)
    assert result.status is Status.CONVERGED
    assert result.primal_energy == pytest.approx(solve(small).primal_energy, rel=1e-12)
    assert np.isfinite(result.displacement.vec.FV().NumPy()).all()


def test_load_that_is_bad_from_the_start_is_named(small):
    load = Parameter(1.0)
    problem = dataclasses.replace(small, traction={"load": CF((0.0, load))})
    load.Set(NAN)
    result = semismooth_newton(problem, 1e3)
    assert result.status is Status.NONFINITE
    assert result.iterations == 0


# Broken linear algebra


def broken_factorisation(self):
    raise RuntimeError("matrix is singular")


@pytest.mark.parametrize("name", ["coupled", "coupled 1e4"])
def test_failed_factorisation_is_named_with_the_last_good_state(
    small, monkeypatch, name
):
    reached = []
    invert = NewtonSystem._invert

    def third_time(self, matrix):
        reached.append(None)
        if len(reached) == 3:
            broken_factorisation(self)
        invert(self, matrix)

    monkeypatch.setattr(NewtonSystem, "_invert", third_time)
    result = semismooth_newton(small, regularisation=REGULARISATIONS[name])
    assert result.status is Status.NONFINITE
    assert result.iterations == 2
    assert "could not factorise the Newton matrix: matrix is singular" in result.message
    assert np.isfinite(state_of(result)).all()
    with pytest.raises(SolverError, match="singular"):
        result.raise_for_status()


def test_primal_failed_factorisation_is_named(small, monkeypatch):
    monkeypatch.setattr(Stiffness, "whole", lambda self, A: broken_factorisation(self))
    result = primal_newton(small, options=PrimalOptions(inverse="umfpack"))
    assert result.status is Status.NONFINITE
    assert "singular" in result.message
    assert np.isfinite(state_of(result)).all()


def test_factors_of_nan_are_named(small, monkeypatch):
    """NGSolve's sparsecholesky returns NaN for singular matrices and says nothing."""
    invert = NewtonSystem._invert

    def poisoned_matrix(self, matrix):
        matrix.AsVector().FV().NumPy().fill(NAN)
        invert(self, matrix)

    monkeypatch.setattr(NewtonSystem, "_invert", poisoned_matrix)
    result = semismooth_newton(small, 1e3)
    assert result.status is Status.NONFINITE
    assert np.isfinite(state_of(result)).all()


@pytest.mark.parametrize("name", ["coupled", "full product"])
def test_direction_uphill_is_a_failed_line_search(small, monkeypatch, name):
    solve = NewtonSystem.solve

    def uphill(self, r):
        dy, dv = solve(self, r)
        dy *= -1.0
        dv *= -1.0
        return dy, dv

    monkeypatch.setattr(NewtonSystem, "solve", uphill)
    result = semismooth_newton(small, regularisation=REGULARISATIONS[name])
    assert result.status is Status.LINESEARCH_FAILED
    assert "smaller gamma or a smaller load step" in result.message


# Messages say what was seen, where, and what to try


def test_message_names_the_damped_step(small):
    result = semismooth_newton(small, 1e4, options=NewtonOptions(max_iterations=4))
    shortest = min(result.history.records[1:], key=lambda r: r.step_length)
    assert shortest.step_length < 1
    assert (
        f"Step {shortest.iteration} was damped to {shortest.step_length:.3g}"
        in result.message
    )


def test_every_status_has_its_advice():
    silent, of_others = (
        {Status.CONVERGED, Status.STOPPED},
        {"BOUNDED", "LIMIT_LOAD", "UNHELD", "NOT_UNIQUE", "MESH_LIMIT", "STEP_LIMIT"},
    )
    assert {status.name for status in set(Status) - silent - set(ADVICE)} == of_others


@pytest.mark.parametrize("R", [REGULARISATIONS["full product"], Coupled(1e2)])
def test_tolerance_below_rounding_is_named_and_the_message_quotes_the_true_residual(
    small, R
):
    """Loads of 3e4 leave 1e-10 of rounding; what is updated from step to step drifts below it."""
    problem = dataclasses.replace(small, traction={"load": (0.0, 3e4)})
    options = NewtonOptions(tolerance=1e-16)
    result = semismooth_newton(problem, regularisation=R, options=options)
    assert result.status is Status.STAGNATED
    assert 1e-12 < result.residual_norm < 1e-7
    assert f"the residual is {result.residual_norm:.3g}" in result.message
    reach = float(re.search(r"A tolerance above (\S+) can be met", result.message)[1])
    assert reach > result.residual_norm + result.residual_rounding


def test_a_residual_below_the_tolerance_is_not_what_a_tolerance_should_exceed():
    """Rounding errors may hide a larger residual: the advice says how large that may be."""
    problem = lshape_problem(lshape.paper_mesh(33))
    result = semismooth_newton(problem, 1e3, options=NewtonOptions(tolerance=1e-14))
    assert result.status is Status.STAGNATED
    assert max(1e-14, result.residual_norm) < result.residual_rounding
    assert "above this residual" not in result.message
    reach = float(re.search(r"A tolerance above (\S+) can be met", result.message)[1])
    met = semismooth_newton(problem, 1e3, options=NewtonOptions(tolerance=reach))
    assert met.status is Status.CONVERGED


# Paths and load histories pass statuses on


def test_path_that_fails_inside_says_where(small):
    options = PathOptions(
        gamma_start=10.0,
        gamma_end=1e6,
        growth=100.0,
        newton=NewtonOptions(max_iterations=5),
    )
    path = follow_path(small, options)
    assert path.status is Status.ITERATION_LIMIT
    assert "5 steps" in path.message
    assert path.steps[-1].status is Status.ITERATION_LIMIT
    assert math.isfinite(path.last.dual_energy)


def test_path_stopped_in_an_inner_iteration_is_stopped(small):
    def monitor(record):
        if record.iteration == 2:
            raise KeyboardInterrupt

    options = PathOptions(gamma_start=10.0, gamma_end=1e4, growth=10.0)
    path = follow_path(small, options, newton_monitor=monitor)
    assert path.status is Status.STOPPED
    assert np.isfinite(state_of(path.last)).all()


def test_ctrl_c_before_the_first_state_of_a_path_is_passed_on(small, monkeypatch):
    def interrupted(self, functional, inverse):
        raise KeyboardInterrupt

    monkeypatch.setattr(NewtonSystem, "__init__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        follow_path(small, PathOptions())


def failing_solver(status):
    """A step solver that gives up with a status from the second step on."""
    calls = []

    def solve(problem, start):
        calls.append(None)
        result = semismooth_newton(problem, 1e2)
        if len(calls) >= 2:
            return dataclasses.replace(
                result, status=status, message="seen in the solver"
            )
        return result

    return solve


@pytest.mark.parametrize("status", [s for s in Status if not s.is_success])
def test_history_that_fails_keeps_the_finished_steps(small, status):
    steps = [(t, {"traction": {"load": (0.0, 3.0 * t)}}) for t in (1.0, 2.0, 3.0)]
    evolution = evolve(small, steps, failing_solver(status))
    assert evolution.status is status
    assert len(evolution.steps) == 1
    assert "seen in the solver" in evolution.message
    assert Integrate(Norm(evolution.steps[0].fields.displacement), small.mesh) > 0


# Interrupts in the library


@pytest.mark.parametrize("where", ["_invert", "solve"])
def test_ctrl_c_anywhere_in_a_step_returns_the_last_state(small, monkeypatch, where):
    original, calls = getattr(NewtonSystem, where), []

    def interrupted(self, *arguments):
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(self, *arguments)

    monkeypatch.setattr(NewtonSystem, where, interrupted)
    result = semismooth_newton(small, 1e4)
    assert (result.status, result.iterations) == (Status.STOPPED, 2)
    assert np.isfinite(state_of(result)).all()


def test_ctrl_c_in_the_primal_solver_returns_the_last_state(small, monkeypatch):
    calls, direction = [], Factors.linearise

    def interrupted(self, here):
        calls.append(None)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return direction(self, here)

    monkeypatch.setattr(Factors, "linearise", interrupted)
    result = primal_newton(small)
    assert (result.status, result.iterations) == (Status.STOPPED, 2)
    assert np.isfinite(state_of(result)).all()


def test_errors_of_a_monitor_are_not_swallowed(small):
    def monitor(record):
        raise ZeroDivisionError

    for solver in (lambda: semismooth_newton(small, 1e3, monitor=monitor),
                   lambda: primal_newton(small, monitor=monitor)):  # fmt: skip
        with pytest.raises(ZeroDivisionError):
            solver()


# Hard problems end in a status


HARD = {
    "nearly incompressible": {"lame_lambda": 5e6},
    "nearly perfect plasticity": {"hardening": 1e-3},
    "tiny yield stress": {"yield_stress": 1e-9},
    "huge yield stress": {"yield_stress": 1e12},
    "soft": {"lame_lambda": 1e-9, "lame_mu": 1e-9},
}


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("method", ["primal", "coupled"])
def test_hard_problems_end_in_a_status(name, method):
    material = Material.kinematic(
        **({"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": 1.25, "hardening": 100.0}
        | HARD[name])
    )  # fmt: skip
    mesh = block.structured_mesh(4, 4, simplices=True)
    load = {"left": CF((0.0, 3.0 * y))}
    problem = flat_problem(mesh, material, traction=load, contact="contact", gap=1e-3)
    if method == "primal":
        result = primal_newton(problem)
        residual, tolerance = balance_residual(result), 2e-10
    else:
        result = semismooth_newton(
            problem, 1e2, options=NewtonOptions(max_iterations=60)
        )
        witness = dual_residual(result)
        residual, tolerance = witness.norm, 1e-10 + witness.rounding
    assert isinstance(result.status, Status)
    assert np.isfinite(state_of(result)).all()
    assert result.status is not Status.CONVERGED or residual < tolerance
    assert result.status is Status.CONVERGED or result.message
