"""Pieces of the paper's method: solves with D, balance of a result, and how a run ends."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve.la import BaseVector

from ngepc import (
    Coupled,
    Material,
    NewtonOptions,
    Problem,
    Status,
    lshape_problem,
    semismooth_newton,
)
from ngepc.dual import stopping
from ngepc.dual.algorithm import DualLine
from ngepc.dual.result import DualResult
from ngepc.dual.stopping import Tolerances, ended, final_check
from ngepc.geometries import block, lshape
from ngepc.results.outcome import History

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
)


def pressed(**data):
    """A block that is clamped below and pressed from above."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    data = {"contact": "contact", "gap": -2e-3} | data
    return semismooth_newton(Problem(mesh, METAL, "clamped", **data), 1e4)


def test_solves_with_d_leave_no_residual():
    """D y = r in one solve, also for right hand sides of plastic strains."""
    blocks = pressed().functional.blocks
    free = np.array(list(blocks.Y.FreeDofs()), dtype=bool)
    r = blocks.load.CreateVector()
    random = np.random.default_rng(0)
    r.FV().NumPy()[:] = np.where(free, random.normal(size=len(free)), 0.0)
    y = blocks.primal_response(r)
    rest = (r - blocks.D * y).Evaluate().FV().NumPy()[free]
    assert np.linalg.norm(rest) < 1e-9 * r.Norm()


def test_forces_of_a_result_balance():
    """Applied forces, those of the obstacle and reactions; the obstacle's are the pressure's."""
    result = pressed(traction={"right": (0.5, -0.2)})
    forces = result.equilibrium
    size = np.abs(forces.contact).max()
    assert result.status is Status.CONVERGED
    assert np.abs(forces.free_residual).max() < 1e-8 * size
    reactions = sum(forces.reactions.values())
    rest = forces.applied.sum(axis=1) + forces.contact.sum(axis=1) + reactions
    assert np.abs(rest).max() < 1e-8 * size
    assert forces.contact[1].sum() == pytest.approx(-result.contact_force, rel=1e-9)
    assert result.contact_force > 0


def vector(value):
    """A vector of NGSolve with one number."""
    made = BaseVector(1)
    made[0] = value
    return made


@pytest.mark.parametrize(
    ("slope", "rounding", "status"),
    [
        (1e-20, True, Status.STAGNATED),
        (-1e-20, True, Status.LINESEARCH_FAILED),
        (1.0, False, Status.LINESEARCH_FAILED),
        (math.nan, False, Status.NONFINITE),
    ],
)
def test_why_no_step_length_was_found(slope, rounding, status):
    """An ascent by rounding alone means that nothing is left to gain."""
    again = SimpleNamespace(penalties=(1.0, 2.0), multipliers=vector(1.0))
    functional = SimpleNamespace(at=lambda v, y: again)
    line = SimpleNamespace(
        here=SimpleNamespace(functional=functional, v=None, y=None),
        slope_0=slope,
        dv=vector(1.0),
        is_rounding=lambda value: rounding,
    )
    assert DualLine.fault(line) is status


@pytest.mark.parametrize(
    ("factor", "corrections", "status"),
    [(0.1, 2, Status.CONVERGED), (0.8, 1, None), (0.3, 3, None)],
)
def test_corrections_go_on_while_they_halve_the_residual(
    factor, corrections, status, monkeypatch
):
    """From 1 on, for a tolerance of 0.02: three corrections at most."""
    solves = []

    class Linear:
        """The residual is v, a solve takes a part of it away."""

        def __init__(self, functional, v):
            self.functional = functional
            self.v = v
            self.residual = v
            self.residual_norm = abs(v[0])
            self.norms = np.array([abs(v[0]), 0.0])
            self.y = None

    def solve(right):
        solves.append(right[0])
        return None, ((1 - factor) * right).Evaluate()

    functional = SimpleNamespace(rounding=lambda y: np.array([1e-9, 0.0]))
    monkeypatch.setattr(stopping, "DualIterate", Linear)
    here, found, _ = final_check(
        Linear(functional, vector(1.0)), Tolerances(0.02), 3, solve
    )
    assert len(solves) == corrections
    kept = corrections if factor <= 0.5 else corrections - 1
    assert here.residual_norm == pytest.approx(factor**kept)
    assert found is status


def test_messages_tell_of_damping_in_the_last_five_steps():
    problem = lshape_problem(lshape.paper_mesh(33))
    result = semismooth_newton(problem, 1e3, options=NewtonOptions(max_iterations=1))
    lengths = [math.nan, 0.01, 1.0, 0.25, 1.0, 0.5, 1.0, 1.0]
    records = [
        SimpleNamespace(iteration=number, step_length=length)
        for number, length in enumerate(lengths)
    ]
    here = SimpleNamespace(functional=result.functional, v=result.v)
    asked = (Status.ITERATION_LIMIT, "", History(records), Tolerances(1e-8))
    message = ended(here, *asked).message
    assert "Step 3 was damped to 0.25, the shortest of the last 5." in message
    asked = (Status.ITERATION_LIMIT, "", History(records[:3]), Tolerances(1e-8))
    message = ended(here, *asked).message
    assert "Step 1 was damped to 0.01, the shortest of the last 2." in message


@pytest.mark.parametrize(
    ("gamma", "label"),
    [(1.0, "1"), (2500.0, "2500"), (1e4, "1e4"), (5.0**13, "1.221e9"), (1e-5, "1e-05")],
)
def test_a_result_says_its_gamma_as_it_is_written_in_a_call(gamma, label):
    functional = SimpleNamespace(regularisation=Coupled(gamma))
    result = DualResult(functional, *[None] * 5)
    assert result.method_label == f"gamma = {label}"
    assert float(result.method_label.partition("=")[2]) == pytest.approx(
        gamma, rel=1e-3
    )
