"""The comparisons of methods run, converge, and say how far the energies are apart."""

import json

from ngepc.__main__ import main
from ngepc.studies.balanced import REGULARISATIONS


def test_solvers_study_writes_its_table(tmp_path, capsys):
    assert main(["study", "solvers", "--levels", "1", "--out", str(tmp_path)]) == 0
    cells = json.loads((tmp_path / "solvers.json").read_text())["cells"]
    assert {(c["method"], c["start"]) for c in cells} == {
        (m, s) for m in ("coupled 1e4", "balanced", "primal") for s in ("cold", "nested")
    }
    energy = {c["method"]: c["primal_energy"] for c in cells}
    assert abs(energy["balanced"] / energy["primal"] - 1) < 0.02
    assert abs(energy["coupled 1e4"] / energy["primal"] - 1) > 0.05
    assert "Which would you choose" in (tmp_path / "solvers.md").read_text()


def test_balanced_study_counts_cold_and_nested(tmp_path, capsys):
    assert main(["study", "balanced", "--levels", "2", "--out", str(tmp_path)]) == 0
    cells = json.loads((tmp_path / "balanced.json").read_text())["cells"]
    assert {(c["example"], c["regularisation"], c["start"]) for c in cells} == {
        (e, r, s) for e in ("(a)", "(b)") for r in REGULARISATIONS for s in ("cold", "nested")
    }
    assert max(c["iterations"] for c in cells if c["example"] == "(a)") <= 15
    assert max(c["iterations"] for c in cells if c["example"] == "(b)") <= 12
    energies = {}
    for c in cells:
        energies.setdefault((c["example"], c["regularisation"], c["nodes"]), []).append(
            c["dual_energy"]
        )
    for cold, nested in energies.values():
        assert abs(nested / cold - 1) < 1e-8
    assert "| (b), nodes | 873 | 1641 |" in (tmp_path / "balanced.md").read_text()
