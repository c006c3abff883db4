"""Numbers of the paper's equations and statements: those of a table, each where that says."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "reproduce.md").read_text(encoding="utf-8")
TABLE = TEXT.partition("## Equations and statements")[2]
ROWS = re.findall(r"^\| (.*?) \| .*? \| `(.*?)` \|$", TABLE, re.MULTILINE)

KINDS = "Algorithm|Assumption|Corollary|Definition|Lemma|Proposition|Remark|Theorem"
STATEMENT = re.compile(rf"(?:{KINDS})s? (\d\.\d+)")
EQUATION = re.compile(r"\(([2-7]\.\d+)\)|\\tag\{(\d\.\d+)\}")
NUMBER = re.compile(r"\d\.\d+|D_gamma|OC2_gamma|R[12]")

KNOWN = {number for numbers, _ in ROWS for number in NUMBER.findall(numbers)}


def read(path):
    return path.read_text(encoding="utf-8")


def docstrings(path):
    """The text of a module outside of its code."""
    strings = (
        node.value
        for node in ast.walk(ast.parse(read(path)))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    )
    return "\n".join(strings)


def prose(path):
    """The text of a page without its code."""
    return re.sub(r"```.*?```|`[^`\n]*`", "", read(path), flags=re.DOTALL)


def cited(text):
    """The numbers of equations and statements in a text."""
    equations = {number for pair in EQUATION.findall(text) for number in pair if number}
    return equations | set(STATEMENT.findall(text))


@pytest.mark.parametrize(("numbers", "place"), ROWS)
def test_it_is_where_the_table_says(numbers, place):
    file = next(p for p in (ROOT / place, ROOT / "ngepc" / place) if p.is_file())
    text = read(file)
    for number in NUMBER.findall(numbers):
        assert number in text, (number, place)


def test_every_number_is_one_of_the_table():
    assert len(KNOWN) >= 35
    pages = [*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "method").glob("*.md")]
    texts = {path: prose(path) for path in pages}
    texts |= {path: docstrings(path) for path in (ROOT / "ngepc").rglob("*.py")}
    unknown = {
        path.relative_to(ROOT).as_posix(): sorted(cited(text) - KNOWN)
        for path, text in texts.items()
        if cited(text) - KNOWN
    }
    assert unknown == {}


def test_citations_are_seen():
    assert cited(r"By (2.14) and Lemma 6.3, \tag{6.1}") == {"2.14", "6.3", "6.1"}
    assert cited("x (0.5) of 3.4 in section 7.1") == set()
