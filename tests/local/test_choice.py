"""The linear solver that is taken when none is given."""

from dataclasses import replace

import numpy as np
import pytest

from ngepc import Coulomb, NewtonOptions, semismooth_newton
from ngepc.geometries import block
from ngepc.linalg.direct import FactorisationError
from ngepc.local import choice
from ngepc.local.iterative import IterativeTangent
from ngepc.studies.large import pressed


def cube(n, **data):
    mesh = block.structured_mesh(n, n, n, simplices=True)
    return replace(pressed(mesh, 100.0), **data)


def test_plane_and_small_bodies_take_factors():
    square = block.structured_mesh(60, 60, simplices=True)
    plane = pressed(block.structured_mesh(3, 3, 3, simplices=True), 100.0)
    flat = replace(plane, mesh=square, gap=-1e-3, kinematics="plane strain")
    assert semismooth_newton(flat).linear_solver == "sparsecholesky"
    assert semismooth_newton(plane).linear_solver == "sparsecholesky"


@pytest.mark.parametrize("friction", [None, 5.0, Coulomb(0.3)])
def test_large_solids_take_multigrid(friction, monkeypatch):
    """The same solution, whatever was chosen, and the result says what."""
    monkeypatch.setattr(choice, "MOST_BY_FACTORS", 500)
    monkeypatch.setattr(choice, "MOST_BY_FACTORS_TRESCA", 500)
    monkeypatch.setattr(choice, "MOST_BY_FACTORS_ORDER_ONE", 500)
    problem = cube(6, friction=friction)
    chosen = semismooth_newton(problem)
    assert chosen.linear_solver == "PyAMG"
    assert sum(chosen.history.column("linear_iterations")) > 0
    direct = semismooth_newton(problem, options=NewtonOptions(inverse="sparsecholesky"))
    assert direct.linear_solver == "sparsecholesky"
    size = np.abs(direct.state.u).max()
    assert np.abs(chosen.state.u - direct.state.u).max() < 1e-8 * size


def test_factors_take_the_place_of_multigrid_that_gives_up(monkeypatch):
    def fails(*args):
        raise FactorisationError("no")

    monkeypatch.setattr(choice, "MOST_BY_FACTORS_ORDER_ONE", 500)
    monkeypatch.setattr(IterativeTangent, "minimise", fails)
    result = semismooth_newton(cube(6))
    assert result.status.label == "converged"
    assert result.linear_solver == "sparsecholesky"
