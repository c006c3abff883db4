"""The tangent: NGSolve's forms against the direct assembly, and both against differences."""

import numpy as np
import pytest
from bodies import CASES, pressed_body
from saddle_forms import SaddleForms, SymbolicForms

from ngepc import NewtonOptions, Status, semismooth_newton
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem

CHOLESKY = "sparsecholesky"

DIRECT = (CHOLESKY, "umfpack")

every_case = pytest.mark.parametrize(("shape", "kinematics", "order"), CASES)


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


@every_case
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
    forms, here = SaddleForms(discrete, "umfpack"), discrete.state(discrete.supports.values)
    load = 0.6 * discrete.load
    for _ in range(12):
        forms.linearise(here)
        missing = np.where(discrete.supports.free, load - here.internal_forces, 0.0)
        here = discrete.state(here.u + forms.solve(missing))
    missing = np.where(discrete.supports.free, load - here.internal_forces, 0.0)
    assert here.at.yields.any()
    assert np.abs(missing).max() < 1e-11 * np.abs(load).max()


@every_case
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


@every_case
def test_tangent_is_the_derivative_of_the_internal_forces(shape, kinematics, order):
    """With w = beta s/|s|: central differences of the forces, and of the energy."""
    discrete = DiscreteProblem(pressed_body(shape, kinematics, order))
    here = random_state(discrete).on_sphere()
    d, t = 1e-2 * np.random.default_rng(2).normal(size=here.u.shape) * np.abs(here.u), 1e-5
    ahead, behind = (discrete.state(here.u + sign * t * d) for sign in (1, -1))
    assert (ahead.at.yields == behind.at.yields).all()
    change = (ahead.internal_forces - behind.internal_forces) / (2 * t)
    volume, e = discrete.points.strain(d)
    moduli = here.moduli
    assert relative(discrete.points.forces(moduli.bulk * volume, moduli(e)), change) < 1e-6
    slope = (ahead.energy - behind.energy) / (2 * t)
    assert np.vdot(here.internal_forces - discrete.load, d) == pytest.approx(slope, rel=1e-6)


@every_case
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
