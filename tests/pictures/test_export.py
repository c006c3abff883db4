"""VTU and PVD files: read back by an independent reader, and refused when they are not there."""

from xml.etree import ElementTree

import numpy as np
import pytest
from ngsolve import CF, InnerProduct, Integrate
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh
from solved import block_primal, lshape_dual, lshape_primal, two_blocks

from ngepc import Material, Problem, evolve, semismooth_newton
from ngepc.model.processes import Team
from ngepc.pictures.export import FIELDS, export_vtu
from ngepc.pictures.vtu import in_space
from ngepc.results import files
from ngepc.results.records import l2_norm

meshio = pytest.importorskip(
    "meshio", reason="meshio reads the files back (extra 'test')"
)


def cells(mesh):
    """The corners of all cells; nodes on edges come after them."""
    (block,) = mesh.cells
    return block.data[:, : 3 if block.type.startswith("triangle") else 4]


def sizes(mesh):
    corners = mesh.points[cells(mesh)]
    edges = corners[:, 1:] - corners[:, :1]
    if edges.shape[1] == 2:
        return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    return np.abs(np.linalg.det(edges)) / 6


@pytest.mark.parametrize("solve", [lshape_dual, lshape_primal, block_primal])
def test_files_hold_the_body_and_its_fields(solve, tmp_path):
    result = solve()
    path = export_vtu(result, tmp_path / "new" / "folder" / "body.vtu")
    read = meshio.read(path)
    body = result.problem.mesh
    touching = {"contact_pressure"} if solve is not lshape_dual else set()
    assert set(read.point_data) == {*FIELDS, *touching}
    assert len(cells(read)) == body.ne
    assert sizes(read).sum() == pytest.approx(0.75 if body.dim == 2 else 1.0, rel=1e-12)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("solve", [lshape_primal, two_blocks])
def test_piecewise_constant_tensors_keep_their_norms(solve, tmp_path):
    result = solve()
    read = meshio.read(export_vtu(result, tmp_path / "body.vtu"))
    for name in ("plastic_strain", "stress"):
        tensor = read.point_data[name][cells(read)[:, 0]]
        assert tensor.shape[1] == 9
        norm = np.sqrt((tensor**2).sum(axis=1) @ sizes(read))
        assert norm == pytest.approx(
            l2_norm(getattr(result, name), result.problem.mesh), rel=1e-10
        )


def test_displacements_have_three_components_and_the_right_mean(tmp_path):
    result = lshape_primal()
    read = meshio.read(export_vtu(result, tmp_path / "body.vtu"))
    u = read.point_data["displacement"]
    assert u.shape[1] == 3
    assert np.abs(u[:, 2]).max() == 0.0
    mean = u[cells(read)].mean(axis=1).T @ sizes(read)
    expected = Integrate(result.displacement, result.problem.mesh)
    np.testing.assert_allclose(mean[:2], expected, rtol=1e-11)


def test_chosen_fields_only(tmp_path):
    read = meshio.read(
        export_vtu(lshape_primal(), tmp_path / "b.vtu", ["displacement", "strain"])
    )
    assert set(read.point_data) == {"displacement", "strain"}


def test_series_lists_its_steps_beside_it(tmp_path):
    steps = {0.5: lshape_dual(), 1.5: lshape_primal()}
    path = export_vtu(steps, tmp_path / "load.pvd")
    listed = ElementTree.parse(path).getroot().findall("./Collection/DataSet")
    assert [float(entry.get("timestep")) for entry in listed] == [0.5, 1.5]
    for entry, result in zip(listed, steps.values(), strict=True):
        read = meshio.read(path.parent / entry.get("file"))
        p = read.point_data["plastic_strain"][cells(read)[:, 0]]
        expected = Integrate(
            InnerProduct(result.plastic_strain, result.plastic_strain),
            result.problem.mesh,
        )
        assert (p**2).sum(axis=1) @ sizes(read) == pytest.approx(expected, rel=1e-10)


def test_parts_of_processes_are_listed_and_written_each_by_its_own(
    tmp_path, monkeypatch
):
    result = lshape_primal()
    for rank in (1, 0):
        process = Team()  # the other one has the same mesh
        process.size, process.rank = 2, rank
        monkeypatch.setattr(type(result.problem), "processes", process)
        path = export_vtu(result, tmp_path / "body.vtu")
    assert path == tmp_path / "body.pvd"
    listed = ElementTree.parse(path).getroot().findall("./Collection/DataSet")
    assert [(e.get("part"), e.get("file")) for e in listed] == [
        ("0", "body_0000.vtu"),
        ("1", "body_0001.vtu"),
    ]
    for entry in listed:
        assert (
            len(cells(meshio.read(tmp_path / entry.get("file"))))
            == result.problem.mesh.ne
        )


