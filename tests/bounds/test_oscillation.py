"""Loads that vary inside elements: what is left of them, its constants, and bounds that hold."""

import math

import numpy as np
import pytest
from campaigns.constants import constants, normal_of, with_moments
from campaigns.crossings import finer
from ngsolve import CF, sin, x, y, z

from ngepc import Material, Problem, semismooth_newton, solve_to
from ngepc.bounds.bound import error_bound
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.oscillation import (
    INSIDE,
    OUTSIDE,
    REFERENCE,
    CarriedLoads,
    from_reference,
    rotating_loads,
)
from ngepc.bounds.simplices import Simplices
from ngepc.geometries import block
from ngepc.goals.check_receipt import KORN

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1e3
)
FORCES = {2: (6 * x - 3 * y, 2 * x + 1), 3: (6 * x - 3 * y, 2 * x + z, y - 4 * z + 2)}


def body(N, width, **data):
    return Problem(block.mesh(width, (1.0, 0.7, 0.8)[:N]), MATERIAL, **data, order=1)


def carried(N):
    problem = body(N, 0.5, body_force=FORCES[N])
    cells = Simplices.of(problem.mesh)
    return cells, CarriedLoads(Boundary(problem, cells))


def parts_of(cells):
    """The vertices of the parts, (nt, parts, N + 1, N)."""
    X, N = cells.points[cells.nodes], cells.N
    parts = np.repeat(X[:, None], N + 1, axis=1)
    parts[:, np.arange(N + 1), np.arange(N + 1)] = X.mean(axis=1)[:, None]
    return parts


def loads_of(cells, loads):
    """f_h on the parts, (nt, parts, N)."""
    N = cells.N
    turning = np.einsum("ta,aki->tki", loads.inner[:, N:], rotating_loads(N))
    reference = loads.inner[:, None, :N] + turning
    return (
        np.matmul(reference, cells.jacobian.transpose(0, 2, 1))
        / cells.det[:, None, None]
    )


def at(N, X):
    """The force of FORCES, by hand."""
    a = X[..., 0], X[..., 1], X[..., -1]
    force = (
        6 * a[0] - 3 * a[1],
        2 * a[0] + (1 if N == 2 else a[2]),
        a[1] - 4 * a[2] + 2,
    )
    return np.stack(force[:N], axis=-1)


@pytest.mark.parametrize("N", [2, 3])
def test_the_work_on_rigid_motions_is_carried(N):
    cells, loads = carried(N)
    f_h, parts, rng = loads_of(cells, loads), parts_of(cells), np.random.default_rng(1)
    turn = rng.normal(size=(N, N))
    turn, shift = turn - turn.T, rng.normal(size=N)
    middles = parts.mean(axis=2)
    volume = cells.volume[:, None] / (N + 1)
    carried_work = (volume * (f_h * (middles @ turn.T + shift)).sum(axis=2)).sum(axis=1)
    f, w = at(N, parts), parts @ turn.T + shift
    products = (f * w).sum(axis=(2, 3)) + (f.sum(axis=2) * w.sum(axis=2)).sum(axis=2)
    work = (volume / ((N + 1) * (N + 2)) * products).sum(axis=1)
    assert np.allclose(carried_work, work, rtol=1e-12, atol=1e-12 * np.abs(work).max())


@pytest.mark.parametrize("N", [2, 3])
def test_constant_forces_are_carried_by_cells_of_all_sizes(N):
    """Small cells far from the origin, where rounded coordinates would leave 1e-8 of the force."""
    problem = body(N, 0.5, body_force=(2.0, -1.0, 0.5)[:N])
    mesh = problem.mesh
    for _ in range(24):
        corner = np.abs([np.sum(v.point) - 0.7 for v in mesh.vertices]).argmin()
        for element in mesh.Elements():
            there = corner in [v.nr for v in element.vertices]
            mesh.SetRefinementFlag(element, there)
        mesh.Refine()
    loads = CarriedLoads(Boundary(problem, Simplices.of(mesh)))
    assert not loads.left.any()


@pytest.mark.parametrize("N", [2, 3])
def test_what_is_left_is_bounded(N):
    """Against quadratic displacements on each cell."""
    cells, loads = carried(N)
    f_h, parts, rng = loads_of(cells, loads), parts_of(cells), np.random.default_rng(2)
    points, weights = gauss(N)
    X = np.einsum("qa,tkai->tkqi", points, parts)
    rest = at(N, X) - f_h[:, :, None]
    away = X - cells.points[cells.nodes].mean(axis=1)[:, None, None]
    weight = cells.volume[:, None, None] / (N + 1) * weights
    worst = 0.0
    for _ in range(40):
        A = rng.normal(size=(N, N, N))
        A = A + A.transpose(0, 2, 1)
        w = np.einsum("iab,tkqa,tkqb->tkqi", A, away, away)
        slope = 2 * np.einsum("iab,tkqa->tkqib", A, away)
        strain = (slope + slope.swapaxes(-1, -2)) / 2
        work = np.abs((weight * (rest * w).sum(axis=-1)).sum(axis=(1, 2)))
        size = np.sqrt((weight * (strain**2).sum(axis=(-1, -2))).sum(axis=(1, 2)))
        worst = max(worst, (work / (loads.left * size)).max())
    assert 0.05 < worst <= 1


