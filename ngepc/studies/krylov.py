"""Counts of the Krylov solvers on a block under a sphere, over refinements and gamma."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.dual.balanced import Balanced
from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.dual.plastic_strain import PointwisePlasticStrain
from ngepc.dual.result import DualResult
from ngepc.krylov.solver import Krylov
from ngepc.model.problem import Problem
from ngepc.studies.benchmark import peak_memory
from ngepc.studies.large import indented_block
from ngepc.studies.output import Table, write_table

POINTWISE = PointwisePlasticStrain()

CASES = {
    "gamma_T chosen by the mesh": Balanced(plastic_strain=POINTWISE),
    "1e3": Balanced(1e3, plastic_strain=POINTWISE),
    "1e5": Balanced(1e5, plastic_strain=POINTWISE),
    "1e7": Balanced(1e7, plastic_strain=POINTWISE),
    "1e9": Balanced(1e9, plastic_strain=POINTWISE),
    "1e9, p constant on elements": Balanced(1e9),
}
"""The first one is solved on every mesh."""

MESHES = 4
"""The last one has 90,945 nodes."""

DIRECT_NODES = 2000
"""The largest mesh on which the direct solver runs beside."""

QUADRATURE_POINTS = 60
TOLERANCE = 1e-8


def count_iterations(
    levels: int, progress: Callable[[str], None] = lambda line: None
) -> list[dict]:
    """Solve on ``levels`` meshes, all cases on all but the last of four.

    Parameters
    ----------
    levels
        Number of meshes; the first has 281 nodes.
    progress
        Called with a line of text after each solve.

    Returns
    -------
    list of dict
        case, nodes, status, Newton steps, MINRES solves, the iterations of each step, energy,
        its relative difference to the direct solver's where that has run, processor time, memory.
    """
    table = []
    for level in range(1, levels + 1):
        problem = indented_block(level)
        for case in CASES if level < MESHES else list(CASES)[:1]:
            clock = time.process_time()
            result = _solve(problem, CASES[case], Krylov())
            cell = _cell(result, case, time.process_time() - clock)
            if problem.mesh.nv <= DIRECT_NODES:
                direct = _solve(problem, CASES[case], "sparsecholesky")
                cell["difference"] = abs(result.dual_energy / direct.dual_energy - 1)
                cell["steps_direct"] = direct.iterations
            table.append(cell)
            progress(f"{cell['nodes']} nodes, {case}: {cell['steps']} steps, {cell['status']}")
    return table


def _solve(problem: Problem, regularisation: Balanced, inverse: str | Krylov) -> DualResult:
    options = NewtonOptions(
        tolerance=TOLERANCE, quadrature_points=QUADRATURE_POINTS, inverse=inverse
    )
    result = semismooth_newton(problem, regularisation=regularisation, options=options)
    return result.or_interrupted()


def _cell(result: DualResult, case: str, seconds: float) -> dict:
    history = result.history
    return {
        "case": case,
        "nodes": result.problem.mesh.nv,
        "status": result.status.label,
        "steps": result.iterations,
        "solves": history.column("back_substitutions")[1:],
        "iterations": history.column("linear_iterations")[1:],
        "dual_energy": result.dual_energy,
        "difference": None,
        "steps_direct": None,
        "cpu_s": seconds,
        "memory_mb": peak_memory(),
    }


def write_krylov(folder: Path, table: Sequence[dict]) -> list[Path]:
    """Write the table of counts."""
    nodes = list(dict.fromkeys(cell["nodes"] for cell in table))
    rows = []
    for case in dict.fromkeys(cell["case"] for cell in table):
        cells = {c["nodes"]: c for c in table if c["case"] == case}
        rows.append([case, *(_text(cells[n]) if n in cells else "" for n in nodes)])
    notes = [
        "A sphere pressed into a block, Balanced(gamma_T) with plastic strains at every point, "
        f"cold, tolerance {TOLERANCE:g}: Newton steps (those with the direct solver), MINRES "
        "iterations for one solve (mean over the run; mean in the dearest Newton step), processor "
        "time of one thread, and the relative difference of J*_gamma to the direct solver's."
    ]
    head = ["", *(f"{n} nodes" for n in nodes)]
    title = "Krylov solvers in three dimensions"
    return write_table(
        folder,
        Table(name="krylov", title=title, head=head, rows=rows, notes=notes, cells=table),
    )


def _text(cell: dict) -> str:
    mean = sum(cell["iterations"]) / max(1, sum(cell["solves"]))
    done = "" if cell["status"] == "converged" else f" {cell['status']}"
    beside, check = "", ""
    if cell["difference"] is not None:
        beside, check = f" ({cell['steps_direct']})", f", {cell['difference']:.0e}"
    pairs = zip(cell["iterations"], cell["solves"], strict=True)
    most = max((n / max(1, solves) for n, solves in pairs), default=0)
    return f"{cell['steps']}{beside}{done}; {mean:.0f}; {most:.0f}; {cell['cpu_s']:.0f} s{check}"
