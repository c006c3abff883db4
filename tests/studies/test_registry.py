"""The registry: every study exists, takes the options it lists, and keeps its own defaults."""

import inspect

import pytest

from ngepc.cli.commands import STUDIES, keyword
from ngepc.cli.study import study_class
from ngepc.studies.locking import Locking
from ngepc.studies.work import Table, Work


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_takes_its_options(name, tmp_path):
    work, options = study_class(STUDIES[name]), set(map(keyword, STUDIES[name].options))
    assert issubclass(work, Work)
    assert work.name == name
    parameters = inspect.signature(work).parameters
    assert options <= set(parameters)
    assert all(parameters[o].default is not inspect.Parameter.empty for o in options)
    assert inspect.getdoc(work)


def test_success_looks_at_every_status(tmp_path):
    all_converged = Locking(tmp_path).succeeded
    assert all_converged([{"status": "converged", "direct_status": "converged"}])
    assert not all_converged([{"status": "converged", "direct_status": "stagnated"}])
    assert not all_converged([{"primal": {"status": "converged"}, "dual": {"status": "stopped"}}])


def test_tables_escape_bars_and_flatten_records(tmp_path):
    cells = [{"a": 1, "list": [1.5, None], "deep": {"x": 2}, "left out": [{"y": 3}]}]
    table = Table(name="t", title="T", head=["|u|"], rows=[["a|b"]], notes=["note"], cells=cells)
    csv, markdown, json = table.write(tmp_path / "new")
    assert csv.read_text() == "a,list,deep_x\n1,1.5 ,2\n"
    assert r"| \|u\| |" in markdown.read_text()
    assert r"| a\|b |" in markdown.read_text()
    assert '"left out"' in json.read_text()
