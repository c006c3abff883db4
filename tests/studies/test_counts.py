"""The count table as a study: resumes, refuses foreign checkpoints, writes what it promises."""

import json

import numpy as np
import pytest

from ngepc.__main__ import main
from ngepc.results import checkpoint
from ngepc.studies.counts import Table1, Table2
from ngepc.studies.examples import coarse_start, nested
from ngepc.studies.paper import TABLE_1

ROWS = ("1e0", "1e1", "1e3", "default", "default*", "primal")


def small_table(folder, **options):
    return Table1(folder, levels=1, rows=ROWS, **options)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table1")
    arguments = ["study", "table1", "--levels", "1", "--rows", ",".join(ROWS)]
    assert main([*arguments, "--out", str(folder)]) == 0
    return folder


def test_study_writes_table_and_figure(finished):
    table = (finished / "table1.md").read_text()
    assert "| 1e0 | 1 (1) |" in table
    assert "](table1_steps.png)\n" in table
    cells = json.loads((finished / "table1.json").read_text())["cells"]
    assert [c["status"] for c in cells] == ["converged"] * len(ROWS)
    assert (finished / "table1_steps.png").stat().st_size > 5000


def test_default_method_needs_a_dozen_steps_and_finds_the_primal_energy(finished):
    cells = json.loads((finished / "table1.json").read_text())["cells"]
    default, nested, primal = (
        next(c for c in cells if c["row"] == row) for row in ROWS[3:]
    )
    assert default["iterations"] <= 12
    assert nested["iterations"] <= default["iterations"]
    for cell in (default, nested):
        assert cell["primal_energy"] == pytest.approx(primal["primal_energy"], rel=0.02)
        assert cell["paper"] is None


def test_second_run_solves_nothing_and_gives_the_same_table(finished, monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("a stored cell was solved again")

    monkeypatch.setattr(Table1, "solve", refuse)
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
    cell = study.cells()[0]
    path = study.path_of(cell)
    path.parent.mkdir()
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(ValueError, match="damaged"):
        study.kept(cell)
    assert path.read_bytes() == b"not a checkpoint"
    path.unlink()
    checkpoint.save(path, {"study": "other"}, {}, {"v": np.zeros(3)})
    with pytest.raises(ValueError, match="other work"):
        study.kept(cell)


def test_starts_are_those_of_the_paper(tmp_path, monkeypatch):
    """From the solution on 417 nodes, with a star from the next coarser mesh, (b) from zero."""
    starts = {}

    def seen(method, problem, start, options):
        starts[method] = start and start.problem.mesh.nv
        raise KeyboardInterrupt

    monkeypatch.setattr("ngepc.studies.counts.solved_by", seen)
    for study, row in ((Table1, "1e1"), (Table1, "default"), (Table2, "1e4")):
        with pytest.raises(KeyboardInterrupt):
            study(tmp_path).solve(row, study(tmp_path).nodes[1])
    assert starts == {"1e1": 417, "default": None, "1e4": None}


def test_nested_iteration_goes_through_all_meshes(monkeypatch):
    result = nested("wrench", "default", 1641)
    before = nested("wrench", "default", 873)
    assert (before.problem.mesh.nv, result.problem.mesh.nv) == (873, 1641)
    seen = []
    monkeypatch.setattr(
        "ngepc.studies.examples.solved_by",
        lambda way, problem, start, options: seen.append((way, start)) or Reached(),
    )
    coarse_start("lshape", "1e5", None)
    assert [way for way, _ in seen] == [1e3, 1e4, 1e5]
    assert seen[0][1] is None
    coarse_start.cache_clear()


class Reached:
    """What stands for a result."""

    def or_interrupted(self):
        return self


def test_rows_that_the_paper_has_and_no_others(tmp_path):
    assert Table1(tmp_path, levels=1).rows == (*TABLE_1, "default")
    with pytest.raises(ValueError, match="the table has 1e0"):
        Table1(tmp_path, rows=("1e7",))
    with pytest.raises(ValueError, match="levels=7"):
        Table1(tmp_path, levels=7)


def test_figures_of_elastic_rows_alone_are_drawn(tmp_path, monkeypatch):
    """Rows that take one step everywhere used to end in an empty picture after the work."""
    drawn = []
    monkeypatch.setattr(
        "ngepc.studies.counts.save_figure", lambda f, path: drawn.append(f)
    )
    study = Table1(tmp_path, levels=1, rows=("1e0",))
    study.draw(study.run())
    (axes,) = drawn[0].axes
    assert list(axes.lines[0].get_ydata()) == [1]


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
