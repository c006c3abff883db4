"""Results as starts of other problems: equal multipliers, equal nodal values."""

import numpy as np
import pytest

from ngepc import Coupled, lshape_problem, semismooth_newton
from ngepc.dual.functional import scaled_excess
from ngepc.dual.newton import NewtonOptions, prepared
from ngepc.geometries import lshape


@pytest.fixture(scope="module")
def problem():
    return lshape_problem(lshape.paper_mesh(225))


@pytest.fixture(scope="module")
def coupled(problem):
    return semismooth_newton(problem, 1e4)


def parts(result_or_functional, v):
    blocks = result_or_functional.blocks
    z, q = (blocks.part_of(v, name).FV().NumPy() for name in ("contact", "plastic"))
    return np.array(z), np.array(q).reshape(-1, blocks.problem.mesh.nv)


def functional(problem, regularisation):
    return prepared(problem, regularisation, NewtonOptions(quadrature_points=64))


def test_excess_is_scaled_in_its_direction():
    q = np.array([[3.0, 0.3, 0.0], [4.0, 0.4, 0.0]])
    scaled = scaled_excess(q, 1.0, 0.25)
    assert scaled[:, 0] == pytest.approx([3 * 2 / 5, 4 * 2 / 5])  # |q| = 1 + (5 - 1) / 4
    assert scaled[:, 1:] == pytest.approx(q[:, 1:])


def test_same_problem_starts_from_the_same_numbers(problem, coupled):
    v = functional(problem, Coupled(1e4)).carried(coupled.functional, coupled.v)
    assert (v.FV().NumPy() == coupled.v.FV().NumPy()).all()


@pytest.mark.parametrize("gamma", [1e5, 20.0])
def test_nodal_multipliers_are_kept(problem, coupled, gamma):
    there = functional(problem, Coupled(gamma))
    (z, q), (z_new, q_new) = (
        parts(coupled.functional, coupled.v),
        parts(there, there.carried(coupled.functional, coupled.v)),
    )

    def multipliers(weights, z, q):
        excess = np.maximum(np.sqrt((q**2).sum(axis=0)) - float(problem.beta), 0)
        return weights.contact * np.maximum(z, 0), weights.plastic * excess

    before, after = coupled.functional.weights, there.weights
    for old, new in zip(multipliers(before, z, q), multipliers(after, z_new, q_new), strict=True):
        assert old.max() > 0
        assert new == pytest.approx(old, rel=1e-9, abs=1e-12 * old.max())
