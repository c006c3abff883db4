"""Names of the package that tests, notebooks, pages and benchmarks take from modules are there."""

import ast
import json
import re
from functools import cache

import pytest
from sources import ROOT, modules, nodes, rooms

FOLDERS = ("tests", "benchmarks", "docs", "notebooks", "packaging")
SNIPPET = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
FROM = re.compile(r"^ *from (ngepc[\w.]*) import (\([^)]*\)|[^\n#]+)", re.MULTILINE)
IMPORT = re.compile(r"^ *import (ngepc[\w.]*)", re.MULTILINE)
STRING = re.compile(r"""(["'])(ngepc(?:\.\w+)+)\1""")
NOT_THERE = {
    f"tests/house/{name}.py"
    for name in ("test_deprecated", "test_imports", "test_rooms")
}
"""Files about names that are gone, or never were."""

STYLE = "ngepc.pictures.ngepc"
"""The style of matplotlib, a file."""


def python_of(path):
    """The code of a file: of a notebook its cells, of a page its snippets."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        return "\n".join(
            "".join(c["source"]) for c in cells if c["cell_type"] == "code"
        )
    return "\n".join(SNIPPET.findall(text)) if path.suffix == ".md" else text


def files():
    """Path from the project -> its code, if that mentions a module of the package."""
    paths = [*ROOT.glob("*.md")]
    for folder in FOLDERS:
        for ending in ("*.py", "*.ipynb", "*.md"):
            paths += (ROOT / folder).rglob(ending)
    for path in sorted(set(paths)):
        name = path.relative_to(ROOT).as_posix()
        code = python_of(path)
        made = name.startswith("docs/notebooks/")  # copies, by the build of the site
        if "ngepc." in code and name not in NOT_THERE and not made:
            yield name, code


@cache
def names_of(module):
    """What stands at the top of a module: definitions, assignments, imports."""
    found = set()
    for node in ast.walk(modules()[module]):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {a.asname or a.name for a in node.names}
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def taken(code):
    """Dotted names that some code imports, or gives as a string, as ``monkeypatch`` needs it."""
    for module, names in FROM.findall(code):
        for name in names.strip("()").replace("\n", " ").split(","):
            if name.strip():
                yield f"{module}.{name.split()[0]}"
    yield from IMPORT.findall(code)
    yield from (name for _, name in STRING.findall(code))


def is_there(name):
    """Whether a dotted name leads to a module of the package, or to a name in one."""
    if name in modules() or name == STYLE:
        return True
    parts = name.split(".")
    for k in range(len(parts) - 1, 1, -1):
        if ".".join(parts[:k]) in modules():
            return parts[k] in names_of(".".join(parts[:k]))
    return False


def checked(name):
    """Whether a name is one of the rooms; those of ``ngepc`` itself are checked elsewhere."""
    parts = name.split(".")
    return parts[0] == "ngepc" and len(parts) > 2 and ".".join(parts[:2]) in modules()


def test_names_that_others_take_are_there():
    missing = {
        (place, name)
        for place, code in files()
        for name in taken(code)
        if checked(name) and not is_there(name)
    }
    assert missing == set()


@pytest.mark.parametrize(
    ("code", "there"),
    [
        ("from ngepc.model.problem import Problem", [True]),
        ("from ngepc.model import problem, nothing", [True, False]),
        ("import ngepc.model.nothing", [False]),
        ("'ngepc.model.problem.Problem.solve'", [True]),
        ("'ngepc.model.problem.nothing'", [False]),
    ],
)
def test_names_that_are_missing_are_seen(code, there):
    found = list(taken(code))
    assert all(map(checked, found))
    assert list(map(is_there, found)) == there


def test_pages_say_where_names_are():
    """`ngepc.pictures.rows`, and '`flat_rows` from `ngepc.pictures.rows`', outside of code."""
    said = re.compile(r"(?:`(\w+)` (?:from|in|of) )?`(ngepc(?:\.\w+)+)`")
    old = {ROOT / "docs" / "versions.md", ROOT / "CHANGELOG.md"}
    pages = {*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - old
    found = [pair for page in pages for pair in said.findall(page.read_text("utf-8"))]
    names = {".".join(filter(None, (module, name))) for name, module in found}
    assert len(names) > 20
    assert [n for n in sorted(names) if checked(n) and not is_there(n)] == []


def test_messages_and_docstrings_name_what_is_there():
    stub = (ROOT / "ngepc" / "__init__.pyi").read_text("utf-8")
    public = set(re.findall(r"import \w+ as (\w+)", stub))
    files = {"mplstyle", "geometries", "notebooks", "__version__"}
    known = public | files | {name.split(".")[1] for name in rooms()}
    said = {
        (place, name)
        for place, inside in nodes().items()
        for node in inside
        if isinstance(node, ast.Constant) and place != "ngepc._deprecated"
        for name in re.findall(r"\bngepc(?:\.\w+)+", str(node.value))
    }
    assert len(said) > 20
    assert [
        (place, name)
        for place, name in sorted(said)
        if not (is_there(name) if checked(name) else name.split(".")[1] in known)
    ] == []
