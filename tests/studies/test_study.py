"""Table 1 as a study: resumes, refuses foreign checkpoints, writes what it promises."""

import json

import numpy as np
import pytest

from ngepc.__main__ import main
from ngepc.results import checkpoint
from ngepc.studies.table1 import Table1
from ngepc.studies.tables import Cell


def small_table(folder, **options):
    return Table1(folder, nodes=(833,), rows=("1e0", "1e1", "1e3"), **options)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table1")
    arguments = ["study", "table1", "--levels", "1", "--rows", "1e0,1e1,1e3", "--figures"]
    assert main([*arguments, "--out", str(folder)]) == 0
    return folder


def test_study_writes_table_and_figures(finished):
    table = (finished / "table1.md").read_text()
    assert "| 1e0 | 1 (1) |" in table
    cells = json.loads((finished / "table1.json").read_text())["cells"]
    assert [c["status"] for c in cells] == ["converged"] * 3
    assert (finished / "lshape.html").stat().st_size > 500_000
    assert len(list(finished.glob("*.png"))) >= 6


def test_second_run_solves_nothing_and_gives_the_same_table(finished, monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("a stored cell was solved again")

    monkeypatch.setattr("ngepc.studies.table1.semismooth_newton", refuse)
    first = json.loads((finished / "table1.json").read_text())["cells"]
    assert [r["dual_energy"] for r in small_table(finished).run()] == [
        r["dual_energy"] for r in first
    ]


def test_interrupted_study_resumes_with_the_same_digits(finished, tmp_path):
    lines = []

    def stop_after_one(line):
        lines.append(line)
        if len(lines) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        small_table(tmp_path, progress=stop_after_one).run()
    resumed = small_table(tmp_path).run()
    whole = json.loads((finished / "table1.json").read_text())["cells"]
    for a, b in zip(resumed, whole, strict=True):
        assert a["dual_energy"] == pytest.approx(b["dual_energy"], rel=1e-12)
        assert a["iterations"] == b["iterations"]


def test_damaged_and_foreign_cells_are_refused_and_kept(tmp_path):
    study = small_table(tmp_path)
    cell = Cell("1e0", 833)
    path = tmp_path / "cells" / f"{cell.name}.npz"
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(ValueError, match="damaged"):
        study.outcome(cell)
    assert path.read_bytes() == b"not a checkpoint"
    path.unlink()
    checkpoint.save(path, {"study": "other"}, {}, {"v": np.zeros(3)})
    with pytest.raises(ValueError, match="other work"):
        study.outcome(cell)


def test_checkpoint_round_trip_and_truncation(tmp_path):
    path = tmp_path / "c.npz"
    assert checkpoint.load(path, {"a": 1}) is None
    checkpoint.save(path, {"a": 1}, {"x": [1.5]}, {"v": np.arange(4.0)})
    back = checkpoint.load(path, {"a": 1})
    assert back.record == {"x": [1.5]}
    assert (back.arrays["v"] == np.arange(4.0)).all()
    whole = path.read_bytes()
    for length in (0, 10, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="damaged"):
            checkpoint.load(path, {"a": 1})


def test_report_of_a_finished_study(finished, tmp_path):
    page = tmp_path / "report.html"
    assert main(["report", str(finished), "--out", str(page)]) == 0
    assert "mesh independence" in page.read_text()
