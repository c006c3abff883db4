"""The documentation: its first page runs, its links lead somewhere, every public name is in it."""

import os
import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

import ngepc

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(p for p in (ROOT / "docs").rglob("*.md") if "results" not in p.parts)


def test_first_steps_lead_to_a_picture_and_a_page(tmp_path):
    page = (ROOT / "docs" / "first_steps.md").read_text(encoding="utf-8")
    (tmp_path / "block.py").write_text(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1])
    paths = filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])
    run = subprocess.run(
        [sys.executable, "block.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(paths), "NGS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    assert "Newton steps" in run.stdout
    assert (tmp_path / "block.png").stat().st_size > 10_000
    assert (tmp_path / "block.html").stat().st_size > 100_000


@pytest.mark.parametrize("path", PAGES, ids=lambda p: p.relative_to(ROOT / "docs").as_posix())
def test_links_lead_somewhere(path):
    for target in re.findall(r"\]\(([^)#\s]+?)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
        if target.startswith(("http:", "https:", "ngepc.")):
            continue
        beside = (path.parent / target).resolve()
        in_root = ROOT / beside.relative_to(ROOT / "docs") if "docs" in beside.parts else beside
        assert beside.exists() or in_root.exists(), f"{path.name} links to {target}"


def test_site_builds_without_warnings_and_has_every_public_name(tmp_path):
    pytest.importorskip("myst_nb", reason="needs the extra docs")
    pytest.importorskip("sphinx_book_theme", reason="needs the extra docs")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(ROOT / "docs")]
    run = subprocess.run([*command, str(tmp_path)], capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    pages = [p.read_text(encoding="utf-8") for p in tmp_path.rglob("*.html")]
    assert not [p for p in pages if re.search(r'src="https?:', p)]
    inventory = (tmp_path / "objects.inv").read_bytes().split(b"\n", 4)[4]
    documented = {line.split()[0] for line in zlib.decompress(inventory).decode().splitlines()}
    public = {f"ngepc.{name}" for name in ngepc.__all__ if not name.startswith("_")}
    assert public <= documented
