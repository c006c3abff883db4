"""Make every committed result again: the command stands in each results/NAME.json.

``PYTHONPATH=tests python -m campaigns.remake [NAME ...]`` runs the commands one after the other,
those that take longest last, and writes what each took to results/times.json.  Cells of a command
that was interrupted are kept in results/cells, so the same line goes on; a command that has
finished from today's code is not run again.  ``--list`` only says what would be done.
"""

import argparse
import glob
import json
import os
import resource
import shlex
import subprocess
import sys
import time
from pathlib import Path

from ngepc.studies.work import PACKAGE, commit

HERE = Path(__file__).resolve().parents[2]
RESULTS = HERE / "results"
TIMES = RESULTS / "times.json"
PETSC_PYTHON = HERE / ".venv-petsc" / "bin" / "python"
NEED_PETSC = {"large", "processes"}
PETSC_FOLDERS = "/usr/lib/petscdir/petsc*/*-real"
"""Where Debian keeps PETSc, as in the Makefile."""


def commands(folder=RESULTS):
    """Name of a result -> the command that made it."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        if path != folder / TIMES.name:
            found[path.stem] = json.loads(path.read_text())["command"]
    return found


def program(command):
    """The words that run a recorded command: with this Python, or with the one that has PETSc."""
    words = shlex.split(command)
    if words[:2] == ["python", "-m"]:
        words = words[2:]
    needs_petsc = NEED_PETSC & set(words) and PETSC_PYTHON.exists()
    python = str(PETSC_PYTHON) if needs_petsc else sys.executable
    return [python, "-m", *words]


def surroundings():
    """The environment of a command: with PETSC_DIR, which Debian's petsc4py needs."""
    found = sorted(glob.glob(PETSC_FOLDERS))
    return {"PETSC_DIR": found[-1], **os.environ} if found else dict(os.environ)


def times():
    """Command -> what it took when it was run last."""
    return json.loads(TIMES.read_text()) if TIMES.exists() else {}


def waiting(names):
    """The commands of these results that have not been run on today's code, quick ones first."""
    known = times()
    wanted = {command for name, command in commands().items() if name in names}
    left = [command for command in wanted if not up_to_date(known.get(command, {}))]
    return sorted(left, key=lambda command: known.get(command, {}).get("cpu_s", 1e4))


def same_code(entry):
    """Whether the package is still that of the commit with which a command was run."""
    words = [
        "git",
        "-C",
        str(PACKAGE),
        "diff",
        "--quiet",
        entry.get("commit", ""),
        "--",
        ".",
    ]
    return subprocess.run(words, capture_output=True).returncode == 0


def up_to_date(entry):
    """Whether a command has finished with today's package."""
    return bool(entry) and entry["finished"] and same_code(entry)


def forget_cells(command):
    """Delete what a command has kept: it comes from another package."""
    words = shlex.split(command)
    for name in set(words) & {path.stem for path in RESULTS.glob("*.json")}:
        for path in (RESULTS / "cells").glob(f"{name}-*.npz"):
            path.unlink()


def run(command):
    """Run a command; its time is added to that of the attempts that were interrupted."""
    before = times().get(command, {})
    on = commit()
    goes_on = bool(before) and not before["finished"] and same_code(before)
    if not goes_on:
        forget_cells(command)
    start = time.perf_counter()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        words = program(command)
        ended = subprocess.run(words, cwd=HERE, env=surroundings()).returncode
    finally:
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
        entry = {
            "wall_s": time.perf_counter() - start,
            "cpu_s": spent,
            "commit": on,
            "finished": False,
        }
        if goes_on:
            entry["wall_s"] += before["wall_s"]
            entry["cpu_s"] += before["cpu_s"]
        write(command, entry)
    write(command, {**entry, "finished": ended == 0})
    return ended


def write(command, entry):
    """Keep what a command took."""
    rounded = {
        key: round(value, 1) if isinstance(value, float) else value
        for key, value in entry.items()
    }
    known = {**times(), command: rounded}
    TIMES.write_text(json.dumps(dict(sorted(known.items())), indent=2) + "\n")


def main():
    """Run what is waiting; the exit status is 1 if a command failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="default all")
    parser.add_argument("--list", action="store_true", help="only say what is waiting")
    given = parser.parse_args()
    names = set(given.names or commands())
    if unknown := names - set(commands()):
        parser.error(f"no such results: {', '.join(sorted(unknown))}")
    failed = []
    for command in waiting(names):
        print(command, flush=True)
        if not given.list and run(command) != 0:
            failed.append(command)
    for command in failed:
        print(f"failed: {command}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
