"""Make every committed result again: each results/NAME.json contains its command.

``PYTHONPATH=tests python -m campaigns.remake [NAME ...]`` runs the commands one after the other,
those that take longest last, and writes the time of each to results/times.json.  Cells of a command
that was interrupted are kept in the folder ``cells`` beside the result, so the same line continues,
if the code is the same; a result that has been made whole with today's code is not made again.
``--list`` only prints which commands would run.
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

from campaigns.__main__ import arguments

from ngepc.studies.work import PACKAGE, commit

HERE = Path(__file__).resolve().parents[2]
RESULTS = HERE / "results"
TIMES = RESULTS / "times.json"
PETSC_PYTHON = HERE / ".venv-petsc" / "bin" / "python"
NEED_PETSC = {"large", "processes"}
PETSC_FOLDERS = "/usr/lib/petscdir/petsc*/*-real"
"""Where Debian keeps PETSc, as in the Makefile."""


def commands(folder=RESULTS):
    """Name of a result, with its folder -> the command that made it."""
    found = {}
    for path in sorted(folder.rglob("*.json")):
        if path != folder / TIMES.name:
            name = path.relative_to(folder).with_suffix("").as_posix()
            found[name] = json.loads(path.read_text())["command"]
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
    """Name of a result -> the time of its last run."""
    return json.loads(TIMES.read_text()) if TIMES.exists() else {}


def waiting(names):
    """The results that have not been made with today's code, those that take longest last."""
    known = times()
    left = [name for name in names if not up_to_date(name, known.get(name, {}))]
    return sorted(left, key=lambda name: known.get(name, {}).get("cpu_s", 1e4))


def sources(name):
    """What a result is made with: the package, and for a campaign its module."""
    words = shlex.split(commands()[name].removeprefix("python -m "))
    if words[0] != "campaigns":
        return [PACKAGE]
    campaign = arguments().parse_args(words[1:]).kind
    return [PACKAGE, Path(sys.modules[campaign.__module__].__file__)]


def same_code(name, entry):
    """Whether the sources of a result are still those of the commit with which it was made."""
    words = ["git", "-C", str(HERE), "diff", "--quiet", entry.get("commit", "")]
    paths = map(str, sources(name))
    done = subprocess.run([*words, "--", *paths], capture_output=True)
    return done.returncode == 0


def up_to_date(name, entry):
    """Whether a result has been made whole with today's code."""
    return bool(entry) and entry["finished"] and same_code(name, entry)


def run(name):
    """Make a result; its time is added to that of attempts which Ctrl-C has ended.

    It is finished when its table is written, also where the command ends with 1 because the table
    has a cell that did not converge.
    """
    before = times().get(name, {})
    on = commit()
    continues = bool(before) and not before["finished"] and same_code(name, before)
    begun = time.time()
    start = time.perf_counter()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    try:
        ended = status_of(program(commands()[name]))
    finally:
        now = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
        entry = {
            "wall_s": time.perf_counter() - start,
            "cpu_s": spent,
            "commit": on,
            "finished": False,
        }
        if continues:
            entry["wall_s"] += before["wall_s"]
            entry["cpu_s"] += before["cpu_s"]
        write(name, entry)
    written = (RESULTS / f"{name}.json").stat().st_mtime
    write(name, {**entry, "finished": written >= begun})
    return ended


def status_of(words):
    """The exit status of a command; if this is interrupted, the command is ended first.

    Only processes that were waited for have their time in that of the children.
    """
    with subprocess.Popen(words, cwd=HERE, env=surroundings()) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.terminate()
            process.wait()
            raise


def write(name, entry):
    """Store the time of a result."""
    rounded = {
        key: round(value, 1) if isinstance(value, float) else value
        for key, value in entry.items()
    }
    known = {**times(), name: rounded}
    TIMES.write_text(json.dumps(dict(sorted(known.items())), indent=2) + "\n")


def main():
    """Make the results that are not up to date; the exit status is 1 if a command failed."""
    known = commands()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="default all")
    parser.add_argument("--list", action="store_true", help="only print the commands")
    given = parser.parse_args()
    names = given.names or list(known)
    if unknown := set(names) - set(known):
        parser.error(f"no such results: {', '.join(sorted(unknown))}")
    failed = []
    for name in waiting(names):
        print(known[name], flush=True)
        if not given.list and run(name) != 0:
            failed.append(known[name])
    for command in failed:
        print(f"failed: {command}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
