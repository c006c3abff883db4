"""The plastic term M^2: which elements need which rule, and states that stay as they were."""

import dataclasses
from functools import partial

import numpy as np
import pytest

from ngepc import lshape_problem
from ngepc.discretisation.quadrature import SMOOTH, classify
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional, DualIterate
from ngepc.dual.spaces import DualSpaces
from ngepc.geometries import lshape
from ngepc.model.elements import elements_by_shape

VARIATION = "ngepc.discretisation.quadrature.SMOOTH_VARIATION"


def penalty(blocks, points=400):
    """v -> M^2 there, for gamma = 1e4."""
    return partial(DualIterate, DualFunctional(blocks, points, 1e4))


def field(problem, values):
    """q with these values at the vertices, shape (2, vertices), and no contact."""
    free = dataclasses.replace(problem, contact=None, gap=None)
    blocks = LinearBlocks(free, DualSpaces(), "sparsecholesky")
    v = blocks.H_vector()
    v.FV().NumPy()[:] = values.ravel()
    return blocks, v


def beyond(problem, noise):
    """q beyond the threshold, more or less gentle."""
    random = np.random.default_rng(0).normal(0, noise, (2, problem.mesh.nv))
    return field(problem, random + np.array([[3.0], [1.0]]))


def waves(problem, size, seed=1):
    """q that varies over the body."""
    rng, points = (
        np.random.default_rng(seed),
        np.asarray(problem.mesh.ngmesh.Coordinates())[:, :2],
    )
    return field(
        problem,
        size * np.array([np.sin(points @ rng.normal(0, 3, 2) + 1) for _ in range(2)]),
    )


def test_a_low_order_away_from_the_kink_agrees_with_400_points(monkeypatch):
    problem = lshape_problem(lshape.paper_mesh(833))
    blocks, q = beyond(problem, 0.15)
    ((_, nodes),), values = (
        elements_by_shape(problem.mesh),
        np.array(q.FV()).reshape(2, -1),
    )
    assert (classify(values, nodes, 1.25, 1.25) == SMOOTH).sum() > 100
    usual = penalty(blocks)(q)
    monkeypatch.setattr(VARIATION, 0.0)
    fine = penalty(blocks)(q)
    assert usual.penalties[1] == pytest.approx(fine.penalties[1], rel=1e-13)
    a, b = (np.array(state.multipliers.FV()) for state in (usual, fine))
    assert np.abs(a - b).max() < 1e-12 * np.abs(b).max()


def test_the_classifier_decides(monkeypatch):
    """Where everything counts as gentle the integrals change: the test above can fail."""
    problem = lshape_problem(lshape.paper_mesh(833))
    blocks, q = beyond(problem, 1.0)
    usual = penalty(blocks)(q).penalties[1]
    monkeypatch.setattr(VARIATION, 1e9)
    assert abs(penalty(blocks)(q).penalties[1] / usual - 1) > 1e-9


def test_elements_below_the_threshold_are_idle():
    problem = lshape_problem(lshape.paper_mesh(225))
    blocks, q = waves(problem, 0.5)
    state = penalty(blocks)(q)
    assert state.penalties == (0, 0)
    assert state.multipliers.Norm() == 0
    assert not np.asarray(state.hessian().AsVector().FV()).any()


def test_a_state_stays_when_others_are_made():
    """Active sets belong to the state, not to the term: the order of questions does not matter."""
    problem = lshape_problem(lshape.paper_mesh(113))
    (blocks, q), (_, other) = waves(problem, 1.3), waves(problem, 2.0, 5)
    term = penalty(blocks, 64)

    def seen(state):
        matrix = np.array(state.hessian().AsVector().FV())
        return state.penalties, np.array(state.multipliers.FV()), matrix

    expected = seen(term(q))
    here, there = term(q), term(other)
    assert seen(there)[0] != expected[0]
    for a, b in zip(seen(here), expected, strict=True):
        assert (a == b).all() if isinstance(a, np.ndarray) else a == b


def test_an_iterate_is_a_value():
    """What is computed at one v does not change what was or will be at another."""
    problem = lshape_problem(lshape.paper_mesh(225))
    blocks, v = waves(problem, 2.0)
    _, w = waves(problem, 3.0, seed=2)
    functional = DualFunctional(blocks, 100, 1e4)
    here = functional.at(v)
    found = []
    for name in ("penalties", "active", "multipliers"):
        other = functional.at(w)
        other.hessian(), other.penalties, other.multipliers
        found.append(getattr(here, name))
    hessian = here.hessian()
    entries = hessian.AsVector().FV().NumPy()
    before = entries.copy()
    functional.at(w).hessian()
    assert np.array_equal(entries, before)
    alone = DualFunctional(blocks, 100, 1e4).at(v)
    assert found[:2] == [alone.penalties, alone.active]
    multipliers = (vector.FV().NumPy() for vector in (found[2], alone.multipliers))
    assert np.array_equal(*multipliers)
    assert np.array_equal(alone.hessian().AsVector().FV().NumPy(), before)
