"""A process that has imported everything and runs tests in children, one after the other.

It imports the libraries, and the tests and what they use of the package (``{"load": files}``).  A
child that is to judge a mutant (``{"path": file, "tests": [...], "seconds": 20}``: the file has
been written anew) puts the new code into the functions that have changed; where the change is none
of a function's body, or with ``"again": true``, it forgets all modules of the project, so that they
are imported again.  The answer, ``{"code": 1, "by": "tests/...::test_...", "error": "...",
"seconds": 1.3}``, is one line of JSON like the question.
"""

import contextlib
import functools
import gc
import importlib
import json
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path
from types import CodeType, FunctionType

import pytest

KNOWN = (
    "ngsolve",
    "netgen.occ",
    "scipy.optimize",
    "scipy.sparse.linalg",
    "scipy.spatial",
    "matplotlib.pyplot",
    "hypothesis",
    "meshio",
    "pyamg",
    "pytest_timeout",
    "faulthandler",
    "asyncio",
    "netgen.meshing",
    "netgen.geom2d",
    "netgen.csg",
)
MEMORY = 8 * 2**30
PATIENCE = 12  # seconds that pass, over seconds of work
TIMEOUT = -1
LIVE = {}
CACHES = []
QUIET = ("-p", "no:cacheprovider", "-p", "pytest_timeout")


class Recorder:
    """Keeps the first test that fails, and why."""

    def __init__(self):
        self.first = {}

    def pytest_runtest_logreport(self, report):
        """A stage of a test has ended."""
        self.keep(report)

    def pytest_collectreport(self, report):
        """A file has been imported."""
        self.keep(report)

    def keep(self, report):
        """Keep what failed first."""
        if report.failed and not self.first:
            crash = getattr(report.longrepr, "reprcrash", None)
            told = crash.message if crash else str(report.longrepr)
            self.first = {"by": report.nodeid, "error": told.split("\n")[0][:200]}


def codes(code, path=()):
    """(Names of the functions and classes around it, first line) -> code, of a file."""
    found = {(*path, code.co_name, code.co_firstlineno): code}
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            found |= codes(inner, (*path, code.co_name, code.co_firstlineno))
    return found


def alone(code):
    """What a code does itself, without the functions in it."""
    constants = [c for c in code.co_consts if not isinstance(c, CodeType)]
    return code.co_code, repr(constants), code.co_names, code.co_varnames


def exchanged(path, text):
    """Put the code of a file into the functions that came from it; False if that is not all."""
    old = codes(compile(text, path, "exec"))
    new = codes(compile(Path(path).read_text(encoding="utf-8"), path, "exec"))
    changed = {key for key in old if alone(old[key]) != alone(new.get(key, old[key]))}
    if old.keys() != new.keys() or not changed:
        return False
    for key in changed:
        while key and old[key] not in LIVE:
            key = key[:-2]  # a comprehension, or a function that its own function makes
        if not key or old[key].co_freevars != new[key].co_freevars:
            return False
        for function in LIVE[old[key]]:
            function.__code__ = new[key]
    for cached in CACHES:
        cached.cache_clear()
    return True


def remember(folder):
    """Note the functions of the project that are in memory, and what remembers their values."""
    for one in gc.get_objects():
        if isinstance(one, functools._lru_cache_wrapper):
            CACHES.append(one)
        if not isinstance(one, FunctionType):
            continue
        if one.__code__.co_filename.startswith(folder):
            LIVE.setdefault(one.__code__, []).append(one)


def forget(folder):
    """Drop all modules of the project, which are imported again where they are needed."""
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None) or ""
        if file.startswith(folder) and name != "__main__":
            del sys.modules[name]


def broken(path):
    """What is wrong if a module, or what all tests import, cannot be imported; nothing if it can.

    Where ``conftest`` cannot, pytest ends as if there were no such tests.
    """
    name = Path(path).relative_to(os.getcwd()).with_suffix("").parts
    try:
        importlib.import_module(".".join(name))
        if Path("tests", "conftest.py").exists():
            importlib.import_module("conftest")
    except Exception as error:
        told = f"{type(error).__name__}: {error}".split("\n")[0][:200]
        return {"by": "its import", "error": told}
    return {}


def tested(tests, recorder):
    """The exit code of pytest."""
    words = ["-x", "-q", *QUIET, "--tb=short", *tests]
    return int(pytest.main(words, plugins=[recorder]))


def child(asked, answer):
    """Run tests and leave the process."""
    seconds = asked["seconds"]
    path = asked.get("path")
    again = asked.get("again", False)
    swapped = bool(path) and not again and exchanged(path, asked["text"])
    if path and not swapped:
        forget(os.getcwd())
    os.setpgrp()
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    recorder = Recorder()
    recorder.first = broken(path) if path and not swapped else {}
    code = 3
    with contextlib.suppress(BaseException):
        code = 1 if recorder.first else tested(asked["tests"], recorder)
    Path(answer).write_text(
        json.dumps({"code": code, "swapped": swapped, **recorder.first})
    )
    sys.stdout.flush()
    os._exit(0)


def spent():
    """Seconds of work of all children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def ended(pid, latest):
    """Wait for a child; False if it did not end in time."""
    while time.monotonic() < latest:
        if os.waitpid(pid, os.WNOHANG)[0]:
            return True
        time.sleep(0.05)
    return False


def judged(asked, log):
    """What tests say, each set in a process of its own."""
    before = spent()
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        pid = os.fork()
        if pid == 0:
            os.dup2(log, 1)
            os.dup2(log, 2)
            child(asked, answer)
        in_time = ended(pid, time.monotonic() + PATIENCE * asked["seconds"])
        with contextlib.suppress(ProcessLookupError):
            os.killpg(pid, signal.SIGKILL)
        if not in_time:
            os.waitpid(pid, 0)
        found = {"code": TIMEOUT, "error": f"no answer after {asked['seconds']} s"}
        if answer.exists():
            found = json.loads(answer.read_text())
    return {**found, "seconds": round(spent() - before, 2)}


def collected(*files):
    """Import tests; none are run."""
    pytest.main(["--collect-only", "-q", *QUIET, *files])


def load(files, log):
    """Import tests in this process, with what they print in the log."""
    kept = [os.dup(1), os.dup(2)]
    os.dup2(log, 1)
    os.dup2(log, 2)
    collected("tests/conftest.py")
    alone = [file for file in files if not starts_threads(file)]
    collected(*alone)
    sys.stdout.flush()
    os.dup2(kept[0], 1)
    os.dup2(kept[1], 2)
    remember(os.getcwd())
    gc.collect()
    gc.freeze()
    return {"loaded": len(alone)}


def starts_threads(file):
    """Whether the import of a test does, as one that makes a mesh: children would miss them."""
    pid = os.fork()
    if pid == 0:
        with contextlib.suppress(BaseException):
            collected(file)
            os._exit(min(len(os.listdir("/proc/self/task")) - 1, 1))
        os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) != 0


def main():
    """Answer until the input ends; what the tests print goes to a log."""
    for name in KNOWN:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    log = os.open(sys.argv[1], os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for line in sys.stdin:
        asked = json.loads(line)
        found = load(asked["load"], log) if "load" in asked else judged(asked, log)
        print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
