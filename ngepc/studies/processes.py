"""The body of the large study shared by processes: strong and weak scaling.

Each cell is a run of ``mpiexec``.  Times are processor times of a process from the coarsest mesh
on, meshes included, and so is what it waits for others: MPI waits busily.  With fewer free cores
than processes they mean nothing, counts and energies do.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ngepc.geometries import block
from ngepc.local.petsc import PETSc
from ngepc.local.solver import solve_exactly
from ngepc.model.parts import INSTALL, MPI, distribute
from ngepc.studies.cost import peak_memory
from ngepc.studies.large import (
    LAME_MU,
    MAX_STEPS,
    TOLERANCE,
    mean_iterations,
    numbers_of,
    pressed,
)
from ngepc.studies.work import Cell, Table, Work, steps

HARDENING = 0.1
"""h/mu."""

LAUNCH = ("mpiexec", "--allow-run-as-root", "--oversubscribe", "-n")
"""As root and with more processes than cores, as in containers; both are Open MPI's."""

CHILD = "import sys; from ngepc.studies.processes import child; child(sys.argv[1], sys.argv[2])"


def child(levels: str, path: str) -> None:
    """What each process of a cell does; process 0 writes the records of all meshes to a file."""
    world, begin, clock = MPI.COMM_WORLD, time.process_time(), time.perf_counter()
    mesh, result, records = distribute(block.mesh(maxh=0.4) if world.rank == 0 else None), None, []
    for _ in range(int(levels)):
        mesh = mesh.refined()
        problem = pressed(mesh, HARDENING * LAME_MU)
        result = solve_exactly(problem, result, TOLERANCE, MAX_STEPS, PETSc(), None)
        seconds, wall = time.process_time() - begin, time.perf_counter() - clock
        own = world.allgather((mesh.nv, seconds, peak_memory()))
        records.append(
            {
                "processes": world.size,
                "nodes": mesh.processes.count,
                **numbers_of(result),
                "force": result.contact_force,
                "wall_s": wall,
                **dict(zip(("own", "cpu_s", "mb"), map(list, zip(*own, strict=True)), strict=True)),
            }
        )
    if world.rank == 0:
        Path(path).write_text(json.dumps(records), encoding="utf-8")


@dataclass(eq=False)
class Processes(Work):
    """``levels`` meshes in a row, 5 for 702,081 nodes, for each number of ``counts``."""

    levels: int = 3
    counts: Sequence[int] = (1, 2, 4, 8)

    name, title = "processes", "A sphere pressed into a block that processes share"
    settings = ("levels",)
    columns = (
        ("nodes", "{nodes:,}"),
        ("processes", "{processes}"),
        ("nodes of the largest part", lambda r: f"{max(r['own']):,}"),
        ("Newton steps", steps),
        ("CG for a solve", mean_iterations),
        ("CPU s of a process", lambda r: f"{max(r['cpu_s']):.1f}"),
        ("of one process", "{ratio:.2f}"),
        ("wall s", "{wall_s:.0f}"),
        ("MB of a process", lambda r: f"{max(r['mb']):.0f}"),
        ("J", "{energy:.12f}"),
    )

    def cells(self) -> list[Cell]:
        """One for each number of processes."""
        PETSc()  # says so if it is missing
        if MPI is None:
            raise ImportError(INSTALL)
        return [Cell(f"{count} processes") for count in self.counts]

    def solve(self, cell: Cell) -> list[dict]:
        """All meshes on some processes."""
        mine = ("OMPI_", "PMIX_")  # what an MPI of this process has left
        clean = {name: value for name, value in os.environ.items() if not name.startswith(mine)}
        clean["OMPI_MCA_mpi_yield_when_idle"] = "1"  # who waits leaves the core to others
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "records.json"
            program = [sys.executable, "-m", "mpi4py", "-c", CHILD, str(self.levels), str(path)]
            run = subprocess.run([*LAUNCH, cell.row.split()[0], *program], check=False, env=clean)
            if run.returncode:
                raise OSError(f"{cell.row}: mpiexec ended with exit status {run.returncode}")
            return json.loads(path.read_text(encoding="utf-8"))

    def table(self, records: Sequence[dict]) -> Table:
        """A row for each mesh and number of processes, mesh by mesh."""
        alone = {r["nodes"]: max(r["cpu_s"]) for r in records if r["processes"] == 1}
        told = [
            r | ({"ratio": max(r["cpu_s"]) / alone[r["nodes"]]} if r["nodes"] in alone else {})
            for r in records
        ]
        return super().table(sorted(told, key=lambda r: (r["nodes"], r["processes"])))

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What the numbers mean."""
        cores = len(os.sched_getaffinity(0))
        return [
            f"h/mu {HARDENING:g}, tolerance {TOLERANCE:g}, PETSc(), nested from 281 nodes, {cores} "
            "cores. CPU, wall and MB are those from the coarsest mesh on and of the process with "
            "most; of one process: that CPU time over the one of a single process. Waiting counts "
            f"as CPU: beyond {cores} processes times mean nothing. Weak scaling: eight times the "
            "processes on the next mesh."
        ]
