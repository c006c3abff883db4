"""The modules of the package as syntax trees, and who imports whom."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOP_LEVEL = ("geometries", "notebooks")
"""Folders of the project that the package only links to."""


@cache
def modules():
    """Name of a module -> its syntax tree; a room stands for its ``__init__``."""
    found = {}
    for path in sorted((ROOT / "ngepc").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[1] not in TOP_LEVEL:
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


@cache
def nodes():
    """Name of a module -> all nodes of its syntax tree."""
    return {name: list(ast.walk(tree)) for name, tree in modules().items()}


def room(module):
    """The room of a module; '' for the entrance hall, ``ngepc`` itself."""
    parts = module.split(".")
    inner = len(parts) > 2 or ".".join(parts) in rooms()
    return parts[1] if inner else ""


@cache
def rooms():
    """The names of the rooms as modules."""
    names = {".".join(name.split(".")[:2]) for name in modules() if name.count(".") > 1}
    return names | {"ngepc.geometries"}


def imports(inside):
    """Pairs (module, statement) of all modules that are imported by nodes of a tree."""
    for node in inside:
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, (
                f"line {node.lineno}: relative imports hide the room"
            )
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in modules() else node.module, node
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node


@cache
def arrows():
    """Pairs (module, imported module) inside the package, those for type hints included.

    Who imports a module from its room imports the room, with all that it imports itself.
    """
    found = set()
    for name, inside in nodes().items():
        for target, node in imports(inside):
            halls = (
                {node.module} & rooms() if isinstance(node, ast.ImportFrom) else set()
            )
            found |= {(name, t) for t in {target, *halls} if t.split(".")[0] == "ngepc"}
    return found


def circles(edges):
    """Groups of nodes, each of which is reached from all others of its group."""
    after = {}
    for a, b in edges:
        after.setdefault(a, set()).add(b)
    reach = {node: _reached(node, after) for node in after}
    found = {
        frozenset(m for m in reach[node] if node in reach.get(m, ())) | {node}
        for node in after
        if node in reach[node]
    }
    return found


def _reached(node, after):
    seen, left = set(), list(after.get(node, ()))
    while left:
        here = left.pop()
        if here not in seen:
            seen.add(here)
            left += after.get(here, ())
    return seen


def public(tree):
    """The public classes and functions of a module, each once."""
    kinds = ast.ClassDef | ast.FunctionDef
    found = (
        n for n in tree.body if isinstance(n, kinds) and not n.name.startswith("_")
    )
    return [
        n
        for n in found
        if not any(ast.unparse(d) == "overload" for d in n.decorator_list)
    ]


def public_methods(node):
    """The public methods of a class."""
    return [
        n
        for n in node.body
        if isinstance(n, ast.FunctionDef) and not n.name.startswith("_")
    ]
