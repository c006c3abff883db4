"""The built wheel holds every module, geometries, notebooks and type information included."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(folder)]
    subprocess.run([*command, str(ROOT)], check=True, timeout=300)
    return next(folder.glob("ngepc-*.whl"))


def test_wheel_contains_every_module(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    modules = {str(p.relative_to(ROOT)) for p in (ROOT / "ngepc").rglob("*.py")}
    modules |= {f"ngepc/geometries/{p.name}" for p in (ROOT / "geometries").glob("*.py")}
    data = {"py.typed", "__init__.pyi", "pictures/ngepc.mplstyle", "pictures/page.html"}
    assert modules | {f"ngepc/{name}" for name in data} <= names
    notebooks = {
        f"ngepc/{p.relative_to(ROOT).as_posix()}" for p in ROOT.glob("notebooks/**/*.ipynb")
    }
    assert notebooks
    assert notebooks <= names


def test_wheel_works_outside_the_checkout(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path)
    code = (
        "import ngepc; from ngepc.geometries import lshape; "
        f"assert ngepc.__file__.startswith({str(tmp_path)!r}); print(lshape.paper_mesh(417).nv)"
    )
    run = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {code}"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
    )
    assert run.stdout.strip() == "417", run.stderr
