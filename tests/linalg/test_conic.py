"""Conic programs with solutions in closed form."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix, eye

from ngepc.linalg.conic import ConeProgram, cone_solution

NONE = csr_matrix((0, 3))
FREE = {"equations": NONE, "values": np.zeros(0), "above": NONE, "least": np.zeros(0)}


def test_the_lowest_point_of_a_ball():
    c = np.array([1.0, 2.0, -2.0])
    rows = csr_matrix(np.vstack([np.zeros(3), np.eye(3)]))
    ball = (rows, np.array([5.0, 0, 0, 0]), 4)
    found = cone_solution(ConeProgram(cost=c, cones=[ball], **FREE))
    assert found.is_success
    assert found.x == pytest.approx(-5 * c / 3, abs=1e-6)


def test_equations_and_inequalities():
    """The nearest point of a line in the positive octant: minimise t with t >= |(x, y)|."""
    given = {"equations": csr_matrix([[0.0, 1, 1]]), "values": np.array([2.0])}
    given |= {"above": csr_matrix([[0.0, 0, 1]]), "least": np.array([1.5])}
    cone = (csr_matrix(eye(3)), np.zeros(3), 3)
    found = cone_solution(ConeProgram(cost=np.eye(3)[0], cones=[cone], **given))
    assert found.x == pytest.approx((np.sqrt(2.5), 0.5, 1.5), abs=1e-6)


def test_without_a_solution_it_says_so():
    given = FREE | {"above": csr_matrix([[1.0, 0, 0], [-1, 0, 0]]), "least": np.ones(2)}
    assert not cone_solution(ConeProgram(cost=np.ones(3), cones=[], **given)).is_success
