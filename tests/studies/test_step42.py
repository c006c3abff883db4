"""The body of deal.II's step-42: its documented number, and both methods on the same meshes."""

import itertools
import json

import pytest

from ngepc import primal_newton, semismooth_newton
from ngepc.__main__ import main
from ngepc.geometries import block, quarter_cube
from ngepc.studies.step42 import WHOLE, compare_methods, relative, solve_refined, step42_problem


def test_quarter_stands_for_the_whole_body():
    """Equal hexahedra are symmetric; on the whole the documentation of step-42 prints 37.3058."""
    whole = primal_newton(step42_problem(block.structured_mesh(8, 8, 8), WHOLE))
    mesh = quarter_cube.mesh(4, 8, grading=0.0, simplices=False)
    quarter = primal_newton(step42_problem(mesh))
    assert whole.contact_force == pytest.approx(37.3058, abs=5e-5)
    assert 4 * quarter.contact_force == pytest.approx(whole.contact_force, rel=1e-10)
    assert 4 * quarter.primal_energy == pytest.approx(whole.primal_energy, rel=1e-10)


def test_multigrid_on_halved_cells_is_the_direct_solver():
    """From the mesh of step-42 itself, nested."""
    found = solve_refined(8)
    mesh = quarter_cube.mesh(8, 16, grading=0.0, simplices=False)
    direct = semismooth_newton(step42_problem(mesh))
    assert found["nodes"] == mesh.nv
    assert found["default"]["status"] == "converged"
    assert found["default"]["contact_force"] == pytest.approx(4 * direct.contact_force, rel=1e-8)
    assert found["default"]["energy"] == pytest.approx(4 * direct.primal_energy, rel=1e-10)


@pytest.fixture(scope="module")
def tetrahedra():
    return [compare_methods(step42_problem(quarter_cube.mesh(n))) for n in (4, 6, 8)]


def test_methods_differ_by_less_than_the_meshes(tetrahedra):
    for coarser, record in itertools.pairwise(tetrahedra):
        before = coarser["primal"]["contact_force"]
        mesh_change = abs(record["primal"]["contact_force"] / before - 1)
        assert relative(record, "contact_force") < 0.4 * mesh_change
    assert relative(tetrahedra[-1], "contact_force") < 0.025
    assert relative(tetrahedra[-1], "energy") < 0.05
    assert tetrahedra[-1]["displacement_difference"] < 0.1


def test_every_run_takes_a_dozen_steps(tetrahedra):
    for record, method in itertools.product(tetrahedra, ("primal", "default")):
        assert record[method]["status"] == "converged"
        assert record[method]["iterations"] <= 14


def test_study_writes_its_table_and_keeps_its_cells(tmp_path, monkeypatch):
    arguments = ["study", "step42", "--levels", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    text = (tmp_path / "step42.md").read_text()
    cells = json.loads((tmp_path / "step42.json").read_text())["cells"]
    assert [c["mesh"] for c in cells] == ["tetrahedra", "hexahedra", "hexahedra of step-42"]
    assert cells[-1]["primal"]["contact_force"] == pytest.approx(37.3058, abs=5e-5)
    monkeypatch.setattr(
        "ngepc.studies.step42.compare_methods", lambda problem: pytest.fail("solved again")
    )
    assert main(arguments) == 0
    assert (tmp_path / "step42.md").read_text() == text
