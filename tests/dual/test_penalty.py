"""The plastic term M^2: which elements need which rule, and states that stay as they were."""

import numpy as np
import pytest
from ngsolve import GridFunction

from ngepc import lshape_problem
from ngepc.discretisation.quadrature import SMOOTH, classify
from ngepc.discretisation.spaces import plastic_dual_space
from ngepc.dual.penalty import PlasticPenalty
from ngepc.geometries import lshape
from ngepc.model.elements import element_vertices

VARIATION = "ngepc.discretisation.quadrature.SMOOTH_VARIATION"


def penalty(problem, R, points=400):
    return PlasticPenalty(problem, 1e4, R, points)


def field(problem, values):
    """q with these values at the vertices, shape (2, vertices)."""
    R = plastic_dual_space(problem)
    q = GridFunction(R).vec
    q.FV().NumPy()[:] = values.ravel()
    return R, q


def beyond(problem, noise):
    """q beyond the threshold, more or less gentle."""
    random = np.random.default_rng(0).normal(0, noise, (2, problem.mesh.nv))
    return field(problem, random + np.array([[3.0], [1.0]]))


def waves(problem, size, seed=1):
    """q that varies over the body."""
    rng, points = np.random.default_rng(seed), np.asarray(problem.mesh.ngmesh.Coordinates())[:, :2]
    return field(
        problem, size * np.array([np.sin(points @ rng.normal(0, 3, 2) + 1) for _ in range(2)])
    )


def test_a_low_order_away_from_the_kink_agrees_with_400_points(monkeypatch):
    problem = lshape_problem(lshape.paper_mesh(833))
    R, q = beyond(problem, 0.15)
    (nodes,), values = element_vertices(problem.mesh), np.array(q.FV()).reshape(2, -1)
    assert (classify(values, nodes, 1.25, 1.25) == SMOOTH).sum() > 100
    usual = penalty(problem, R).at(q)
    monkeypatch.setattr(VARIATION, 0.0)
    fine = penalty(problem, R).at(q)
    assert usual.energy == pytest.approx(fine.energy, rel=1e-13)
    a, b = (np.array(state.gradient.FV()) for state in (usual, fine))
    assert np.abs(a - b).max() < 1e-12 * np.abs(b).max()


def test_the_classifier_decides(monkeypatch):
    """Where everything counts as gentle the integrals change: the test above can fail."""
    problem = lshape_problem(lshape.paper_mesh(833))
    R, q = beyond(problem, 1.0)
    usual = penalty(problem, R).at(q).energy
    monkeypatch.setattr(VARIATION, 1e9)
    assert abs(penalty(problem, R).at(q).energy / usual - 1) > 1e-9


def test_elements_below_the_threshold_are_idle():
    problem = lshape_problem(lshape.paper_mesh(225))
    R, q = waves(problem, 0.5)
    state = penalty(problem, R).at(q)
    assert state.energy == 0
    assert state.gradient.Norm() == 0
    assert not np.asarray(state.hessian().AsVector().FV()).any()


def test_a_state_stays_when_others_are_made():
    """Active sets belong to the state, not to the term: the order of questions does not matter."""
    problem = lshape_problem(lshape.paper_mesh(113))
    (R, q), (_, other) = waves(problem, 1.3), waves(problem, 2.0, 5)
    term = penalty(problem, R, 64)

    def seen(state):
        matrix = np.array(state.hessian().AsVector().FV())
        return state.energy, np.array(state.gradient.FV()), matrix

    expected = seen(term.at(q))
    here, there = term.at(q), term.at(other)
    assert seen(there)[0] != expected[0]
    for a, b in zip(seen(here), expected, strict=True):
        assert (a == b).all() if isinstance(a, np.ndarray) else a == b
