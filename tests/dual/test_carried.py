"""Results as starts of other problems: equal nodal values, on this and on other meshes."""

import numpy as np
import pytest

from ngepc import Coupled, FullProduct, NewtonOptions, lshape_problem, semismooth_newton
from ngepc.dual.solver import prepared
from ngepc.geometries import lshape


@pytest.fixture(scope="module")
def coupled():
    return semismooth_newton(lshape_problem(lshape.paper_mesh(225)), 1e4)


def carried(problem, regularisation, result):
    there = prepared(problem, regularisation, NewtonOptions(quadrature_points=64))
    return there.blocks, there.carried(result.functional, result.v)


@pytest.mark.parametrize("gamma", [1e4, 20.0])
def test_same_spaces_start_from_the_same_numbers(coupled, gamma):
    _, v = carried(coupled.problem, Coupled(gamma), coupled)
    assert (v.FV().NumPy() == coupled.v.FV().NumPy()).all()


def test_other_boundary_conditions_start_from_the_same_nodal_values(coupled):
    """z has nodes at the ends of Gamma_c without conditions there, and starts from zero in them."""
    blocks, v = carried(coupled.problem, Coupled(1e4, tichonov=FullProduct()), coupled)
    (z, q), (z_old, q_old) = blocks.parts(v), coupled.functional.blocks.parts(coupled.v)
    assert np.sort(z)[np.sort(z) != 0] == pytest.approx(
        np.sort(z_old)[np.sort(z_old) != 0]
    )
    assert q.FV().NumPy() == pytest.approx(q_old.FV().NumPy())


def test_another_mesh_starts_from_the_interpolation(coupled):
    problem = lshape_problem(lshape.paper_mesh(833))
    blocks, v = carried(problem, Coupled(1e4), coupled)
    q = blocks.parts(v)[1].FV().NumPy().reshape(2, -1)
    inside = np.array(blocks.H.components[1].components[0].FreeDofs())
    points = np.asarray(problem.mesh.ngmesh.Coordinates())[inside, :2]
    expected = coupled.plastic_dual(coupled.problem.mesh(*points.T))
    assert pytest.approx(expected, abs=1e-12) == q[:, inside].T
