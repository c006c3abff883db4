"""The registry: every study exists, takes the options it lists, and keeps its own defaults."""

import inspect
import json

import pytest

from ngepc.cli.commands import STUDIES, parser
from ngepc.cli.work import study_class
from ngepc.studies import work
from ngepc.studies.locking import Locking
from ngepc.studies.work import Work


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_takes_its_options(name, tmp_path):
    study = study_class(STUDIES[name])
    options = set(vars(parser().parse_args(["study", name])))
    options -= {"command", "study", "out", "quiet", "verbose"}
    assert issubclass(study, Work)
    assert study.name == name
    parameters = inspect.signature(study).parameters
    assert options <= set(parameters), "Command(..., options) and the class must agree"
    assert all(parameters[o].default is not inspect.Parameter.empty for o in options)
    assert inspect.getdoc(study)


def test_success_looks_at_every_status(tmp_path):
    all_converged = Locking(tmp_path).succeeded
    assert all_converged([{"status": "converged", "direct": {"status": "converged"}}])
    assert not all_converged(
        [{"status": "converged", "direct": {"status": "stagnated"}}]
    )
    assert not all_converged(
        [{"primal": {"status": "converged"}, "dual": {"status": "stopped"}}]
    )


class Bars(Work):
    """A study whose names and records need care."""

    name, title, note, columns = "t", "T", "note", "|u| = {a}|b | none = {missing:.3f}"

    def cells(self):
        return [{"a": 1}, {"a": "1/2*"}]

    def solve(self, a):
        return [{"list": [1.5, None], "deep": {"x": 2}, "left out": [{"y": 3}]}]


def test_tables_escape_bars_and_flatten_records(tmp_path):
    study = Bars(tmp_path / "new")
    csv, markdown, data = study.write(study.run())
    assert csv.read_text().startswith("a,list,deep_x\n1,1.5 ,2\n")
    assert "| \\|u\\| | none |\n| --- | --- |\n| 1\\|b |  |" in markdown.read_text()
    assert '"left out"' in data.read_text()


def test_a_list_in_the_notes_ends_before_that_of_versions(tmp_path, monkeypatch):
    """Markdown makes one list of two that only an empty line separates."""
    monkeypatch.setattr(Bars, "note", "Failures:\n\n- the second")
    _, markdown, _ = Bars(tmp_path).write([{"a": 1}])
    page = markdown.read_text()
    assert "- the second\n\nMade with:\n\n- version: " in page


def test_a_cell_is_solved_once(tmp_path, monkeypatch):
    first = Bars(tmp_path).run()
    assert {path.name for path in (tmp_path / "cells").iterdir()} == {
        "t-1.npz",
        "t-1_2_.npz",
    }
    monkeypatch.setattr(Bars, "solve", lambda self, a: pytest.fail("solved again"))
    assert Bars(tmp_path).run() == first


def test_a_cell_of_other_code_is_solved_again(tmp_path, monkeypatch):
    """What a table says is what the code does whose commit it records."""
    monkeypatch.setattr(Bars, "code", "before")
    Bars(tmp_path).run()
    monkeypatch.undo()
    solved = []
    monkeypatch.setattr(Bars, "solve", lambda self, a: solved.append(a) or {"x": 1})
    for _ in range(2):
        assert [record["x"] for record in Bars(tmp_path).run()] == [1, 1]
    assert solved == [1, "1/2*"]


def test_the_code_of_a_study_is_the_package_and_its_own_folder(tmp_path):
    assert Bars(tmp_path).code == Bars(tmp_path).code != Locking(tmp_path).code


@pytest.mark.parametrize("changed", [False, True])
def test_a_table_records_the_commit_at_the_start(changed, tmp_path, monkeypatch):
    """Commits that come during the run change nothing; code that changes is said and marked."""
    said = []
    study = Bars(tmp_path, progress=said.append)
    monkeypatch.setattr(work, "commit", lambda: "begun")
    records = study.run()
    del said[:]
    monkeypatch.setattr(work, "commit", lambda: "later")
    if changed:
        monkeypatch.setattr(Bars, "code_today", lambda self: "other")
    data = json.loads(study.write(records)[-1].read_text())
    assert data["commit"] == ("begun+" if changed else "begun")
    assert said == ["code was changed during the run: begun gets a +"] * changed


def test_a_cell_of_other_work_is_refused(tmp_path):
    study = Bars(tmp_path)
    study.run()
    study.path_of({"a": 1}).rename(study.path_of({"a": 2}))
    with pytest.raises(ValueError, match="a differs; move it away"):
        study.kept({"a": 2})
