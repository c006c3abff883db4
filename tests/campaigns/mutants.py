"""Mutation testing: faults put into the package, and the tests that notice them.

A cell is one mutation of one line (``campaigns.mutations``), drawn at random, with a given number
in each room.  Tests that execute the line run on a copy of the project with that fault
(``campaigns.executed``, ``campaigns.referee``): one that fails kills it, and so does a process that
crashes, or that does not end in time.  A line that no test executes leaves a survivor.

The map of tests and lines is a folder, made where there is none; it has to be removed when lines
have moved.  Cells that were judged are kept, ``--again`` tries those that survived once more, after
tests have been written, ``--judged`` shows what there is.  The table has both shares: at first
sight, which says what to expect of another draw, and now.

``survivors.json`` beside this file says of a survivor why no test can or need notice it.
"""

import atexit
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from campaigns.executed import Executed, made
from campaigns.mutations import mutations
from campaigns.referee import TIMEOUT

from ngepc.studies.work import Work, in_markdown

ROOT = Path(__file__).resolve().parents[2]
REASONS = Path(__file__).with_name("survivors.json")
ROOMS = (
    "checks",
    "model",
    "linalg",
    "discretisation",
    "results",
    "local",
    "primal",
    "dual",
    "methods",
    "bounds",
    "goals",
    "limit",
    "evolution",
    "sensitivity",
    "bridges",
    "pictures",
    "studies",
    "cli",
)
ELSEWHERE = "local/petsc.py"  # its tests need another Python
PLACES = re.compile(r"(?<![\w.])/[\w.-]+(?:/[\w.-]+)+")  # folders of this machine
KILLER = re.compile(r"tests/\S+\.py::\w+(?:\[.*?\])?(?=: )")  # at the begin of a reason
LEAST = 10  # mutants of each room
MORE = 5
GRACE = 10  # seconds of work beyond what the tests cost without a mutation
KEPT = ("ngepc", "geometries", "notebooks", "tests", "docs", "benchmarks", "results")
NOTE = (
    "Each mutant is the package with one fault. Tests that execute the changed line run until one "
    "fails, those of the same package first, as many as take {study.seconds:g} s together. A "
    "mutant survives if no test executes the line or no test fails. It is equivalent if no user "
    "can notice it; the second table gives the reason. Shares: killed over all that are not "
    "equivalent, at first sight and now. Between the two, tests were written for survivors of this "
    "draw, so that the first is what to expect of another draw (--seed). The package is that of "
    "the commit below, with the names that modules had there; these tests are newer. "
    "{study.elsewhere} is not included: make test-petsc tests it where PETSc is installed. "
    "mutants.csv lists every mutant and the test that kills it. Not killed:"
)


