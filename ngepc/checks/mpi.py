"""Whether NGSolve and the MPI library that distributes a mesh get on with each other."""

from __future__ import annotations

from netgen import config
from ngsolve import Mesh

MOST_WITH_MPICH = 3
"""Processes with NGSolve's wheels and MPICH: no part of the mesh has several neighbours then."""

POINTER = 8
"""Bytes of a handle that NGSolve's wheels can pass to MPI in arrays."""


def check_mpi(mesh: Mesh) -> None:
    """An MPI library that NGSolve gets on with.

    The wheels of NGSolve hand MPI arrays of requests with 8 bytes each.  Those of MPICH have 4, and
    it waits for the first of them alone: memory is overwritten where a part of the mesh has two
    neighbours, https://github.com/NGSolve/netgen/issues/196.

    Raises
    ------
    ValueError
        If too many processes use MPICH.
    """
    if mesh.comm.size <= MOST_WITH_MPICH or "NG_MPI_WRAPPER" not in compile_definitions():
        return
    from mpi4py import MPI

    if MPI._sizeof(MPI.Request) < POINTER:
        library = MPI.Get_library_version().split("\n")[0].strip()
        raise ValueError(
            f"mesh is distributed over {mesh.comm.size} processes by {library}: with NGSolve's "
            f"wheels Open MPI is needed, or at most {MOST_WITH_MPICH} processes"
        )


def compile_definitions() -> str:
    """The definitions that Netgen was compiled with."""
    return getattr(config, "ngcore_compile_definitions", "")
