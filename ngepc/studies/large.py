"""Large bodies: a sphere pressed into a block, by iterative solvers and on several processes.

Each solve starts from the solution on the coarser mesh.  Times are processor times of one thread,
or of each process, from the coarsest mesh on; they include mesh generation and waiting for other
processes, as MPI waits busily.  With fewer free cores than processes only counts and energies are
meaningful.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ngsolve import Mesh, sqrt, x, y

from ngepc.geometries import block
from ngepc.local.exact import solve_exactly
from ngepc.local.iterative import Iterative
from ngepc.local.petsc import PETSc
from ngepc.local.pyamg import PyAMG
from ngepc.local.result import ExactResult
from ngepc.model.material import Material
from ngepc.model.parts import INSTALL, MPI, MeshPart, distribute
from ngepc.model.problem import Problem
from ngepc.studies.examples import in_own_process, peak_memory
from ngepc.studies.work import OverMeshes

LAME_MU = 1e3
DIRECT_NODES = 2000
"""The largest mesh on which the direct solver is run for comparison."""
TOLERANCE = 1e-8
MAX_STEPS = 50
HARDENINGS = (1.0, 0.1, 0.01, 0.001)
SHARED_HARDENING = 0.1
"""Values of h/mu, and the value for runs on several processes."""
SOLVERS = {"pyamg": PyAMG, "petsc": PETSc}


def indented_block(
    refinements: int, hardening: float = 100.0, order: int = 1
) -> Problem:
    """A sphere of radius 1 pressed 0.03 into a unit block; 55, 281, 1745, 12,193, ... nodes.

    The coarsest mesh is refined ``refinements`` times; ``hardening`` is h (stress), mu is 1e3.
    """
    mesh = block.mesh(maxh=0.4)
    for _ in range(refinements):
        mesh.Refine()
    return pressed(mesh, hardening, order)


def pressed(mesh: Mesh, hardening: float, order: int = 1) -> Problem:
    """The same problem on any mesh of the unit cube."""
    elastic = {"lame_lambda": 1e3, "lame_mu": LAME_MU, "yield_stress": 5.0}
    steel = Material.kinematic(**elastic, hardening=hardening)
    gap = 1.0 - sqrt(1.0 - (x - 0.5) ** 2 - (y - 0.5) ** 2) - 0.03
    return Problem(mesh, steel, "clamped", contact="contact", gap=gap, order=order)


def solved_in_a_row(
    mesh: Mesh | MeshPart,
    levels: int,
    hardening: float,
    inverse: Iterative,
    order: int = 1,
) -> Iterator[tuple[ExactResult, dict]]:
    """Results and records on meshes refined once, twice ..., each started from the last result."""
    result = None
    for _ in range(levels):
        if isinstance(mesh, MeshPart):
            finer = mesh = mesh.refined()
        else:
            mesh.Refine()  # refine in place: a copy loses the marks for the next bisection
            finer = Mesh(mesh.ngmesh.Copy())
        problem = pressed(finer, hardening * LAME_MU, order)
        result = solve_exactly(problem, result, TOLERANCE, MAX_STEPS, inverse, None)
        names = ("back_substitutions", "linear_iterations")
        solves, linear = (result.history.column(name)[1:] for name in names)
        each = [n / max(1, k) for n, k in zip(linear, solves, strict=True)]
        numbers = {"status": result.status.label, "iterations": result.iterations}
        numbers |= {
            "solves": solves,
            "linear_iterations": linear,
            "most": max(each, default=0.0),
        }
        numbers |= {
            "mean": sum(linear) / max(1, sum(solves)),
            "energy": result.primal_energy,
        }
        yield result, numbers


def solve_large(
    levels: int, inverse: Iterative, hardening: float = 0.1, order: int = 1
) -> list[dict]:
    """The records of ``levels`` meshes from 281 vertices on; ``hardening`` is h/mu.

    'difference' is the relative difference of the energy from the direct solver's, on small meshes.
    """
    begin = time.process_time()
    records = []
    runs = solved_in_a_row(block.mesh(maxh=0.4), levels, hardening, inverse, order)
    for result, numbers in runs:
        about = {"nodes": len(result.state.u), **numbers}
        about |= {"cpu_s": time.process_time() - begin, "memory_mb": peak_memory()}
        if about["nodes"] <= DIRECT_NODES:
            clock = time.process_time()
            start = (None, TOLERANCE, MAX_STEPS)
            direct = solve_exactly(result.problem, *start, "sparsecholesky", None)
            about["difference"] = abs(about["energy"] / direct.primal_energy - 1)
            begin += time.process_time() - clock  # not part of the method
        records.append(about)
    return records


@dataclass(eq=False)
class Large(OverMeshes):
    """``levels`` meshes in a row for each hardening, each started from the one before."""

    solver: str = "pyamg"
    order: int = 1

    name = "large"
    title = "A sphere pressed into a block, by iterative solvers"
    columns = """h/mu = {hardening:g} | nodes = {nodes:,} | Newton steps = {steps}
        | CG for a solve: mean = {mean:.1f} | most = {most:.0f} | CPU s = {cpu_s:.1f}
        | MB = {memory_mb:.0f} | J = {energy:.10f} | direct = {difference:.0e}"""
    note = (
        f"Solver {{study.solver}}, order {{study.order}}, tolerance {TOLERANCE:g}, nested from "
        "281 vertices; CPU seconds "
        "from the coarsest mesh on, meshes included; MB: peak memory of the process so far; "
        "direct: difference from the energy by the direct solver."
    )

    def cells(self) -> list[dict]:
        """One for each hardening."""
        about = {"solver": self.solver, "levels": self.levels, "order": self.order}
        return [{"hardening": value, **about} for value in HARDENINGS]

    def solve(
        self, hardening: float, solver: str, levels: int, order: int
    ) -> list[dict]:
        """All meshes for one hardening."""
        inverse = SOLVERS[solver]()
        return in_own_process(solve_large, levels, inverse, hardening, order)


LAUNCH = (
    "mpiexec",
    "--allow-run-as-root",
    "--oversubscribe",
    "--bind-to",
    "none",
    "-n",
)
"""Options of Open MPI to run as root and with more processes than cores, as in containers.

