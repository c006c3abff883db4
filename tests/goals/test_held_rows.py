"""Forces of contact rows that are cut off, with the compliance of the rows known."""

import numpy as np
import pytest

from ngepc.goals.held_rows import Held, HeldRows
from ngepc.linalg.secants import Compliance

ROWS = 12


def cut_off(seed, most):
    """S, the forces of a random problem, and what is left of them."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(ROWS, ROWS))
    S = A @ A.T + np.eye(ROWS)
    forces = rng.normal(size=ROWS)
    held = rng.random(ROWS) < 0.8
    forces[~held] = 0.0
    rows = HeldRows(None, None, Compliance.of(S), 0.0)
    start = Held(np.zeros((1, 2)), forces)
    return S, forces, held, rows.limited(start, held, np.full(ROWS, most))


@pytest.mark.parametrize("seed", range(5))
def test_rows_whose_forces_are_not_cut_off_do_not_move(seed):
    """|x| <= most, and S (x - x_0) = 0 on the rows that are held with smaller forces."""
    most = 0.8
    S, forces, held, found = cut_off(seed, most)
    assert np.abs(forces).max() > most, "something is cut off"
    assert np.abs(found).max() <= most
    assert not found[~held].any()
    kept = held & (np.abs(found) < most)
    assert kept.any()
    moved = S @ (found - forces)
    assert np.abs(moved[kept]).max() < 1e-12 * np.abs(S).max()


def test_forces_within_their_limits_stay():
    _, forces, _, found = cut_off(0, most=10.0)
    assert np.array_equal(found, forces)
