"""A hardening law of one's own in one class: solve, certificate, bound and gradient from it."""

from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import Mesh, log, unit_square

from ngepc import HardeningLaw, Material, Problem, error_bound, gradient
from ngepc import semismooth_newton as solve


def logarithm(x):
    """Of numbers and arrays, or of NGSolve's coefficients."""
    return np.log(x) if isinstance(x, float | np.ndarray) else log(x)


@dataclass(frozen=True, eq=False)
class Logarithm(HardeningLaw):
    """R = yield_stress + growth log(1 + x/scale)."""

    yield_stress: float
    growth: float
    scale: float

    def energy(self, x):
        area = (self.scale + x) * logarithm(1 + x / self.scale) - x
        return self.yield_stress * x + self.growth * area

    def stress(self, x):
        return self.yield_stress + self.growth * logarithm(1 + x / self.scale)

    def slope(self, x):
        return self.growth / (self.scale + x)


MESH = Mesh(unit_square.GenerateMesh(maxh=0.4))


def problem(growth):
    metal = Material.with_law(
        lame_lambda=1e3, lame_mu=1e3, law=Logarithm(10.0, growth, 0.01), hardening=20.0
    )
    load = {"traction": {"right": (12.0, 0.0)}, "contact": "top", "gap": 0.01}
    return Problem(MESH, metal, clamped="bottom", **load)


@pytest.fixture(scope="module")
def solved():
    return solve(problem(40.0)).raise_for_status()


def test_the_certificate_closes(solved):
    assert solved.state.at.yields.any()
    gap = solved.primal_energy + solved.dual_energy
    assert abs(gap) <= 1e-9 * abs(solved.primal_energy)


def test_the_bound_is_proved_and_contains_a_finer_solution(solved):
    bound = error_bound(solved)
    finer = Mesh(MESH.ngmesh.Copy())
    finer.Refine()
    best = solve(problem(40.0).changed(mesh=finer)).primal_energy
    assert bound.guaranteed
    assert bound.least_energy <= best <= bound.energy


def test_the_gradient_is_that_of_differences(solved):
    step = 0.1
    high, low = (solve(problem(40.0 + s)).primal_energy for s in (step, -step))
    exact = gradient(solved, "primal_energy", ["law.growth"])["law.growth"]
    assert exact == pytest.approx((high - low) / (2 * step), rel=1e-5)