@dataclass(eq=False)
class Mutants(Work):
    """The campaign.

    Parameters
    ----------
    count, seed
        How many mutants, and which.
    rows
        The rooms that are judged now; None for all.
    map
        The folder that says which tests execute a line.
    seconds
        The tests of one mutant cost at most that together, the cheapest are taken; a fifth of it
        where the mutant is known as equivalent.
    again
        Whether survivors that are not equivalent are tried once more.
    judged
        Whether to show those alone that have been judged already.
    trusted
        Whether the tests that have killed need not pass once more without a mutation.
    """

    count: int = 320
    seed: int = 1
    rows: Sequence[str] | None = None
    map: Path = Path("out/map")
    seconds: float = 20.0
    again: bool = False
    judged: bool = False
    trusted: bool = False

    name, title = "mutants", "Faults that tests detect"
    columns = (
        "package = {room} | mutants = {mutants} | equivalent = {equivalent} "
        "| killed at first = {first} | share = {first share} | killed now = {verdict} "
        "| share = {verdict share}"
    )
    note = NOTE
    elsewhere = ELSEWHERE

    def cells(self):
        """The mutants, room by room, in an order that other lines do not change."""
        found = []
        for room in self.rows or ROOMS:
            drawn = self.drawn[room][: self.shares[room]]
            found += [
                {"room": room, "module": module, "mutant": name}
                for name, module in drawn
            ]
        if not self.judged:
            return found
        kept = [cell for cell in found if self.path_of(cell).exists()]
        if not kept:
            raise ValueError(f"judged=True: no mutant has been judged in {self.folder}")
        return kept

    @cached_property
    def mutations(self):
        """(Module, name) -> mutation, of all rooms."""
        found = {}
        for room in ROOMS:
            for path in sorted((ROOT / "ngepc" / room).glob("*.py")):
                module = f"{room}/{path.name}"
                if module == ELSEWHERE:
                    continue
                for mutation in mutations(path.read_text(encoding="utf-8")):
                    found[module, mutation.name(module)] = mutation
        return found

    @cached_property
    def drawn(self):
        """Room -> (name, module) of all its mutations, shuffled."""
        rooms = defaultdict(list)
        for module, name in self.mutations:
            rooms[module.partition("/")[0]].append((name, module))
        return {room: sorted(rooms[room], key=self.lot) for room in ROOMS}

    def lot(self, pair):
        """A number that decides whether a mutation is drawn, the same in every version."""
        return hashlib.sha256(f"{self.seed} {pair[0]}".encode()).hexdigest()

    @cached_property
    def shares(self):
        """Room -> how many mutants: the same for each, and more for those with more code."""
        sizes = {room: len(self.drawn[room]) for room in ROOMS}
        least = {room: min(LEAST, sizes[room]) for room in ROOMS}
        left = max(0, self.count - sum(least.values()))
        rest = sum(sizes.values())
        return {room: least[room] + round(left * sizes[room] / rest) for room in ROOMS}

    def run(self):
        """The records; RuntimeError if a test that has killed fails without a mutation, too."""
        records = super().run()
        killers = {tests_of(record) for record in records} - {""}
        if killers and not self.trusted:
            found = self.bench.asked(sorted(killers), 30 * len(killers))
            if found["code"] != 0:
                raise RuntimeError(f"it fails without any mutation: {found}")
        return records

    def kept(self, cell):
        """As in other studies; a survivor is tried once more if one asks for it."""
        path = self.path_of(cell)
        if self.again and path.exists():
            survived = super().kept(cell)[0]["verdict"] == "survived"
            if survived and self.reason(cell) is None:
                path.unlink()
                self.survivors.add(cell["mutant"])
        return super().kept(cell)

    def solve(self, room, module, mutant):
        """Put the fault in, run the tests, take it out."""
        mutation = self.mutations[module, mutant]
        first, last = mutation.start[0], mutation.end[0]
        record = {
            "line": first,
            "function": mutation.function,
            "kind": mutation.kind,
            "before": mutation.before,
            "after": mutation.after,
            "verdict": "survived",
            "why": "no test executes the line",
            "tests": 0,
            "work": 0.0,
        }
        tests = self.executed.tests(module, first, last)
        known = self.reason({"module": module, "mutant": mutant}) is not None
        left = self.seconds / 5 if known else self.seconds
        for stage in stages(room, tests):
            if stage and record["verdict"] == "survived":
                taken, cost = self.affordable(stage, mutation, left)
                left -= cost
                found = self.found(module, mutation, taken, int(cost) + GRACE)
                record["tests"] += len(taken)
                record["work"] += found["seconds"]
                record |= verdict(found)
        if record["verdict"] == "killed":
            self.killers[tests_of(record)] += 1
        first = "survived" if mutant in self.survivors else record["verdict"]
        return record | {"first": first}

    def found(self, module, mutation, tests, seconds):
        """What tests say about a mutant.

        Where they do not end in time without it either, as fixtures may belong to other tests, they
        get more.
        """
        again = self.executed.at_import(module, mutation.start[0], mutation.end[0])
        found = self.bench.judge(module, mutation, tests, seconds, again)
        late = found["code"] == TIMEOUT
        if late and self.bench.asked(tests, seconds)["code"] == TIMEOUT:
            found = self.bench.judge(module, mutation, tests, MORE * seconds, again)
        return found

    def affordable(self, tests, mutation, seconds):
        """Some of the tests, one at least, that cost so many seconds at most, and what they cost.

        Tests that have killed other mutants come first, then cheap ones, with chances for all.
        Those that only refuse data are for removed checks.
        """

        def order(test):
            asked = mutation.kind != "removed check"
            chance = int(self.lot((test,))[:6], 16) / 16**6
            dear = chance * (0.01 + self.executed.costs[test])
            return -self.killers[test], refuses(test) == asked, dear

        taken, total = [], 0.0
        for test in sorted(tests, key=order):
            cost = self.executed.costs[test]
            if total + cost <= seconds or not taken:
                taken.append(test)
                total += cost
        return taken, total

    @cached_property
    def killers(self):
        """Test -> the mutants that it has killed in this run."""
        return Counter()

    @cached_property
    def survivors(self):
        """Names of mutants that survived earlier, and are judged again."""
        return set()

    @cached_property
    def executed(self):
        """Which tests execute a line."""
        if not any(self.map.glob("cov.*")):
            self.progress(f"All tests run once for the map in {self.map}")
            made(self.map, ROOT)
        return Executed(self.map)

    @cached_property
    def bench(self):
        """Where the tests run, with the files of all tests that the map knows in memory."""
        bench = Bench()
        bench.answer({"load": self.executed.files})
        return bench

    @cached_property
    def reasons(self):
        """(Module, name of a mutant) -> why no test can notice it."""
        listed = json.loads(REASONS.read_text(encoding="utf-8"))
        return {(one["module"], one["mutant"]): one["reason"] for one in listed}

    def reason(self, cell):
        """Why nobody can notice a mutant; None if nothing is said."""
        return self.reasons.get((cell["module"], cell["mutant"]))

    def table_rows(self, records):
        """The shares of each room, and of all."""
        rooms = {room: [r for r in records if r["room"] == room] for room in ROOMS}
        rooms["all"] = list(records)
        return [shares(room, mine) for room, mine in rooms.items() if mine]

    def excused(self, record):
        """A record with its reason and its verdict at first sight.

        A survivor with a reason is equivalent.
        """
        why = self.reason(record)
        known = {"first": record["verdict"]}
        record = known | record | {"why": PLACES.sub("...", record["why"])}
        if record["verdict"] == "killed" or why is None:
            return record
        return record | {"verdict": "equivalent", "why": why}

    def write(self, records):
        """Reasons go into all three files."""
        return super().write([self.excused(record) for record in records])

    def line(self, record):
        """The verdict."""
        where = f"{record['module']}:{record['line']}"
        what = f"{record['before']} -> {record['after']}".replace("\n", " ")
        return f"{where} {what[:80]}: {record['verdict']}, {record['why'][:90]}"

    def notes(self, records):
        """What was done, and the mutants that are not killed."""
        table = [["line", "kind", "before", "after", "verdict", "why"]]
        table += [
            [
                f"{record['module']}:{record['line']}",
                record["kind"],
                f"`{record['before']}`",
                f"`{record['after']}`",
                record["verdict"],
                record["why"],
            ]
            for record in records
            if record["verdict"] != "killed"
        ]
        return [*super().notes(records), "", *in_markdown(table)]


