"""On a mesh distributed over MPI processes the dual method does the same as on one process."""

import functools
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import distributed_cases as cases
import numpy as np
import pytest
from test_docs import NEEDS_MPI, snippets

from ngepc.checks.mpi import MOST_WITH_MPICH

AS_ROOT = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
PROCESSES = (3, 4)
"""Process 0 has no elements; the others have one neighbour, and two."""


def launcher():
    """The mpiexec beside this Python, or on the path."""
    pytest.importorskip("mpi4py")
    beside = Path(sys.executable).parent / "mpiexec"
    found = str(beside) if beside.exists() else shutil.which("mpiexec")
    if found is None:
        pytest.skip("needs mpiexec")
    return found


def is_mpich(mpiexec):
    told = subprocess.run([mpiexec, "--version"], capture_output=True, text=True, timeout=60)
    return "HYDRA" in told.stdout


def launched(processes, *arguments, folder=None):
    """What a Python script prints that several processes run."""
    mpiexec = launcher()
    if is_mpich(mpiexec) and processes > MOST_WITH_MPICH:
        pytest.skip("needs Open MPI")
    crowd = [] if is_mpich(mpiexec) else ["--oversubscribe"]
    run = subprocess.run(
        [mpiexec, *crowd, "-n", str(processes), sys.executable, *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=folder,
        env={**os.environ, **AS_ROOT, "NGS_NUM_THREADS": "1"},
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


@functools.cache
def distributed(processes):
    found = json.loads(launched(processes, cases.__file__).splitlines()[-1])
    assert found["agree"]
    return found


@functools.cache
def on_one_process(function):
    return function(lambda make: make())


@pytest.mark.parametrize("processes", PROCESSES)
@pytest.mark.parametrize("case", cases.SOLVED)
def test_same_counts_energies_and_forces(case, processes):
    several, one = distributed(processes)["solved"][case], on_one_process(cases.solved)[case]
    assert several["status"] == one["status"] == "converged"
    assert abs(several["iterations"] - one["iterations"]) <= 1
    assert several["values"][0] == pytest.approx(one["values"][0], rel=1e-10)
    scale = np.abs(one["values"]).max()
    np.testing.assert_allclose(several["values"], one["values"], rtol=1e-8, atol=1e-8 * scale)
    first = one["iterations"] // 2
    assert several["residuals"][:first] == pytest.approx(one["residuals"][:first], rel=1e-6)


@pytest.mark.parametrize("processes", PROCESSES)
def test_same_starts_paths_histories_and_gaps(processes):
    several, one = distributed(processes)["more"], on_one_process(cases.more)
    assert several["iterations"] == pytest.approx(one["iterations"], abs=1)
    for name in ("path", "history", "duality"):
        np.testing.assert_allclose(several[name], one[name], rtol=1e-8, err_msg=name)


@pytest.mark.parametrize("processes", PROCESSES)
def test_illegal_data_are_refused_with_the_same_words(processes):
    one = on_one_process(cases.illegal)
    assert "accepted" not in one
    assert distributed(processes)["illegal"] == one


@pytest.mark.parametrize("processes", PROCESSES)
def test_what_is_not_there_is_refused(processes):
    refused = distributed(processes)["refused"]
    where = f"not on a mesh that is distributed over {processes} processes"
    assert [name for name, message in refused.items() if where not in message] == []
    assert "direct solver" in refused["inverse"]
    assert "FullProduct()" in refused["tichonov"]
    assert "semismooth_newton" in refused["primal"]


@pytest.mark.parametrize("processes", [2, 3])
def test_the_how_to_runs(processes, tmp_path):
    (tmp_path / "script.py").write_text(snippets(NEEDS_MPI)[0])
    printed = launched(processes, "script.py", folder=tmp_path).split()
    assert printed[:2] == ["Status.CONVERGED", "10"]
    assert float(printed[2]) == pytest.approx(0.373792404697, rel=1e-10)
    assert len(list(tmp_path.glob("lshape*.vtu"))) == processes - 1


def test_mpich_is_refused_where_ngsolve_overwrites_memory():
    """NGSolve's wheels and four processes: https://github.com/NGSolve/netgen/issues/196."""
    code = (
        "from mpi4py import MPI; from netgen.meshing import Mesh as M; from ngsolve import Mesh;"
        "from ngepc.geometries import lshape; from ngepc.checks.mpi import check_mpi;"
        "w = MPI.COMM_WORLD; "
        "check_mpi(Mesh(lshape.paper_mesh(65).ngmesh.Distribute(w) if w.rank == 0"
        " else M.Receive(w)))"
    )
    mpiexec = launcher()
    if not is_mpich(mpiexec):
        pytest.skip("needs MPICH")
    command = [mpiexec, "-n", "4", sys.executable, "-c", code]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert "Open MPI is needed, or at most 3 processes" in run.stderr
