"""The public surface: every name exists, says what it is, and is seen by static tools."""

import inspect
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import ngepc

ROOT = Path(__file__).resolve().parents[2]


def outside(code: str, folder: Path) -> str:
    """What a fresh interpreter prints, started away from the checkout."""
    command = [
        sys.executable,
        "-c",
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}",
    ]
    run = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=folder
    )
    return run.stdout.strip()


def test_public_names_are_documented():
    for name in sorted(set(ngepc.__all__) - {"__version__"}):
        value = getattr(ngepc, name)
        assert inspect.getdoc(value), name
        if inspect.isfunction(value):
            signature = inspect.signature(value)
            assert signature.return_annotation is not inspect.Signature.empty, name
            for parameter in signature.parameters.values():
                hint = parameter.annotation
                assert hint is not inspect.Parameter.empty, (name, parameter.name)


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        ngepc.Nothing  # noqa: B018


@pytest.mark.parametrize(
    "name", ["DualParameters", "Fractional", "augmented_lagrangian"]
)
def test_names_that_are_gone_say_what_to_take(name):
    with pytest.raises(AttributeError, match=f"no attribute '{name}', it is gone: "):
        getattr(ngepc, name)


def test_modules_are_attributes_without_an_import(tmp_path):
    code = "import ngepc; print(ngepc.obstacles.Sphere.__name__, ngepc.geometries.__name__)"
    assert outside(code, tmp_path) == "Sphere ngepc.geometries"


def test_import_loads_nothing_heavy(tmp_path):
    code = (
        "import ngepc; heavy = {'ngsolve', 'numpy', 'scipy', 'matplotlib'}; "
        "print(len(heavy & set(sys.modules)), len(ngepc.__path__))"
    )
    assert outside(code, tmp_path) == "0 1"


EXTENDING = """
import ngepc
from ngepc.linalg.linesearch import Descent, Step
from ngepc.results.outcome import IterationRecord
from ngepc.studies.work import Work


class Half:
    def search(self, phi: Descent) -> Step | None:
        return Step(length=0.5, energy=phi.energy(0.5), halvings=1)


class Orders(Work):
    name = "orders"
    columns = "order = {order} | J = {energy:.6f}"

    def cells(self) -> list[dict[str, int]]:
        return [{"order": 1}, {"order": 2}]

    def solve(self, order: int) -> dict[str, float]:
        return {"energy": 1.0 / order}


def watch(record: IterationRecord) -> None:
    if record.snapshot is not None:
        print(record.residual_norm, record.snapshot().contact_force)


ngepc.semismooth_newton(
    problem, 1e3, options=ngepc.NewtonOptions(linesearch=Half()), monitor=watch
)
"""
"""A line search, a study and a monitor of a user, with types."""


def users_script(folder: Path, more: str = "") -> Path:
    """The first lines of the README as a user's script."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first_lines = re.search(r"```python\n(.*?)```", readme, re.DOTALL)[1]
    (folder / "script.py").write_text(first_lines + more)
    return folder / "script.py"


def test_a_users_script_has_types(tmp_path):
    """Mypy reads it beside the package; what it finds in unchanged files it keeps in out.

    It does without the stubs of numpy and matplotlib; pyright reads them below.
    """
    pytest.importorskip("mypy", reason="mypy reads the script (extra 'test')")
    asked = "reveal_type(ngepc.Material)\nreveal_type(ngepc.obstacles.Sphere)\n"
    asked += "reveal_type(result.iterations)\n"
    users_script(tmp_path, EXTENDING + asked)
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--follow-imports=silent",
        "--no-site-packages",
        "script.py",
    ]
    run = subprocess.run(
        [*command, "--cache-dir", str(ROOT / "out" / "mypy")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"MYPYPATH": str(ROOT), "PATH": ""},
        check=False,
    )
    assert run.returncode == 0, run.stdout
    assert re.search(r'-> ngepc\.model\.material\.Material"', run.stdout), run.stdout
    assert re.search(r'ngepc\.model\.obstacles\.Sphere"', run.stdout), run.stdout
    assert 'Revealed type is "int"' in run.stdout.replace("builtins.", "")


def test_pyright_finds_nothing_in_a_users_script(tmp_path):
    """And sees a wrong argument; basedpyright is pyright as pip installs it."""
    pytest.importorskip(
        "basedpyright", reason="pyright reads the script (extra 'test')"
    )
    settings = {
        "typeCheckingMode": "standard",
        "extraPaths": [str(ROOT)],
        "include": ["."],
    }
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    users_script(tmp_path)
    wrong = "import ngepc\n\nngepc.NewtonOptions(tolerance='small')\n"
    (tmp_path / "wrong.py").write_text(wrong)
    command = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable]
    run = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, check=False
    )
    errors = [
        line
        for line in run.stdout.splitlines()
        if ": error: " in line or " - error: " in line
    ]
    assert len(errors) == 1, run.stdout
    assert "wrong.py:3" in errors[0]
    assert "reportArgumentType" in run.stdout
