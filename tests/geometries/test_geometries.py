"""The bodies: node counts of the paper's families, names, lengths, areas and volumes."""

import inspect
import math

import numpy as np
import pytest
from ngsolve import CF, Integrate, ds

from ngepc.geometries import (
    block,
    cook,
    lshape,
    plate,
    published,
    punch,
    quarter_cube,
    ring,
    wrench,
)
from ngepc.model.elements import element_facets
from ngepc.model.support import check_conforming

PAPER_A = (833, 1601, 3201, 6273, 12545, 24833)
"""Nodes of Example (a), Table 1 of the paper."""
PAPER_B = (873, 1641, 3281, 6353, 12705)
"""Nodes of Example (b), Tables 2 and 3; the last one printed there, 24927, is no bisection."""


def measure(mesh):
    return Integrate(CF(1.0), mesh)


def lengths(mesh):
    """Boundary name -> length or area."""
    return {
        name: Integrate(CF(1.0) * ds(name), mesh)
        for name in sorted(set(mesh.GetBoundaries()))
    }


def euler_characteristic(mesh):
    """Vertices - edges + faces (- cells), of those that belong to elements."""
    counts = [
        len({item.nr for el in mesh.Elements() for item in getattr(el, kind)})
        for kind in ("vertices", "edges", "faces")[: mesh.dim]
    ]
    return sum((-1) ** i * n for i, n in enumerate([*counts, mesh.ne]))


def test_nodes_of_example_a():
    assert lshape.PAPER_NODES == PAPER_A
    for nodes in (417, *PAPER_A[:4]):
        assert lshape.paper_mesh(nodes).nv == nodes


def test_nodes_of_example_b():
    assert wrench.PAPER_NODES[:5] == PAPER_B
    for nodes in PAPER_B[:4]:
        assert wrench.paper_mesh(nodes).nv == nodes


@pytest.mark.parametrize("nodes", [lshape.PAPER_NODES[-1], wrench.PAPER_NODES[-1]])
def test_finest_meshes(nodes):
    family = lshape if nodes == lshape.PAPER_NODES[-1] else wrench
    assert family.paper_mesh(nodes).nv == nodes


@pytest.mark.parametrize("level", [1, 2, 3, 4, 5])
def test_criss_cross_identity(level):
    """With n x n cells in each square of side 1/2 there are 6 n^2 + 4 n + 1 nodes, 12 n^2 cells."""
    n = 2 ** (level - 1)
    mesh = lshape.paper_mesh(6 * n * n + 4 * n + 1)
    assert mesh.ne == 12 * n * n


@pytest.mark.parametrize(
    ("family", "counts"),
    [
        (lshape, (8, 11, 21, 33, 65, 113, 225, 417, 833)),
        (wrench, (26, 38, 75, 123, 245, 437, 873)),
    ],
    ids=["lshape", "wrench"],
)
def test_triangles_double_with_each_bisection(family, counts):
    triangles = [family.paper_mesh(n).ne for n in counts]
    assert triangles == [triangles[0] * 2**k for k in range(len(counts))]
    assert triangles[0] == {lshape: 6, wrench: 24}[family]


@pytest.mark.parametrize("nodes", [225, 417, 833])
def test_bisected_triangles_are_right_isosceles(nodes):
    mesh = lshape.paper_mesh(nodes)
    x = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    corners = x[np.array([[v.nr for v in el.vertices] for el in mesh.Elements()])]
    sides = np.sort(
        np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1
    )
    assert np.ptp(sides, axis=0).max() < 1e-14
    assert sides[0, 2] / sides[0, 0] == pytest.approx(math.sqrt(2))


@pytest.mark.parametrize(
    "mesh", [lshape.paper_mesh(113), lshape.mesh(0.1)], ids=["paper", "csg"]
)
def test_lshape(mesh):
    assert measure(mesh) == pytest.approx(0.75, rel=1e-11)
    assert lengths(mesh) == pytest.approx(
        {"clamped": 0.5, "contact": 1.0, "free": 2.0, "load": 0.5}, rel=1e-11
    )


