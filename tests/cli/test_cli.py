"""The command line: JSON on standard output, exit statuses, one-line errors."""

import json
import subprocess
import sys
import time

import pytest

from ngepc.__main__ import main

KEYS = {
    "problem", "nodes", "triangles", "gamma", "status", "iterations", "dual_energy",
    "primal_energy", "residual_norm", "residual_norms", "step_lengths", "contact_force",
    "displacement_l2", "plastic_strain_l2", "wall_time_s", "version",
}  # fmt: skip


def test_solve_prints_one_json_object(capsys):
    assert main(["solve", "lshape", "--nodes", "113", "--gamma", "1e3", "--json", "-"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert set(record) >= KEYS
    assert (record["problem"], record["nodes"], record["triangles"]) == ("lshape", 113, 192)
    assert record["status"] == "converged"
    assert len(record["residual_norms"]) == record["iterations"] + 1
    assert len(record["step_lengths"]) == record["iterations"]
    assert record["contact_force"] > 0


def test_not_converged_is_exit_status_1_with_the_json_written(tmp_path, capsys):
    target = tmp_path / "new" / "result.json"
    arguments = ["solve", "lshape", "--nodes", "113", "--max-iterations", "2"]
    assert main([*arguments, "--json", str(target)]) == 1
    assert json.loads(target.read_text())["status"] == "iteration_limit"


def test_solve_starts_from_the_coarse_mesh(capsys):
    assert main(["solve", "lshape", "--gamma", "10", "--start", "coarse", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["iterations"] == 1


def test_csg_mesh_has_a_similar_energy(capsys):
    energies = []
    for mesh in (["--nodes", "417"], ["--maxh", "0.03"]):
        assert main(["solve", "lshape", *mesh, "--gamma", "1e3", "--json", "-"]) == 0
        energies.append(json.loads(capsys.readouterr().out)["dual_energy"])
    assert energies[1] == pytest.approx(energies[0], rel=0.04)  # both are first-order in h


def test_figures_are_written(tmp_path, capsys):
    arguments = ["solve", "lshape", "--nodes", "113", "--gamma", "1e3", "--figures", str(tmp_path)]
    assert main(arguments) == 0
    names = {path.name for path in tmp_path.glob("*.png")}
    assert {"lshape_plastic_strain.png", "lshape_yield_function.png"} <= names


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve", "lshap"], "lshape"),
        (["solv", "lshape"], "solve"),
        (["solve", "lshape", "--nodes", "800"], "it has"),
        (["solve", "lshape", "--gamma", "-1"], "> 0"),
        (["solve", "lshape", "--gamma", "nan"], "> 0"),
        (["solve", "lshape", "--tolerance", "0"], "> 0"),
        (["solve", "lshape", "--nodes", "833", "--maxh", "0.1"], "not allowed"),
        (["solve", "lshape", "--start", "warm"], "coarse"),
        (["study", "table9"], "table1"),
        (["solve", "lshape", "--method", "primal", "--gamma", "3"], "no regularisation"),
        (["study", "table1", "--levels", "7"], "1 to 6"),
        (["study", "table1", "--rows", "1e7"], "1e0"),
    ],
)
def test_bad_usage_is_one_line_and_exit_status_2(arguments, message, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(arguments)
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    assert message in captured.err.splitlines()[-1]
    assert "Traceback" not in captured.err


def test_unwritable_target_fails_before_the_work(tmp_path, capsys):
    begin = time.perf_counter()
    assert main(["solve", "lshape", "--nodes", "24833", "--json", str(tmp_path)]) == 2
    assert time.perf_counter() - begin < 5
    assert "folder" in capsys.readouterr().err


def test_help_does_not_wait_for_ngsolve():
    code = "import sys, ngepc.__main__ as m; m.parser(); print('ngsolve' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"


@pytest.mark.parametrize(
    "choice", [["--method", "primal"], [], ["--gamma", "1e4", "--start", "coarse"]]
)
def test_methods_agree_on_the_primal_energy(choice, capsys):
    assert main(["solve", "lshape", "--nodes", "833", *choice, "--json", "-"]) == 0
    record = json.loads(capsys.readouterr().out)
    if "coarse" not in choice:  # the coupled gamma = 1e4 is far from the limit
        assert record["primal_energy"] == pytest.approx(-0.3753, rel=0.02)
    assert record["contact_force"] > 2


@pytest.mark.parametrize("method", ["dual", "primal"])
def test_saved_run_becomes_a_report(method, tmp_path, capsys):
    saved, page = tmp_path / "run.npz", tmp_path / "pages" / "run.html"
    gamma = ["--gamma", "1e3"] if method == "dual" else []
    arguments = ["solve", "lshape", "--nodes", "113", "--method", method, *gamma]
    assert main([*arguments, "--save", str(saved)]) == 0
    assert main(["report", str(saved), "--out", str(page)]) == 0
    text = page.read_text()
    assert "contact force" in text
    assert text.count("data:image/png") >= 5


def test_report_refuses_what_is_no_run(tmp_path, capsys):
    other = tmp_path / "other.npz"
    other.write_bytes(b"something")
    for path, message in ((other, "damaged"), (tmp_path / "none.npz", "no such run")):
        assert main(["report", str(path)]) == 2
        assert message in capsys.readouterr().err
    assert main(["report", str(tmp_path)]) == 2
    assert "no table1.json" in capsys.readouterr().err
