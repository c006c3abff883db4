"""Random problems: both methods agree within what their energies allow, statuses are honest.

A few derandomised examples run here; ``python -m campaigns fuzz --count 100`` runs many.
"""

import dataclasses
import json
import math

import numpy as np
import pytest
from campaigns import fuzz
from campaigns.__main__ import main
from campaigns.fuzz import Fuzz, examine
from campaigns.random_problems import BODIES, GAPS, HARDENINGS, Draw, build, draws
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from ngsolve import Integrate, Norm
from witness import distance_bound, dual_residual

from ngepc import (
    Coupled,
    FullProduct,
    NewtonOptions,
    PrimalOptions,
    Status,
    Units,
    semismooth_newton,
)
from ngepc.primal.solver import primal_newton

FEW = settings(
    max_examples=6,
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
)

PLANE = sorted(set(BODIES) - {"cube"})

DRAWS = st.builds(
    Draw,
    body=st.sampled_from(PLANE),
    maxh=st.floats(0.12, 0.25),
    stress_unit=st.floats(-3, 3),
    length_unit=st.floats(-2, 2),
    poisson=st.sampled_from([-0.4, 0.0, 0.3, 0.45, 0.49]),
    yield_bound=st.floats(-4, -1.5),
    hardening=st.floats(-3, 0.5),
    kind=st.sampled_from(HARDENINGS),
    load=st.floats(-1.5, 1.2).map(lambda power: 10**power),
    angle=st.floats(0, 2 * math.pi),
    gap=st.sampled_from(GAPS),
    gap_size=st.floats(-1, 1).map(lambda power: 10**power),
    history=st.sampled_from([0.0, 0.5, 2.0]),
)

USUAL = next(draws(3))

ROUNDED_UP = Draw(  # a step to the end of the feasible set left z = 1e-17 > 0
    body="hole",
    maxh=0.11921378140688502,
    stress_unit=2.9447977103075313,
    length_unit=1.0870097508142549,
    poisson=0.49,
    yield_bound=-2.4175270670065983,
    hardening=-1.457478830082436,
    kind="kinematic",
    load=2.384296215769767,
    angle=4.793372117844414,
    gap="pushed",
    gap_size=1.1409925070915494,
    history=0.06692229448269416,
)


@FEW
@given(DRAWS)
@example(ROUNDED_UP)
@example(dataclasses.replace(USUAL, body="lshape", gap="pushed"))
@example(dataclasses.replace(USUAL, body="hole", gap="touching", history=2.0))
@example(dataclasses.replace(USUAL, body="cube", maxh=0.3, gap="near"))
def test_methods_agree_and_statuses_are_honest(draw):
    verdict = examine(draw)
    assert verdict["failures"] == ()
    assert verdict["statuses"][0] == "converged"


@FEW
@given(DRAWS)
def test_primal_solution_is_feasible_and_dissipates(draw):
    """u.n <= psi at the nodes, forces push, |dev sigma - alpha_2| <= beta(alpha_1), J <= J(0)."""
    problem = build(draw)
    result = primal_newton(problem)
    assert result.status is Status.CONVERGED
    size = np.abs(result.displacement.vec.FV().NumPy()).max()
    assert result.open_gap.min(initial=0.0) > -1e-10 * size
    assert result.nodal_contact_forces.min(initial=0.0) >= 0
    yield_excess = result.yield_function
    excess = Integrate(yield_excess + Norm(yield_excess), problem.mesh)
    scale = problem.material.yield_stress * Integrate(1.0, problem.mesh)
    assert excess < 1e-7 * scale
    if draw.gap != "pushed" and draw.history == 0:
        assert result.primal_energy <= 0


def test_the_same_seed_gives_the_same_problems():
    first, second = (
        [d for d, _ in zip(draws(11), range(20), strict=False)] for _ in range(2)
    )
    assert first == second
    assert len(set(first)) == 20


def test_study_is_resumable_and_carries_its_seed(tmp_path, monkeypatch):
    arguments = ["--out", str(tmp_path), "fuzz", "--seed", "2"]
    main([*arguments, "--count", "2"])
    first = json.loads((tmp_path / "fuzz.json").read_text())
    assert len(first["cells"]) == 2
    seen = []
    monkeypatch.setattr(
        "campaigns.fuzz.examine", lambda d: seen.append(d) or examine(d)
    )
    main([*arguments, "--count", "3"])
    assert len(seen) == 1
    table = (tmp_path / "fuzz.md").read_text()
    assert "| all | 3 | 0 |" in table
    assert "seed 2" in table


def coupled(draw, problem):
    """The paper's regularisation in units in which lame_mu is 1e3 and the body has size one."""
    length = BODIES[draw.body].length * 10**draw.length_unit
    units = Units(stress=problem.material.lame_mu / 1e3, length=length)
    return Coupled(10.0, tichonov=FullProduct(), units=units)


@FEW
@given(DRAWS)
@example(dataclasses.replace(USUAL, body="hole", gap="touching", history=2.0))
def test_regularised_solution_is_as_near_as_energies_allow_and_its_status_honest(draw):
    problem = build(draw)
    options = NewtonOptions(quadrature_points=25)
    dual = semismooth_newton(
        problem, regularisation=coupled(draw, problem), options=options
    )
    if dual.status is not Status.CONVERGED:
        assert dual.message
        return
    unit, witness = dual.functional.blocks.residual_unit, dual_residual(dual, 25)
    assert witness.norm < 1e-10 * unit + witness.rounding
    distance, above = distance_bound(primal_newton(problem), dual)
    assert distance <= above + 1e-8 * (abs(above) + abs(dual.dual_energy))


def test_a_lie_is_found(monkeypatch):
    """The judge detects a result for another load and a false status."""
    draw = dataclasses.replace(USUAL, body="lshape", load=5.0, gap="near")
    assert examine(draw)["failures"] == ()
    problem_of, solve = fuzz.build, fuzz.semismooth_newton
    lighter = problem_of(dataclasses.replace(draw, load=1.0))

    def other_load(problem):
        return solve(dataclasses.replace(problem, traction=lighter.traction))

    with monkeypatch.context() as patch:
        patch.setattr(fuzz, "semismooth_newton", other_load)
        assert "energies allow" in " ".join(examine(draw)["failures"])

    def of_another_problem(problem):
        other = primal_newton(lighter)
        other.state.body.problem = problem
        return other

    with monkeypatch.context() as patch:
        patch.setattr(fuzz, "primal_newton", of_another_problem)
        assert "energies allow" in " ".join(examine(draw)["failures"])

    def hurried(problem):
        return primal_newton(problem, options=PrimalOptions(tolerance=1e-3))

    with monkeypatch.context() as patch:
        patch.setattr(fuzz, "primal_newton", hurried)
        assert "says converged" in " ".join(examine(draw)["failures"])


def test_study_refuses_a_foreign_checkpoint(tmp_path):
    kept = tmp_path / "cells" / "fuzz-5-1.npz"
    kept.parent.mkdir()
    kept.write_bytes(b"something else")
    with pytest.raises(ValueError, match="damaged"):
        Fuzz(tmp_path, 1, 5).run()
    assert kept.read_bytes() == b"something else"
