"""The tangent: NGSolve's forms against the direct assembly, and both against differences."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import ALTERNATING, pressed_body
from saddle_forms import SaddleForms

from ngepc import (
    Coulomb,
    Material,
    NewtonOptions,
    PrimalOptions,
    PyAMG,
    Roller,
    Status,
    SymbolicForms,
    Voce,
    primal_newton,
    semismooth_newton,
)
from ngepc.discretisation.factors import Factors
from ngepc.local.system import DiscreteProblem

CHOLESKY = "sparsecholesky"

DIRECT = (CHOLESKY, "umfpack")

in_turn = pytest.mark.parametrize(("shape", "kinematics", "order"), ALTERNATING)


def random_state(discrete):
    """A state in which about half of the points yield, w anywhere in its ball."""
    rng = np.random.default_rng(0)
    free, d = discrete.supports.free, discrete.problem.kinematics.d
    u = np.where(free, rng.normal(size=free.shape), 0.0)
    u *= 1.1 * 1.25 / np.median(discrete.state(u).at.size)
    w = rng.normal(size=(len(discrete.points), d))
    state = discrete.state(u, w)
    assert 0 < state.at.yields.mean() < 1
    return state


def relative(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


@in_turn
def test_condensed_saddle_forms_are_the_tangent(shape, kinematics, order):
    """u x p x q, condensed by NGSolve, answers forces as the matrix assembled directly does."""
    discrete = DiscreteProblem(pressed_body(shape, kinematics, order))
    here = random_state(discrete)
    forms, direct = SaddleForms(discrete, "umfpack"), Factors(discrete, CHOLESKY)
    forms.linearise(here)
    direct.linearise(here)
    forces = np.random.default_rng(1).normal(size=here.u.shape)
    assert relative(direct.solve(forces), forms.solve(forces)) < 1e-12


@pytest.mark.parametrize("shape", ["triangles", "prisms"])
def test_newton_steps_with_the_forms_solve_a_problem(shape):
    """Five lines for a lecture: u += K^-1 (l - internal forces), w on the sphere."""
    discrete = DiscreteProblem(pressed_body(shape))
    forms, here = (
        SaddleForms(discrete, "umfpack"),
        discrete.state(discrete.supports.values),
    )
    load = 0.6 * discrete.load
    for _ in range(12):
        forms.linearise(here)
        missing = np.where(discrete.supports.free, load - here.internal_forces, 0.0)
        here = discrete.state(here.u + forms.solve(missing))
    missing = np.where(discrete.supports.free, load - here.internal_forces, 0.0)
    assert here.at.yields.any()
    assert np.abs(missing).max() < 1e-11 * np.abs(load).max()


@in_turn
def test_newton_takes_the_same_decisions_with_forms(shape, kinematics, order):
    """What touches, what yields and how long the steps are, iterate by iterate."""
    problem, numbers = pressed_body(shape, kinematics, order), []
    for inverse in (CHOLESKY, SymbolicForms()):
        result = semismooth_newton(problem, options=NewtonOptions(inverse=inverse))
        assert result.status is Status.CONVERGED
        names = ("contact_active", "plastic_active", "step_length", "energy")
        numbers.append(np.array([result.history.column(name) for name in names]))
    direct, forms = numbers
    assert (direct[:2, -1] > 0).all()
    assert forms.shape == direct.shape
    assert forms == pytest.approx(direct, rel=1e-9, abs=1e-12)


SOFT = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=Voce(1.25, 1.0, 10.0))

MORE = {
    "springs": {"springs": {"left": 2.0}},
    "a law": {"material": SOFT, "initial_strain": 1e-4},
    "friction": {"friction": Coulomb(0.3)},
    "a roller": {"prescribed": {"left": Roller((1.0, 0.2))}},
}


@pytest.mark.parametrize("given", MORE.values(), ids=MORE)
@pytest.mark.parametrize("solver", ["umfpack", PyAMG()])
def test_forms_know_all_that_the_fast_assembly_knows(given, solver):
    """With direct and iterative solvers: the same steps, forces and word on other equilibria."""
    problem = replace(pressed_body("triangles"), **given)
    options = [
        NewtonOptions(inverse=inverse)
        for inverse in (solver, SymbolicForms(inverse=solver))
    ]
    direct, forms = (semismooth_newton(problem, options=chosen) for chosen in options)
    assert (forms.status, forms.message) == (direct.status, direct.message)
    assert forms.history.energies == pytest.approx(direct.history.energies, rel=1e-9)
    assert forms.state.contact == pytest.approx(
        direct.state.contact, rel=1e-8, abs=1e-10
    )


def test_the_primal_method_says_that_it_has_forms_of_its_own():
    with pytest.raises(ValueError, match="forms of its own"):
        primal_newton(
            pressed_body("triangles"), options=PrimalOptions(inverse=SymbolicForms())
        )


@in_turn
def test_tangent_is_the_derivative_of_the_internal_forces(shape, kinematics, order):
    """With w = beta s/|s|: central differences of the forces, and of the energy."""
    discrete = DiscreteProblem(pressed_body(shape, kinematics, order))
    here = random_state(discrete).with_radial_return()
    d, t = (
        1e-2 * np.random.default_rng(2).normal(size=here.u.shape) * np.abs(here.u),
        1e-5,
    )
    ahead, behind = (discrete.state(here.u + sign * t * d) for sign in (1, -1))
    assert (ahead.at.yields == behind.at.yields).all()
    change = (ahead.internal_forces - behind.internal_forces) / (2 * t)
    volume, e = discrete.points.strain(d)
    moduli = here.moduli
    assert (
        relative(discrete.points.forces(moduli.bulk * volume, moduli(e)), change) < 1e-6
    )
    slope = (ahead.energy - behind.energy) / (2 * t)
    assert np.vdot(here.internal_forces - discrete.load, d) == pytest.approx(
        slope, rel=1e-6
    )


@in_turn
def test_matrix_is_the_product_with_moduli(shape, kinematics, order):
    """Stiffness.fill: K u = B' C B u at free components, for any symmetric moduli."""
    discrete = DiscreteProblem(pressed_body(shape, kinematics, order))
    here = random_state(discrete)
    moduli = here.moduli
    volume, e = discrete.points.strain(here.u)
    forces = discrete.points.forces(moduli.bulk * volume, moduli(e))
    for solver in DIRECT:
        factors = Factors(discrete, solver)
        factors.update(moduli)
        assert relative(factors.solve(forces), here.u) < 1e-10