def test_an_older_file_survives_a_failure(tmp_path, monkeypatch):
    path = export_vtu(lshape_primal(), tmp_path / "body.vtu")
    before = path.read_bytes()

    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        export_vtu(lshape_dual(), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: export_vtu(lshape_primal(), p / "a.vtk"), "ends in '.vtu'"),
        (
            lambda p: export_vtu(lshape_primal(), p / "a.vtu", ["stres"]),
            "at least one, of",
        ),
        (lambda p: export_vtu({0: lshape_primal()}, p / "a.vtu"), "ends in '.pvd'"),
        (lambda p: export_vtu({}, p / "a.pvd"), "at least one"),
    ],
)
def test_bad_input_is_named(call, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        call(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_tensors_with_three_rows_on_a_plane_mesh_keep_them():
    """Plane strain: 3 x 3 stresses in two dimensions."""
    mesh = lshape_primal().problem.mesh
    place = mesh(np.array([0.7, 0.6]), np.array([0.2, 0.3]))
    three = CF(tuple(range(1, 10)), dims=(3, 3))
    assert in_space(three, place)[0].tolist() == list(range(1, 10))
    two = CF((1, 2, 3, 4), dims=(2, 2))
    assert in_space(two, place)[0].tolist() == [1, 2, 0, 3, 4, 0, 0, 0, 0]
    assert in_space(CF((5, 6)), place)[0].tolist() == [5, 6, 0]


SHAPES = {
    "triangles": (2, {"quad_dominated": False}, 5, 22, 1.0),
    "quadrilaterals": (2, {"quad_dominated": True}, 9, 23, 1.0),
    "tetrahedra": (3, {"hexes": False}, 10, 24, 1.0),
    "prisms": (3, {"hexes": False, "prism": True}, 13, 26, 1.0),
    "hexahedra": (3, {"hexes": True}, 12, 25, 1.0),
}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", SHAPES)
def test_cells_of_both_orders_fill_the_body(name, order, tmp_path):
    """Volumes by an independent reader: positive, and their sum that of the body."""
    pyvista = pytest.importorskip("pyvista", reason="VTK reads (extra 'stills')")
    dim, options, linear, quadratic, size = SHAPES[name]
    if dim == 2:
        mesh = MakeStructured2DMesh(quads=options["quad_dominated"], nx=2, ny=2)
    else:
        mesh = MakeStructured3DMesh(**options, nx=2, ny=2, nz=2)
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1.0
    )
    names = list(dict.fromkeys(mesh.GetBoundaries()))
    up = CF((0.0,) * (dim - 1) + (0.1,))
    problem = Problem(mesh, steel, names[0], {names[2]: up}, order=order)
    result = semismooth_newton(problem)
    path = export_vtu(result, tmp_path / "body.vtu")
    grid = pyvista.read(path)
    assert set(grid.celltypes) == {linear if order == 1 else quadratic}
    sizes = grid.compute_cell_sizes()
    measure = sizes["Area"] if dim == 2 else sizes["Volume"]
    assert measure.min() > 0
    assert measure.sum() == pytest.approx(size, rel=1e-9)
    u = grid.point_data["displacement"][:, :dim]
    where = np.moveaxis(grid.points[:, :dim], 1, 0)
    inside = 0.999 * where + 0.0005  # points on faces belong to several elements
    np.testing.assert_allclose(
        u, result.displacement(mesh(*inside)), atol=2e-3 * np.abs(u).max()
    )


def test_bodies_have_numbers_and_contact_faces_their_pressure(tmp_path):
    result = two_blocks()
    read = meshio.read(export_vtu(result, tmp_path / "two.vtu"))
    body = np.ravel(read.cell_data["body"])
    assert set(body) == {0, 1}
    upper = result.problem.mesh.GetMaterials().index("upper")
    heights = read.points[read.cells[0].data].mean(axis=1)[:, 2]
    np.testing.assert_array_equal(body == upper, heights > 1)
    pressed = read.point_data["contact_pressure"].ravel()
    on_face = pressed[np.isclose(read.points[:, 2], 1.0) & (pressed > 0)]
    np.testing.assert_allclose(on_face, 0.5, rtol=1e-6)


def test_a_history_is_written_as_it_is(tmp_path):
    history = evolve(block_primal().problem, [(0.5, {}), (1.0, {"gap": 0.0})])
    path = export_vtu(history, tmp_path / "steps.pvd")
    pyvista = pytest.importorskip("pyvista", reason="VTK reads (extra 'stills')")
    reader = pyvista.get_reader(path)
    assert reader.time_values == [0.5, 1.0]
    reader.set_active_time_value(1.0)
    (grid,) = reader.read()
    largest = grid.point_data["contact_pressure"].max()
    assert largest == pytest.approx(history.column("max_contact_pressure")[-1])
    assert largest > 0
