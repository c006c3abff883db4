"""A mesh distributed over MPI processes is refused with a message, not solved wrongly."""

import shutil
import subprocess
import sys

import pytest

CODE = """
import netgen.meshing, ngsolve
from mpi4py import MPI
from ngepc import lshape_problem
from ngepc.geometries import lshape
world = MPI.COMM_WORLD
if world.rank == 0:
    part = lshape.paper_mesh(113).ngmesh.Distribute(world)
else:
    part = netgen.meshing.Mesh.Receive(world)
try:
    lshape_problem(ngsolve.Mesh(part))
except ValueError as error:
    print(error, flush=True)
"""


def test_distributed_mesh_is_refused_by_every_process():
    pytest.importorskip("mpi4py")
    launcher = shutil.which("mpiexec")
    if launcher is None:
        pytest.skip("needs mpiexec")
    done = subprocess.run(
        [launcher, "-n", "2", sys.executable, "-c", CODE],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    message = "mesh is distributed over 2 processes: a mesh of one process is needed"
    assert done.stdout.count(message) == 2
