"""J beside conic programming: a program that shares nothing with the solvers but the data."""

import pytest

pytest.importorskip("clarabel")

from campaigns.cones import AGREE, Cones, random_problem
from conic import FULL, minimum

from ngepc import primal_newton

SEEDS = (2, 3, 6, 7, 8, 9, 10, 12, 14, 15, 16, 19, 22, 40)
"""Plane and solid, both orders, no contact, obstacles, two bodies, Tresca's friction."""


@pytest.mark.parametrize("seed", SEEDS)
def test_energies_agree(tmp_path, seed):
    record = Cones(tmp_path).solve(seed)
    assert not record["wrong"], record
    assert record["difference"] < 100 * AGREE  # also where the accuracy is reduced


def test_the_primal_method_agrees_too():
    problem = random_problem(2)
    found = minimum(problem)
    assert found.status == FULL
    energy = primal_newton(problem).raise_for_status().primal_energy
    assert abs(energy - found.energy) < AGREE * abs(energy)
