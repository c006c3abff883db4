"""Which coefficients are polynomials, and of what degree."""

import math

import numpy as np
import pytest
from ngsolve import (
    CF,
    H1,
    L2,
    CoefficientFunction,
    Grad,
    GridFunction,
    HDiv,
    IfPos,
    InnerProduct,
    Integrate,
    Norm,
    Parameter,
    SurfaceL2,
    Sym,
    VectorH1,
    dx,
    exp,
    sin,
    specialcf,
    sqrt,
    x,
    y,
)

from ngepc import Material, Problem, error_bound, semismooth_newton
from ngepc.checks.coefficients import as_constant
from ngepc.discretisation.polynomials import degree_of, is_polynomial
from ngepc.geometries import block
from ngepc.model.elements import outward_normal

MESH = block.mesh(0.5, (1.0, 0.7))
U = GridFunction(VectorH1(MESH, order=2))
S = GridFunction(L2(MESH, order=3))
PARTS = MESH.MaterialCF({"body": 2.0})


@pytest.mark.parametrize(
    ("value", "degree"),
    [
        (CF(2.5), 0),
        (as_constant(2.5), 0),
        (CF((as_constant(2.5) * x, as_constant(0.0))), 1),
        (0 * x, 0),
        (-3 * specialcf.normal(2), 0),
        (MESH.MaterialCF({"body": 2.0}), 0),
        (-x / 3, 1),
        (x * y / PARTS, 2),
        (1 / (PARTS + 1), 0),
        (sqrt(PARTS) + PARTS**0.3, 0),
        (-10 * outward_normal(MESH), 0),
        (IfPos(MESH.MaterialCF({"body": 2.0}), x, 1.0), 1),
        (CF((x, 2.0, 0.0, y)).Reshape((2, 2)), 1),
        (Parameter(2) * x * y - y + 1, 2),
        ((x - 0.5) ** 3, 3),
        (InnerProduct(CF((x, y)), CF((x * x, y))), 3),
        (U, 2),
        (U[0], 2),
        (U.components[1] * x, 3),
        (InnerProduct(U, U), 4),
        (Sym(Grad(U)), 2),
        (2 * S, 3),
        (GridFunction(SurfaceL2(MESH, order=1)), 1),
        (GridFunction(HDiv(MESH, order=1)), 2),
    ],
)
def test_degrees(value, degree):
    assert degree_of(value) == degree
    assert is_polynomial(value) == (degree <= 3)


@pytest.mark.parametrize(
    "value",
    [
        sin(x),
        IfPos(x, 1, 2),
        sqrt(x),
        1 / (1 + x),
        Norm(U),
        exp(S),
        x**0.5,
        PARTS / x,
        sqrt(1 + x * PARTS),
        PARTS**x,
    ],
)
def test_other_functions_have_none(value):
    assert degree_of(value) == math.inf
    assert not is_polynomial(value)


def test_functions_of_another_mesh_are_none_on_this_one():
    other = block.mesh(0.2, (1.0, 0.7))
    function = GridFunction(H1(other))
    assert is_polynomial(2 * function, other)
    assert not is_polynomial(2 * function, MESH)
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1e3
    )
    function.Set(IfPos(x - 0.3, 1.0, 0.0))
    load = (0.0, 2 * function)
    bound = error_bound(
        semismooth_newton(Problem(MESH, material, body_force=load, order=1))
    )
    assert not bound.guaranteed
    assert "body_force" in bound.message


def unseen(mesh: object, degree: int) -> CoefficientFunction:
    """A function of high degree that is zero at the points of low rules, with the mean 1."""
    space = L2(mesh, order=degree)
    bumps = GridFunction(space)
    random = np.random.default_rng(3)
    bumps.vec.FV().NumPy()[:] = random.normal(size=space.ndof)
    return bumps


def test_high_degrees_are_integrated_and_no_proof():
    """Rules of loads are exact to degree three: a function of degree nine is looked at."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=500.0, hardening=1e3
    )
    load = unseen(MESH, 9)
    problem = Problem(MESH, material, body_force=(load, 0.0), order=1)
    result = semismooth_newton(problem)
    exact = Integrate(load * dx(bonus_intorder=9), MESH)
    found = result.discrete.load[:, 0].sum()
    size = Integrate(Norm(load) * dx(bonus_intorder=9), MESH)
    assert abs(found - exact) < 1e-3 * size
    assert not error_bound(result).guaranteed
    assert "body_force" in result.message
