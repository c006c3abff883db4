"""Small bodies of every shape of element, with loads that make a part yield and touch."""

import numpy as np
from netgen.meshing import Element1D, Element2D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh, x
from ngsolve.meshes import MakeStructured3DMesh

from ngepc import Material, Problem, outward_normal
from ngepc.geometries import block, ring

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)

FLAT = {2: "two-dimensional", 3: "solid"}
"""Dimension of a mesh -> kinematics in which tensors are as large: the law of the paper."""

MESHES = {
    "triangles": lambda: block.structured_mesh(3, 3, simplices=True),
    "quadrilaterals": lambda: block.structured_mesh(3, 3),
    "tetrahedra": lambda: block.structured_mesh(2, 2, 2, simplices=True),
    "hexahedra": lambda: block.structured_mesh(2, 2, 2),
    "prisms": lambda: prisms(2),
    "curved triangles": lambda: curved(ring.quarter_mesh(0.5)),
    "curved tetrahedra": lambda: curved(ring.shell_octant_mesh(1.0)),
}

PLANAR = ("plane strain", "two-dimensional", "axisymmetric")

CASES = [
    (shape, kinematics, order)
    for shape in MESHES
    for kinematics in (PLANAR if shape in ("triangles", "quadrilaterals") else (None,))
    for order in (1, 2)
]
ALTERNATING = [CASES[2 * k + k % 2] for k in range(len(CASES) // 2)]
"""Each shape with each kinematics once, of order one and two in turn."""


def curved(mesh):
    """The mesh with elements bent to the geometry."""
    mesh.Curve(2)
    return mesh


def prisms(n, across=None):
    """The unit cube as 2 n m^2 prisms, with the boundary names of ``geometries.block``.

    m is ``across``, n if it is None.
    """
    m = n if across is None else across
    mesh = MakeStructured3DMesh(hexes=False, prism=True, nx=n, ny=m, nz=m)
    names = {"bottom": "clamped", "top": "contact"}
    for number, name in enumerate(mesh.GetBoundaries()):
        mesh.ngmesh.SetBCName(number, names.get(name, name))
    return mesh


def distorted(n, size=0.25, seed=1, mixed=False):
    """A unit square of n x n convex quadrilaterals, some of them triangles if ``mixed``."""
    regular = block.structured_mesh(n, n)
    old = regular.ngmesh
    random = np.random.default_rng(seed)
    new = NetgenMesh(dim=2)
    numbers = []
    for point in old.Points():
        place = np.array([point[0], point[1]])
        inside = (place > 1e-9) & (place < 1 - 1e-9)
        place += inside.all() * random.uniform(-size / n, size / n, 2)
        numbers.append(new.Add(MeshPoint(Pnt(*place, 0))))
    new.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    new.SetMaterial(1, "body")
    for element in old.Elements2D():
        corners = [numbers[vertex.nr - 1] for vertex in element.vertices]
        if mixed and random.uniform() < 0.4:
            new.Add(Element2D(1, [corners[k] for k in (0, 1, 2)]))
            new.Add(Element2D(1, [corners[k] for k in (0, 2, 3)]))
            continue
        new.Add(Element2D(1, corners))
    for element in old.Elements1D():
        ends = [numbers[vertex.nr - 1] for vertex in element.vertices]
        new.Add(Element1D(ends, index=element.index))
    for number, name in enumerate(regular.GetBoundaries()):
        new.SetBCName(number, name)
    return Mesh(new)


def tapered(n, layers=None, size=0.25, taper=0.3, seed=1, length=1.0):
    """A cube of hexahedra with flat faces, over distorted squares, narrower at the top.

    The sides 'left' and 'front' stay where they are.
    """
    flat = distorted(n, size, seed)
    regular = block.structured_mesh(n, n)
    pairs = zip(regular.vertices, flat.vertices, strict=True)
    moved = {tuple(np.round(old.point, 9)): new.point for old, new in pairs}
    mesh = block.structured_mesh(n, n, layers or n).ngmesh
    for point in mesh.Points():
        x, y = moved[tuple(np.round((point[0], point[1]), 9))]
        narrow = 1 - taper * point[2]
        place = (x * narrow, y * narrow, point[2])
        for axis, value in enumerate(place):
            point[axis] = length * value
    for element in (*mesh.Elements3D(), *mesh.Elements2D()):
        element.curved = True
    mesh.Update()
    return Mesh(mesh)


def in_quadrilaterals(mesh):
    """A mesh of triangles, each cut into three convex quadrilaterals by its centre."""
    new = NetgenMesh(dim=2)
    middles = {}

    def added(place):
        """A new vertex."""
        return new.Add(MeshPoint(Pnt(*place, 0)))

    def middle(a, b):
        """The vertex in the middle of an edge."""
        key = frozenset((a, b))
        if key not in middles:
            middles[key] = added((places[a] + places[b]) / 2)
        return middles[key]

    places = np.array([vertex.point for vertex in mesh.vertices])
    corners = [added(place) for place in places]
    for number, name in enumerate(mesh.GetMaterials()):
        new.Add(FaceDescriptor(surfnr=number + 1, domin=number + 1, bc=number + 1))
        new.SetMaterial(number + 1, name)
    for element in mesh.ngmesh.Elements2D():
        nodes = [vertex.nr - 1 for vertex in element.vertices]
        centre = added(places[nodes].mean(axis=0))
        for k, node in enumerate(nodes):
            after = middle(node, nodes[(k + 1) % 3])
            before = middle(nodes[k - 1], node)
            new.Add(Element2D(element.index, [corners[node], after, centre, before]))
    for element in mesh.ngmesh.Elements1D():
        a, b = (vertex.nr - 1 for vertex in element.vertices)
        for ends in ((corners[a], middle(a, b)), (middle(a, b), corners[b])):
            new.Add(Element1D(list(ends), index=element.index))
    for number, name in enumerate(mesh.GetBoundaries()):
        new.SetBCName(number, name)
    return Mesh(new)


def pressed_body(shape, kinematics=None, order=1, material=STEEL):
    """A body of ``MESHES`` that yields in a part and touches its obstacle in a part."""
    mesh = MESHES[shape]()
    model = {"material": material, "kinematics": kinematics, "order": order}
    if shape.startswith("curved"):
        blown = {"inner": -1.4 * outward_normal(mesh)}
        sides = {"left": (0, None), "bottom": (None, 0)}
        if mesh.dim == 3:
            sides = {
                "left": (0, None, None),
                "front": (None, 0, None),
                "bottom": (None, None, 0),
            }
        return Problem(
            mesh,
            clamped=None,
            traction=blown,
            prescribed=sides,
            contact="outer",
            gap=5e-4 * x,
            **model,
        )
    pull, lift = (
        ((2.0, 1.5), (0.0, 1.0))
        if mesh.dim == 2
        else ((2.0, 0.5, 1.0), (0.0, 0.0, 1.0))
    )
    gap = 3e-4 + 2e-3 * (x - 0.3) ** 2
    load = {"traction": {"right": pull}, "body_force": lift}
    return Problem(mesh, contact="contact", gap=gap, **load, **model)


def flat_problem(mesh, *arguments, **named):
    """A Problem with the law of the paper: tensors as large as the mesh has dimensions."""
    return Problem(mesh, *arguments, kinematics=FLAT[mesh.dim], **named)


def moved_by(turn, mesh):
    """The mesh with its points mapped by a matrix."""
    for point in mesh.ngmesh.Points():
        for i, value in enumerate(turn @ np.array(point.p)[: len(turn)]):
            point[i] = float(value)
    return Mesh(mesh.ngmesh)
