"""J*_gamma against its residual and its Newton matrix, by central differences."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import CF, InnerProduct, x, y, z

from ngepc.dual.algorithm import NewtonSystem
from ngepc.dual.functional import DualIterate
from ngepc.dual.solver import prepared
from ngepc.dual.spaces import Coupled, FullProduct, Units
from ngepc.geometries import block
from ngepc.model.material import Material
from ngepc.results.options import NewtonOptions

BACK_STRESS = {
    2: CF((0.2, 0.1, 0.1, -0.2), dims=(2, 2)),
    3: CF((0.2, 0.1, 0, 0.1, -0.3, 0, 0, 0, 0.1), dims=(3, 3)),
}


def body(N, *, varying=False, **changes):
    """A loaded block with every kind of datum: initial state, volume force, combined hardening."""
    cells = (4, 4) if N == 2 else (2, 2, 2)
    mesh = block.structured_mesh(*cells, simplices=True)
    extra = {"lame_mu": 800 + 100 * x, "yield_stress": 1 + x * y} if varying else {}
    material = Material(
        **{"lame_lambda": 900.0, "lame_mu": 800.0, "yield_stress": 1.25, **extra},
        hardening=100.0,
        hardening_modulus=0.5,
        hardening_stiffness=200.0,
    )
    state = {
        "initial_plastic_strain": 1e-3 * BACK_STRESS[N],
        "initial_hardening": (0.1 * (1 + y) if varying else 0.1, BACK_STRESS[N]),
    }
    load = (0.0,) * (N - 1) + (2.0,)
    return replace(
        flat_problem(
            mesh,
            material,
            traction={"left": load},
            body_force=load,
            contact="contact",
            gap=0.01 * (1 + x),
            prescribed={"right": (1e-3 * (y, z)[N - 2], *(None,) * (N - 1))},
            **state,
        ),
        **changes,
    )


class State:
    """J*_gamma with its derivatives at a random v on the free degrees of freedom."""

    def __init__(self, problem, regularisation, seed=1, points=25):
        options = NewtonOptions(quadrature_points=points)
        self.functional = prepared(problem, regularisation, options)
        self.blocks = self.functional.blocks
        self.random = np.random.default_rng(seed)
        self.free = np.array(self.blocks.H.FreeDofs())
        self.v = self.direction(2.0)

    def direction(self, size=1.0):
        w = self.blocks.H_vector()
        w.FV().NumPy()[:] = size * self.random.standard_normal(len(w)) * self.free
        return w

    def at(self, step, w):
        v = w.CreateVector()
        v.data = self.v + step * w
        return DualIterate(self.functional, v)

    def energy_error(self, w, step):
        """Relative difference of <J*', w> and the central difference of J*."""
        there, back = self.at(step, w), self.at(-step, w)
        slope = InnerProduct(self.at(0.0, w).residual, w)
        size = abs(slope) + there.magnitude
        return abs((there.energy - back.energy) / (2 * step) - slope) / size

    def residual_difference(self, w, step):
        r = w.CreateVector()
        r.data = (
            1 / (2 * step) * (self.at(step, w).residual - self.at(-step, w).residual)
        )
        return r

    def newton_error(self, w, step):
        """|K^(-1) (residual difference) - w| / |w|: the Newton matrix undoes the difference."""
        system = NewtonSystem(self.blocks, "sparsecholesky")
        system.factorise(
            self.functional, DualIterate(self.functional, self.v).hessian()
        )
        dy, dv = system.solve(self.residual_difference(w, step))
        image = self.blocks.primal_of(w)  # D dy = Lambda* dv
        image -= self.blocks.primal_of(self.blocks.H_vector())
        image -= dy
        error = dv.CreateVector()
        error.data = (dv - w).Evaluate()
        size = image.Norm() / dy.Norm()
        free = self.free * error.FV().NumPy()
        return max(size, np.linalg.norm(free) / np.linalg.norm(w.FV().NumPy()))

    def set_plastic(self, values):
        """The vertex values of q, shape (d, vertices) or (d, 1)."""
        q = self.blocks.parts(self.v)[1].FV().NumPy()
        d = len(values)
        free = self.free[-len(q) :]
        q[:] = (np.broadcast_to(values, (d, len(q) // d)).ravel()) * free


CASES = {
    "plane, numbers": lambda: (body(2), Coupled(1e3)),
    "plane, small gamma": lambda: (body(2), Coupled(3.0)),
    "plane, coefficients": lambda: (body(2, varying=True), Coupled(1e3)),
    "plane, no contact": lambda: (body(2, contact=None, gap=None), Coupled(1e3)),
    "plane, full product": lambda: (
        body(2),
        Coupled(1e3, tichonov=FullProduct(), units=Units(stress=2.0, length=3.0)),
    ),
    "plane, weak Tichonov term": lambda: (body(2), Coupled(1e2, gamma_tichonov=1e6)),
    "space, full product": lambda: (body(3), Coupled(1e3, tichonov=FullProduct())),
    "space, numbers": lambda: (body(3), Coupled(1e3)),
    "space, coefficients": lambda: (body(3, varying=True), Coupled(1e2)),
}


@pytest.mark.parametrize("name", CASES)
def test_residual_is_the_derivative_of_the_energy(name):
    state = State(*CASES[name]())
    for _ in range(3):
        assert state.energy_error(state.direction(), 1e-4) < 1e-7


@pytest.mark.parametrize("name", CASES)
def test_newton_matrix_is_the_derivative_of_the_residual(name):
    state = State(*CASES[name]())
    assert (
        DualIterate(state.functional, state.v).active[1] > 0.1
    )  # the nonsmooth terms take part
    for _ in range(2):
        assert state.newton_error(state.direction(), 1e-6) < 1e-7


def kinked_states():
    """At q = 0, and at |q| = beta everywhere."""
    beta = 1.25 * 1.05
    on_circle = np.array([[0.6], [0.8]])
    return {"q = 0": 0 * on_circle, "|q| = beta": beta * on_circle}


@pytest.mark.parametrize("name", kinked_states())
def test_energy_is_differentiable_on_the_kink(name):
    """The central difference has an error c t there: it halves with t, down to the residual."""
    state = State(body(2), Coupled(10.0))
    state.set_plastic(kinked_states()[name])
    w = state.direction()
    errors = [state.energy_error(w, step) for step in (1e-2, 1e-3, 1e-4, 1e-5)]
    for coarse, fine in pairwise(errors):
        assert fine < 0.11 * coarse or fine < 1e-9
    assert errors[-1] < 1e-5


@pytest.mark.parametrize("name", kinked_states())
@pytest.mark.parametrize("side", [1, -1])
def test_newton_derivative_at_the_kink(name, side):
    """|Psi(v + t w) - Psi(v) - G(v + t w) t w| = o(t), Definition 6.1, on either side."""
    state = State(body(2), Coupled(10.0))
    state.set_plastic(kinked_states()[name])
    w = state.direction()
    here = state.at(0.0, w)
    ratios = []
    for step in (1e-2, 1e-4, 1e-6):
        there = state.at(side * step, w)
        difference = w.CreateVector()
        difference.data = 1 / (side * step) * (there.residual - here.residual)
        system = NewtonSystem(state.blocks, "sparsecholesky")
        system.factorise(state.functional, there.hessian())
        _, dv = system.solve(difference)
        dv -= w
        ratios.append(np.linalg.norm(state.free * dv.FV().NumPy()) / w.Norm())
    assert ratios[1] < 0.02 * ratios[0] or ratios[1] < 1e-8
    assert ratios[2] < 1e-6


def test_newton_matrix_is_symmetric_and_definite():
    """<G w, v> = <G v, w> and <G w, w> > 0 for the reduced Newton matrix."""
    state = State(body(2), Coupled(1e3))
    a, b = state.direction(), state.direction()
    Ga, Gb = (state.residual_difference(w, 1e-6) for w in (a, b))
    assert InnerProduct(Ga, b) == pytest.approx(InnerProduct(Gb, a), rel=1e-6)
    assert InnerProduct(Ga, a) > 0
    assert InnerProduct(Gb, b) > 0
