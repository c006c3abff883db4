"""One thread (the same digits twice), no messages from the mesh generator, no windows.

``SLOW`` lists what ``make check`` leaves to ``make test``.
"""

import gc
import os
import sys
from functools import cache, wraps
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from drawing import draw_quickly
from netgen.csg import CSGeometry
from netgen.meshing import SetMessageImportance
from netgen.occ import OCCGeometry
from ngsolve import Mesh, SetNumThreads

from ngepc.geometries import block, ring
from ngepc.pictures.stills import renderer

# While modules of tests are imported nothing is garbage.
gc.disable()

HERE = Path(__file__).parent

SLOW = (
    "abuse/test_bad_arguments.py",
    "abuse/test_interruption.py",
    "abuse/test_robustness.py",
    "goals/test_adaptive.py",
    "bounds/test_admissible.py",
    "bounds/test_bound.py",
    "bounds/test_convex.py",
    "goals/test_defect.py",
    "bounds/test_enclosure.py",
    "bounds/test_foundation.py",
    "goals/test_friction_of_goals.py",
    "goals/test_goal_bound.py",
    "goals/test_brackets.py",
    "goals/test_goals_of_bodies.py",
    "bounds/test_hexahedra.py",
    "bounds/test_hidden.py",
    "bounds/test_laws.py",
    "bounds/test_matching.py",
    "bounds/test_oscillation.py",
    "bounds/test_proved.py",
    "bounds/test_quadratic.py",
    "bounds/test_quadrilaterals.py",
    "bounds/test_random.py",
    "bounds/test_rates.py",
    "goals/test_receipt.py",
    "goals/test_receipt_order_two.py",
    "goals/test_rollers_of_goals.py",
    "bounds/test_revolution.py",
    "bounds/test_rollers.py",
    "bounds/test_sizes.py",
    "bounds/test_solid.py",
    "goals/test_sub_elements.py",
    "goals/test_supremum_of_ellipsoids.py",
    "goals/test_supremum_of_laws.py",
    "bounds/test_thickness.py",
    "bounds/test_thin.py",
    "goals/test_verdicts.py",
    "bridges/test_functions.py",
    "campaigns",
    "cli",
    "contact/test_equilibria.py",
    "contact/test_floating.py",
    "contact/test_friction.py",
    "contact/test_order_two.py",
    "contact/test_two_bodies.py",
    "discretisation/test_finer.py",
    "discretisation/test_invariants.py",
    "discretisation/test_loads.py",
    "discretisation/test_narrow.py",
    "dual/test_algorithms_66_68.py",
    "dual/test_duality.py",
    "dual/test_honest_convergence.py",
    "dual/test_path.py",
    "dual/test_statuses.py",
    "dual/test_threads.py",
    "evolution",
    "geometries/test_files.py",
    "geometries/test_geometries.py",
    "limit",
    "linalg/test_cores.py",
    "local/test_choice.py",
    "local/test_counts.py",
    "local/test_exactness.py",
    "local/test_forms.py",
    "local/test_multigrid.py",
    "local/test_order_one.py",
    "local/test_processes.py",
    "local/test_recovery.py",
    "local/test_sums.py",
    "model/test_own.py",
    "paper",
    "physics/test_closed_forms.py",
    "physics/test_cones.py",
    "physics/test_convergence_rates.py",
    "physics/test_crossings.py",
    "physics/test_cycles.py",
    "physics/test_hill.py",
    "physics/test_invariances.py",
    "physics/test_kinematics.py",
    "physics/test_plane_stress.py",
    "physics/test_laws.py",
    "physics/test_promises.py",
    "physics/test_property.py",
    "physics/test_published.py",
    "physics/test_rates.py",
    "physics/test_supports.py",
    "physics/test_verification.py",
    "pictures",
    "results/test_damaged.py",
    "results/test_files.py",
    "results/test_pickling.py",
    "results/test_recovery.py",
    "sensitivity",
    "site",
    "studies",
)
"""Folders and files whose tests take more than some 2.5 seconds of processor time together.

Those of both Newton methods, ``dual/test_newton.py`` and ``primal/test_primal.py``, are quick ones
nevertheless.
"""
LONGEST = (
    "site/test_docs.py",
    "site/test_notebooks.py",
    "physics/test_crossings.py",
    "local/test_multigrid.py",
    "physics/test_convergence_rates.py",
    "physics/test_published.py",
    "sensitivity",
    "local/test_sums.py",
    "bounds",
    "goals",
    "site",
    "abuse",
    "contact",
    "physics",
    "local",
    "limit",
    "pictures",
    "studies",
    "cli",
    "evolution",
    "dual/test_newton.py",
    "primal",
    "dual",
    "results",
    "house",
)
"""Files and folders that begin first, so that no process is left with a long one at the end."""
SLOW_PLACES = {HERE / name for name in SLOW}


