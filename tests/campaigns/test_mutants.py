"""The mutation tool on a module of ten lines, with a weak and a strong test."""

import ast
import shutil
from types import SimpleNamespace

import pytest
from campaigns import mutants
from campaigns.executed import Executed
from campaigns.mutants import Bench, Mutants, verdict
from campaigns.mutations import mutations

MODULE = '''"""A module."""


def pressed(force: float | None, area=2.0, *, most=5):
    """The pressure."""
    if force is None:
        raise ValueError(f"force={1 + 1} is needed")
    pressure = max(force / area + 1, 0)
    check(pressure)
    if pressure > most and area < 3:
        pressure = -pressure
    return pressure
'''
WEAK = "from ngepc.room.ten import pressed\n\n\ndef test_it():\n    pressed(1.0)\n"
STRONG = """import pytest

from ngepc.room.ten import pressed


def test_it():
    assert pressed(4.0) == 3.0


def test_what_is_needed():
    with pytest.raises(ValueError, match="is needed"):
        pressed(None)
"""


def found(kind):
    return {(m.before, m.after) for m in mutations(MODULE) if m.kind == kind}


def test_each_kind_is_found():
    assert {("force / area", "force * area"), ("-pressure", "pressure")} <= found(
        "operator"
    )
    assert ("force / area + 1", "1") in found("dropped term")
    assert found("constant") >= {("2.0", "4.0"), ("5", "6"), ("0", "1")}
    assert found("comparison") >= {("area < 3", "area <= 3"), ("area < 3", "area >= 3")}
    assert ("pressure > most and area < 3", "area < 3") in found("dropped condition")
    assert found("function") == {
        ("max(force / area + 1, 0)", "min(force / area + 1, 0)")
    }
    assert found("removed check") == {
        ("force is None", "False"),
        ("check(pressure)", "pass"),
    }


def test_texts_hints_and_messages_stay():
    """Nor do other lines move, and each mutant is another program."""
    tree = ast.dump(ast.parse(MODULE))
    for mutation in mutations(MODULE):
        text = mutation.apply(MODULE)
        assert ast.dump(ast.parse(text)) != tree
        assert text.count("\n") == MODULE.count("\n")
        assert '"""The pressure."""' in text
        assert "force: float | None" in text
        assert '{1 + 1} is needed"' in text


def test_names_outlive_lines_that_come_before():
    later = MODULE.replace("\n\n\ndef", "\n\nE = 1\n\n\ndef")
    names = [{m.name("room/ten.py") for m in mutations(t)} for t in (MODULE, later)]
    assert names[0] < names[1]


def test_map(tmp_path):
    """Lines that run at import belong to all tests of the file."""
    executed = Executed(tmp_path)
    executed._lines["room/ten.py"] = {4: set(), 8: {"a"}, 9: {"a", "b"}}
    (tmp_path / "all.spent").write_text("2.50 tests/a\n0.10 tests/b[x y]\n")
    assert executed.costs == {"tests/a": 2.5, "tests/b[x y]": 0.1}
    assert executed.tests("room/ten.py", 8, 8) == ["a"]
    assert executed.tests("room/ten.py", 4, 4) == ["a", "b"]
    assert executed.tests("room/ten.py", 11, 11) == []


