"""Newton steps of the balanced regularisation on both examples, cold and nested."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from ngepc.dual.balanced import Balanced
from ngepc.dual.newton import semismooth_newton
from ngepc.dual.plastic_strain import PointwisePlasticStrain
from ngepc.dual.result import DualResult
from ngepc.geometries import lshape, wrench
from ngepc.model.examples import lshape_problem, wrench_problem
from ngepc.model.problem import Problem
from ngepc.studies.output import Table, write_table

EXAMPLES: dict[str, tuple[tuple[int, ...], Callable[[int], Problem]]] = {
    "(a)": (lshape.PAPER_NODES, lambda nodes: lshape_problem(lshape.paper_mesh(nodes))),
    "(b)": (wrench.PAPER_NODES, lambda nodes: wrench_problem(wrench.paper_mesh(nodes))),
}

REGULARISATIONS = {
    "Balanced(1e9)": Balanced(1e9),
    "Balanced()": Balanced(),
    "Balanced(1e9), p at every point": Balanced(1e9, plastic_strain=PointwisePlasticStrain()),
}


def count_balanced(levels: int, progress: Callable[[str], None] = lambda line: None) -> list[dict]:
    """Solve both examples on the first meshes of Tables 1 and 2, from v = 0 and nested.

    Parameters
    ----------
    levels
        Meshes, 1 to 6.
    progress
        Called with a line of text after each solve.

    Returns
    -------
    list of dict
        example, regularisation, start, nodes, status, iterations, dual_energy, cpu_s (one thread,
        with set-up).
    """
    table = []
    for example, (nodes, problem_on) in EXAMPLES.items():
        for name, regularisation in REGULARISATIONS.items():
            coarser = None
            for n in nodes[:levels]:
                problem = problem_on(n)
                for start in ("cold", "nested"):
                    begin, clock = coarser if start == "nested" else None, time.process_time()
                    result = semismooth_newton(problem, start=begin, regularisation=regularisation)
                    result.or_interrupted()
                    key = {"example": example, "regularisation": name, "start": start, "nodes": n}
                    table.append({**key, **_measured(result, clock)})
                    progress(f"{example} {name} {start} {n} nodes: {result.iterations} steps")
                coarser = result
    return table


def _measured(result: DualResult, clock: float) -> dict:
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "dual_energy": result.dual_energy,
        "cpu_s": time.process_time() - clock,
    }


def write_balanced(folder: Path, table: list[dict]) -> list[Path]:
    """Write balanced.csv, balanced.md and balanced.json."""
    rows = []
    for example in EXAMPLES:
        nodes = list(dict.fromkeys(c["nodes"] for c in table if c["example"] == example))
        rows.append([f"{example}, nodes", *nodes, ""])
        for name in REGULARISATIONS:
            for start in ("cold", "nested"):
                key = (example, name, start)
                cells = [c for c in table if (c["example"], c["regularisation"], c["start"]) == key]
                total = sum(c["iterations"] for c in cells)
                rows.append([f"{name}, {start}", *map(_text, cells), total])
    notes = [
        "Newton steps to a residual of 1e-10 in reference units; cold from v = 0, nested from the "
        "result on the next coarser mesh, the first mesh from v = 0. Contact is exact."
    ]
    meshes = range(1, len(rows[0]) - 1)
    head = ["", *(f"mesh {k}" for k in meshes), "total"]
    return write_table(
        folder,
        Table(
            name="balanced",
            title="Balanced regularisation",
            head=head,
            rows=rows,
            notes=notes,
            cells=table,
        ),
    )


def _text(cell: dict) -> str:
    ended = "" if cell["status"] == "converged" else f" {cell['status']}"
    return f"{cell['iterations']}{ended}"