def gauss(N):
    """Barycentric points and weights of a product rule on a simplex."""
    t, w = np.polynomial.legendre.leggauss(4)
    t, w = (1 + t) / 2, w / 2
    grids = np.stack(np.meshgrid(*[t] * N, indexing="ij"), axis=-1).reshape(-1, N)
    weights = np.prod(
        np.stack(np.meshgrid(*[w] * N, indexing="ij"), axis=-1), axis=-1
    ).ravel()
    left, shares = np.ones(len(grids)), []
    for k in range(N):
        shares.append(left * grids[:, k])
        weights = weights * left if k else weights
        left = left * (1 - grids[:, k])
    return np.stack([*shares, left], axis=1), weights * math.factorial(N)


@pytest.mark.parametrize("N", [2, 3])
def test_cells_are_maps_of_the_reference(N):
    """M E are the edges of a cell; its inverse, the square of its norm, its determinant."""
    cells, _ = carried(N)
    X = cells.points[cells.nodes]
    edges = (X[:, 1:] - X[:, :1]).swapaxes(1, 2)
    maps = edges @ np.linalg.inv(REFERENCE[N])
    inverse, square, determinant = from_reference(cells, slice(None))
    assert np.allclose(inverse @ maps, np.eye(N), atol=1e-12)
    assert np.allclose(square, np.linalg.norm(maps, 2, axis=(1, 2)) ** 2, rtol=1e-12)
    assert np.allclose(np.abs(determinant), np.abs(np.linalg.det(maps)), rtol=1e-12)


@pytest.mark.parametrize(("N", "cuts"), [(2, 3), (3, 2)])
def test_constants_are_bounds(N, cuts):
    """From above, and from below what discrete stresses have."""
    inside, outside, least = constants(N, cuts)
    assert 0.6 * INSIDE[N] < least < inside <= INSIDE[N]
    assert outside <= OUTSIDE[N]


@pytest.mark.parametrize(("N", "cuts"), [(2, 2), (3, 1)])
def test_constants_of_receipts_are_bounds(N, cuts):
    """For cells with edges J by |J|^2 |J^-1|, Frobenius norms; tractions may have moments."""
    J = REFERENCE[N]
    lengths = np.linalg.svd(J, compute_uv=False)
    factor = lengths[0] / lengths[-1] ** 2
    assert INSIDE[N] * factor <= KORN[N]
    outside = KORN[N] * math.sqrt(math.factorial(N))
    any_traction = math.hypot(OUTSIDE[N], with_moments(N, cuts, INSIDE[N]))
    side = math.sqrt(abs(np.linalg.det(J)) / np.linalg.norm(normal_of(J.T)))
    assert 0.8 * outside < any_traction * factor * side <= outside


LOADS = {
    "rotating": (2, {"body_force": (-6 * (y - 0.3), 6 * (x - 0.5))}),
    "waves": (2, {"body_force": (6 * sin(5 * x * y), 3 * x * y)}),
    "traction": (2, {"traction": {"contact": CF((8 * x * (1 - x), 2 * sin(3 * x)))}}),
    "rotating in space": (3, {"body_force": (-6 * (y - 0.3), 6 * (x - 0.5), z)}),
    "traction in space": (
        3,
        {"traction": {"contact": (8 * x * (1 - x), 2 * y * y, 0.0)}},
    ),
}


@pytest.mark.parametrize("case", LOADS)
def test_energies_of_meshes_do_not_cross(case):
    """The part of what varies is of higher order."""
    N, data = LOADS[case]
    problem = body(N, 0.25 if N == 2 else 0.4, **data)
    bound, fine = (error_bound(semismooth_newton(finer(problem, k))) for k in (0, 2))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert 0 < bound.oscillation < bound.total
    assert bound.per_cell.sum() == pytest.approx(bound.total, rel=1e-12)
    assert fine.oscillation / fine.total < 0.6 * bound.oscillation / bound.total


def test_meshes_follow_loads_that_vary():
    solved = solve_to(body(2, 0.4, **LOADS["waves"][1]), 0.2)
    assert solved.reached
    lower = [record.energy - record.total for record in solved.records]
    assert max(lower) <= min(record.energy for record in solved.records)
