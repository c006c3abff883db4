"""What a checkpoint belongs to: every datum of a problem tells, and what is read comes back."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, x

from ngepc import Material, Point, Problem
from ngepc.geometries import block
from ngepc.results.checkpoint import load, problem_fingerprint, save, work_fingerprint
from ngepc.results.stored import array_of, reading

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
)
CORNER = Point((1.0, 1.0))
PROBLEM = Problem(
    block.structured_mesh(3, 3),
    METAL,
    "clamped",
    {"right": (0.1, 0.0), CORNER: (0.0, 0.1)},
    contact="contact",
    gap=0.01,
    springs={"left": 3.0},
    order=1,
)
CHANGES = {
    "material": {"material": replace(METAL, hardening=11.0)},
    "a field of it": {"material": replace(METAL, hardening=10.0 + x)},
    "clamped": {"clamped": ("clamped", "right"), "traction": {CORNER: (0.0, 0.1)}},
    "load": {"traction": {"right": (0.1, 0.2), CORNER: (0.0, 0.1)}},
    "load that varies": {"traction": {"right": CF((0.1 * x, 0.0)), CORNER: (0.0, 0.1)}},
    "load at a point": {"traction": {"right": (0.1, 0.0), CORNER: (0.0, 0.2)}},
    "pressure": {"pressure": {"left": 0.1}},
    "springs": {"springs": {"left": 4.0}},
    "gap": {"gap": 0.02},
    "gap that varies": {"gap": 0.01 + 0.0 * x + 1e-9 * x},
    "contact": {"contact": None, "gap": None},
    "friction": {"friction": 0.1},
    "body force": {"body_force": (0.0, -1.0)},
    "history": {"initial_accumulated": 0.0},
    "order": {"order": 2},
}


def test_the_same_data_have_one_fingerprint():
    again = replace(PROBLEM, material=replace(METAL))
    assert problem_fingerprint(again) == problem_fingerprint(PROBLEM)
    assert work_fingerprint("run", again, steps=2) == work_fingerprint(
        "run", PROBLEM, steps=2
    )


def test_each_datum_changes_the_fingerprint():
    changed = {
        name: problem_fingerprint(replace(PROBLEM, **change))
        for name, change in CHANGES.items()
    }
    changed["none"] = problem_fingerprint(PROBLEM)
    assert len(set(changed.values())) == len(changed)


def test_the_mesh_and_the_work_tell_as_well():
    finer = replace(PROBLEM, mesh=block.structured_mesh(4, 3))
    known = work_fingerprint("run", PROBLEM)
    assert work_fingerprint("run", finer)["mesh"] != known["mesh"]
    assert work_fingerprint("path", PROBLEM) != known


def test_what_is_saved_is_loaded(tmp_path):
    path = tmp_path / "run.npz"
    about = {"study": "one", "nodes": (3, 4)}
    assert load(path, about) is None
    save(path, about, {"steps": [1, 2.5, None]}, {"u": np.arange(3.0)})
    found = load(path, about)
    assert found.record == {"steps": [1, 2.5, None]}
    assert array_of(path, found.arrays, "u", 3).tolist() == [0.0, 1.0, 2.0]


def test_what_does_not_fit_is_said(tmp_path):
    path = tmp_path / "run.npz"
    save(path, {"study": "one"}, {}, {"u": np.array([0.0, np.inf])})
    with pytest.raises(ValueError, match="other work: kind, study differ"):
        load(path, {"study": "two", "kind": "a"})
    arrays = load(path, {"study": "one"}).arrays
    for name, size in (("u", 2), ("u", 3), ("v", 2)):
        with pytest.raises(ValueError, match=f"{name!r} .* {size} finite real numbers"):
            array_of(path, arrays, name, size)
    path.write_bytes(b"no archive")
    with pytest.raises(ValueError, match="is damaged or no checkpoint"):
        load(path, {"study": "one"})


@pytest.mark.parametrize("error", [MemoryError(), PermissionError(13, "denied")])
def test_a_file_that_cannot_be_read_now_is_not_called_damaged(
    tmp_path, monkeypatch, error
):
    path = tmp_path / "run.npz"
    save(path, {"study": "one"}, {}, {"u": np.arange(3.0)})

    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(np, "load", refuse)
    with pytest.raises(type(error)):
        load(path, {"study": "one"})
    with pytest.raises(MemoryError), reading(path):
        raise MemoryError
