"""Messages with a number and what it counts: "1 step", never "1 steps"."""

import ast
import re
from itertools import pairwise

from sources import ROOT, nodes

PLURAL = re.compile(
    r" (?:[a-z]+ ){0,2}(components|corners|elements|entries|facets|files|halvings|iterations"
    r"|measurements|meshes|motions|numbers|points|rows|sides|steps|times|values)\b|.*\w\(s\)"
)
SEVERAL = {
    "N": "2 or 3",
    "len(cells)": "2 or 3",
    "len(x)": "the two of a curve at least",
    "len(recent)": "behind a colon",
    "size": "the unknowns of a mesh",
    "text": "the legal lengths",
    "len(points)": "a part of all points",
    "len(samples)": "a part of all points",
    "mesh.cells": "a column",
    "total": "the nested steps of a study",
    "FEW": "a constant",
    "FORCE": "a constant",
    "MOST_ROWS": "a constant",
    "slender": "300 at least",
    "name": "no number",
}
"""What stands before a plural in messages, and why it is not one."""


def counts(inside):
    """What stands before plurals in the f-strings among the nodes of a program."""
    for node in inside:
        parts = node.values if isinstance(node, ast.JoinedStr) else []
        for number, after in pairwise(parts):
            if not isinstance(number, ast.FormattedValue):
                continue
            if isinstance(after, ast.Constant) and PLURAL.match(after.value):
                yield ast.unparse(number.value)


def programs():
    """Name -> nodes of the syntax tree, those of bodies included."""
    bodies = (ROOT / "geometries").glob("*.py")
    return nodes() | {path.name: nodes_of(path.read_text()) for path in bodies}


def nodes_of(text):
    return list(ast.walk(ast.parse(text)))


def test_numbers_in_messages_agree_with_what_they_count():
    found = {
        (name, number)
        for name, inside in programs().items()
        for number in counts(inside)
        if number not in SEVERAL
    }
    assert not found


def test_disagreements_are_seen():
    said = (
        'f"after {n} steps", f"{n} sampled points", f"{n} rigid motion(s)", f"{n} is"'
    )
    assert list(counts(nodes_of(said))) == ["n", "n", "n"]
