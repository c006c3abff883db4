"""Orthonormal coordinates of trace-free symmetric tensors, in place of P and M^(1/2) of (3.1)."""

import numpy as np
import pytest
from coordinates import basis, coordinates, coordinates_count, deviator, strain, tensor
from ngsolve import CF, Grad, GridFunction, VectorH1, sin, x, y, z

from ngepc.geometries import block

MESHES = {2: block.structured_mesh(1, 1), 3: block.structured_mesh(1, 1, 1)}
DIMENSIONS = pytest.mark.parametrize("N", [2, 3])


def value(cf, N):
    """A coefficient at one point of the body, with the shape of the coefficient."""
    point = (0.3, 0.6, 0.2)[:N]
    return np.array(cf(MESHES[N](*point))).reshape(tuple(cf.dims))


def random_coordinates(N, seed=1):
    return np.random.default_rng(seed).normal(size=coordinates_count(N))


@DIMENSIONS
def test_number_of_coordinates(N):
    assert coordinates_count(N) == {2: 2, 3: 5}[N]
    assert basis(N).shape == (coordinates_count(N), N, N)


@DIMENSIONS
def test_basis_is_orthonormal(N):
    gram = np.einsum("aij,bij->ab", basis(N), basis(N))
    assert gram == pytest.approx(np.eye(coordinates_count(N)), abs=1e-15)


@DIMENSIONS
def test_basis_is_symmetric_and_trace_free(N):
    E = basis(N)
    assert (transposed := E.transpose(0, 2, 1)) == pytest.approx(E, abs=0.0)
    assert np.trace(transposed, axis1=1, axis2=2) == pytest.approx(0.0, abs=1e-15)


@DIMENSIONS
def test_basis_is_complete(N):
    """With the identity it spans all symmetric matrices."""
    rows = np.concatenate([basis(N), np.eye(N)[None]]).reshape(-1, N * N)
    assert np.linalg.matrix_rank(rows) == N * (N + 1) // 2


def test_basis_is_a_copy():
    basis(2)[0, 0, 0] = 7.0
    assert basis(2)[0, 0, 0] == pytest.approx(2**-0.5)


@DIMENSIONS
def test_tensor_is_an_isometry(N):
    """|P(p)|_F = |p| and P(p) : P(q) = p . q."""
    p, q = random_coordinates(N, 1), random_coordinates(N, 2)
    P, Q = (value(tensor(CF(tuple(c)), N), N) for c in (p, q))
    assert np.linalg.norm(P) == pytest.approx(np.linalg.norm(p), rel=1e-14)
    assert (P * Q).sum() == pytest.approx(p @ q, rel=1e-13)


@DIMENSIONS
def test_tensor_is_symmetric_and_trace_free(N):
    P = value(tensor(CF(tuple(random_coordinates(N))), N), N)
    assert pytest.approx(P.T, abs=1e-15) == P
    assert np.trace(P) == pytest.approx(0.0, abs=1e-15)


@DIMENSIONS
def test_coordinates_invert_tensor(N):
    p = random_coordinates(N)
    assert value(coordinates(tensor(CF(tuple(p)), N), N), N) == pytest.approx(
        p, rel=1e-14
    )


@DIMENSIONS
def test_tensor_of_coordinates_is_the_deviator(N):
    """P inverts on trace-free matrices and projects the others."""
    A = np.random.default_rng(3).normal(size=(N, N))
    A = A + A.T
    A_cf = CF(tuple(A.ravel()), dims=(N, N))
    dev = A - np.trace(A) / N * np.eye(N)
    assert value(tensor(coordinates(A_cf, N), N), N) == pytest.approx(dev, abs=1e-14)
    assert value(deviator(A_cf, N), N) == pytest.approx(dev, abs=1e-14)


@DIMENSIONS
def test_deviator_is_a_projection(N):
    A = CF(tuple(np.random.default_rng(4).normal(size=N * N)), dims=(N, N))
    once = value(deviator(A, N), N)
    assert np.trace(once) == pytest.approx(0.0, abs=1e-15)
    assert value(deviator(deviator(A, N), N), N) == pytest.approx(once, abs=1e-15)


@DIMENSIONS
def test_rotation_keeps_the_length_of_the_coordinates(N):
    Q, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(N, N)))
    P = value(tensor(CF(tuple(random_coordinates(N))), N), N)
    turned = CF(tuple((Q @ P @ Q.T).ravel()), dims=(N, N))
    length = np.linalg.norm(value(coordinates(turned, N), N))
    assert length == pytest.approx(np.linalg.norm(P), rel=1e-13)


@DIMENSIONS
def test_strain_of_a_rigid_motion_vanishes(N):
    W = np.random.default_rng(6).normal(size=(N, N))
    X = (x, y, z)[:N]
    spin = CF(tuple(sum(float(c) * X[j] for j, c in enumerate(row)) for row in W - W.T))
    u = GridFunction(VectorH1(MESHES[N], order=1))
    u.Set(spin)
    assert value(strain(u), N) == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(value(Grad(u), N)) > 0.1


def test_strain_is_the_symmetric_gradient():
    u = GridFunction(VectorH1(MESHES[2], order=3))
    u.Set(CF((sin(y), x * x)))
    G = value(Grad(u), 2)
    assert value(strain(u), 2) == pytest.approx((G + G.T) / 2, abs=1e-14)
