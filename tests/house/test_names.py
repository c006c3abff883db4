"""Names, docstrings, hints, size: what can be counted about the sources of the package."""

import ast
from collections import Counter
from functools import cache

import pytest
from sources import modules, nodes, public, public_methods, room

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


MOST_LINES = 45
"""Of a function without its docstring: what a screen shows."""

MOST_NESTED = 4
"""Loops, conditions, blocks of ``with`` and ``try`` inside each other."""

MOST_ARGUMENTS = 8
"""Arguments that may be given by position."""


@cache
def functions():
    """(module and name, node) for all functions, inner ones too."""
    return [
        (f"{module}.{node.name}", node)
        for module, inside in nodes().items()
        for node in inside
        if isinstance(node, ast.FunctionDef)
    ]


def lines_of(function):
    """The lines of a function without those of its docstring."""
    text = function.body[0] if ast.get_docstring(function) else None
    documented = 0 if text is None else text.end_lineno - text.lineno + 1
    return function.end_lineno - function.lineno + 1 - documented


def nesting(node):
    """How many blocks of a function stand inside each other; functions in it count alone."""
    blocks = ast.If | ast.For | ast.While | ast.With | ast.Try
    alone = ast.FunctionDef | ast.ClassDef
    lines = ast.stmt | ast.ExceptHandler | ast.match_case
    children = (n for n in ast.iter_child_nodes(node) if isinstance(n, lines))
    inner = (n for n in children if not isinstance(n, alone))
    return max((isinstance(n, blocks) + nesting(n) for n in inner), default=0)


def test_no_function_is_longer_than_a_screen():
    assert {n: lines_of(f) for n, f in functions() if lines_of(f) > MOST_LINES} == {}


def test_no_function_is_nested_deeply():
    assert {n: nesting(f) for n, f in functions() if nesting(f) > MOST_NESTED} == {}


def test_no_function_takes_many_arguments_by_position():
    count = {
        name: len(function.args.posonlyargs) + len(function.args.args)
        for name, function in functions()
    }
    assert {name: k for name, k in count.items() if k > MOST_ARGUMENTS} == {}


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
        for name, inside in nodes().items()
        for node in inside
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


@pytest.mark.parametrize(
    ("code", "lines", "nested"),
    [
        ("def f():\n    '''One.\n\n    Two.\n    '''\n    return 1", 2, 0),
        ("def f():\n    for i in a:\n        if i:\n            g(i)", 4, 2),
        ("def f():\n    if a:\n        def g():\n            if b: c()", 4, 1),
    ],
)
def test_length_and_nesting_are_seen(code, lines, nested):
    function = ast.parse(code).body[0]
    assert (lines_of(function), nesting(function)) == (lines, nested)
