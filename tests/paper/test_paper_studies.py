"""Small instances of the studies of Tables 2 and 3, Figures 2 to 6 and duality."""

import json
from dataclasses import replace

import pytest

from ngepc import lshape_problem, semismooth_newton, wrench_problem
from ngepc.__main__ import main
from ngepc.geometries import lshape, wrench
from ngepc.studies import paths
from ngepc.studies.convergence import Figure4, convergence_quotients
from ngepc.studies.counts import Table2
from ngepc.studies.paths import PATHS, Duality, Figures, Table3


def test_table2_resumes_and_writes_both_counts(tmp_path):
    first = Table2(tmp_path, 1, ("1e1",)).run()
    lines = []
    study = Table2(tmp_path, 1, ("1e1", "1e3"), progress=lines.append)
    table = study.run()
    assert table[0] == first[0]
    assert [r["iterations"] for r in table] == [2, pytest.approx(13, abs=3)]
    assert len(lines) == 2
    written = study.write(table)
    assert [path.name for path in written] == [
        *("table2.csv", "table2.md", "table2.json", "table2_steps.png")
    ]
    assert "2 (2)" in (tmp_path / "table2.md").read_text()
    assert json.loads((tmp_path / "table2.json").read_text())["cells"][1]["paper"] == 12
    with pytest.raises(ValueError, match="rows"):
        Table2(tmp_path, 1, ("1e9",))


def test_table3_compares_path_and_direct_solve(tmp_path, monkeypatch):
    monkeypatch.setattr("ngepc.studies.paths.FAMILIES", {"wrench": (245,)})
    study = Table3(tmp_path, levels=1)
    table = study.run()
    record = table[0]
    assert record["status"] == record["direct"]["status"] == "converged"
    assert record["changes"][-1] < record["outer_bound"] <= record["changes"][-2]
    assert record["direct"]["path_value"] == pytest.approx(
        record["path_values"][-1], rel=0.02
    )
    assert Table3(tmp_path, levels=1).run() == table
    study.write(table)
    assert "directly" in (tmp_path / "table3.md").read_text()


def test_figures_command_draws_and_reports_them(tmp_path, quickly_drawn):
    command = ["study", "figures", "--lshape-nodes", "33", "--wrench-nodes", "75"]
    assert main([*command, "--out", str(tmp_path)]) == 0
    for number in (2, 3, 5, 6):
        assert (tmp_path / f"figure{number}.png").read_bytes().startswith(b"\x89PNG")
    cells = json.loads((tmp_path / "figures.json").read_text())["cells"]
    assert [cell["figure"] for cell in cells] == [2, 3, 5, 6]
    assert all(0 < cell["zone_area"] < cell["body_area"] for cell in cells)


def test_paths_of_the_figures_end_where_the_captions_say():
    assert PATHS["wrench"].gamma_end == pytest.approx(8.24e6, rel=1e-3)
    assert PATHS["lshape"].gamma_end == pytest.approx(1.2e9, rel=0.02)
    with pytest.raises(ValueError, match="nodes=5"):
        Figures("out", lshape_nodes=5).cells()


def test_quotients_fall_superlinearly():
    problem = wrench_problem(wrench.paper_mesh(245))
    found = convergence_quotients(problem, 1e3)
    assert found["iterations"] == semismooth_newton(problem, 1e3).iterations
    assert found["reference_residual"] < 1e-14
    assert len(found["quotients"]) == 5
    sound = [
        q
        for q, good in zip(found["quotients"], found["meaningful"], strict=True)
        if good
    ]
    assert len(sound) >= 3
    assert sound[-1] < 0.1 * sound[0]
    assert found["distances"][-1] < 1e-6 * found["distances"][0]


def test_quotients_below_rounding_are_marked():
    """One step solves the elastic problem: what follows is rounding."""
    found = convergence_quotients(lshape_problem(lshape.paper_mesh(33)), 1.0)
    assert found["iterations"] == 1
    assert len(found["quotients"]) == 1
    assert found["rounding"] < 1e-10 * found["distances"][0]


def test_figure4_study(tmp_path, monkeypatch, quickly_drawn):
    monkeypatch.setattr("ngepc.studies.convergence.coarse_start", lambda *_: None)
    small = {"lshape": (113,), "wrench": (123,)}
    monkeypatch.setattr("ngepc.studies.convergence.FAMILIES", small)
    study = Figure4(tmp_path, levels=1)
    table = study.run()
    names = [path.name for path in study.write(table)]
    assert names == ["figure4.csv", "figure4.md", "figure4.json", "figure4.png"]
    assert [r["body"] for r in table] == ["lshape", "wrench"]
    with pytest.raises(ValueError, match="levels"):
        Figure4(tmp_path, 7).run()


def test_duality_study_has_a_record_for_each_gamma(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "BY_TENS", replace(paths.BY_TENS, gamma_end=1e4))
    study = Duality(tmp_path, lshape_nodes=33, wrench_nodes=75)
    table = [r for r in study.run() if r["body"] == "wrench"]
    assert [r["gamma"] for r in table] == [10, 100, 1000, 10000]
    assert table[-1]["tichonov"] < table[0]["tichonov"]
    for r in table:
        parts = (
            "contact_term",
            "plastic_term",
            "contact_penalty",
            "plastic_penalty",
            "tichonov",
        )
        assert r["gap"] == pytest.approx(sum(r[part] for part in parts), rel=1e-8)
