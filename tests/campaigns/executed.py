"""The tests that execute each line of the package, and the time of each test.

A map is a folder with files of three kinds: ``cov.NAME`` of coverage with contexts, ``NAME.log`` of
pytest, and ``NAME.spent`` with the seconds of each test, as

    SPENT=FOLDER/NAME.spent COVERAGE_FILE=FOLDER/cov.NAME pytest TESTS --cov --cov-context=test \\
        -p campaigns.spent > FOLDER/NAME.log

writes them; ``made`` does it for all tests but notebooks and those that read the package as text.
"""

import os
import re
import subprocess
import sys
from collections import defaultdict
from functools import cached_property

from coverage import CoverageData

APART = ("site", "house", "campaigns")
"""Tests of pages, of the style of the code, and of this tool."""

FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/\S+)")


def made(folder, root):
    """Run all tests of a checkout once, for the map in ``folder``: it takes twice as long."""
    folder.mkdir(parents=True, exist_ok=True)
    words = [sys.executable, "-m", "pytest", "-m", "not notebooks", "-q"]
    words += ["-p", "campaigns.spent", "--cov", "--cov-context=test", "--cov-report="]
    words += [f"--ignore=tests/{name}" for name in APART]
    whole = folder.resolve()
    surroundings = {
        **os.environ,
        "COVERAGE_FILE": str(whole / "cov.all"),
        "SPENT": str(whole / "all.spent"),
    }
    with open(folder / "all.log", "w") as log:
        subprocess.run(words, cwd=root, env=surroundings, stdout=log, check=False)


class Executed:
    """The map in ``folder``."""

    def __init__(self, folder):
        self.folder = folder
        self._lines = {}

    @cached_property
    def _data(self):
        """The files of coverage."""
        found = []
        for path in sorted(self.folder.glob("cov.*")):
            data = CoverageData(str(path))
            data.read()
            found.append(data)
        return found

    @cached_property
    def costs(self):
        """Seconds of a processor of each test."""
        seconds = defaultdict(float)
        for path in self.folder.glob("*.spent"):
            for line in path.read_text(encoding="utf-8").splitlines():
                spent, _, test = line.partition(" ")
                seconds[test] = max(seconds[test], float(spent))
        return seconds

    @cached_property
    def files(self):
        """The files of all tests that execute something."""
        contexts = {c for data in self._data for c in data.measured_contexts()}
        return sorted({c.partition("::")[0] for c in contexts if "::" in c})

    @cached_property
    def failed(self):
        """Tests that fail without any mutation; they are not used."""
        texts = [path.read_text(errors="replace") for path in self.folder.glob("*.log")]
        lines = [line for text in texts for line in text.splitlines()]
        return {match[1] for line in lines if (match := FAILED.match(line))}

    def lines(self, module):
        """Line -> the tests that execute it; no test for lines that run at import."""
        if module not in self._lines:
            found = defaultdict(set)
            for data in self._data:
                for line, contexts in lines_of(data, module):
                    tests = {test_of(c) for c in contexts if " at 0x" not in c}
                    found[line] |= tests - {"", *self.failed}
            self._lines[module] = found
        return self._lines[module]

    def at_import(self, module, first, last):
        """Whether one of the lines runs while modules are imported."""
        wanted = set(range(first, last + 1))
        return any(
            line in wanted and "" in contexts
            for data in self._data
            for line, contexts in lines_of(data, module)
        )

    def tests(self, module, first, last):
        """The tests that execute one of the lines, the cheapest first.

        Where none does because the lines run when the module is imported, those of any line of it.
        """
        lines = self.lines(module)
        found = set().union(*(lines[k] for k in range(first, last + 1) if k in lines))
        imported = not found and any(k in lines for k in range(first, last + 1))
        if imported:
            found = set().union(*lines.values())
        return sorted(found, key=lambda test: (self.costs[test], test))


def lines_of(data, module):
    """Pairs (line, contexts) of a module in a file of coverage, wherever the checkout was."""
    for path in data.measured_files():
        if path.endswith(f"/ngepc/{module}"):
            yield from data.contexts_by_lineno(path).items()


def test_of(context):
    """The test of a context of pytest-cov, 'tests/...::test_a|run'."""
    return context.rpartition("|")[0]
