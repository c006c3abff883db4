"""The comparisons of methods run, converge, and say how far the energies are apart."""

import json

from ngepc.__main__ import main


def test_solvers_study_writes_its_table(tmp_path, capsys):
    assert main(["study", "solvers", "--levels", "1", "--out", str(tmp_path)]) == 0
    cells = json.loads((tmp_path / "solvers.json").read_text())["cells"]
    assert {(c["method"], c["start"]) for c in cells} == {
        (m, s) for m in ("coupled 1e4", "exact", "primal") for s in ("cold", "nested")
    }
    energy = {c["method"]: c["primal_energy"] for c in cells}
    assert abs(energy["exact"] / energy["primal"] - 1) < 0.02
    assert abs(energy["coupled 1e4"] / energy["primal"] - 1) > 0.05
    assert "Which would you choose" in (tmp_path / "solvers.md").read_text()
