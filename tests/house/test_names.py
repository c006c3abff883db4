"""Names, docstrings, hints, size: what can be counted about the sources of the package."""

import ast
from collections import Counter

import pytest
from sources import modules, public, public_methods, room

COMMANDS = {"run"}
"""Each command of the command line has it."""

STILL_TWICE: set[str] = set()
"""Public names that two modules have today; this set may only shrink."""


def owners():
    """(module, name, node) for each public class and function outside of classes."""
    for module, tree in modules().items():
        for node in public(tree):
            if not (room(module) == "cli" and node.name in COMMANDS):
                yield module, node.name, node


def documented_things():
    """(full name, node) for public classes, functions and methods."""
    for module, tree in modules().items():
        for node in public(tree):
            yield f"{module}.{node.name}", node
            if isinstance(node, ast.ClassDef):
                for method in public_methods(node):
                    yield f"{module}.{node.name}.{method.name}", method


def missing_hints(function, in_class):
    """Arguments of a function without a hint, 'return' for its value."""
    arguments = function.args
    given = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    static = any(ast.unparse(d) == "staticmethod" for d in function.decorator_list)
    given = given[1:] if in_class and not static else given
    given += [a for a in (arguments.vararg, arguments.kwarg) if a]
    missing = [a.arg for a in given if a.annotation is None]
    return missing + ["return"] * (function.returns is None)


def test_no_public_name_stands_twice():
    count = Counter(name for _, name, _ in owners())
    assert {name for name, times in count.items() if times > 1} == STILL_TWICE


def test_everything_public_is_documented():
    missing = {
        name for name, node in documented_things() if not ast.get_docstring(node)
    }
    assert sorted(missing) == []


def test_everything_public_has_hints():
    missing = set()
    for name, node in documented_things():
        if isinstance(node, ast.FunctionDef):
            in_class = name.rsplit(".", 2)[-2][:1].isupper()
            missing |= {f"{name}: {a}" for a in missing_hints(node, in_class)}
    assert sorted(missing) == []


def test_every_module_says_what_it_is():
    assert [
        name for name, tree in modules().items() if not ast.get_docstring(tree)
    ] == []


def test_the_library_prints_nothing():
    calls = (
        (name, node.lineno)
        for name, tree in modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "print"
    )
    assert list(calls) == []


@pytest.mark.parametrize(
    ("code", "missing"),
    [
        ("def f(a, *, b: int = 1, **c) -> int: ...", ["a", "c"]),
        ("def f(a: int): ...", ["return"]),
        ("def f(a: int, *b: int) -> int: ...", []),
    ],
)
def test_missing_hints_are_seen(code, missing):
    assert missing_hints(ast.parse(code).body[0], False) == missing
