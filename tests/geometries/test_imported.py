"""Meshes that meshio reads: names of groups, both orders, all shapes, what is refused."""

import meshio
import numpy as np
import pytest
from bodies import MESHES, STEEL
from ngsolve import BND
from ngsolve.meshes import MakeStructured3DMesh

from ngepc import Problem, semismooth_newton
from ngepc.geometries import block, imported
from ngepc.model.elements import element_facets, elements_by_shape
from ngepc.model.support import check_conforming

NAMES = {
    (1, 2): "line",
    (2, 3): "triangle",
    (2, 4): "quad",
    (3, 4): "tetra",
    (3, 6): "wedge",
}
NAMES |= {(3, 8): "hexahedron"}


def as_meshio(mesh, *, named=None, turned=False):
    """A mesh with physical groups, as gmsh writes it; every second element turned inside out."""
    N, x = mesh.dim, np.asarray(mesh.ngmesh.Coordinates())
    boundaries = sorted(set(mesh.GetBoundaries()) if named is None else named)
    groups = {name: np.array([tag, N - 1]) for tag, name in enumerate(boundaries, 1)}
    groups["steel"] = np.array([99, N])
    cells, tags = [], []
    for _, vertices in elements_by_shape(mesh):
        vertices = vertices.copy()
        if turned:
            vertices[::2] = vertices[::2][:, [0, 2, 1, *range(3, vertices.shape[1])]]
        cells.append((NAMES[N, vertices.shape[1]], vertices))
        tags.append(np.full(len(vertices), 99))
    for tag, name in enumerate(boundaries, 1):
        sides = [[v.nr for v in el.vertices] for el in mesh.Boundaries(name).Elements()]
        for count in {len(side) for side in sides}:
            some = np.array([side for side in sides if len(side) == count])
            cells.append((NAMES[N - 1, count], some))
            tags.append(np.full(len(some), tag))
    flat = np.column_stack([x, np.zeros((len(x), 3 - x.shape[1]))])
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    return meshio.Mesh(flat, cells, cell_data=data, field_data=groups)


def second_order(source):
    """The same with nodes in the middles of lines and triangles, and a node that nothing uses."""
    points, cells = [*source.points, np.array([9.0, 9.0, 0.0])], []
    for part in source.cells:
        ends = {"line": [(0, 1)], "triangle": [(0, 1), (1, 2), (2, 0)]}[part.type]
        more = []
        for cell in part.data:
            middles = [
                (source.points[cell[a]] + source.points[cell[b]]) / 2 for a, b in ends
            ]
            more.append([*cell, *range(len(points), len(points) + len(middles))])
            points += middles
        cells.append(
            (f"{part.type}{2 * len(ends) if len(ends) > 1 else 3}", np.array(more))
        )
    return meshio.Mesh(
        np.array(points),
        cells,
        cell_data=source.cell_data,
        field_data=source.field_data,
    )


def through_a_file(source, folder):
    path = folder / "part.msh"
    meshio.write(path, source, file_format="gmsh22", binary=False)
    return imported.mesh(meshio.read(path))


def pulled(mesh):
    load = (3.0, *[1.0] * (mesh.dim - 1))
    problem = Problem(
        mesh, STEEL, "clamped", {"left": load}, contact="contact", gap=-1e-3
    )
    return semismooth_newton(problem).raise_for_status()


@pytest.mark.parametrize(
    "shape", ["triangles", "quadrilaterals", "tetrahedra", "hexahedra", "prisms"]
)
def test_files_of_gmsh_give_the_same_solution(shape, tmp_path):
    mesh = MESHES[shape]()
    again = through_a_file(as_meshio(mesh), tmp_path)
    assert set(again.GetBoundaries()) == set(mesh.GetBoundaries())
    assert again.GetMaterials() == ("steel",)
    one, two = pulled(mesh), pulled(again)
    assert two.primal_energy == pytest.approx(one.primal_energy, rel=1e-12)
    assert two.contact_force == pytest.approx(one.contact_force, rel=1e-12)


