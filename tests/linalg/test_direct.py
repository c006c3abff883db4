"""Sums of sparse blocks and their inverses, against dense matrices."""

import numpy as np
import pytest
from netgen.geom2d import unit_square
from ngsolve import H1, BilinearForm, Mesh, dx, grad, x

from ngepc import (
    Coupled,
    FullProduct,
    NewtonOptions,
    SurfaceGradient,
    lshape_problem,
    semismooth_newton,
)
from ngepc.geometries import lshape
from ngepc.linalg.direct import (
    SHIPPED,
    SparseSum,
    from_entries,
    require_solver,
    symmetric_inverse,
)

SIZE, FIRST = 12, 5


def symmetric(size: int, seed: int, share: float = 0.4):
    """A symmetric matrix with a share of its entries by its lower triangle, and the same, dense."""
    generator = np.random.default_rng(seed)
    dense = generator.standard_normal((size, size)) * (
        generator.random((size, size)) < share
    )
    dense = np.tril(dense) + np.eye(size)
    rows, columns = np.nonzero(dense)
    lower = from_entries(rows, columns, dense[rows, columns], size, size)
    return lower, dense + np.tril(dense, -1).T


def stored(total: SparseSum) -> np.ndarray:
    """The stored entries as a dense array."""
    matrix = total.matrix()
    return np.array([[matrix[i, j] for j in range(SIZE)] for i in range(SIZE)])


def laplacian():
    """A matrix in NGSolve's symmetric storage, and the same, dense."""
    mesh = Mesh(unit_square.GenerateMesh(maxh=0.5))
    V = H1(mesh, order=1)
    u, v = V.TnT()
    form = BilinearForm(V, symmetric=True, symmetric_storage=True)
    form += (grad(u) * grad(v) + (1 + x) * u * v) * dx
    full = BilinearForm((grad(u) * grad(v) + (1 + x) * u * v) * dx).Assemble().mat
    return form.Assemble().mat, full.ToDense().NumPy(), V


@pytest.mark.parametrize("mirrored", [False, True])
def test_blocks_are_added_where_they_stand(mirrored):
    (large, dense), (block, small) = symmetric(SIZE, 1, share=1.0), symmetric(4, 2)
    total = SparseSum(large, mirrored=mirrored)
    total.add(block, FIRST, 3.0)
    dense[FIRST : FIRST + 4, FIRST : FIRST + 4] += 3.0 * small
    assert stored(total) == pytest.approx(dense if mirrored else np.tril(dense))


@pytest.mark.parametrize("first", [0, FIRST, SIZE - 4])
def test_a_block_outside_of_the_pattern_is_refused(first):
    diagonal = from_entries(np.arange(SIZE), np.arange(SIZE), np.ones(SIZE), SIZE, SIZE)
    total = SparseSum(diagonal)
    with pytest.raises(ValueError, match="outside of the pattern"):
        total.add(symmetric(4, 2)[0], first)
    assert (total.values == 1).all()


def test_the_matrix_follows_the_values():
    large, dense = symmetric(SIZE, 1)
    total = SparseSum(large, mirrored=True)
    first = total.matrix()
    total.values *= 2.0
    assert total.matrix() is first
    assert stored(total) == pytest.approx(2 * dense)


@pytest.mark.parametrize("name", SHIPPED)
def test_inverse_of_a_matrix_in_symmetric_storage(name):
    """umfpack would take the lower triangle for the whole matrix."""
    lower, dense, V = laplacian()
    free = V.GetDofs(V.mesh.Boundaries("left|right"))
    rows = np.flatnonzero(np.array(free, dtype=bool))
    b, expected = lower.CreateColVector(), np.zeros(V.ndof)
    b.FV().NumPy()[:] = np.random.default_rng(3).standard_normal(V.ndof)
    solution = (symmetric_inverse(lower, free, name) * b).Evaluate().FV().NumPy()
    expected[rows] = np.linalg.solve(dense[np.ix_(rows, rows)], b.FV().NumPy()[rows])
    assert solution == pytest.approx(expected, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize(
    "tichonov", [SurfaceGradient(), FullProduct()], ids=["R2", "full"]
)
def test_a_run_does_not_depend_on_the_direct_solver(tichonov):
    problem = lshape_problem(lshape.paper_mesh(113))
    regularisation = Coupled(1e3, tichonov=tichonov)
    runs = [
        semismooth_newton(
            problem, regularisation=regularisation, options=NewtonOptions(inverse=name)
        )
        for name in SHIPPED
    ]
    assert runs[0].iterations == runs[1].iterations
    assert runs[1].dual_energy == pytest.approx(runs[0].dual_energy, rel=1e-10)


@pytest.mark.parametrize("value", ["mumpss", "", 3, None])
def test_unknown_solvers_are_named(value):
    with pytest.raises(ValueError, match=r"inverse=.*one of sparsecholesky, umfpack"):
        require_solver("inverse", value)
