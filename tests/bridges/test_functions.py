"""Responses and their functions in JAX and PyTorch: values of solves, slopes of differences."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import minimize

from ngepc import (
    Material,
    Norton,
    Problem,
    Reaction,
    Response,
    lshape_problem,
    semismooth_newton,
)
from ngepc.bridges import jax_function, torch_function
from ngepc.geometries import block, lshape

NAMES = ("yield_stress", "hardening", "traction", "gap")


def response(functional="contact_force"):
    return Response(lshape_problem(lshape.paper_mesh(225)), functional, NAMES)


POINT = np.array([1.3, 90.0, 0.9, 0.005])


def test_values_are_those_of_a_solve():
    problem = lshape_problem(lshape.paper_mesh(225))
    steel = replace(problem.material, yield_stress=1.3, hardening=90.0)
    load = {"load": 0.9 * problem.traction["load"]}
    same = replace(problem, material=steel, traction=load, gap=0.105)
    value, _ = response()(POINT)
    assert value == pytest.approx(semismooth_newton(same).contact_force, rel=1e-9)
    assert response().start.tolist() == [1.25, 100.0, 1.0, 0.0]


@pytest.mark.parametrize("functional", ["contact_force", Reaction("clamped", 1)])
def test_derivatives_are_those_of_differences(functional):
    f = response(functional)
    _, slopes = f(POINT)
    for k, size in enumerate((1e-5, 1e-3, 1e-5, 1e-6)):
        step = np.zeros(4)
        step[k] = size
        difference = (f(POINT + step)[0] - f(POINT - step)[0]) / (2 * size)
        assert slopes[k] == pytest.approx(difference, rel=2e-5, abs=1e-8)


def test_scipy_finds_the_load_for_a_force():
    f = response()

    def squared(theta):
        value, slope = f([1.25, 100.0, theta[0], 0.0])
        return (value - 2.0) ** 2, 2 * (value - 2.0) * slope[2:3]

    found = minimize(squared, [1.0], jac=True, method="BFGS", tol=1e-10)
    assert f([1.25, 100.0, found.x[0], 0.0])[0] == pytest.approx(2.0, abs=1e-5)


def test_unknown_parameters_are_named():
    problem = lshape_problem(lshape.paper_mesh(113))
    with pytest.raises(ValueError, match=r"'young' is none of lame_lambda, .*traction"):
        Response(problem, "contact_force", ["young"])
    with pytest.raises(TypeError, match="a list of names"):
        Response(problem, "contact_force", "gap")
    with pytest.raises(TypeError, match="a Response"):
        jax_function("contact_force")
    with pytest.raises(TypeError, match="a Response"):
        torch_function("contact_force")


def test_jax_differentiates_through_a_solve():
    jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")
    jax.config.update("jax_enable_x64", True)
    f = jax_function(response())
    value, slopes = response()(POINT)

    def chained(theta):
        return f(theta) ** 2

    theta = jax.numpy.asarray(POINT)
    assert float(f(theta)) == pytest.approx(value, rel=1e-9)
    np.testing.assert_allclose(jax.grad(chained)(theta), 2 * value * slopes, rtol=1e-7)
    np.testing.assert_allclose(
        jax.jit(jax.grad(chained))(theta), 2 * value * slopes, rtol=1e-7
    )


def test_torch_differentiates_through_a_solve():
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    theta = torch.tensor(POINT, requires_grad=True)
    value, slopes = response()(POINT)
    loss = torch_function(response())(theta) ** 2
    loss.backward()
    assert float(loss.detach()) == pytest.approx(value**2, rel=1e-9)
    np.testing.assert_allclose(theta.grad.numpy(), 2 * value * slopes, rtol=1e-7)


class Square(Response):
    """The sum of squares: a response without a solve."""

    def __init__(self):
        pass

    def __call__(self, theta):
        return theta @ theta, 2 * theta


class Tensor(np.ndarray):
    """As much of a tensor as the bridge needs."""

    def detach(self):
        return self

    cpu = double = numpy = detach

    def new_tensor(self, values):
        return np.asarray(values).view(Tensor)


def test_what_pytorch_is_given(monkeypatch):
    """Forwards the value, backwards the slope times what comes from above; PyTorch stays away."""

    class Function:
        """Calls ``forward`` with a context, and keeps that."""

        def save_for_backward(self, *tensors):
            self.saved_tensors = tensors

        @classmethod
        def apply(cls, theta):
            context = Function()
            return cls.forward(context, theta), lambda up: cls.backward(context, up)

    torch = SimpleNamespace(autograd=SimpleNamespace(Function=Function))
    monkeypatch.setitem(sys.modules, "torch", torch)
    theta = POINT.view(Tensor)
    value, backward = torch_function(Square())(theta)
    assert value == pytest.approx(POINT @ POINT, rel=1e-15)
    np.testing.assert_allclose(backward(3.0), 6.0 * POINT, rtol=1e-15)


def test_what_jax_is_given(monkeypatch):
    """A number and its slope, in the precision of the parameters; JAX itself stays away."""

    class Differentiated:
        """Keeps what ``defvjp`` is given."""

        def __init__(self, function):
            self.function = function

        def __call__(self, theta):
            return self.function(theta)

        def defvjp(self, forward, backward):
            self.forward = forward
            self.backward = backward

    def pure_callback(call, shapes, theta):
        found = call(theta)
        for number, shape in zip(found, shapes, strict=True):
            assert (number.shape, number.dtype) == (shape.shape, shape.dtype)
        return found

    def shape(shape, dtype):
        return SimpleNamespace(shape=shape, dtype=dtype)

    jax = SimpleNamespace(
        custom_vjp=Differentiated, pure_callback=pure_callback, ShapeDtypeStruct=shape
    )
    monkeypatch.setitem(sys.modules, "jax", jax)
    function = jax_function(Square())
    for theta in (POINT, POINT.astype(np.float32)):
        assert function(theta) == pytest.approx(theta @ theta, rel=1e-6)
        value, kept = function.forward(theta)
        assert value == pytest.approx(theta @ theta, rel=1e-6)
        (slope,) = function.backward(kept, theta.dtype.type(3.0))
        np.testing.assert_allclose(slope, 6 * theta, rtol=1e-6)


STEEL = {"young": 200e3, "poisson": 0.3}
CURVE = [(0.001, 200.0), (0.002, 300.0), (0.005, 380.0)]
METALS = {
    "lame_mu": Material.metal(**STEEL, yield_stress=200.0, plastic_modulus=4e3),
    "overlay.bounds[0]": Material.cyclic(**STEEL, curve=CURVE),
    "overlay.shares[1]": Material.cyclic(**STEEL, curve=CURVE),
    "rate.overstress": Material.metal(
        **STEEL, yield_stress=150.0, plastic_modulus=4e3, rate=Norton(300.0, 5.0)
    ),
    "law.stress_there[1]": Material.metal(**STEEL, curve=CURVE),
}


@pytest.mark.parametrize("name", METALS)
def test_parameters_are_data_of_metals_and_of_their_parts(name):
    metal = METALS[name]
    problem = Problem(
        block.structured_mesh(3, 3, simplices=True),
        metal,
        prescribed={"contact": (0.0, -3e-3)},
        duration=1.0 if metal.rate is not None else None,
    )
    f = Response(problem, "elastic_energy", [name])
    _, slopes = f(f.start)
    step = 1e-5 * f.start
    difference = (f(f.start + step)[0] - f(f.start - step)[0]) / (2 * step)
    assert abs(difference) > 0
    assert slopes == pytest.approx(difference, rel=1e-5)
