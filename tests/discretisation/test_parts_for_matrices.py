"""The parts in which the matrices of the elements are summed."""

import numpy as np
import pytest

from ngepc.discretisation import element_strains as module
from ngepc.discretisation.element_stiffness import ElementStiffness, parts_for_matrices
from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.geometries import block, lshape
from ngepc.model.kinematics import PLANE_STRAIN, SOLID


def divided(monkeypatch):
    monkeypatch.setattr(module, "SMALL", 1000)
    monkeypatch.setattr(module, "CHUNK", 20_000)


def refined(order):
    mesh = block.mesh(maxh=0.4)
    for _ in range(3 - order):
        mesh.Refine()
    return Points(mesh, SOLID, order)


def pairs_of(nodes):
    """The number of pairs of nodes that some elements couple."""
    a, b = np.tril_indices(nodes.shape[1])
    i, j = nodes[:, a], nodes[:, b]
    return len(np.unique(np.maximum(i, j) * (nodes.max() + 1) + np.minimum(i, j)))


@pytest.mark.parametrize(
    "make",
    [
        lambda: refined(1),
        lambda: refined(2),
        lambda: Points(lshape.paper_mesh(417), PLANE_STRAIN, 2),
    ],
    ids=["order 1", "order 2", "plane"],
)
def test_each_element_is_in_one_part(make, monkeypatch):
    divided(monkeypatch)
    points = make()
    parts = list(parts_for_matrices(points))
    found = np.concatenate([part.elements.points.ravel() for part in parts])
    assert len(parts) >= 4
    assert sorted(found) == list(range(len(points)))
    assert [part.count for part in parts] == [
        len(part.elements.nodes) for part in parts
    ]


@pytest.mark.parametrize("order", [1, 2])
def test_parts_in_space_share_few_pairs_of_nodes(order, monkeypatch):
    """Consecutive elements of a refined mesh share twice as many with others, or more."""
    divided(monkeypatch)
    points = refined(order)
    (whole,) = points.blocks
    least = pairs_of(whole.nodes)
    consecutive = sum(pairs_of(whole.nodes[chunk]) for chunk in whole.matrix_chunks)
    near = sum(pairs_of(part.elements.nodes) for part in parts_for_matrices(points))
    assert near - least < 0.5 * (consecutive - least)


@pytest.mark.parametrize("order", [1, 2])
def test_parts_give_the_sums_of_the_whole(order, monkeypatch):
    points = refined(order)
    free = np.ones((points.scalar.ndof, 3), dtype=bool)
    random = np.random.default_rng(5)
    bulk, across, extra = random.uniform(0.5, 2.0, size=(3, len(points)))
    moduli = Moduli(bulk, across, extra, random.normal(size=(len(points), SOLID.d)))
    whole = ElementStiffness(points, free).summed(moduli)
    divided(monkeypatch)
    parts = ElementStiffness(points, free).summed(moduli)
    assert parts == pytest.approx(whole, abs=1e-14 * abs(whole).max())
