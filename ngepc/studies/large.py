"""Large bodies: a sphere pressed into a block, each mesh started from the one before.

Times are processor times of one thread and count everything from the coarsest mesh on, meshes
included.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

from ngsolve import Mesh, sqrt, x, y

from ngepc.discretisation.stiffness import StiffnessBlocks, SymbolicBlocks
from ngepc.geometries import block
from ngepc.local.iterative import Iterative
from ngepc.local.petsc import PETSc
from ngepc.local.pyamg import PyAMG
from ngepc.local.result import ExactResult
from ngepc.local.solver import solve_exactly
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.studies.cost import peak_memory
from ngepc.studies.work import Cell, Work, steps

LAME_MU = 1e3

DIRECT_NODES = 2000
"""The largest mesh on which the direct solver runs beside."""

TOLERANCE, MAX_STEPS = 1e-8, 50

HARDENINGS = (1.0, 0.1, 0.01, 0.001)
"""Values of h/mu."""

SOLVERS = {"pyamg": PyAMG, "petsc": PETSc}


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


def solve_large(levels: int, inverse: Iterative, hardening: float = 0.1) -> list[dict]:
    """Solve on ``levels`` meshes from 281 nodes on.

    Parameters
    ----------
    levels
        Number of meshes.
    inverse
        ``PETSc()`` or another iterative solver.
    hardening
        h/mu.

    Returns
    -------
    list of dict
        One record for each mesh: nodes, status, Newton steps, linear iterations and solves of each,
        energy, its relative difference to the direct solver's on small meshes, processor time,
        memory.
    """
    begin, result, records = time.process_time(), None, []
    mesh = block.mesh(maxh=0.4)
    for _ in range(levels):
        mesh.Refine()
        problem = pressed(Mesh(mesh.ngmesh.Copy()), hardening * LAME_MU)
        result = solve_exactly(problem, result, TOLERANCE, MAX_STEPS, inverse, None)
        about = {"hardening": hardening, "nodes": problem.mesh.nv, **numbers_of(result)}
        about |= {"cpu_s": time.process_time() - begin, "memory_mb": peak_memory()}
        if problem.mesh.nv <= DIRECT_NODES:
            clock = time.process_time()
            direct = solve_exactly(problem, None, TOLERANCE, MAX_STEPS, "sparsecholesky", None)
            about["difference"] = abs(result.primal_energy / direct.primal_energy - 1)
            begin += time.process_time() - clock  # not part of the method
        records.append(about)
    return records


def numbers_of(result: ExactResult) -> dict:
    """Status, counts and energy of a solve."""
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "solves": result.history.column("back_substitutions")[1:],
        "linear_iterations": result.history.column("linear_iterations")[1:],
        "energy": result.primal_energy,
    }


def mean_iterations(record: dict) -> str:
    """Linear iterations of a solve, in the mean of a run."""
    return f"{sum(record['linear_iterations']) / max(1, sum(record['solves'])):.1f}"


def most_iterations(record: dict) -> str:
    """The same for the dearest Newton step."""
    pairs = zip(record["linear_iterations"], record["solves"], strict=True)
    return f"{max((n / max(1, k) for n, k in pairs), default=0.0):.0f}"


def assembly_times(refinements: int = 2, repeats: int = 3) -> dict[str, float]:
    """Processor time to assemble a tangent directly and by symbolic forms, microseconds a cell."""
    discrete = DiscreteProblem(indented_block(refinements))
    moduli, found = starting_state(discrete, None).moduli, {}
    for kind in (StiffnessBlocks, SymbolicBlocks):
        blocks = kind(discrete.points, discrete.free, discrete.added)
        blocks.values(moduli)
        begin = time.process_time()
        for _ in range(repeats):
            blocks.values(moduli)
        spent = time.process_time() - begin
        found[kind.__name__] = 1e6 * spent / (repeats * discrete.problem.mesh.ne)
    return found


@dataclass(eq=False)
class Large(Work):
    """``levels`` meshes in a row for each hardening, each started from the one before."""

    levels: int = 3
    solver: str = "pyamg"

    name, title = "large", "A sphere pressed into a block, by iterative solvers"
    settings = ("levels", "solver")
    columns = (
        ("h/mu", "{hardening:g}"),
        ("nodes", "{nodes:,}"),
        ("Newton steps", steps),
        ("CG for a solve: mean", mean_iterations),
        ("most", most_iterations),
        ("CPU s", "{cpu_s:.1f}"),
        ("MB", "{memory_mb:.0f}"),
        ("J", "{energy:.10f}"),
        ("direct", "{difference:.0e}"),
    )

    def cells(self) -> list[Cell]:
        """One for each hardening."""
        return [Cell(f"h over mu {value:g}") for value in HARDENINGS]

    def solve(self, cell: Cell) -> list[dict]:
        """All meshes for one hardening, in a process of its own: its memory is measured."""
        inverse, value = SOLVERS[self.solver](), float(cell.row.split()[-1])
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(solve_large, self.levels, inverse, value).result()

    def notes(self, records: Sequence[dict]) -> list[str]:
        """What the numbers mean."""
        return [
            f"Solver {self.solver}, tolerance {TOLERANCE:g}, nested from 281 nodes; CPU seconds "
            "from the coarsest mesh on, meshes included; MB: the most that the process has held so "
            "far; direct: difference of the energies."
        ]