def shares(room, records):
    """A row of the table: how many mutants of a room are killed, at first sight and now."""
    judged = [record for record in records if record["verdict"] != "equivalent"]
    row = {
        "room": room,
        "mutants": len(records),
        "equivalent": len(records) - len(judged),
    }
    for when in ("first", "verdict"):
        killed = sum(record[when] == "killed" for record in judged)
        row[when] = killed
        row[f"{when} share"] = f"{100 * killed / len(judged):.0f} %" if judged else ""
    return row


def tests_of(record):
    """The test that has killed a mutant, '' if there is none."""
    found = KILLER.match(record["why"])
    return found[0] if record["verdict"] == "killed" and found else ""


def refuses(test):
    """Whether the name of a test says that it judges messages."""
    words = (
        "refuse",
        "named",
        "nonsense",
        "message",
        "needed",
        "says",
        "warn",
        "illegal",
    )
    return any(word in test.rpartition("::")[2] for word in words)


def stages(room, tests):
    """The tests of the same room, those of others, those of nonsense, which no number concerns."""
    mirrored = [test for test in tests if test.startswith(f"tests/{room}/")]
    abuse = [test for test in tests if test.startswith("tests/abuse/")]
    others = [test for test in tests if test not in {*mirrored, *abuse}]
    return mirrored, others, abuse


