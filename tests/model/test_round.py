"""What straight sides cut off round bodies, against regular polygons in a circle."""

import math

import numpy as np
import pytest
from netgen.occ import Box, Cylinder, OCCGeometry, WorkPlane, Z
from ngsolve import Mesh, x

from ngepc import (
    LoadWork,
    Material,
    Problem,
    confidence,
    evolve,
    load_cycle,
    semismooth_newton,
    solve_to,
    verdict,
)
from ngepc.geometries import block, lshape
from ngepc.model.round import cut_off, on_geometry, round_note

METAL = Material.metal(
    young=1000.0, poisson=0.3, yield_stress=5.0, tangent_modulus=50.0
)


def disc(maxh):
    circle = WorkPlane().Circle(0, 0, 1).Face()
    circle.edges.name = "rim"
    return Mesh(OCCGeometry(circle, dim=2).GenerateMesh(maxh=maxh))


@pytest.mark.parametrize("maxh", [0.5, 0.2])
def test_a_polygon_in_a_circle(maxh):
    """Area and length are those of sin(t)/t and sin(t/2)/(t/2); arcs of order two are close."""
    mesh = disc(maxh)
    t = 2 * math.pi / len(list(mesh.Boundaries("rim").Elements()))
    parts = cut_off(mesh)
    assert parts[""] == pytest.approx(1 - math.sin(t) / t, rel=0.1 * t)
    assert parts["rim"] == pytest.approx(1 - 2 * math.sin(t / 2) / t, rel=0.1 * t)


def test_straight_and_curved_bodies_lack_nothing():
    for mesh in (block.structured_mesh(2, 2, 2), lshape.mesh(maxh=0.3)):
        assert max(map(abs, cut_off(mesh).values())) < 1e-12
    curved = disc(0.5)
    curved.Curve(2)
    assert cut_off(curved) == {}


def test_messages_say_it():
    """From one percent on; beside bounds, which are those of the polygon, from a thousandth on."""
    coarse, fine = (
        Problem(disc(h), METAL, None, springs={"rim": (1.0, 1.0)}, body_force=(1.0, 0))
        for h in (0.5, 0.2)
    )
    said = round_note(coarse)
    assert said.startswith("Straight sides of a round body: the area of the body is ")
    assert said in semismooth_newton(coarse).message
    assert said in evolve(coarse, load_cycle(coarse, [1.0], steps=1)).message
    result = semismooth_newton(fine)
    assert "Straight sides" not in result.message
    assert "Straight sides" in confidence(result)


def test_refined_meshes_keep_straight_sides():
    loads = {"springs": {"rim": (1.0, 1.0)}, "body_force": (x, 0)}
    run = solve_to(Problem(disc(0.5), METAL, None, **loads), relative_error=0.1)
    assert run.reached
    assert len(run.records) > 1
    assert run.message.startswith("Straight sides of a round body: the area")


def test_faces_that_lack_something_are_named():
    rod = Cylinder((0, 0, 0), Z, 1, 1) - Cylinder((0, 0, -1), Z, 0.6, 3)
    rod.faces.name = "side"
    rod.faces.Max(Z).name = "end"
    mesh = Mesh(OCCGeometry(rod).GenerateMesh(maxh=0.6))
    parts = cut_off(mesh)
    assert parts["end"] == max(parts.values(), key=abs)
    assert "the area of 'end' is " in round_note(Problem(mesh, METAL, "side"))


def rod(maxh):
    whole = Cylinder((0, 0, 0), Z, 1, 2)
    whole.faces.name = "side"
    return Mesh(OCCGeometry(whole).GenerateMesh(maxh=maxh))


@pytest.mark.parametrize("body", [disc, rod])
@pytest.mark.parametrize(
    "image",
    [
        lambda p: 1e-3 * p,
        lambda p: 25.4 * p,
        lambda p: 1.02 * p,
        lambda p: p + np.array([5.0, 0.0, 0.0]),
        lambda p: np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]]) @ (p + 0.3),
    ],
)
def test_a_mesh_that_has_left_its_geometry_lacks_nothing(body, image):
    """Netgen keeps the geometry where it was: lengths beside it say nothing of the mesh."""
    mesh = body(0.5)
    assert on_geometry(mesh)
    for point in mesh.ngmesh.Points():
        point[0], point[1], point[2] = image(np.array(point.p))
    mesh.ngmesh.Update()
    moved = Mesh(mesh.ngmesh)
    assert not on_geometry(moved)
    assert (
        round_note(Problem(moved, METAL, None, springs={moved.GetBoundaries()[0]: 1.0}))
        == ""
    )


def test_a_coarse_mesh_is_on_its_geometry():
    """Sides over a radian and more: their arcs differ much from those of order two."""
    circle = WorkPlane().Circle(0, 0, 1).Face()
    for safety in (1.0, 0.5):
        coarse = {"curvaturesafety": safety, "segmentsperedge": 0.1}
        mesh = OCCGeometry(circle, dim=2).GenerateMesh(maxh=5, **coarse)
        assert on_geometry(Mesh(mesh))


def test_the_coarsest_hole_in_a_box_is_on_its_geometry():
    """Areas of the hole grow with order two, those of the ends become smaller."""
    box = Box((0, 0, 0), (1, 1, 1)) - Cylinder((0.5, 0.5, -1), Z, 0.45, 3)
    box.faces.name = "side"
    mesh = Mesh(OCCGeometry(box).GenerateMesh(maxh=5, curvaturesafety=1))
    missing = cut_off(mesh)[""]
    assert missing < -0.1
    assert on_geometry(mesh)
    assert "the volume of the body is" in round_note(Problem(mesh, METAL, "side"))


@pytest.mark.parametrize("body", [disc, rod])
def test_a_small_shift_changes_little_of_what_is_said(body):
    """By a tenth of the sagitta: the sides cut off what they did."""
    mesh = body(0.5)
    missing = cut_off(mesh)[""]
    for point in mesh.ngmesh.Points():
        point[0] += 0.005
    mesh.ngmesh.Update()
    moved = Mesh(mesh.ngmesh)
    assert on_geometry(moved)
    assert cut_off(moved)[""] == pytest.approx(missing, rel=0.05)


def test_a_verdict_says_what_its_interval_lacks():
    loads = {"springs": {"rim": (1.0, 1.0)}, "body_force": (1.0, 0)}
    problem = Problem(disc(0.5), METAL, None, **loads)
    found = verdict(problem, LoadWork(body_force=(1.0, 0.0)), at_most=100.0)
    assert round_note(problem) in str(found)