@pytest.mark.parametrize("shape", ["triangles", "tetrahedra"])
def test_elements_are_turned_to_one_orientation(shape):
    mesh = MESHES[shape]()
    again = imported.mesh(as_meshio(mesh, turned=True))
    assert pulled(again).primal_energy == pytest.approx(
        pulled(mesh).primal_energy, rel=1e-12
    )


def test_second_order_files_give_their_corners(tmp_path):
    mesh = MESHES["triangles"]()
    again = through_a_file(second_order(as_meshio(mesh)), tmp_path)
    assert again.nv == mesh.nv
    assert pulled(again).primal_energy == pytest.approx(
        pulled(mesh).primal_energy, rel=1e-12
    )


def test_what_has_no_group_is_free():
    mesh = MESHES["hexahedra"]()
    again = imported.mesh(as_meshio(mesh, named=("clamped", "contact")))
    assert set(again.GetBoundaries()) == {"clamped", "contact", "free"}
    check_conforming(*element_facets(again))
    assert len(list(again.Boundaries("free").Elements())) == 4 * 4
    with pytest.raises(
        ValueError, match="there is no boundary 'top'; this mesh has 'clamped'"
    ):
        Problem(again, STEEL, contact="top", gap=0.0)


@pytest.mark.parametrize("shape", ["triangles", "tetrahedra"])
def test_facets_in_no_set_are_boundary_if_they_are_outer(shape):
    """Also in space, also where the file lists them, and those inside the body are none."""
    mesh = MESHES[shape]()
    source = as_meshio(mesh)
    cells = [
        *source.cells,
        (source.cells[-1].type, source.cells[0].data[:, : mesh.dim]),
    ]
    with pytest.warns(UserWarning, match="has no groups"):
        again = imported.mesh(meshio.Mesh(source.points, cells))
    assert again.GetMaterials() == ("body",)
    assert set(again.GetBoundaries()) == {"boundary"}
    assert len(list(again.Boundaries("boundary").Elements())) == len(
        list(mesh.Elements(BND))
    )


def test_cell_sets_are_names_too():
    """What Abaqus and others call their groups."""
    mesh = block.structured_mesh(3, 2)
    source = as_meshio(mesh)
    sets = {name: [None] * len(source.cells) for name in source.field_data}
    for number, tag in enumerate(source.cell_data["gmsh:physical"]):
        name = next(n for n, (t, _) in source.field_data.items() if t == tag[0])
        sets[name][number] = np.arange(len(tag))
    named = imported.mesh(meshio.Mesh(source.points, source.cells, cell_sets=sets))
    assert set(named.GetBoundaries()) == set(mesh.GetBoundaries())
    assert named.GetMaterials() == ("steel",)
    twice = meshio.Mesh(
        source.points, source.cells, cell_sets=sets | {"section": sets["steel"]}
    )
    with pytest.raises(
        ValueError, match=r"cell_sets\['section'\] has 'quad' cells that another set"
    ):
        imported.mesh(twice)
    del twice.cell_sets["section"]
    assert imported.mesh(twice).ne == mesh.ne


def refused(change):
    source = as_meshio(block.structured_mesh(2, 2, simplices=True))
    change(source)
    return source


def only_lines(source):
    del source.cells[0], source.cell_data["gmsh:physical"][0]


BAD = {
    "not flat": (
        lambda s: s.points.__setitem__((slice(None), 2), s.points[:, 0] ** 2),
        "constant z, or solid cells, are needed",
    ),
    "lines alone": (only_lines, "triangles, quadrilaterals or solid cells"),
    "polygons": (
        lambda s: s.cells.__setitem__(0, meshio.CellBlock("polygon", s.cells[0].data)),
        "source has cells 'polygon': one of line, triangle",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused(name):
    change, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        imported.mesh(refused(change))


def test_what_is_no_mesh_is_refused():
    for nonsense in (None, "part.msh", MakeStructured3DMesh(nx=1, ny=1, nz=1)):
        with pytest.raises(TypeError, match=r"a meshio\.Mesh is needed"):
            imported.mesh(nonsense)
