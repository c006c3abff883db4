"""The built wheel holds every module, geometries, notebooks and type information included."""

import re
import runpy
import subprocess
import sys
import zipfile
from configparser import ConfigParser
from pathlib import Path

import pytest

import ngepc

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-deps",
        "-w",
        str(folder),
    ]
    subprocess.run([*command, str(ROOT)], check=True, timeout=300)
    return next(folder.glob("ngepc-*.whl"))


def test_wheel_contains_every_module(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    modules = {str(p.relative_to(ROOT)) for p in (ROOT / "ngepc").rglob("*.py")}
    modules |= {
        f"ngepc/geometries/{p.name}" for p in (ROOT / "geometries").glob("*.py")
    }
    data = {"py.typed", "__init__.pyi", "pictures/ngepc.mplstyle", "pictures/page.html"}
    data |= {"notebooks/quizzes.json"}
    assert modules | {f"ngepc/{name}" for name in data} <= names
    notebooks = {
        f"ngepc/{p.relative_to(ROOT).as_posix()}"
        for p in ROOT.glob("notebooks/**/*.ipynb")
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
        [
            sys.executable,
            "-c",
            f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {code}",
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
    )
    assert run.stdout.strip() == "417", run.stderr


def test_a_checkout_is_found_beside_a_folder_of_its_name(tmp_path):
    """Of a checkout "ngepc", a script in the folder around it imports the package."""
    (tmp_path / "ngepc").mkdir()
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
    place = str(tmp_path / "installed")
    subprocess.run(
        [*command, "--target", place, "--editable", str(ROOT)], check=True, timeout=300
    )
    code = (
        f"import site; site.addsitedir({place!r}); import ngepc; print(ngepc.__file__)"
    )
    run = subprocess.run(
        [sys.executable, "-E", "-S", "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
    )
    assert run.stdout.strip() == str(ROOT / "ngepc" / "__init__.py"), run.stderr


def test_conda_recipe_names_what_the_wheel_needs():
    """Rendered as conda does it: one set line and plain substitutions."""
    yaml = pytest.importorskip(
        "yaml", reason="reads the recipe; comes with the extra docs"
    )
    text = (ROOT / "packaging" / "conda" / "meta.yaml").read_text(encoding="utf-8")
    version = re.search(r'set version = "(.+?)"', text)[1]
    plain = re.sub(r"\{%.*?%\}", "", text).replace("{{ version }}", version)
    recipe = yaml.safe_load(plain.replace("{{ PYTHON }}", "python"))
    assert recipe["package"] == {"name": "ngepc", "version": ngepc.__version__}
    setup = ConfigParser()
    setup.read(ROOT / "setup.cfg", encoding="utf-8")
    options = setup["options"]
    needed = {line.replace(">=", " >=") for line in options["install_requires"].split()}
    found = {
        line.replace("matplotlib-base", "matplotlib")
        for line in recipe["requirements"]["run"]
    }
    assert found - needed == {f"python {options['python_requires']}"}
    assert needed <= found
    assert (ROOT / recipe["about"]["license_file"]).is_file()


def test_what_an_index_shows_needs_no_other_file(wheel):
    """An index knows no relative addresses, and its renderer drops pictures that are data."""
    archive = zipfile.ZipFile(wheel)
    (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
    shown = archive.read(name).decode("utf-8").partition("\n\n")[2]
    assert shown.startswith("# ngepc")
    addresses = re.findall(r"\]\(([^)]+)\)", shown)
    assert addresses
    assert all(address.startswith("https://") for address in addresses)
    first_lines = re.search(
        r"```python\n.*?```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL
    )
    assert first_lines[0] in shown


def test_the_paper_has_the_table_of_the_results():
    """``python paper/table.py`` writes it from results/accuracy.json."""
    made = runpy.run_path(str(ROOT / "paper" / "table.py"))
    text = (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
    assert made["with_table"](text) == text
    cited = set(re.findall(r"@([\w-]+)\]", text))
    bib = (ROOT / "paper" / "paper.bib").read_text(encoding="utf-8")
    assert cited == set(re.findall(r"@\w+\{([\w-]+),", bib))


def test_citation_files_agree():
    yaml = pytest.importorskip("yaml", reason="comes with the extra docs")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "citing.md").read_text("utf-8")
    assert citation["version"] == ngepc.__version__
    release = f"## {citation['version']} ({citation['date-released']})"
    assert release in (ROOT / "CHANGELOG.md").read_text("utf-8").splitlines()
    assert f"version = {{{citation['version']}}}" in page
    words = " ".join(page.replace("{Newton}", "Newton").split())
    for title in (citation["title"], citation["references"][0]["title"]):
        assert title in words


def test_binder_and_conda_install_the_package_with_its_notebooks():
    yaml = pytest.importorskip("yaml", reason="comes with the extra docs")
    asked = (ROOT / ".binder" / "requirements.txt").read_text("utf-8").split()
    place = ROOT / "packaging" / "conda" / "environment.yml"
    packages = yaml.safe_load(place.read_text(encoding="utf-8"))["dependencies"]
    (by_pip,) = (p["pip"] for p in packages if isinstance(p, dict))
    setup = ConfigParser()
    setup.read(ROOT / "setup.cfg", encoding="utf-8")
    extras = set(setup["options.extras_require"])
    for line in (*asked, *by_pip):
        wanted = re.search(r"\[(.+)\]", line)[1].split(",")
        assert set(wanted) <= extras
