"""Bisection of triangles in arrays."""

import numpy as np
import pytest
from netgen.occ import Glue, MoveTo, OCCGeometry
from ngsolve import BND, CF, H1, VOL, GridFunction, Integrate, Mesh, x, y

from ngepc.bounds.bisection import Bisection
from ngepc.bounds.copies import bisected
from ngepc.bounds.simplices import Simplices
from ngepc.geometries import lshape, wrench


def two_materials():
    """Two squares of different materials side by side."""
    left, right = (MoveTo(x, 0).Rectangle(1, 1).Face() for x in (0, 1))
    left.faces.name = "left"
    right.faces.name = "right"
    return Mesh(OCCGeometry(Glue([left, right]), dim=2).GenerateMesh(maxh=0.3))


MESHES = [lshape.mesh(0.2), wrench.paper_mesh(873), two_materials()]


def cut_twice(mesh, share):
    """A mesh with random triangles cut, then random ones of these, and the parents."""
    random = np.random.default_rng(3)
    finer = Bisection(mesh)
    for _ in range(2):
        finer.cut(np.flatnonzero(random.random(len(finer.nodes)) < share))
    return finer, *finer.built()


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("share", [0.02, 0.5])
def test_children_fill_their_parents(mesh, share):
    finer, made, parents = cut_twice(mesh, share)
    area = np.array(Integrate(CF(1), made, element_wise=True))
    whole = np.array(Integrate(CF(1), mesh, element_wise=True))
    assert np.bincount(parents, area) == pytest.approx(whole, rel=1e-12)
    assert area.min() > 0
    old = Simplices.of(mesh).points
    assert np.array_equal(finer.points[: len(old)], old)


@pytest.mark.parametrize("mesh", MESHES)
def test_the_mesh_conforms_and_boundaries_keep_their_names(mesh):
    """No vertex lies inside a side: the outer sides are the boundary segments."""
    _, made, _ = cut_twice(mesh, 0.1)
    cells = Simplices.of(made)
    inner = (
        len(made.GetMaterials()) > 1
    )  # between two materials there are segments, too
    assert inner or cells.outer.sum() == made.GetNE(BND)
    assert made.GetMaterials() == mesh.GetMaterials()
    for name in set(mesh.GetBoundaries()):
        lengths = [
            Integrate(CF(1), m, BND, definedon=m.Boundaries(name)) for m in (mesh, made)
        ]
        assert lengths[0] == pytest.approx(lengths[1], rel=1e-12)
    quadratic = GridFunction(H1(made, order=2))
    quadratic.Set(x * x + x * y)
    assert Integrate((quadratic - x * x - x * y) ** 2, made, VOL) < 1e-20


def test_angles_do_not_degenerate():
    """Newest-vertex bisection makes triangles of few shapes: after six passes towards a corner."""
    finer = Bisection(lshape.mesh(0.3))
    least = least_angle(finer)
    for _ in range(6):
        near = np.linalg.norm(finer.points[finer.nodes], axis=2).min(axis=1)
        finer.cut(np.flatnonzero(near == near.min()))
    assert least_angle(finer) >= 0.4 * least


def least_angle(finer):
    """The least angle of all triangles (radians)."""
    corners = finer.points[finer.nodes]
    one = np.roll(corners, -1, axis=1) - corners
    two = np.roll(corners, -2, axis=1) - corners
    sizes = np.linalg.norm(one, axis=2) * np.linalg.norm(two, axis=2)
    return np.arccos(np.einsum("tkc,tkc->tk", one, two) / sizes).min()


def test_it_is_netgens_bisection():
    """The same triangles, in another order, where no two sides of a triangle are equally long."""
    mesh = lshape.mesh(0.2)
    chosen = np.random.default_rng(1).random(mesh.ne) < 0.1
    finer = Bisection(mesh)
    finer.cut(np.flatnonzero(chosen))
    made, _ = finer.built()
    other, _ = bisected(mesh, chosen)
    assert sorted_centres(made) == pytest.approx(sorted_centres(other), abs=1e-12)


def sorted_centres(mesh):
    """The centres of the triangles of a mesh, in lexicographic order."""
    cells = Simplices.of(mesh)
    centres = cells.points[cells.nodes].mean(axis=1).round(13)
    return centres[np.lexsort(centres.T)]
