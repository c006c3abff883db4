"""Tangents as sums over two halves of the body: the same products, symmetric, with any threads."""

import numpy as np
import pytest

from ngepc.discretisation import summands
from ngepc.discretisation.summands import Summands, element_parts
from ngepc.geometries import block
from ngepc.linalg.cores import crew
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem
from ngepc.studies.large import pressed


@pytest.fixture(params=["tetrahedra", "hexahedra"])
def discrete(request):
    simplices = request.param == "tetrahedra"
    mesh = block.structured_mesh(2, 3, 4, simplices=simplices)
    return DiscreteProblem(pressed(mesh, 100.0, order=2))


@pytest.fixture
def blocks(discrete):
    return discrete.stiffness.values(starting_state(discrete, None).moduli)


def parts(discrete, unknowns=summands.LARGE):
    return element_parts(discrete.problem.mesh, unknowns)


@pytest.fixture(params=[summands.LARGE - 1, summands.LARGE], ids=["one", "two"])
def tangent(request, discrete, blocks):
    found = Summands(discrete.stiffness, parts(discrete, request.param))
    found.blocks[:] = blocks
    found.renew()
    return found


def close(a, b):
    return np.abs(a - b).max() < 1e-13 * np.abs(b).max()


def test_each_element_is_in_one_half(discrete):
    lower, upper = parts(discrete)
    assert np.array_equal(lower, ~upper)
    assert lower.mean() == pytest.approx(summands.LOWER, abs=0.02)


def test_products_are_those_of_the_whole_matrix(discrete, blocks, tangent):
    x = np.random.default_rng(1).standard_normal(discrete.free.size)
    assert close(tangent.times(x), discrete.stiffness.symmetric(blocks) @ x)


def test_replaced_blocks_are_those_of_products(discrete, blocks, tangent):
    """Each third block, some of which belong to both halves."""
    numbers = np.arange(0, len(blocks), 3)
    changed = blocks.copy()
    changed[numbers] *= 2.0
    tangent.replace(numbers, changed[numbers])
    assert np.array_equal(tangent.blocks, changed)
    x = np.random.default_rng(2).standard_normal(discrete.free.size)
    assert close(tangent.times(x), discrete.stiffness.symmetric(changed) @ x)


def test_products_have_the_same_digits_with_any_number_of_threads(discrete, tangent):
    x = np.random.default_rng(3).standard_normal(discrete.free.size)
    found = []
    for size in (1, 2, 4):
        with crew(size):
            found.append(tangent.times(x))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])