@pytest.mark.parametrize(
    "mesh", [wrench.paper_mesh(123), wrench.mesh(0.3)], ids=["paper", "csg"]
)
def test_wrench(mesh):
    """The load stands on conv{(5, 2.6), (8, 2)}; twelve quadrilaterals of area one."""
    assert measure(mesh) == pytest.approx(12.0, rel=1e-11)
    found = lengths(mesh)
    assert found["clamped"] == pytest.approx(2.0)
    assert found["contact"] == pytest.approx(1.0)
    assert found["load"] == pytest.approx(math.hypot(3.0, 0.6))
    assert set(found) == {"clamped", "contact", "free", "load"}


def test_cook():
    mesh = cook.bisected_mesh(25)
    assert measure(mesh) == pytest.approx(48 * (44 + 16) / 2, rel=1e-11)
    assert lengths(mesh) == pytest.approx(
        {
            "clamped": 44.0,
            "load": 16.0,
            "free": math.hypot(48, 44) + math.hypot(48, 16),
        },
        rel=1e-11,
    )


BLOCKS = {
    "rectangles": lambda: block.structured_mesh(3, 4, size=(2, 3)),
    "triangles": lambda: block.structured_mesh(3, 4, size=(2, 3), simplices=True),
    "triangles of CSG": lambda: block.mesh(0.4, (2, 3)),
    "hexahedra": lambda: block.structured_mesh(3, 4, 5, size=(2, 3, 1)),
    "tetrahedra": lambda: block.structured_mesh(
        3, 4, 5, size=(2, 3, 1), simplices=True
    ),
    "tetrahedra of CSG": lambda: block.mesh(0.8, (2, 3, 1)),
}


@pytest.mark.parametrize("name", BLOCKS)
def test_block(name):
    """Same names whatever the cells; every side stands where its name says."""
    mesh = BLOCKS[name]()
    a, b, c = 2.0, 3.0, 1.0
    if mesh.dim == 2:
        expected = {"left": b, "right": b, "clamped": a, "contact": a}
        height, top = 1, b
    else:
        sides = {"left": b * c, "right": b * c, "front": a * c, "back": a * c}
        expected = {**sides, "clamped": a * b, "contact": a * b}
        height, top = 2, c
    assert lengths(mesh) == pytest.approx(expected, rel=1e-10)
    assert measure(mesh) == pytest.approx(6.0, rel=1e-10)
    assert mesh.GetMaterials() == ("body",)
    where = {
        "left": (0, 0.0),
        "right": (0, a),
        "clamped": (height, 0.0),
        "contact": (height, top),
    }
    where |= {"front": (1, 0.0), "back": (1, b)} if mesh.dim == 3 else {}
    x = np.asarray(mesh.ngmesh.Coordinates())
    for side, (axis, value) in where.items():
        nodes = {v.nr for el in mesh.Boundaries(side).Elements() for v in el.vertices}
        assert x[sorted(nodes), axis] == pytest.approx(value, abs=1e-14)


@pytest.mark.parametrize(
    ("cells", "simplices", "elements"),
    [
        ((3, 4), False, 12),
        ((3, 4), True, 24),
        ((2, 3, 4), False, 24),
        ((2, 3, 4), True, 144),
    ],
)
def test_structured_counts(cells, simplices, elements):
    mesh = block.structured_mesh(*cells, simplices=simplices)
    assert mesh.ne == elements
    assert mesh.nv == math.prod(n + 1 for n in cells)


def test_hole_of_the_block_is_round():
    """Chords of length c miss 2 pi c^2 / 12 of the hole; bent elements far less."""
    mesh = block.with_hole(0.15, (1, 2), 0.3)
    error = []
    for k in (1, 2, 3):
        mesh.Curve(k)
        error.append(abs(measure(mesh) - (2 - math.pi * 0.09)))
    assert error[0] == pytest.approx(2 * math.pi * 0.15**2 / 12, rel=0.2)
    assert error[1] < error[0] / 100
    assert error[2] < error[1] / 5
    assert lengths(mesh)["hole"] == pytest.approx(0.6 * math.pi, rel=1e-4)