Open MPI binds up to two processes to a core each.  There the threads of Netgen, which makes the
coarsest mesh, wait for each other: 1.6 s in place of 0.1 s.
"""

CHILD = "import sys; from ngepc.studies.large import child; child(*sys.argv[1:])"


def child(levels: str, path: str, order: str) -> None:
    """The work of each process of a cell; process 0 writes the records of all meshes to a file."""
    world = MPI.COMM_WORLD
    begin = time.process_time()
    clock = time.perf_counter()
    records = []
    whole = distribute(block.mesh(maxh=0.4) if world.rank == 0 else None)
    size = int(levels), SHARED_HARDENING
    runs = solved_in_a_row(whole, *size, PETSc(), int(order))
    for result, numbers in runs:
        mesh = result.problem.mesh
        seconds = time.process_time()
        wall = time.perf_counter() - clock
        own = world.allgather((len(result.state.u), seconds - begin, peak_memory()))
        each = dict(
            zip(("own", "cpu_s", "mb"), map(list, zip(*own, strict=True)), strict=True)
        )
        about = {"force": result.contact_force, "wall_s": wall, **each}
        about |= {f"largest_{name}": max(values) for name, values in each.items()}
        nodes = mesh.of_nodes(int(order)).node_count
        records.append({"nodes": nodes, **numbers, **about})
    if world.rank == 0:
        Path(path).write_text(json.dumps(records), encoding="utf-8")


@dataclass(eq=False)
class Processes(OverMeshes):
    """``levels`` meshes in a row, 5 for 702,081 nodes, for each number of ``counts``."""

    counts: Sequence[int] = (1, 2, 4, 8)
    order: int = 1

    name = "processes"
    title = "A sphere pressed into a block, distributed over processes"
    columns = """nodes = {nodes:,} | processes = {processes}
        | nodes of the largest part = {largest_own:,} | Newton steps = {steps}
        | CG for a solve = {mean:.1f} | CPU s of a process = {largest_cpu_s:.1f}
        | of one process = {ratio:.2f} | wall s = {wall_s:.0f} | MB of a process = {largest_mb:.0f}
        | J = {energy:.12f}"""

    def cells(self) -> list[dict]:
        """One for each number of processes."""
        PETSc()  # raises if it is missing
        if MPI is None:
            raise ImportError(INSTALL)
        about = {"levels": self.levels, "order": self.order}
        return [{"processes": count, **about} for count in self.counts]

    def solve(self, processes: int, levels: int, order: int) -> list[dict]:
        """All meshes on some processes."""
        mine = ("OMPI_", "PMIX_")  # variables of an MPI run around this process
        clean = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(mine)
        }
        # processes that wait yield their cores
        clean["OMPI_MCA_mpi_yield_when_idle"] = "1"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "records.json"
            program = [
                sys.executable,
                "-m",
                "mpi4py",
                "-c",
                CHILD,
                str(levels),
                str(path),
                str(order),
            ]
            run = subprocess.run(
                [*LAUNCH, str(processes), *program], check=False, env=clean
            )
            if run.returncode:
                raise OSError(
                    f"{processes} processes: mpiexec ended with status {run.returncode}"
                )
            return json.loads(path.read_text(encoding="utf-8"))

    def table_rows(self, records: Sequence[dict]) -> list[dict]:
        """A row for each mesh and number of processes, mesh by mesh."""
        alone = {r["nodes"]: r["largest_cpu_s"] for r in records if r["processes"] == 1}
        rows = []
        for r in sorted(records, key=lambda r: (r["nodes"], r["processes"])):
            one = alone.get(r["nodes"])
            rows.append(r | {"ratio": one and r["largest_cpu_s"] / one})
        return rows

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What the numbers mean."""
        cores = len(os.sched_getaffinity(0))
        return [
            f"h/mu {SHARED_HARDENING:g}, order {self.order}, tolerance {TOLERANCE:g}, PETSc(), "
            "nested from 281 vertices, "
            f"{cores} cores. CPU, wall and MB are those from the coarsest mesh on and of the "
            "process with most. Column 'of one process': this CPU time divided by that of a single "
            f"process. Waiting counts as CPU time, so that times with more than {cores} processes "
            "mean little. Weak scaling: eight times the processes on the next mesh."
        ]
