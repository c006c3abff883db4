"""Large bodies: a sphere pressed into a block, each mesh started from the one before.

Times are processor times of one thread and count everything from the coarsest mesh on, meshes
included.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from ngsolve import Mesh, sqrt, x, y

from ngepc.geometries import block
from ngepc.local.iterative import Iterative
from ngepc.local.petsc import PETSc
from ngepc.local.pyamg import PyAMG
from ngepc.local.result import ExactResult
from ngepc.local.solver import solve_exactly
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.studies.cost import peak_memory
from ngepc.studies.work import Cell, Outcome, Table, Work

LAME_MU = 1e3

DIRECT_NODES = 2000
"""The largest mesh on which the direct solver runs beside."""

TOLERANCE, MAX_STEPS = 1e-8, 50

HEAD = ("nodes", "Newton steps", "CG for a solve: mean", "most", "CPU s", "MB", "J", "direct")


def indented_block(refinements: int, hardening: float = 100.0, order: int = 1) -> Problem:
    """A sphere of radius 1 pressed 0.03 into a unit block; 55, 281, 1745, 12,193, ... nodes.

    Parameters
    ----------
    refinements
        Times that the coarsest mesh is refined.
    hardening
        h (stress); mu is 1e3.
    order
        Of the displacements.
    """
    mesh = block.mesh(maxh=0.4)
    for _ in range(refinements):
        mesh.Refine()
    return pressed(mesh, hardening, order)


def pressed(mesh: Mesh, hardening: float, order: int = 1) -> Problem:
    """The same on another mesh of the unit cube."""
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=LAME_MU, yield_stress=5.0, hardening=hardening
    )
    gap = 1.0 - sqrt(1.0 - (x - 0.5) ** 2 - (y - 0.5) ** 2) - 0.03
    return Problem(mesh, steel, "clamped", contact="contact", gap=gap, order=order)


def solve_large(
    levels: int,
    inverse: Iterative,
    hardening: float = 0.1,
    progress: Callable[[str], None] = lambda line: None,
) -> list[dict]:
    """Solve on ``levels`` meshes from 281 nodes on.

    Parameters
    ----------
    levels
        Number of meshes.
    inverse
        ``PETSc()`` or another iterative solver.
    hardening
        h/mu.
    progress
        Called with a line of text after each solve.

    Returns
    -------
    list of dict
        One record for each mesh: nodes, status, steps, iterations and solves of each step, energy,
        its relative difference to the direct solver's on small meshes, processor time, memory.
    """
    begin, result, records = time.process_time(), None, []
    mesh = block.mesh(maxh=0.4)
    for _ in range(levels):
        mesh.Refine()
        problem = pressed(Mesh(mesh.ngmesh.Copy()), hardening * LAME_MU)
        result = solve_exactly(problem, result, TOLERANCE, MAX_STEPS, inverse, None)
        record = _recorded(result, hardening, time.process_time() - begin)
        if problem.mesh.nv <= DIRECT_NODES:
            clock = time.process_time()
            direct = solve_exactly(problem, None, TOLERANCE, MAX_STEPS, "sparsecholesky", None)
            record["difference"] = abs(result.primal_energy / direct.primal_energy - 1)
            begin += time.process_time() - clock  # not part of the method
        records.append(record)
        progress("  ".join(text_of(record)))
    return records


def _recorded(result: ExactResult, hardening: float, seconds: float) -> dict:
    """The numbers of one solve."""
    return {
        "hardening": hardening,
        "nodes": result.problem.mesh.nv,
        "status": result.status.label,
        "steps": result.iterations,
        "solves": result.history.column("back_substitutions")[1:],
        "iterations": result.history.column("linear_iterations")[1:],
        "energy": result.primal_energy,
        "difference": None,
        "cpu_s": seconds,
        "memory_mb": peak_memory(),
    }


def text_of(record: dict) -> list[str]:
    """The row of a record under ``HEAD``; "most" is the mean of the dearest Newton step."""
    solves = [max(1, n) for n in record["solves"]]
    most = max((n / k for n, k in zip(record["iterations"], solves, strict=True)), default=0.0)
    done = "" if record["status"] == "converged" else f" {record['status']}"
    check = "" if record["difference"] is None else f"{record['difference']:.0e}"
    return [
        f"{record['nodes']:,}",
        f"{record['steps']}{done}",
        f"{sum(record['iterations']) / max(1, sum(solves)):.1f}",
        f"{most:.0f}",
        f"{record['cpu_s']:.1f}",
        f"{record['memory_mb'] or 0:.0f}",
        f"{record['energy']:.10f}",
        check,
    ]


HARDENINGS = (1.0, 0.1, 0.01, 0.001)
"""Values of h/mu."""

SOLVERS = {"pyamg": PyAMG, "petsc": PETSc}


@dataclass(eq=False)
class Large(Work):
    """The study: all meshes in a row for each hardening, each started from the one before.

    Parameters
    ----------
    levels
        Meshes: 281, 1745, 12,193, 90,945 nodes.
    solver
        'pyamg' or 'petsc'.
    """

    levels: int = 3
    solver: str = "pyamg"

    name = "large"
    title = "A sphere pressed into a block, by iterative solvers"

    def settings(self) -> dict:
        """The meshes and the solver."""
        return {"levels": self.levels, "solver": self.solver}

    def cells(self) -> list[Cell]:
        """One for each hardening."""
        return [Cell(f"h over mu {value:g}") for value in HARDENINGS]

    def solve(self, cell: Cell) -> Outcome:
        """All meshes for one hardening, in a process of its own: its memory is measured."""
        inverse, value = SOLVERS[self.solver](), float(cell.row.split()[-1])
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            meshes = pool.submit(solve_large, self.levels, inverse, value).result()
        return Outcome({"hardening": value, "meshes": meshes})

    def line(self, r: dict) -> str:
        """The last mesh."""
        return f"h/mu {r['hardening']:g}: " + "  ".join(text_of(r["meshes"][-1]))

    def table(self, records: Sequence[dict]) -> Table:
        """A row for each mesh."""
        rows = [[f"{r['hardening']:g}", *text_of(m)] for r in records for m in r["meshes"]]
        note = (
            f"Solver {self.solver}, tolerance {TOLERANCE:g}, nested from 281 nodes; CPU seconds "
            "from the coarsest mesh on, meshes included; MB: the most that the process has held so "
            "far; direct: difference of the energies."
        )
        head = ("h/mu", *HEAD)
        return Table(
            name=self.name, title=self.title, head=head, rows=rows, notes=[note], cells=records
        )
