"""Which would you choose: coupled, exact and primal side by side, cold and nested."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.dual.newton import semismooth_newton
from ngepc.dual.regularisation import Coupled
from ngepc.geometries import lshape
from ngepc.model.examples import lshape_problem
from ngepc.primal.solver import primal_newton
from ngepc.studies.output import Table, write_table

METHODS: dict[str, Callable] = {
    "coupled 1e4": lambda problem, start: semismooth_newton(
        problem, start=start, regularisation=Coupled(1e4)
    ),
    "exact": lambda problem, start: semismooth_newton(problem, start=start),
    "primal": lambda problem, start: primal_newton(problem, start),
}


def compare_solvers(
    nodes: Sequence[int], progress: Callable[[str], None] = lambda line: None
) -> list[dict]:
    """Solve Example (a) by every method on every mesh, cold and from the next coarser mesh.

    Parameters
    ----------
    nodes
        Members of the mesh family, ascending; the nested runs start from the cold one on the
        417-node mesh.
    progress
        Called with a line of text after each solve.

    Returns
    -------
    list of dict
        method, start, nodes, status, iterations, cpu_s (processor time of one thread), energy J.
    """
    table = []
    for method, solve in METHODS.items():
        previous = solve(lshape_problem(lshape.paper_mesh(lshape.COARSE_NODES)), None)
        previous.or_interrupted()
        for n in nodes:
            problem = lshape_problem(lshape.paper_mesh(n))
            runs = {}
            for start, begin in (("cold", None), ("nested", previous)):
                clock = time.process_time()
                runs[start] = result = solve(problem, begin).or_interrupted()
                table.append(
                    {
                        "method": method,
                        "start": start,
                        "nodes": n,
                        "status": result.status.label,
                        "iterations": result.iterations,
                        "cpu_s": time.process_time() - clock,
                        "primal_energy": result.primal_energy,
                    }
                )
                progress(f"{method} {start} {n} nodes: {result.iterations} steps")
            previous = runs["nested"]
    return table


def write_solvers(folder: Path, table: Sequence[dict]) -> list[Path]:
    """Write the comparison; errors are relative to the primal energy on the finest mesh."""
    finest = max(cell["nodes"] for cell in table)
    best = next(
        c["primal_energy"] for c in table if (c["method"], c["nodes"]) == ("primal", finest)
    )
    nodes = list(dict.fromkeys(cell["nodes"] for cell in table))
    rows = []
    for method in METHODS:
        for start in ("cold", "nested"):
            cells = [c for c in table if (c["method"], c["start"]) == (method, start)]
            rows.append([f"{method}, {start}", *(_text(c, best) for c in cells)])
    notes = [
        "Example (a): Newton steps, processor time of one thread with set-up, and the relative "
        f"difference of the energy J to the primal solver's on {finest} nodes. Coupled at a fixed "
        "gamma solves another problem, whose energy does not tend to this limit."
    ]
    head = ["method", *(f"{n} nodes" for n in nodes)]
    return write_table(
        folder,
        Table(
            name="solvers",
            title="Which would you choose",
            head=head,
            rows=rows,
            notes=notes,
            cells=table,
        ),
    )


def _text(cell: dict, best: float) -> str:
    error = abs(cell["primal_energy"] / best - 1)
    done = "" if cell["status"] == "converged" else f" {cell['status']}"
    return f"{cell['iterations']}{done}, {cell['cpu_s']:.1f} s, {error:.1e}"