def test_hole_of_the_3d_block():
    mesh = block.with_hole(0.25, (1, 2, 1), 0.25)
    mesh.Curve(3)
    assert measure(mesh) == pytest.approx(2 * (1 - math.pi / 16), rel=1e-3)
    found = lengths(mesh)
    assert found["hole"] == pytest.approx(math.pi, rel=1e-3)
    assert found["front"] == pytest.approx(1 - math.pi / 16, rel=1e-3)
    assert found["contact"] == pytest.approx(2.0)
    assert set(found) == {
        "clamped",
        "contact",
        "left",
        "right",
        "front",
        "back",
        "hole",
    }


@pytest.mark.parametrize("part", [1, 4])
def test_ring(part):
    mesh = ring.mesh(0.2, 1.0, 2.0) if part == 1 else ring.quarter_mesh(0.2, 1.0, 2.0)
    mesh.Curve(3)
    assert measure(mesh) == pytest.approx(3 * math.pi / part, rel=1e-6)
    expected = {"inner": 2 * math.pi / part, "outer": 4 * math.pi / part}
    expected |= {"left": 1.0, "bottom": 1.0} if part == 4 else {}
    assert lengths(mesh) == pytest.approx(expected, rel=1e-5)


def test_shell_octant():
    mesh = ring.shell_octant_mesh(0.5, 1.0, 2.0)
    mesh.Curve(3)
    assert measure(mesh) == pytest.approx(7 * math.pi / 6, rel=1e-3)
    sector = 3 * math.pi / 4
    assert lengths(mesh) == pytest.approx(
        {
            "inner": math.pi / 2,
            "outer": 2 * math.pi,
            "left": sector,
            "front": sector,
            "bottom": sector,
        },
        rel=2e-3,
    )


def test_quarter_plate():
    mesh = plate.quarter_mesh(0.15, (2, 3), 0.5)
    mesh.Curve(3)
    assert measure(mesh) == pytest.approx((6 - math.pi / 4) / 4, rel=1e-6)
    expected = {
        "hole": math.pi / 4,
        "left": 1.0,
        "bottom": 0.5,
        "right": 1.5,
        "top": 1.0,
    }
    assert lengths(mesh) == pytest.approx(expected, rel=1e-5)


def test_punch():
    """The patch is meshed finely, the block around it coarsely."""
    mesh = punch.mesh(0.8, 0.05, (8, 4), 1.0)
    assert measure(mesh) == pytest.approx(32.0, rel=1e-11)
    expected = {"clamped": 8.0, "contact": 1.0, "left": 4.0, "right": 4.0, "top": 7.0}
    assert lengths(mesh) == pytest.approx(expected, rel=1e-11)
    edges = len(list(mesh.Boundaries("contact").Elements()))
    assert 20 <= edges <= 24
    assert mesh.ne < 2 * 32 / 0.05**2 / 10


@pytest.mark.parametrize("simplices", [False, True])
@pytest.mark.parametrize("grading", [0.0, 3.0])
def test_quarter_cube(grading, simplices):
    """Cells under the middle of the top are smaller by sinh(s)/s."""
    mesh = quarter_cube.mesh(4, 6, grading=grading, simplices=simplices)
    assert measure(mesh) == pytest.approx(0.25, rel=1e-11)
    expected = {"clamped": 0.25, "contact": 0.25}
    expected |= dict.fromkeys(("mirror_x", "mirror_y", "side_x", "side_y"), 0.5)
    assert lengths(mesh) == pytest.approx(expected, rel=1e-10)
    x = np.asarray(mesh.ngmesh.Coordinates())
    where = {
        "mirror_x": (0, 0.5),
        "side_x": (0, 1),
        "mirror_y": (1, 0.5),
        "side_y": (1, 1),
    }
    for name, (axis, value) in (where | {"clamped": (2, 0), "contact": (2, 1)}).items():
        nodes = {v.nr for el in mesh.Boundaries(name).Elements() for v in el.vertices}
        assert x[sorted(nodes), axis] == pytest.approx(value, abs=1e-14)
    first = np.diff(np.unique(x[:, 0]))[0]
    equal = 0.5 / 4
    graded = math.sinh(grading / 4) / math.sinh(grading) / 2 if grading else equal
    assert first == pytest.approx(graded)


