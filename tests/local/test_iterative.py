"""Projected conjugate gradients and the active sets of contact, without any library."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.sparse import diags, vstack

from ngepc import NewtonOptions, PyAMG, semismooth_newton
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.stiffness import Stiffness
from ngepc.geometries.block import structured_mesh
from ngepc.linalg.direct import FactorisationError
from ngepc.local.active_set import InexactTarget
from ngepc.local.closed import Closed, TangentialRows
from ngepc.local.exact import solve_exactly
from ngepc.local.iterative import (
    FullPattern,
    Iterative,
    IterativeTangent,
    rows_in_order,
)
from ngepc.local.result import ExactResult
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem
from ngepc.results.iteration import newton_iteration
from ngepc.studies.large import indented_block, pressed


class Diagonal:
    def coarsen(self, matrix):
        pass

    def update(self, pinned):
        diagonal = pinned.diagonal()
        return lambda r: r / diagonal


class Plain(Iterative):
    """Conjugate gradients with nothing but the diagonal."""

    def preconditioner(self, pattern, body):
        return Diagonal()


@pytest.fixture(scope="module", params=[1, 2], ids=["order 1", "order 2"])
def discrete(request):
    return DiscreteProblem(indented_block(0, order=request.param))


def tangent_of(discrete, most=2000):
    return IterativeTangent(discrete, discrete.stiffness, Plain(max_iterations=most))


def test_both_triangles_are_the_matrix_of_the_direct_solver(discrete):
    tangent, factors = tangent_of(discrete), Factors(discrete, "sparsecholesky")
    for one in (tangent, factors):
        one.linearise(starting_state(discrete, None))
    matrix = tangent.matrix.toarray()
    assert np.abs(matrix - matrix.T).max() < 1e-14 * matrix.max()
    forces = np.random.default_rng(1).standard_normal(discrete.supports.free.shape)
    forces[~discrete.supports.free] = 0.0
    u = factors.solve(forces)
    assert (
        np.abs(matrix @ u.ravel() - forces.ravel()).max() < 1e-12 * np.abs(forces).max()
    )
    assert (
        np.abs(tangent.solve(forces, accuracy=1e-12) - u).max() < 1e-9 * np.abs(u).max()
    )
    assert tangent.back_substitutions == 1
    assert tangent.linear_iterations > 10


def test_the_pattern_of_a_hundred_thousand_nodes_does_not_overflow():
    count, rng = 100_000, np.random.default_rng(4)
    rows, columns = np.array([0, 7, 60_000, 99_999]), np.array([0, 3, 59_999, 12])
    lower = SimpleNamespace(
        rows=rows.astype(np.int32), columns=columns.astype(np.int32), N=3
    )
    lower.free, blocks = np.ones((count, 3), dtype=bool), rng.standard_normal((4, 3, 3))
    matrix = FullPattern(lower).matrix(blocks)
    for i, j, block in zip(rows, columns, blocks, strict=True):
        assert (matrix[3 * i : 3 * i + 3, 3 * j : 3 * j + 3].toarray() == block).all()
        assert (
            i == j
            or (matrix[3 * j : 3 * j + 3, 3 * i : 3 * i + 3].toarray() == block.T).all()
        )
    assert matrix.nnz == 9 * 7
    assert Stiffness.places(lower, rows, columns).tolist() == [0, 1, 2, 3]


def test_the_projection_keeps_supports_and_closed_rows(discrete):
    active = np.arange(len(discrete.rows)) % 2 == 0
    closed, rng = Closed(discrete, active), np.random.default_rng(2)
    x, y = rng.standard_normal((2, discrete.supports.free.size))
    kept = closed.project(x)
    assert kept == pytest.approx(closed.project(kept), abs=1e-13)
    assert kept @ y == pytest.approx(x @ closed.unbalanced(y), rel=1e-12)
    assert np.abs(discrete.rows.normal[active] @ kept).max() < 1e-13
    assert not kept[~discrete.supports.free.ravel()].any()
    amounts = rng.standard_normal(active.sum())
    assert discrete.rows.normal[active] @ closed.moved(amounts) == pytest.approx(
        amounts
    )


def test_pins_are_projections_across_the_normals(discrete):
    active = np.ones(len(discrete.rows), dtype=bool)
    nodes, projections = Closed(discrete, active).pins(3)
    assert set(nodes) <= set(discrete.rows.nodes)
    assert projections == pytest.approx(projections @ projections, abs=1e-13)
    for node, projection in zip(nodes, projections, strict=True):
        normal = discrete.rows.normals[discrete.rows.nodes == node]
        assert np.abs(normal @ projection).max() < 1e-12


def test_rows_that_slip_push_obliquely(discrete):
    """Forces along what the rows push go, all displacements that keep them stay."""
    rows, rng = discrete.rows, np.random.default_rng(5)
    m, active = len(rows), np.arange(len(rows)) % 3 > 0
    sticks = np.repeat((np.arange(m) % 3 == 1)[:, None], 2, axis=1)
    slant = 0.4 * rng.standard_normal((m, 2)) * (np.arange(m) % 3 == 2)[:, None]
    stiffness = diags((slant != 0).ravel().astype(float)).tocsr()
    tangential_rows = TangentialRows(sticks, 0 * slant, slant, stiffness)
    closed, x = (
        Closed(discrete, active, tangential_rows),
        rng.standard_normal(discrete.free.size),
    )
    kept = closed.project(x)
    assert closed.project(kept) == pytest.approx(kept, abs=1e-12)
    held = vstack([rows.normal[active], rows.tangential[sticks.ravel()]])
    assert np.abs(held @ kept).max() < 1e-12
    n = np.where(active, rng.standard_normal(m), 0.0)
    pushed = rows.normal.T @ n + rows.tangential.T @ (slant * n[:, None]).ravel()
    assert np.abs(closed.unbalanced(pushed)).max() < 1e-12
    gaps = rng.standard_normal(3 * m)
    forces = closed.forces(pushed, gaps)
    assert forces[:m] == pytest.approx(n, abs=1e-12)
    assert forces[m:] == pytest.approx(
        (slant * n[:, None]).ravel() - stiffness @ gaps[m:]
    )
    tangent = tangent_of(discrete)
    tangent.linearise(starting_state(discrete, None))
    right = closed.unbalanced(rng.standard_normal(x.size))
    u = tangent.minimise(closed, right, np.zeros_like(right), 1e-9)
    assert np.abs(held @ u).max() < 1e-13
    stiff = tangent.multiply(u) + rows.tangential.T @ (
        stiffness @ (rows.tangential @ u)
    )
    assert np.linalg.norm(closed.unbalanced(stiff - right)) < 2e-9


def test_conjugate_gradients_minimise_over_what_is_free(discrete):
    tangent = tangent_of(discrete)
    tangent.linearise(starting_state(discrete, None))
    closed = Closed(discrete, np.ones(len(discrete.rows), dtype=bool))
    right = closed.unbalanced(
        np.random.default_rng(3).standard_normal(discrete.supports.free.size)
    )
    x = tangent.minimise(closed, right, np.zeros_like(right), 1e-9)
    assert closed.project(x) == pytest.approx(x, abs=1e-14)
    assert np.linalg.norm(closed.unbalanced(tangent.multiply(x) - right)) < 2e-9


def test_too_few_iterations_are_said(discrete):
    tangent = tangent_of(discrete, most=3)
    tangent.linearise(starting_state(discrete, None))
    with pytest.raises(FactorisationError, match="did not converge in 3 iterations"):
        tangent.solve(np.ones(discrete.supports.free.shape))


def test_an_indefinite_preconditioner_is_said(discrete):
    tangent = tangent_of(discrete)
    tangent.linearise(starting_state(discrete, None))
    closed = Closed(discrete, np.zeros(len(discrete.rows), dtype=bool))
    tangent.prepare(closed)
    tangent._precondition = np.negative
    right = closed.project(np.ones(discrete.supports.free.size))
    with pytest.raises(FactorisationError, match="not positive definite"):
        tangent.minimise(closed, right, 0 * right, 1e-9)


def test_active_sets_find_the_solution_of_the_direct_method(discrete):
    start, tolerance = starting_state(discrete, None), 1e-10
    target = InexactTarget(discrete, 1e-2, tolerance)
    limits = tolerance, 20, None, target
    found = newton_iteration(start, tangent_of(discrete), ExactResult, *limits)
    exact = solve_exactly(discrete.problem, None, tolerance, 20, "sparsecholesky", None)
    assert found.status.label == exact.status.label == "converged"
    assert found.primal_energy == pytest.approx(exact.primal_energy, rel=1e-10)
    assert found.contact_force == pytest.approx(exact.contact_force, rel=1e-7)
    assert found.iterations <= exact.iterations + 2
    assert found.state.penetration <= found.state.touching_distance


def test_sets_end_that_alternate_within_the_accuracy():
    """The sphere on 5 cells: two rows open and close, with forces below the accuracy."""
    pytest.importorskip("pyamg")
    mesh = structured_mesh(5, 5, 5, simplices=True)
    options = NewtonOptions(inverse=PyAMG())
    result = semismooth_newton(pressed(mesh, 100.0, order=2), options=options)
    assert result.status.label == "converged"
    assert max(result.history.column("back_substitutions")) <= 5


def test_linear_systems_are_solved_as_exactly_as_the_step_deserves(discrete):
    target = InexactTarget(discrete, 1e-2, 1e-10)
    assert target.accuracy(1.0, None) == 1e-2
    tenth_of_what_newton_leaves = 0.1 * 1e-4
    assert target.accuracy(1e-2, 1.0) == pytest.approx(tenth_of_what_newton_leaves)
    tenth_of_the_tolerance = 0.1 * 1e-3
    assert target.accuracy(1e-7, 1e-2) == pytest.approx(tenth_of_the_tolerance)
    assert target.accuracy(2e-10, 1e-7) == pytest.approx(0.1 * 0.5)


def test_portions_of_rows_follow_each_other():
    starts = np.array([0, 3, 3, 10, 11, 30])
    for size in (1, 4, 12, 100):
        portions = rows_in_order(starts, size)
        assert portions[0].start == 0
        assert portions[-1].stop == 5
        assert all(a.stop == b.start for a, b in pairwise(portions))


def test_products_are_those_of_the_tangent_after_rows_are_pinned(discrete):
    """The matrix is stored once, pinned; what that leaves out is added."""
    tangent = tangent_of(discrete)
    tangent.linearise(starting_state(discrete, None))
    x = np.random.default_rng(5).standard_normal(discrete.free.size)
    before = tangent.multiply(x)
    whole = tangent.matrix.toarray()
    tangent.prepare(Closed(discrete, np.ones(len(discrete.rows), dtype=bool)))
    assert np.abs(tangent.matrix.toarray() - whole).max() > 1e-3 * np.abs(whole).max()
    assert tangent.multiply(x) == pytest.approx(
        before, abs=1e-12 * np.abs(before).max()
    )
