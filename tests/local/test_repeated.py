"""``RepeatedSolver`` gives what ``semismooth_newton`` gives, whatever changes in between."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import x

from ngepc import Coulomb, Material, Problem, Roller, semismooth_newton
from ngepc.geometries import block
from ngepc.local.solver import RepeatedSolver

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
)
SOFTER = Material.kinematic(
    lame_lambda=1e3, lame_mu=5e2, yield_stress=1.0, hardening=20.0
)

CHANGES = (
    {},
    {"gap": -0.003},
    {"gap": 0.1 * (x - 0.3) ** 2 - 0.004},
    {"traction": {"left": (1.0, 0.0)}},
    {"prescribed": {"clamped": (0.0, 0.001)}, "clamped": None},
    {"prescribed": {"clamped": (0.0, 0.002)}},
    {"prescribed": {"clamped": (0.0, 0.0), "right": Roller((1.0, 0.1), 0.0)}},
    {"prescribed": {"clamped": (0.0, 0.0), "right": Roller((1.0, 0.2), 0.0)}},
    {"prescribed": None, "clamped": "clamped", "friction": Coulomb(0.2)},
    {"friction": None, "springs": {"right": 100.0}},
    {"springs": None, "material": SOFTER},
    {"order": 2},
    {"gap": {"contact": 0.2 * (x - 0.6) ** 2 - 0.003}},
    {"kinematics": "two-dimensional", "order": 1},
)


def same(one, other):
    u = one.displacement.vec.FV().NumPy()
    v = other.displacement.vec.FV().NumPy()
    assert one.status is other.status
    assert one.iterations == other.iterations
    assert one.primal_energy == pytest.approx(other.primal_energy, rel=1e-13)
    assert np.abs(u - v).max() <= 1e-12 * np.abs(v).max()
    assert one.contact_force == pytest.approx(other.contact_force, rel=1e-11)


def test_one_problem_after_the_other():
    mesh = block.structured_mesh(4, 4, simplices=True)
    problem = Problem(mesh, METAL, contact="contact", gap=-0.002, order=1)
    solver = RepeatedSolver()
    before = None
    for change in CHANGES:
        problem = replace(problem, **change)
        result = solver(problem)
        same(result, semismooth_newton(problem))
        if before is not None:  # what an earlier result has is left alone
            assert before[0].primal_energy == before[1]
            assert before[0].contact_force == before[2]
        before = result, result.primal_energy, result.contact_force


def test_what_is_kept():
    mesh = block.structured_mesh(4, 4, simplices=True)
    first = Problem(mesh, METAL, contact="contact", gap=-0.002, order=1)
    solver = RepeatedSolver()
    one = solver(first).discrete
    two = solver(replace(first, traction={"left": (1.0, 0.0)})).discrete
    three = solver(replace(first, gap=-0.003)).discrete
    assert two.points is one.points
    assert two.supports is one.supports
    assert two.rows is one.rows
    assert two.stiffness is one.stiffness
    assert three.supports is one.supports
    assert three.rows is not one.rows
    assert three.contact.matrix is one.contact.matrix
