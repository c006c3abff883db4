"""Tangents as blocks on and below the diagonal: the same matrix as with both triangles."""

from itertools import pairwise

import numpy as np
import pytest

from ngepc import PyAMG
from ngepc.local.closed import Closed
from ngepc.local.iterative import FullStorage
from ngepc.local.lower import LowerStorage
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem
from ngepc.studies.large import indented_block

pytest.importorskip("pyamg")


@pytest.fixture(scope="module", params=[1, 2], ids=["order 1", "order 2"])
def discrete(request):
    return DiscreteProblem(indented_block(0, order=request.param))


@pytest.fixture
def storages(discrete):
    """The tangent at zero, stored both ways."""
    moduli = starting_state(discrete, None).moduli
    both = FullStorage(discrete.stiffness), LowerStorage(discrete.stiffness)
    for storage in both:
        storage.fill(moduli)
    return both


def close(a, b):
    return np.abs(a - b).max() < 1e-13 * np.abs(b).max()


def test_products_are_those_of_both_triangles(discrete, storages):
    full, lower = storages
    x = np.random.default_rng(1).standard_normal(discrete.free.size)
    assert close(lower.multiply(x), full.matrix @ x)


def test_pinning_changes_and_leaves_out_the_same(discrete, storages):
    full, lower = storages
    pins = Closed(discrete, np.ones(len(discrete.rows), dtype=bool)).pins(3)
    x = np.random.default_rng(2).standard_normal(discrete.free.size)
    whole = full.matrix @ x
    left_out = [storage.pin(*pins) for storage in storages]
    assert abs(left_out[0] - left_out[1]).max() < 1e-12 * abs(left_out[0]).max()
    assert close(lower.multiply(x), full.matrix @ x)
    assert close(lower.multiply(x) + left_out[1] @ x, whole)
    assert not close(lower.multiply(x), whole)


def test_the_leading_part_is_that_of_the_vertices(discrete, storages):
    full, lower = storages
    count = discrete.problem.mesh.nv
    leading = lower.leading(count).matrix()
    wanted = full.matrix[: 3 * count, : 3 * count]
    assert abs(leading - wanted).max() < 1e-13 * abs(wanted).max()


def test_cycles_are_symmetric_and_contract(discrete, storages):
    full, lower = storages
    cycles = PyAMG().preconditioner(lower, discrete)
    cycles.coarsen(lower)
    cycle = cycles.update(lower)
    first, second = np.random.default_rng(3).standard_normal((2, discrete.free.size))
    assert first @ cycle(second) == pytest.approx(second @ cycle(first), rel=1e-10)
    error = first
    sizes = [error @ (full.matrix @ error)]
    for _ in range(10):
        error = error - cycle(full.matrix @ error)
        sizes.append(error @ (full.matrix @ error))
    assert all(after <= before for before, after in pairwise(sizes))
    assert sizes[-1] < 1e-3 * sizes[0]
