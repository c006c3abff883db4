"""Files of runs that were changed: refused with the file's name, before any work.

A digest in the file sees every change.  What was written with a right digest and wrong contents,
by another program for example, is seen by names, types, shapes and ranges.
"""

import json
import random
from copy import deepcopy

import numpy as np
import pytest

from ngepc import evolve, lshape_problem
from ngepc.__main__ import main
from ngepc.cli.solve import load_run
from ngepc.dual.path import PathOptions, follow_path
from ngepc.geometries import lshape
from ngepc.results import checkpoint
from ngepc.studies.counts import Table1

PROBLEM = lshape_problem(lshape.paper_mesh(33))
SHORT = PathOptions(gamma_start=10.0, gamma_end=100.0, growth=10.0)
STEPS = [(0.5, {"gap": 0.15}), (1.0, {"gap": 0.1})]


def made_by_command(*more):
    """A run that the command line saves, and what reads it."""

    def run(path):
        if path.exists():
            return load_run(path)[0]
        command = ["solve", "lshape", "--nodes", "33", "--quiet", *more]
        return main([*command, "--save", str(path)])

    return run


def history(path):
    found = evolve(PROBLEM, STEPS, checkpoint=path)
    return [vars(step.record) for step in found.steps]


def table(path):
    path.parent.mkdir(exist_ok=True)
    return Table1(path.parent.parent, levels=1, rows=("1e0",)).run()


KINDS = {
    "run of the exact method": made_by_command(),
    "run of the paper's method": made_by_command("--gamma", "1e2"),
    "path": lambda path: follow_path(PROBLEM, SHORT, checkpoint=path).path_values,
    "history": history,
    "study": table,
}


@pytest.fixture(scope="module", params=KINDS)
def saved(request, tmp_path_factory):
    """What reads a file again, the file, its contents, and what was read of it."""
    folder = tmp_path_factory.mktemp("saved") / "cells"
    folder.mkdir()
    name = "table1-1e0-833.npz" if request.param == "study" else "run.npz"
    path = folder / name
    KINDS[request.param](path)
    return KINDS[request.param], path, path.read_bytes(), KINDS[request.param](path)


def parts_of(path):
    """Fingerprint, record and arrays of a file."""
    with np.load(path) as data:
        arrays = {key: data[key] for key in data.files}
    header = json.loads(str(arrays.pop("header")))
    return header["fingerprint"], header["record"], arrays


def places_in(value, before=()):
    """The path to every entry of nested dictionaries and lists."""
    pairs = []
    if isinstance(value, dict):
        pairs = list(value.items())
    if isinstance(value, list):
        pairs = list(enumerate(value))
    for key, entry in pairs:
        yield (*before, key)
        yield from places_in(entry, (*before, key))


def with_change(record, place, change):
    """A copy of a record with one entry removed or put in place of another."""
    other = deepcopy(record)
    inner = other
    for key in place[:-1]:
        inner = inner[key]
    if change == "removed":
        del inner[place[-1]]
    else:
        inner[place[-1]] = change
    return other


RETYPED = ("removed", None, "text", [], {}, -7, True, [[1.0]], float("nan"))
ARRAYS = {
    "one number": lambda a: a[:1],
    "complex": lambda a: a.astype(complex),
    "NaN": lambda a: np.where(np.arange(len(a)) == 3, np.nan, a),
    "a table": lambda a: a[:, None],
    "texts": lambda a: a.astype(str),
    "longer": lambda a: np.append(a, 0.0),
    "integers": lambda a: a.astype(int),
}


def read_again(saved, write):
    """Read a file that ``write`` has changed; the message of a ValueError, '' for none."""
    run, path, whole, _ = saved
    write(path)
    try:
        run(path)
    except ValueError as error:
        return str(error)
    finally:
        path.write_bytes(whole)
    return ""


def rewritten(header, arrays):
    """What writes a file with this header and these arrays, whatever its digest says."""
    text = np.array(json.dumps(header))
    return lambda path: np.savez(path, header=text, **arrays)


def test_every_change_is_refused(saved):
    """Twenty random entries and all arrays: removed, of another type, of another value."""
    _, path, _, _ = saved
    with np.load(path) as data:
        arrays = {key: data[key] for key in data.files}
    header = json.loads(str(arrays.pop("header")))
    rng = random.Random(1)
    places = sorted(places_in(header), key=str)
    for _ in range(20):
        change = rng.choice(RETYPED)
        place = rng.choice(places)
        other = with_change(header, place, change)
        if json.dumps(other) != json.dumps(header):
            said = read_again(saved, rewritten(other, arrays))
            # None and a missing entry, 1 and True are the same work
            assert str(path) in said or (place[0] == "fingerprint" and not said)
    for name, array in arrays.items():
        for change in ARRAYS.values():
            other = arrays | {name: change(array)}
            assert str(path) in read_again(saved, rewritten(header, other))
        rest = {key: value for key, value in arrays.items() if key != name}
        assert str(path) in read_again(saved, rewritten(header, rest))
    assert read_again(saved, rewritten(header, arrays)) == ""


def test_wrong_contents_with_a_right_digest_make_no_raw_error(saved):
    """What is no record of its kind is refused by name; legal numbers are what the file says."""
    _, path, _, _ = saved
    fingerprint, record, arrays = parts_of(path)
    rng = random.Random(2)
    places = sorted(places_in(record), key=str)

    def written(record, arrays):
        return lambda path: checkpoint.save(path, fingerprint, record, arrays)

    for _ in range(20):
        place = rng.choice(places)
        change = rng.choice(RETYPED)
        other = with_change(record, place, change)
        said = read_again(saved, written(other, arrays))
        assert said == "" or str(path) in said
        if change == [[1.0]] and "records" not in place:
            assert said
    for name, array in arrays.items():
        for change in ARRAYS.values():
            other = arrays | {name: change(array)}
            said = read_again(saved, written(record, other))
            assert f"{path} is damaged" in said
        if not name.startswith("contact"):  # steps with gamma have none
            rest = {key: value for key, value in arrays.items() if key != name}
            assert str(path) in read_again(saved, written(record, rest))