ALL = {
    "punch": punch.mesh,
    "quarter cube": lambda: quarter_cube.mesh(3),
    "lshape": lambda: lshape.mesh(0.1),
    "lshape paper": lambda: lshape.paper_mesh(113),
    "wrench": lambda: wrench.mesh(0.4),
    "wrench paper": lambda: wrench.paper_mesh(123),
    "cook": lambda: cook.bisected_mesh(25),
    "quarter plate": lambda: plate.quarter_mesh(0.1),
    "ring": lambda: ring.mesh(0.3),
    "quarter ring": lambda: ring.quarter_mesh(0.3),
    "shell": lambda: ring.shell_octant_mesh(0.6),
    "block with hole": lambda: block.with_hole(0.5),
    "plane block with hole": lambda: block.with_hole(0.2, (1, 1)),
    **BLOCKS,
}


@pytest.mark.parametrize("name", ALL)
def test_every_body_is_sound(name):
    """Every boundary is named, the region is ``body``, elements conform, one connected piece.

    Euler: V - E + F (- C) = 1 for a disc or ball, minus one for each hole through it.
    """
    mesh = ALL[name]()
    assert not {"", "default", "bc_0"} & set(mesh.GetBoundaries())
    assert mesh.GetMaterials() == ("body",)
    check_conforming(*element_facets(mesh))
    pierced = name in {"ring", "block with hole", "plane block with hole"}
    assert euler_characteristic(mesh) == (0 if pierced else 1)


@pytest.mark.parametrize("name", ["lshape", "ring", "block with hole"])
def test_same_mesh_twice(name, monkeypatch):
    """Made anew, where the first one may be a copy of what another test has made."""
    first = ALL[name]()
    monkeypatch.setattr(block, "with_hole", inspect.unwrap(block.with_hole))
    second = ALL[name]()
    assert np.array_equal(
        np.asarray(first.ngmesh.Coordinates()), np.asarray(second.ngmesh.Coordinates())
    )


@pytest.mark.parametrize(("maxh", "coarser"), [(0.1, 0.2), (0.05, 0.1)])
def test_mesh_width_is_a_bound(maxh, coarser):
    """Edges stay within a factor of maxh; halving it gives about four times the triangles."""
    mesh = lshape.mesh(maxh)
    x = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    longest = max(
        np.linalg.norm(x[e.vertices[0].nr] - x[e.vertices[1].nr]) for e in mesh.edges
    )
    assert longest < 1.5 * maxh
    assert 2.5 < mesh.ne / lshape.mesh(coarser).ne < 6


PUBLISHED = {
    "half a block": (
        lambda: published.half_block(4, 2, 1, 0.1, 1),
        8,
        {"contact": 1, "free": 3, "symmetry": 2},
    ),
    "roller": (
        lambda: published.roller_on_block(2.0),
        20000 + math.pi * 50**2 / 4,
        {"load": 50, "bottom": 100, "symmetry": 250, "flat": 9},
    ),
    "rings": (
        lambda: published.shrunk_rings(0.1, 1, 2, 3, 0.01),
        math.pi / 4 * (2.005**2 - 1 + 9 - 1.995**2),
        {"inner inside": math.pi / 2, "left": 2.01},
    ),
    "stacked": (
        lambda: published.stacked_blocks(2, 0.3),
        0.94,
        {"above": 0.6, "below": 1, "top": 0.6},
    ),
    "stacked, 3D": (
        lambda: published.stacked_blocks(3, 0.5),
        0.844,
        {"above": 0.36, "clamped": 1},
    ),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_bodies_of_published_problems(name):
    build, size, sides = PUBLISHED[name]
    mesh = build()
    assert measure(mesh) == pytest.approx(size, rel=5e-3)
    found = lengths(mesh)
    for side, length in sides.items():
        assert found[side] == pytest.approx(length, rel=5e-3), side
