"""Names for facets of any mesh, by place, plane and normal; areas are those of the geometry."""

import numpy as np
import pytest
from bodies import MESHES, curved
from netgen.occ import Cylinder, OCCGeometry, Z
from ngsolve import Integrate, Mesh

from ngepc import Problem, semismooth_newton
from ngepc.geometries import block, imported, lshape, ring
from ngepc.model.material import Material

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
)


def area(mesh, name):
    return Integrate(1, mesh, definedon=mesh.Boundaries(name))


@pytest.mark.parametrize("shape", MESHES)
def test_a_side_has_its_area_and_all_else_stays(shape):
    mesh = MESHES[shape]()
    across = [0.0] * mesh.dim
    across[0] = -1.0
    before = {name: area(mesh, name) for name in set(mesh.GetBoundaries())}
    least = np.asarray(mesh.ngmesh.Coordinates())[:, 0].min()
    point = [least] + [0.0] * (mesh.dim - 1)
    sides = [imported.OnPlane(point, across), lambda *c: c[0] <= least + 1e-9]
    if not shape.startswith("curved"):
        sides.append(imported.Facing(across))
    areas = []
    for where in sides:
        named = imported.name(mesh, "new", where)
        areas.append(area(named, "new"))
        whole = sum(area(named, name) for name in set(named.GetBoundaries()))
        assert whole == pytest.approx(sum(before.values()), rel=1e-12)
        assert Integrate(1, named) == pytest.approx(Integrate(1, mesh), rel=1e-14)
        assert named.GetCurveOrder() == mesh.GetCurveOrder()
    assert areas == pytest.approx([areas[0]] * len(areas), rel=1e-12)
    assert areas[0] > 0
    assert {name: area(mesh, name) for name in before} == before  # mesh itself stays


def test_parts_of_curved_faces_stay_curved():
    """The half of a cylinder is named; refined areas would fail with the wrong surface."""
    body = Mesh(OCCGeometry(Cylinder((0, 0, 0), Z, 1, 2)).GenerateMesh(maxh=0.5))
    body.Curve(3)
    lid = imported.name(body, "lid", imported.OnPlane((0, 0, 2), (0, 0, 1)))
    assert area(lid, "lid") == pytest.approx(np.pi, rel=2e-4)
    part = imported.name(body, "upper", lambda x, y, z: z >= 0.999)
    assert area(part, "upper") > np.pi
    assert Integrate(1, part) == pytest.approx(Integrate(1, body), rel=1e-14)
    hollow = curved(ring.quarter_mesh(0.5))
    faced = imported.name(hollow, "axis", imported.Facing((-1, 0), 2))
    assert area(faced, "axis") == pytest.approx(area(hollow, "left"), rel=1e-12)


def test_a_named_boundary_carries_what_the_given_one_does():
    mesh = lshape.mesh(maxh=0.2)
    given = {"clamped": "clamped", "gap": 0.1, "pressure": {"load": 10.0}}
    again = imported.name(mesh, "stop", imported.Facing((0, 1), 1))
    assert area(again, "stop") >= area(mesh, "contact")
    top = np.asarray(mesh.ngmesh.Coordinates())[:, 1].max()
    again = imported.name(mesh, "stop", lambda x, y: y >= top - 1e-9)
    one = semismooth_newton(Problem(mesh, STEEL, contact="contact", **given))
    two = semismooth_newton(Problem(again, STEEL, contact="stop", **given))
    assert two.primal_energy == pytest.approx(one.primal_energy, rel=1e-12)


SQUARE = block.structured_mesh(2, 2)

BAD = [
    ("", lambda x, y: y > 0.9, ValueError, "name=''"),
    ("a|b", lambda x, y: y > 0.9, ValueError, "without the signs"),
    ("top", lambda x, y: y > 2.0, ValueError, "no facet of the outer boundary"),
    ("top", lambda x, y: y, ValueError, "one True or False for each of 9 points"),
    ("top", "y > 0", TypeError, r"a function of coordinates, OnPlane"),
    ("top", imported.Facing((0, 0, 1)), ValueError, "2 numbers are needed"),
    ("top", imported.OnPlane((0, 0), (0, 0, 1)), ValueError, "2 numbers are needed"),
]


@pytest.mark.parametrize(("name", "where", "kind", "message"), BAD)
def test_bad_arguments_are_refused(name, where, kind, message):
    with pytest.raises(kind, match=message):
        imported.name(SQUARE, name, where)


def test_bad_directions_are_refused():
    with pytest.raises(ValueError, match="a vector other than zero"):
        imported.Facing((0, 0))
    with pytest.raises(ValueError, match="within=180"):
        imported.Facing((0, 1), 180)