def verdict(found):
    """What the answer of the referee says about a mutant.

    Exit codes of pytest: 0 all pass, 1 some fail, 2 interrupted, 3 internal, 4 a file cannot be
    imported, or it has no such test, 5 no tests.
    """
    if found["code"] in (4, 5) and "by" not in found:
        raise RuntimeError("the map names tests that are not there: make it again")
    if found["code"] == 0:
        return {"verdict": "survived", "why": "no test fails"}
    by = found.get("by") or "the process"
    return {"verdict": "killed", "why": f"{by}: {found.get('error', 'no import')}"}


class Bench:
    """A copy of the project, which goes at the end, and the referee that runs its tests."""

    def __init__(self):
        self.folder = Path(tempfile.mkdtemp(prefix="mutants-"))
        atexit.register(shutil.rmtree, self.folder, ignore_errors=True)
        self.count = 0
        self.project = self.folder / "project"
        self.project.mkdir()
        caches = shutil.ignore_patterns("__pycache__", "cells", "out")
        for name in KEPT:
            if (ROOT / name).exists():
                shutil.copytree(
                    ROOT / name, self.project / name, symlinks=True, ignore=caches
                )
        for path in ROOT.glob("*.*"):
            if path.is_file():
                shutil.copy2(path, self.project)
        self.referee = self.called()

    def called(self):
        """The referee, with the copy first on the path."""
        paths = [str(self.project), str(self.project / "tests")]
        surroundings = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(paths),
            "NGS_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "OMP_NUM_THREADS": "1",
            "MKL_NUM_THREADS": "1",
            "MPLBACKEND": "Agg",
            "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        }
        words = [sys.executable, "-m", "campaigns.referee", self.folder / "log"]
        return subprocess.Popen(
            words,
            cwd=self.project,
            env=surroundings,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def judge(self, module, mutation, tests, seconds, again=False):
        """What tests say about the package with a mutation, imported ``again`` where asked.

        Python knows compiled files by the second in which the source changed: each mutant gets a
        second of its own.
        """
        path = self.project / "ngepc" / module
        text = path.read_text(encoding="utf-8")
        before = path.stat().st_mtime_ns
        self.count += 1
        path.write_text(mutation.apply(text), encoding="utf-8")
        os.utime(path, (self.count, self.count))
        try:
            return self.asked(tests, seconds, path=str(path), text=text, again=again)
        finally:
            path.write_text(text, encoding="utf-8")
            os.utime(path, ns=(before, before))

    def asked(self, tests, seconds, **changed):
        """What tests say about the package as it stands in the copy."""
        return self.answer({"tests": tests, "seconds": seconds, **changed})

    def answer(self, question):
        """The referee's answer."""
        self.referee.stdin.write(json.dumps(question) + "\n")
        self.referee.stdin.flush()
        answer = self.referee.stdout.readline()
        if not answer:
            raise RuntimeError(f"the referee has ended, see {self.folder / 'log'}")
        return json.loads(answer)
