"""Finished steps in a temporary file: their fields are those of steps in memory."""

import copy
import gc
import pickle
import weakref

import numpy as np
import pytest
from ngsolve import Integrate

from ngepc import Coulomb, Material, Problem, Schedule, evolve, lshape_problem
from ngepc.evolution import kept, run
from ngepc.evolution.load_path import load_cycle
from ngepc.geometries import block, lshape

METAL = {"young": 1000.0, "poisson": 0.3, "yield_stress": 2.0, "plastic_modulus": 20.0}


def dragged():
    """A block with isotropic hardening that is pressed and dragged: slip starts anew."""
    problem = Problem(
        block.structured_mesh(2, 2, simplices=True),
        Material.metal(**METAL, kind="isotropic"),
        contact="contact",
        gap=0.0,
        friction=Coulomb(0.3),
    )

    def deeper(t):
        return {"gap": -0.004 * t}

    moved = Schedule((0.25, 0.5, 0.75, 1.0), deeper, obstacle_motion=lambda t: (t, 0.0))
    return evolve(problem, moved)


def reversed_load():
    """Example (a) of the paper, loaded both ways."""
    problem = lshape_problem(lshape.paper_mesh(33))
    return evolve(problem, load_cycle(problem, [1, -1], steps=2))


HISTORIES = (dragged, reversed_load)


def everything(history):
    """All that the steps say, with integrals of fields of their history."""
    found = []
    for step in history.steps:
        fields = step.fields
        mesh = fields.problem.mesh
        found += [
            step.values_of("displacement"),
            step.values_of("plastic_increment"),
            fields.displacement.vec.FV().NumPy(),
            [Integrate(fields.von_mises, mesh)],
            [Integrate(fields.accumulated_plastic_strain, mesh)],
            [Integrate(fields.yield_function, mesh)],
            step.slip.ravel(),
            [step.solution.primal_energy, fields.problem.duration],
        ]
    return np.concatenate(found)


def in_memory(history):
    """Which steps have their arrays in memory."""
    return ["kept" not in vars(step) for step in history.steps]


@pytest.mark.parametrize("make", HISTORIES)
def test_steps_in_a_file_have_the_fields_of_steps_in_memory(make, monkeypatch):
    history = make()
    count = len(history.steps)
    assert in_memory(history) == [False] * (count - 2) + [True] * 2
    monkeypatch.setattr(run, "IN_MEMORY", count)
    expected = make()
    assert all(in_memory(expected))
    assert np.array_equal(everything(history), everything(expected))


def test_copies_have_everything_in_memory():
    history = reversed_load()
    expected = everything(history)
    for again in (pickle.loads(pickle.dumps(history)), copy.deepcopy(history)):
        assert all(in_memory(again))
        assert everything(again) == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_fields_live_as_long_as_they_are_used():
    step = reversed_load().steps[0]
    fields = step.fields
    assert step.fields is fields
    watch = weakref.ref(fields)
    del fields
    gc.collect()
    assert watch() is None
    assert step.fields.problem.mesh.ne > 0


def test_steps_stay_in_memory_if_the_disk_is_full(monkeypatch):
    expected = everything(reversed_load())

    def full(store, array):
        raise OSError("no space left on device")

    monkeypatch.setattr(kept.Store, "put", full)
    history = reversed_load()
    assert all(in_memory(history))
    assert np.array_equal(everything(history), expected)


def test_steps_of_another_mesh_are_refused():
    history = reversed_load()
    history.problem.mesh.Refine()
    with pytest.raises(ValueError, match="solve again"):
        _ = history.steps[0].fields
