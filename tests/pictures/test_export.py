"""VTU and PVD files: read back by an independent reader, and refused when they are not there."""

from xml.etree import ElementTree

import numpy as np
import pytest
from ngsolve import CF, InnerProduct, Integrate
from solved import block_primal, lshape_dual, lshape_primal

from ngepc.model.processes import Team
from ngepc.pictures import export
from ngepc.pictures.export import FIELDS, export_vtu, in_space
from ngepc.results.records import l2_norm

meshio = pytest.importorskip(
    "meshio", reason="meshio reads the files back (extra 'test')"
)


def cells(mesh):
    (block,) = mesh.cells
    return block.data


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
    assert set(read.point_data) == set(FIELDS)
    assert len(cells(read)) == body.ne
    assert sizes(read).sum() == pytest.approx(0.75 if body.dim == 2 else 1.0, rel=1e-12)
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("solve", [lshape_primal, block_primal])
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


class Silent:
    """A VTKOutput that writes nothing and says nothing."""

    def __init__(self, *_, **__):
        pass

    def Do(self):
        return "out"


def test_a_writer_that_writes_nothing_is_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(export, "VTKOutput", Silent)
    with pytest.raises(OSError, match="wrote no file"):
        export_vtu(lshape_primal(), tmp_path / "body.vtu")
    assert not (tmp_path / "body.vtu").exists()


def test_an_older_file_survives_a_failure(tmp_path, monkeypatch):
    path = export_vtu(lshape_primal(), tmp_path / "body.vtu")
    before = path.read_bytes()
    monkeypatch.setattr(export, "VTKOutput", Silent)
    with pytest.raises(OSError, match="wrote no file"):
        export_vtu(lshape_primal(), path)
    assert path.read_bytes() == before


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
    place = lshape_primal().problem.mesh(0.7, 0.2)
    three = CF(tuple(range(1, 10)), dims=(3, 3))
    assert in_space(three)(place) == tuple(range(1, 10))
    two = CF((1, 2, 3, 4), dims=(2, 2))
    assert in_space(two)(place) == (1, 2, 0, 3, 4, 0, 0, 0, 0)
    assert in_space(CF((5, 6)))(place) == (5, 6, 0)
