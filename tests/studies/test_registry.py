"""The registry: every study exists, takes the options it lists, and keeps its own defaults."""

import importlib
import inspect

import pytest

from ngepc.cli.study import STUDIES, all_converged
from ngepc.studies.work import Table, Work


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_takes_its_options(name, tmp_path):
    study = STUDIES[name]
    module, _, kind = study.work.partition(":")
    work = getattr(importlib.import_module(f"ngepc.studies.{module}"), kind)
    assert issubclass(work, Work)
    assert work.name == name
    parameters = inspect.signature(work).parameters
    assert set(study.options) <= set(parameters)
    assert all(parameters[o].default is not inspect.Parameter.empty for o in study.options)
    assert inspect.getdoc(work)


def test_success_looks_at_every_status():
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
