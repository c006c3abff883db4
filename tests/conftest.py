"""One thread (the same digits twice), no messages from the mesh generator, no windows."""

import os

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from netgen.meshing import SetMessageImportance
from ngsolve import SetNumThreads


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    SetNumThreads(1)
    SetMessageImportance(0)
