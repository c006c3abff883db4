"""The study of accuracy: decks that CalculiX solves as we do, and times read off between meshes."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import Integrate
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngepc.studies import accuracy, by_getfem, calculix
from ngepc.studies.accuracy import (
    Accuracy,
    by_calculix,
    by_ngepc,
    fastest,
    ratios,
    runs_by_getfem,
    shown_time,
    time_to,
)
from ngepc.studies.accuracy_cases import CASES, beam
from ngepc.studies.accuracy_decks import curve_of, deck_of, rigid_layer, surface_of
from ngepc.studies.calculix import CORNER_EDGES, FACES, QuadraticMesh

needs_ccx = pytest.mark.skipif(not calculix.available(), reason="ccx is not installed")

MESHES = {
    "triangles": MakeStructured2DMesh(nx=2, ny=3, quads=False),
    "quadrilaterals": MakeStructured2DMesh(nx=2, ny=3, quads=True),
    "tetrahedra": MakeStructured3DMesh(nx=2, ny=1, nz=1, hexes=False),
    "hexahedra": MakeStructured3DMesh(nx=2, ny=1, nz=1, hexes=True),
}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_middles_lie_between_corners(mesh):
    body = QuadraticMesh(mesh)
    x = body.points[body.elements]
    edges = CORNER_EDGES[body.shape]
    corners = body.corners.shape[1]
    for number, (a, b) in enumerate(edges):
        assert np.allclose(x[:, corners + number], (x[:, a] + x[:, b]) / 2)
    assert len(np.unique(body.elements)) == len(body.points)


@pytest.mark.parametrize("name", ["tetrahedra", "hexahedra"])
def test_faces_point_outwards(name):
    """The normals of the faces S1, S2, ... by the right-hand rule add up to zero and point out."""
    body = QuadraticMesh(MESHES[name])
    x = body.points[body.corners]
    centre = x.mean(axis=1)
    for face in FACES[body.shape]:
        p = x[:, list(face)]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        outwards = np.einsum("ei,ei->e", normal, p.mean(axis=1) - centre)
        assert (outwards > 0).all() or (outwards < 0).all()


@pytest.mark.parametrize("name", ["triangles", "quadrilaterals"])
def test_sides_of_plane_elements_are_those_of_the_boundary(name):
    """Each S1, S2, ... of an element on the right boundary lies there."""
    body = QuadraticMesh(MESHES[name])
    sides = body.faces_on("right")
    assert len(sides) == 3
    for element, side in sides:
        corners = body.corners[element, list(FACES[body.shape][side])]
        assert np.allclose(body.points[corners, 0], 1)


def test_nodes_and_edges_of_a_boundary():
    body = QuadraticMesh(MESHES["triangles"])
    right = body.nodes_on("right")
    assert np.allclose(body.points[right, 0], 1)
    assert len(right) == 2 * 3 + 1
    assert sum(length for *_, length in body.edges_on("right")) == pytest.approx(1)


@needs_ccx
@pytest.mark.parametrize(
    ("case", "bricks", "tolerance"),
    [("Cook's membrane", False, 1e-3), ("plastic hinge, 3D", False, 5e-3)],
)
def test_two_programs_agree(case, bricks, tolerance):
    """The same quadratic simplices; one increment here, some there."""
    ours = by_ngepc(CASES[case], "default", 0)
    theirs = by_calculix(CASES[case], bricks, 0)
    assert ours["status"] == theirs["status"] == "converged"
    assert ours["value"] == pytest.approx(theirs["value"], rel=tolerance)


def test_getfem_agrees():
    """The same law and the same points on the same triangles; one increment."""
    if by_getfem.interpreter() is None:
        pytest.skip("no Python with GetFEM")
    case = CASES["Cook's membrane"]
    ours = by_ngepc(case, "default", 0)
    (theirs,) = runs_by_getfem(case, 1)
    assert theirs["increments"] == 1
    assert theirs["value"] == pytest.approx(ours["value"], rel=5e-3)


def test_arrays_for_getfem_are_those_of_the_case():
    case = CASES["notched tension"]
    mesh = case.mesh(0, True)
    data = by_getfem.arrays_of(case, mesh)
    names = list(mesh.GetBoundaries())
    assert data["asked"] == names.index("top")
    assert data["values"].tolist() == [[0, 0], [0, 0], [0, 0.03]]
    assert data["fixed"].tolist() == [[0, 1], [1, 0], [0, 1]]
    highest = data["points"][:, 1].max()
    top = data["middles"][data["numbers"] == names.index("top")]
    assert top[:, 1] == pytest.approx(highest)


def test_decks_of_all_cases_are_written():
    for case in CASES.values():
        lines = deck_of(case, case.mesh(0, True)).lines
        assert lines[-1] == "*END STEP"
        assert any(line.startswith("*NODE PRINT") for line in lines)


def test_times_are_read_off_between_meshes():
    errors = [0.1, 0.025, 0.00625]
    times = [1.0, 4.0, 16.0]
    assert time_to(errors, times, 0.05) == pytest.approx(2.0)
    assert time_to(errors, times, 0.2) == 1.0
    assert time_to(errors, times, 1e-3) == math.inf
    assert time_to([0.01, 0.2], [1.0, 2.0], 0.05) == math.inf
    assert time_to([0.03, 0.02], [2.6, 1.1], 0.05) == 1.1  # the finer mesh needs less
    assert shown_time(math.inf) == "-"


def test_the_fastest_of_three_short_runs_counts():
    short = iter([0.2, 0.1, 0.3, 0.0])
    assert fastest(lambda: {"cpu": next(short)}) == {"cpu": 0.1}
    long = iter([5.0, 0.1])
    assert fastest(lambda: {"cpu": next(long)}) == {"cpu": 5.0}
    assert fastest(lambda: None) is None


def test_ratios_are_those_of_the_faster_elements():
    times = {"a": [1.0, math.inf], "b": [3.0, 2.0], "c": [4.0, math.inf]}
    assert ratios(times, ("a", "b"), ("c", "missing")) == ["0.25", "ngepc alone"]
    assert ratios(times, ("c",), ("a", "b")) == ["4.00", "-"]


@pytest.mark.parametrize("level", [1, 2])
def test_the_beam_is_graded_and_symmetric(level):
    """A box 6 x 1 x 1, the same upside down, with the shortest cells at the clamped end."""
    mesh = beam(level, simplices=False)
    x = np.array([v.point for v in mesh.vertices])
    assert Integrate(1.0, mesh) == pytest.approx(6.0)
    heights = np.unique(x[:, 2].round(12))
    assert heights == pytest.approx(1 - heights[::-1])
    lengths = np.diff(np.unique(x[:, 0].round(12)))
    assert (np.diff(lengths) > 0).all()


def test_without_other_programs_their_rows_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(calculix, "available", lambda: False)
    monkeypatch.setattr(by_getfem, "interpreter", lambda: None)
    programs = {cell["program"] for cell in Accuracy(tmp_path).cells()}
    own = {"default", "order 1", "order 2, direct", "order 2, PyAMG"}
    assert programs == own | {"default, bricks"}


def test_errors_are_sizes(tmp_path, monkeypatch):
    """Of values below and above the reference; a level that failed is left out."""
    found = iter([1.8, None, 2.1, 1.98])

    def run(solve):
        return {"value": next(found), "cpu": 2.0, "iterations": 7}

    monkeypatch.setattr(accuracy, "fastest", run)
    monkeypatch.setattr(accuracy, "reference", lambda case: 2.0)
    data = SimpleNamespace(levels=(4, 4))
    monkeypatch.setattr(accuracy, "CASES", {"it": data})
    record = Accuracy(tmp_path, levels=4).solve("it", "default")
    assert record["errors"] == pytest.approx([0.1, 0.05, 0.01])
    assert record["finest"] == pytest.approx(1.0)
    assert (record["failed"], record["steps_there"]) == (1, 7)


def test_two_ratios_are_written_for_each_case(tmp_path):
    """Beside CalculiX, and beside the best choice of ours, at 5 and 1 percent."""

    def record(program, cpu):
        both = {"errors": [0.2, 0.04, 0.009], "cpu": [cpu, 2 * cpu, 4 * cpu]}
        return {"case": "it", "program": program, **both}

    programs = [("default", 2.0), ("ccx", 8.0), (accuracy.CHOICES[0], 1.0)]
    lines = Accuracy(tmp_path).notes([record(*one) for one in programs])
    (line,) = [one for one in lines if one.startswith("| it |")]
    assert line == "| it | 0.25 | 0.25 | 2.00 | 2.00 |"


def layer_of(case):
    """How thick the layer of stiff elements of a case is at its thinnest place."""
    heights = []

    def mesh(points, elements, name, group):
        below, above = np.split(points, 2)
        assert (below[:, :-1] == above[:, :-1]).all()
        heights.append((above - below)[:, -1].min())
        return 0

    calls = ("node_set", "surface", "material", "section", "add")
    deck = SimpleNamespace(elements=0, mesh=mesh, **{n: lambda *_: None for n in calls})
    N = 3 if case.rigid.axis == 0 else 2
    body = SimpleNamespace(points=np.zeros((1, N)), faces_on=lambda name: [])
    rigid_layer(case, body, deck)
    return heights[0]


def test_rigid_layers_are_solid():
    """Segments and faces that follow one another, and a layer a tenth of their span thick."""
    for case in CASES.values():
        if case.rigid is None:
            continue
        rigid = replace(case.rigid, cells=3)
        low, high = rigid.span
        points, ends = curve_of(rigid)
        assert points[:, 0] == pytest.approx(np.linspace(low, high, 4))
        assert ends.tolist() == [[0, 1], [1, 2], [2, 3]]
        assert layer_of(replace(case, rigid=rigid)) == pytest.approx(0.1 * (high - low))


def test_faces_of_a_rigid_sphere():
    """They cover the square below it, counted round about."""
    spheres = [case.rigid for case in CASES.values() if case.rigid]
    (rigid,) = {one for one in spheres if one.axis == 0}
    rigid = replace(rigid, cells=3)
    low, high = rigid.span
    points, corners = surface_of(rigid)
    x, y = points[corners][..., :2].transpose(2, 0, 1)
    areas = (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1) / 2
    assert areas == pytest.approx(9 * [((high - low) / 3) ** 2])
    assert points[0, :2] == pytest.approx([low, low])