def without_threads(generate):
    """Netgen's threads wait for each other most of the time: one makes the same mesh earlier."""

    @wraps(generate)
    def mesh(*args, **options):
        return generate(*args, **({"parallel_meshing": False} | options))

    return mesh


CSGeometry.GenerateMesh = without_threads(CSGeometry.GenerateMesh)
OCCGeometry.GenerateMesh = without_threads(OCCGeometry.GenerateMesh)


def made_once(make):
    """A mesh with the same arguments is a copy of the first one."""
    meshes = {}

    @wraps(make)
    def mesh(*args, **kwargs):
        key = repr((args, kwargs))
        if key not in meshes:
            meshes[key] = make(*args, **kwargs).ngmesh
        return Mesh(meshes[key].Copy())

    return mesh


block.mesh, block.with_hole = made_once(block.mesh), made_once(block.with_hole)
ring.shell_octant_mesh = made_once(ring.shell_octant_mesh)


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    SetNumThreads(1)
    SetMessageImportance(0)


@pytest.fixture
def two_threads():
    """Two threads of NGSolve."""
    SetNumThreads(2)
    yield
    SetNumThreads(1)


@pytest.fixture(autouse=True)
def no_open_figures():
    """Pictures are figures of pyplot where a test imports it."""
    yield
    if pyplot := sys.modules.get("matplotlib.pyplot"):
        pyplot.close("all")


@pytest.fixture
def quickly_drawn(monkeypatch):
    """Coarse pictures without layout and ticks, for tests of what is around them."""
    draw_quickly(monkeypatch)


@pytest.fixture
def draws_solids():
    try:
        renderer()
    except ImportError as error:
        pytest.skip(str(error))


def pytest_ignore_collect(collection_path, config):
    """Leave out slow files that are not wanted: to import them takes as long as to run the rest."""
    unwanted = "not slow" in config.getoption("markexpr")
    return True if unwanted and collection_path in SLOW_PLACES else None


@cache
def rank(path):
    """The place of a file of tests in LONGEST, after them all if it is none of these."""
    places = (path, *path.parents)
    ranks = [i for i, name in enumerate(LONGEST) if HERE / name in places]
    return min(ranks, default=len(LONGEST))


@cache
def is_slow(path):
    """Whether a file of tests is one of SLOW."""
    return not SLOW_PLACES.isdisjoint((path, *path.parents))


def pytest_collection_finish():
    """Search for garbage again, and only among what the tests make."""
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)
    gc.enable()


def pytest_configure(config):
    """Let each worker begin with other folders: what one has compiled the others only read."""
    worker = getattr(config, "workerinput", None)
    if worker and config.args == [HERE.name]:
        folders = sorted({str(path.parent) for path in HERE.glob("*/test_*.py")})
        first = int(worker["workerid"].removeprefix("gw"))
        first = first * len(folders) // worker["workercount"]
        config.args = folders[first:] + folders[:first]


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: (rank(item.path), item.path))
    for item in items:
        if is_slow(item.path):
            item.add_marker(pytest.mark.slow)