def test_names_of_tests_may_have_colons():
    name = "tests/room/test_ten.py::test_it[strain: 1]"
    killed = {"verdict": "killed", "why": f"{name}: assert 1: 2"}
    assert mutants.tests_of(killed) == name
    assert mutants.tests_of({"verdict": "killed", "why": "its import: x"}) == ""
    assert mutants.tests_of({"verdict": "survived", "why": f"{name}: x"}) == ""


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A campaign of three mutants whose tests answer as one says, in ``answers``."""
    all_found = {m.name("room/ten.py"): m for m in mutations(MODULE)}
    names = sorted(all_found)[:3]
    study = Mutants(tmp_path)
    study.mutations = {("room/ten.py", name): all_found[name] for name in names}
    study.executed = SimpleNamespace(
        tests=lambda *_: ["tests/room/test_ten.py::test_it"],
        costs={"tests/room/test_ten.py::test_it": 0.1},
    )
    study.reasons = {("room/ten.py", names[2]): "It is the same."}
    study.answers = {name: 0 for name in names}
    of = {mutation: name for name, mutation in all_found.items()}

    def found(module, mutation, tests, seconds):
        code = study.answers[of[mutation]]
        return {"code": code, "seconds": 0.1, "by": tests[0]}

    monkeypatch.setattr(study, "found", found)
    cells = [{"room": "room", "module": "room/ten.py", "mutant": n} for n in names]
    monkeypatch.setattr(study, "cells", lambda: cells)
    return study


def test_both_shares_are_said(study):
    """A mutant that a new test kills survived at first sight, whatever comes after."""
    first, second, _ = study.answers
    study.trusted = True
    assert [r["verdict"] for r in study.run()] == 3 * ["survived"]
    study.again = True
    study.answers[first] = 1
    study.run()
    records = [study.excused(record) for record in study.run()]
    assert [r["first"] for r in records] == 3 * ["survived"]
    assert [r["verdict"] for r in records] == ["killed", "survived", "equivalent"]
    row = ["room", 3, 1, 0, "0 %", 1, "50 %"]
    assert list(mutants.shares("room", records).values()) == row
    row = ["room", 1, 1, 0, "", 0, ""]
    assert list(mutants.shares("room", records[2:]).values()) == row
    study.again = False
    study.answers[second] = 1  # it is not judged any more
    assert [study.excused(record) for record in study.run()] == records
    study.path_of(study.cells()[0]).unlink()
    study.survivors.clear()
    assert study.run()[0]["first"] == "killed"


def test_the_page_has_shares_and_what_is_not_killed(study, tmp_path, monkeypatch):
    """The list of all mutants is a file of its own: the page fits the screen."""
    monkeypatch.setattr(mutants, "ROOMS", ("room",))
    first, *_ = study.answers
    study.answers[first] = 1
    study.trusted = True
    listed, page, _ = study.write(study.run())
    rows = [
        line.split(" | ") for line in page.read_text().splitlines() if line[:1] == "|"
    ]
    assert rows[2] == ["| room", "3", "1", "1", "50 %", "1", "50 % |"]
    assert [row[4] for row in rows[6:]] == ["survived", "equivalent"]
    assert rows[-1][-1] == "It is the same. |"
    assert listed.read_text().count("room/ten.py") == 3


def test_reasons_are_those_of_mutants_of_today(tmp_path):
    """The name of a mutant contains its module, its function and its expression."""
    reasons = Mutants(tmp_path).reasons
    package = mutants.ROOT / "ngepc"
    names = {
        (module, mutation.name(module))
        for module in {module for module, _ in reasons}
        for mutation in mutations((package / module).read_text(encoding="utf-8"))
    }
    assert sorted(reasons.keys() - names) == []


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A project with one module; as regular packages come before others, whatever is installed."""
    room = tmp_path / "ngepc" / "room"
    room.mkdir(parents=True)
    (room.parent / "__init__.py").touch()
    (room / "__init__.py").touch()
    (room / "ten.py").write_text('check = float\nthird = "abc"[2]\n' + MODULE)
    (tmp_path / "tests").mkdir()
    shutil.copytree(
        mutants.ROOT / "tests" / "campaigns", tmp_path / "tests" / "campaigns"
    )
    (tmp_path / "tests" / "test_weak.py").write_text(WEAK)
    (tmp_path / "tests" / "test_strong.py").write_text(STRONG)
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    bench = Bench()
    yield bench
    bench.referee.stdin.close()
    bench.referee.wait()
    shutil.rmtree(bench.folder)


def test_weak_and_strong_tests(bench):
    """A fault in the sum survives one test and is killed by the other; so is a removed check."""
    path = bench.project / "ngepc" / "room" / "ten.py"
    text = path.read_text()
    known = {(m.before, m.after): m for m in mutations(text)}
    weak, strong = ["tests/test_weak.py"], ["tests/test_strong.py"]

    def judged(before, after, tests):
        answer = bench.judge("room/ten.py", known[before, after], tests, 60)
        return verdict(answer)

    bench.answer({"load": [*weak, *strong]})
    assert bench.asked([*weak, *strong], 60)["code"] == 0
    dropped = ("force / area + 1", "force / area")
    assert judged(*dropped, weak)["verdict"] == "survived"
    killed = judged(*dropped, strong)
    assert killed["verdict"] == "killed"
    assert killed["why"].startswith("tests/test_strong.py::test_it: ")
    assert judged("force is None", "False", strong)["verdict"] == "killed"
    assert judged("2.0", "4.0", strong)["verdict"] == "killed"  # imported again
    broken = judged("2", "3", strong)
    why = "its import: IndexError: string index out of range"
    assert broken == {"verdict": "killed", "why": why}
    assert path.read_text() == text


def test_a_fault_that_stops_what_all_tests_import_is_killed(bench):
    """The module itself can be imported."""
    text = (bench.project / "ngepc" / "room" / "ten.py").read_text()
    mutation = next(m for m in mutations(text) if m.before == "2.0")
    conftest = bench.project / "tests" / "conftest.py"
    conftest.write_text(
        "from ngepc.room.ten import pressed\n\nassert pressed(4.0) == 3\n"
    )
    weak = ["tests/test_weak.py"]
    bench.answer({"load": weak})
    killed = verdict(bench.judge("room/ten.py", mutation, weak, 60))
    assert killed["why"].startswith("its import: AssertionError")
