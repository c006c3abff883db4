"""The rooms of the package: what each is, and that imports only ever go downwards."""

import ast

import pytest
from sources import arrows, circles, imports, modules, nodes, room, rooms

FLOORS = (
    ("checks",),
    ("geometries",),
    ("model",),
    ("linalg",),
    ("discretisation",),
    ("results",),
    ("local", "primal", "dual"),
    ("methods",),
    ("bounds",),
    ("goals",),
    ("limit",),
    ("evolution",),
    ("sensitivity",),
    ("bridges",),
    ("pictures",),
    ("studies",),
    ("cli",),
)
"""From the ground up; rooms on one floor do not import each other."""

FLOOR = {name: number for number, names in enumerate(FLOORS) for name in names}
ANYWHERE = {"ngepc._deprecated", "ngepc._version"}
"""What every room may import from the entrance hall; the command line also ``ngepc`` itself."""

STILL_UPWARDS = set()
"""Pairs (module, imported module) that break the rule today; this set may only shrink."""

OPTIONAL = {
    ("ngepc.bridges.functions", "jax"),
    ("ngepc.bridges.functions", "torch"),
    ("ngepc.linalg.conic", "clarabel"),
    ("ngepc.pictures.live", "anywidget"),
    ("ngepc.pictures.live", "traitlets"),
    ("ngepc.pictures.monitors", "IPython.display"),
    ("ngepc.pictures.views", "ngsolve.webgui"),
    ("ngepc.pictures.stills", "pyvista"),
}
"""Imports of what an extra brings, with an error that names the extra."""


def goes_down(a, b):
    """Whether module ``a`` may import ``b``."""
    here, there = room(a), room(b)
    if b in ANYWHERE or here == there or here == "":
        return True
    return here == "cli" if there == "" else FLOOR[there] < FLOOR[here]


def test_every_room_has_its_floor():
    assert {name.split(".")[1] for name in rooms()} <= set(FLOOR)


def test_imports_go_down():
    upwards = {(a, b) for a, b in arrows() if not goes_down(a, b)}
    rule = "import from the module that has the name, in a package above in CONTRIBUTING.md"
    assert upwards == STILL_UPWARDS, rule


def test_the_entrance_hall_is_light():
    """``import ngepc`` knows the rooms by name only."""
    assert {b for a, b in arrows() if a == "ngepc"} == ANYWHERE


def test_no_modules_import_each_other():
    assert circles(arrows()) == set()


STILL_INDIRECT = {
    ("ngepc.bounds.plane", "ngepc.bounds.data", "Displaced"),
    ("ngepc.bounds.plane", "ngepc.bounds.data", "stress_coordinates"),
    ("ngepc.evolution.run", "ngepc.goals.adaptive", "Refinement"),
}
"""(Module, where from, name) of names that come from a third module; this set may only shrink."""


def from_third_modules():
    """(Module, where from, name) of imports of a name that its module imports itself."""
    taken = {
        name: {
            alias.asname or alias.name
            for node in inside
            if isinstance(node, ast.ImportFrom) and node.module.startswith("ngepc")
            for alias in node.names
        }
        for name, inside in nodes().items()
    }
    for name, inside in nodes().items():
        for target, node in imports(inside):
            if isinstance(node, ast.ImportFrom) and target in taken.keys() - rooms():
                names = {alias.name for alias in node.names}
                yield from ((name, target, one) for one in names & taken[target])


def test_names_come_from_the_modules_that_define_them():
    assert set(from_third_modules()) <= STILL_INDIRECT


def in_functions(inside):
    """Modules that nodes of a tree import inside a function."""
    functions = [node for node in inside if isinstance(node, ast.FunctionDef)]
    return [
        target
        for target, node in imports(inside)
        if any(f.lineno <= node.lineno <= f.end_lineno for f in functions)
    ]


def test_imports_stand_at_the_top():
    """The command line, too: ``importlib`` in ``ngepc.__main__`` loads NGSolve after ``--help``."""
    late = {
        (name, target)
        for name, inside in nodes().items()
        for target in in_functions(inside)
    }
    assert late == OPTIONAL


def test_a_room_says_what_it_is():
    for name in sorted(rooms() - {"ngepc.geometries"}):
        first = (ast.get_docstring(modules()[name]) or "").split("\n\n")[0]
        assert first.endswith("."), name
        assert len(first.split()) >= 8, (name, first)
        assert not first.startswith(name.split(".")[1]), (
            "a sentence, not the name again"
        )


MANY = 16
"""More modules than this need a map."""


def modules_of(room):
    """The names of the modules of a room, without the room's."""
    return [n.rpartition(".")[2] for n in modules() if n.startswith(f"{room}.")]


def on_map(text):
    """The names that the list in the docstring of a room gives, '- heading: one, other'."""
    items = " ".join(text.split()).split(" - ")[1:]
    return [name for item in items for name in item.partition(": ")[2].split(", ")]


@pytest.mark.parametrize(
    "room", [r for r in sorted(rooms()) if len(modules_of(r)) > MANY]
)
def test_the_map_of_a_large_room_names_each_of_its_modules(room):
    """What the docstring of ``__init__`` lists, once each; a new module is entered there."""
    listed = on_map(ast.get_docstring(modules()[room]))
    assert sorted(listed) == sorted(modules_of(room))


# The tools themselves: a rule that cannot fail is none


def test_maps_are_read():
    assert on_map("A room.\n\n- doors: one, other,\n  third\n- windows: fourth") == [
        "one",
        "other",
        "third",
        "fourth",
    ]


def test_circles_are_found():
    assert circles({("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")}) == {
        frozenset("abc")
    }
    assert circles({("a", "a"), ("a", "b")}) == {frozenset("a")}
    assert circles({("a", "b"), ("a", "c"), ("b", "c")}) == set()


def test_imports_for_hints_and_in_functions_are_seen():
    code = "if TYPE_CHECKING:\n  from ngepc.cli import work\ndef f():\n  import ngepc.dual.solver"
    inside = list(ast.walk(ast.parse(code)))
    assert [target for target, _ in imports(inside)] == [
        "ngepc.cli.work",
        "ngepc.dual.solver",
    ]
    assert in_functions(inside) == ["ngepc.dual.solver"]
    assert not goes_down("ngepc.model.problem", "ngepc.cli.work")
    assert not goes_down("ngepc.local.newton", "ngepc.primal.result")
    assert not goes_down("ngepc.model.problem", "ngepc.__main__")
    assert not goes_down("ngepc.pictures.curves", "ngepc")
    assert goes_down("ngepc.cli.work", "ngepc.model.problem")


def test_every_slow_place_is_there(request):
    """What ``make check`` leaves out, tests/conftest.py."""
    conftest = next(
        p for p in request.config.pluginmanager.get_plugins() if hasattr(p, "SLOW")
    )
    assert [name for name in conftest.SLOW if not (conftest.HERE / name).exists()] == []
