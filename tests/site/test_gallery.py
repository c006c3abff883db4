"""Every script of the gallery runs, checks itself, prints one line and draws one picture."""

import importlib
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from drawing import leave_out_layout
from matplotlib.image import imread

GALLERY = Path(__file__).resolve().parents[2] / "docs" / "gallery"
NO_SCRIPTS = ("shared", "pressed_shell")
SCRIPTS = sorted(p.stem for p in GALLERY.glob("*.py") if p.stem not in NO_SCRIPTS)


@pytest.fixture
def script(monkeypatch):
    """Import a script as it is found when it runs: with its folder on the path."""
    monkeypatch.syspath_prepend(str(GALLERY))
    yield importlib.import_module
    for name in (*SCRIPTS, *NO_SCRIPTS):
        sys.modules.pop(name, None)


def test_the_gallery_has_the_problems_it_promises():
    assert set(SCRIPTS) >= {
        "calibration",
        "cook",
        "hertz",
        "holed_plate",
        "indentation",
        "pressed_ring",
        "wrench_turns",
    }


def test_scripts_are_as_short_as_the_page_says():
    page = (GALLERY.parent / "gallery.md").read_text(encoding="utf-8")
    assert "a script of less than a hundred lines" in page
    for name in SCRIPTS:
        lines = (GALLERY / f"{name}.py").read_text(encoding="utf-8").splitlines()
        assert len(lines) < 100, name


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_checks_itself(name, script, tmp_path, request, monkeypatch):
    leave_out_layout(monkeypatch)
    if name == "indentation":
        request.getfixturevalue("draws_solids")
    line = script(name).main(tmp_path, coarse=True)
    assert "\n" not in line
    assert any(sign.isdigit() for sign in line)
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.png"]
    picture = imread(tmp_path / f"{name}.png")[..., :3]
    assert min(picture.shape[:2]) > 300
    ink = np.mean(picture.min(axis=2) < 0.95)
    assert 0.05 < ink < 0.9


def test_a_script_runs_from_the_command_line(script, tmp_path, monkeypatch, capsys):
    """With its folder on the path, as Python puts it there."""
    arguments = ["cook.py", "--coarse", "--out", str(tmp_path / "new")]
    monkeypatch.setattr(sys, "argv", arguments)
    runpy.run_path(str(GALLERY / "cook.py"), run_name="__main__")
    assert capsys.readouterr().out.startswith("cook: elastic tip ")
    assert (tmp_path / "new" / "cook.png").stat().st_size > 10_000


def test_a_check_that_fails_says_what(script):
    check = script("shared").check
    assert check("force", 1.01, 1.0, 0.02) == "force 1.01 (1)"
    with pytest.raises(AssertionError, match=r"force 1.1 \(1\): more than 2.0% apart"):
        check("force", 1.1, 1.0, 0.02)
