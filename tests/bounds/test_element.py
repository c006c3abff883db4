"""The stress element: moments and forces give back the stresses that have them; edge numbers."""

import numpy as np
import pytest

from ngepc.bounds.element import CORNERS, ELEMENTS, _airy_numbers


@pytest.mark.parametrize("N", [2, 3])
def test_data_and_stresses(N):
    """Data of a stress with body forces: what they give has the same moments and divergences."""
    element = ELEMENTS[N]
    table = element.stresses.reshape(-1, element.stresses.shape[2])
    numbers = np.random.default_rng(N).normal(size=table.shape[1])
    stress = table @ numbers
    moments = element._facet_moments() @ stress
    np.testing.assert_allclose(moments, element.moments @ numbers, atol=1e-12)
    found = element.of_data @ np.append(moments, numbers[element.free :])
    np.testing.assert_allclose(element._facet_moments() @ found, moments, atol=1e-10)
    divergences = element._divergences()
    np.testing.assert_allclose(divergences @ found, divergences @ stress, atol=1e-10)
    np.testing.assert_allclose(element._jumps() @ found, 0.0, atol=1e-10)


@pytest.mark.parametrize("N", [2, 3])
def test_closed_stresses_are_orthonormal_and_without_divergence(N):
    element = ELEMENTS[N]
    free = element.stresses[:, :, : element.free].reshape(-1, element.free)
    np.testing.assert_allclose(free.T @ free, np.eye(element.free), atol=1e-12)
    np.testing.assert_allclose(element._divergences() @ free, 0.0, atol=1e-12)


@pytest.mark.parametrize("N", [2, 3])
def test_unit_forces_have_unit_divergence(N):
    """The first N stresses beyond the free ones balance constant forces along the axes."""
    element = ELEMENTS[N]
    loaded = element.stresses[:, :, element.free : element.free + N]
    divergences = element._divergences() @ loaded.reshape(-1, N)
    np.testing.assert_allclose(divergences, -np.tile(np.eye(N), (N + 1, 1)), atol=1e-12)


def test_numbers_of_edges_are_nothing_beyond_what_vertices_know():
    """Cubics along an edge are known from its ends; linear slopes across it, too."""
    powers = np.array([(a, b) for a in range(4) for b in range(4 - a)])
    rows = np.array(_airy_numbers(powers))
    bend, even, odd = np.split(rows[9:], 3)
    for k in range(3):
        own = slice(k * len(powers), (k + 1) * len(powers))
        np.testing.assert_allclose(even[k, own], 0.0, atol=1e-13)
        quadratic = powers.sum(axis=1) <= 2
        np.testing.assert_allclose(bend[k, own][quadratic], 0.0, atol=1e-13)
        np.testing.assert_allclose(odd[k, own][quadratic], 0.0, atol=1e-13)
        assert np.abs(bend[k, own]).max() > 0.1


def test_numbers_of_vertices_are_values_and_gradients():
    """Of x, y and 1 at the three corners."""
    powers = np.array([(0, 0), (1, 0), (0, 1)])
    rows = np.array(_airy_numbers(powers))[:9].reshape(3, 3, 3, 3).sum(axis=2)
    for vertex, (a, b) in enumerate(CORNERS):
        expected = [[1, a, b], [0, 1, 0], [0, 0, 1]]
        np.testing.assert_allclose(rows[vertex], expected, atol=1e-14)
