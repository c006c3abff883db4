"""Saved runs whose arrays were changed are refused with the file's name, before any work."""

import numpy as np
import pytest

from ngepc import evolve, lshape_problem
from ngepc.cli.work import FINGERPRINT, load_run
from ngepc.geometries import lshape
from ngepc.results import checkpoint

CHANGES = {
    "one number": lambda a: a[:1],
    "complex": lambda a: a.astype(complex),
    "NaN": lambda a: np.where(np.arange(len(a)) == 3, np.nan, a),
    "a table": lambda a: a[:, None],
    "texts": lambda a: a.astype(str),
}


def rewritten(path, change, name):
    """The file with one array changed."""
    with np.load(path) as data:
        arrays = {key: data[key] for key in data.files}
    arrays[name] = change(arrays[name])
    np.savez(path, **arrays)


@pytest.mark.parametrize("change", CHANGES)
def test_damaged_histories_are_refused(change, tmp_path):
    path = tmp_path / "run.npz"
    problem = lshape_problem(lshape.paper_mesh(33))
    steps = [(1.0, {"gap": 0.1})]
    evolve(problem, steps, checkpoint=path)
    rewritten(path, CHANGES[change], "u0")
    with pytest.raises(ValueError, match=rf"checkpoint {path} is damaged: 'u' is"):
        evolve(problem, steps, checkpoint=path)


@pytest.mark.parametrize("change", CHANGES)
def test_damaged_runs_are_refused(change, tmp_path):
    path = tmp_path / "run.npz"
    place = {"name": "lshape", "nodes": 113, "maxh": None}
    record = {"method": "newton"}
    kept = {"place": place, "record": record, "history": []}
    checkpoint.save(path, FINGERPRINT, kept, {"state": np.zeros(226)})
    assert load_run(path)[0] == record
    rewritten(path, CHANGES[change], "state")
    with pytest.raises(ValueError, match=rf"checkpoint {path} is damaged: 'state' is"):
        load_run(path)


def test_records_without_a_place_are_refused(tmp_path):
    path = tmp_path / "run.npz"
    checkpoint.save(path, FINGERPRINT, {"record": {}}, {"state": np.zeros(2)})
    with pytest.raises(ValueError, match=rf"checkpoint {path} is damaged \(KeyError"):
        load_run(path)
