"""The body of deal.II's step-42: its documented number, and both methods on the same meshes."""

import json

import pytest

from ngepc import Status, primal_newton, semismooth_newton
from ngepc.__main__ import main
from ngepc.geometries import block
from ngepc.studies.step42 import WHOLE, equal_cells, multigrid_run, step42_problem

COARSE = {"tetrahedra": (3,), "hexahedra": (3,)}
"""Cells along each edge of the graded quarter."""


def test_quarter_stands_for_the_whole_body():
    """Equal hexahedra are symmetric."""
    whole = primal_newton(step42_problem(block.structured_mesh(4, 4, 4), WHOLE))
    quarter = primal_newton(step42_problem(equal_cells(2)))
    assert whole.contact_force > 0
    assert 4 * quarter.contact_force == pytest.approx(whole.contact_force, rel=1e-10)
    assert 4 * quarter.primal_energy == pytest.approx(whole.primal_energy, rel=1e-10)


def test_multigrid_on_halved_cells_is_the_direct_solver(monkeypatch):
    """Nested, from cells twice as wide."""
    monkeypatch.setattr("ngepc.studies.step42.EQUAL", (3, 6))
    found = multigrid_run(6)
    direct = semismooth_newton(step42_problem(found.problem.mesh)).raise_for_status()
    assert found.status is Status.CONVERGED
    assert found.contact_force == pytest.approx(direct.contact_force, rel=1e-8)
    assert found.primal_energy == pytest.approx(direct.primal_energy, rel=1e-10)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The folder of a study of one level."""
    folder = tmp_path_factory.mktemp("step42")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ngepc.studies.step42.CELLS", COARSE)
        assert main(words(folder)) == 0
    return folder


def words(folder):
    """The command that makes the study in a folder."""
    return ["study", "step42", "--levels", "1", "--out", str(folder)]


def records_of(folder):
    """What the study has written there."""
    return json.loads((folder / "step42.json").read_text())["cells"]


def test_methods_agree_and_every_run_takes_a_dozen_steps(written):
    records = records_of(written)
    for primal, default in zip(records[::2], records[1::2], strict=True):
        assert (primal["method"], default["method"]) == ("primal", "default")
        for key in ("contact_force", "energy", "peak_pressure"):
            assert primal[key] == pytest.approx(default[key], rel=1e-10)
        for record in (primal, default):
            assert record["status"] == "converged"
            assert record["iterations"] <= 14


def test_study_writes_its_table_and_keeps_its_cells(written, monkeypatch):
    text = (written / "step42.md").read_text()
    cells = records_of(written)
    meshes = ["tetrahedra", "hexahedra", "hexahedra of step-42"]
    assert [c["mesh"] for c in cells] == [mesh for mesh in meshes for _ in range(2)]
    assert cells[-1]["contact_force"] == pytest.approx(37.3058, abs=5e-5)
    monkeypatch.setattr("ngepc.studies.step42.CELLS", COARSE)
    monkeypatch.setattr(
        "ngepc.studies.step42.timed", lambda *run: pytest.fail("solved again")
    )
    assert main(words(written)) == 0
    assert (written / "step42.md").read_text() == text
