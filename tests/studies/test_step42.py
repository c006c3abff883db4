"""The dual method on the body of deal.II's step-42: it agrees with the primal one."""

import itertools
import json

import pytest
from ngepc.geometries import block, quarter_cube

from ngepc import primal_newton, semismooth_newton
from ngepc.__main__ import main
from ngepc.studies.step42 import WHOLE, compare, relative, step42_problem


def test_quarter_stands_for_the_whole_body():
    """Equal hexahedra are symmetric; on the whole the documentation of step-42 prints 37.3058."""
    whole = primal_newton(step42_problem(block.structured_mesh(8, 8, 8), WHOLE))
    mesh = quarter_cube.mesh(4, 8, grading=0.0, simplices=False)
    quarter = primal_newton(step42_problem(mesh))
    assert whole.contact_force == pytest.approx(37.3058, abs=5e-5)
    assert 4 * quarter.contact_force == pytest.approx(whole.contact_force, rel=1e-10)
    assert 4 * quarter.primal_energy == pytest.approx(whole.primal_energy, rel=1e-10)


@pytest.fixture(scope="module")
def tetrahedra():
    return [compare(step42_problem(quarter_cube.mesh(n))) for n in (4, 6, 8)]


def test_methods_agree_within_regularisation_and_discretisation_error(tetrahedra):
    """Force: the difference is less than the change of the primal value from mesh to mesh."""
    for coarser, record in itertools.pairwise(tetrahedra):
        mesh_change = abs(
            record["primal"]["contact_force"] / coarser["primal"]["contact_force"] - 1
        )
        assert relative(record, "dual", "primal", "contact_force") < 0.4 * mesh_change
    assert relative(tetrahedra[-1], "dual", "primal", "contact_force") < 0.025
    assert tetrahedra[-1]["displacement_difference"] < 0.1


def test_energies_of_the_methods_close_in(tetrahedra):
    gaps = [relative(record, "dual", "primal", "energy") for record in tetrahedra]
    assert max(gaps) < 0.05
    assert gaps[-1] < 0.6 * gaps[-2]


def test_every_run_takes_a_dozen_steps(tetrahedra):
    for record in tetrahedra:
        assert {record[m]["status"] for m in ("primal", "dual")} == {"converged"}
        assert record["primal"]["iterations"] <= 8
        assert record["dual"]["iterations"] <= 14


def test_methods_agree_on_the_cells_of_the_tutorial():
    """One node touches: they differ by less than the third that finer meshes differ from both."""
    problem = step42_problem(quarter_cube.mesh(4, 8, grading=0.0, simplices=False))
    finer = primal_newton(step42_problem(quarter_cube.mesh(8, simplices=False)))
    primal = primal_newton(problem)
    dual = semismooth_newton(problem)
    error = abs(primal.contact_force / finer.contact_force - 1)
    assert abs(dual.contact_force / primal.contact_force - 1) < 0.15 < 0.35 < error


def test_plastic_strain_of_hexahedra_follows_their_bending():
    """With constant plastic strains the force is 37 percent too large on this mesh."""
    problem = step42_problem(quarter_cube.mesh(6, simplices=False))
    dual, primal = semismooth_newton(problem), primal_newton(problem)
    assert dual.plastic_increment.space.ndof == 8 * 5 * problem.mesh.ne
    assert dual.contact_force == pytest.approx(primal.contact_force, rel=0.1)


def test_study_writes_its_table_and_keeps_its_cells(tmp_path, monkeypatch):
    arguments = ["study", "step42", "--levels", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    text = (tmp_path / "step42.md").read_text()
    cells = json.loads((tmp_path / "step42.json").read_text())["cells"]
    assert [c["mesh"] for c in cells] == ["tetrahedra", "hexahedra", "hexahedra of step-42"]
    assert cells[-1]["primal_contact_force"] == pytest.approx(37.3058, abs=5e-5)
    monkeypatch.setattr("ngepc.studies.step42.compare", lambda problem: pytest.fail("solved again"))
    assert main(arguments) == 0
    assert (tmp_path / "step42.md").read_text() == text
