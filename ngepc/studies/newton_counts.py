"""Newton steps of the default method: meshes, nested iteration, small hardening, three dimensions.

Beside it the primal method, and GetFEM 5.4.2 on Example (a) as it was measured.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

from ngepc.geometries import block
from ngepc.model.problem import Problem
from ngepc.results.result import Result
from ngepc.studies.examples import BODIES, FAMILIES, TITLES, example, solved_by
from ngepc.studies.large import LAME_MU, indented_block, pressed
from ngepc.studies.work import Cell, Work, first_of, steps

RATIOS = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
HARDENED_NODES = (833, 3201)
GETFEM = {833: (11, 0.1), 3201: (15, 0.8), 12545: (22, 4.7)}
"""Nodes of Example (a) -> Newton steps and CPU seconds of GetFEM 5.4.2 with its best parameter."""

BLOCK_RATIOS = (1e-1, 1e-3)
BLOCKS = {
    "tetrahedra": {281: 1, 1745: 2, 12193: 3},
    "hexahedra": {343: 6, 1728: 11, 12167: 22},
}
"""Elements -> nodes -> refinements of a coarse mesh, or cells along an edge."""

NOTE = (
    "Cold starts, nested ones from the next coarser mesh, and the primal method; tolerance 1e-10 "
    "(relative forces out of balance); CPU seconds of one thread, set-up included. Rows with h / "
    "mu are Example (a) with other hardening, and a sphere of radius 1 pressed 0.03 into a unit "
    "cube. GetFEM 5.4.2 with its best parameter: measured earlier, on a quiet machine, not here. "
    "'stagnated': the residual has come down to its own rounding, which is above 1e-10 there."
)


def problem_of(body: str, nodes: int, ratio: float | None = None) -> Problem:
    """An example, with the kinematic hardening ``ratio`` mu if given, or a block of BLOCKS."""
    if body in FAMILIES:
        problem = example(body, nodes)
        if ratio is None:
            return problem
        hardening = ratio * problem.material.lame_mu
        return replace(problem, material=replace(problem.material, hardening=hardening))
    size = BLOCKS[body][nodes]
    if body == "tetrahedra":
        return indented_block(size, ratio * LAME_MU)
    return pressed(block.structured_mesh(size, size, size), ratio * LAME_MU)


@cache
def nested(name: str, nodes: int) -> Result:
    """The solution of an example on a mesh, reached through all coarser ones of its family."""
    family = (BODIES[name].COARSE_NODES, *FAMILIES[name])
    coarser = family.index(nodes) - 1
    start = nested(name, family[coarser]) if coarser >= 0 else None
    return solved_by("default", example(name, nodes), start)


def timed(solve: Callable[[], Result]) -> dict:
    """Status, steps and processor time (s) of a solve, set-up included."""
    begin = time.process_time()
    result = solve().or_interrupted()
    seconds = time.process_time() - begin
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "cpu_s": seconds,
        "energy": result.primal_energy,
    }


@dataclass(eq=False)
class NewtonCounts(Work):
    """``levels`` meshes of each family, 1 to 6, and blocks, at most 3."""

    levels: int = 3

    name, title = "counts", "Newton steps of the default method"
    columns = (
        ("problem", "{problem}"),
        ("h / mu", "{hardening:g}"),
        ("nodes", "{nodes}"),
        ("steps", lambda r: steps(r["default"])),
        ("CPU s", "{default[cpu_s]:.2f}"),
        ("nested: steps", lambda r: steps(r["nested"]) if "nested" in r else ""),
        ("CPU s", "{nested[cpu_s]:.2f}"),
        ("primal: steps", lambda r: steps(r["primal"])),
        ("CPU s", "{primal[cpu_s]:.2f}"),
        ("GetFEM: steps", "{getfem[0]}"),
        ("CPU s", "{getfem[1]}"),
    )

    def cells(self) -> list[Cell]:
        """Both examples, then small hardening, then blocks."""
        found = [Cell(name, n) for name, f in FAMILIES.items() for n in first_of(f, self.levels)]
        found += [Cell(f"lshape, {r:g}", n) for n in HARDENED_NODES for r in RATIOS]
        blocks = [(e, n) for e, sizes in BLOCKS.items() for n in list(sizes)[: self.levels]]
        return found + [Cell(f"{e}, {r:g}", n) for r in BLOCK_RATIOS for e, n in blocks]

    def solve(self, cell: Cell) -> dict:
        """By all methods that the table shows for it."""
        body, _, ratio = cell.row.partition(", ")
        h = float(ratio) if ratio else None
        problem = problem_of(body, cell.nodes, h)
        found = {m: timed(lambda m=m: solved_by(m, problem)) for m in ("default", "primal")}
        if h is None:
            family = (BODIES[body].COARSE_NODES, *FAMILIES[body])
            nested(body, family[family.index(cell.nodes) - 1])
            found["nested"] = timed(lambda: nested(body, cell.nodes))
            found["getfem"] = GETFEM.get(cell.nodes) if body == "lshape" else None
        name = TITLES.get(body, f"block, {body}")
        return {"problem": name, "hardening": h, "nodes": problem.mesh.nv, **found}

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Runs that do not converge are part of what is shown."""
        return bool(records)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """How it was measured, how far energies differ, totals of nested iteration."""
        both = [(r["default"], r["primal"]) for r in records]
        good = [(a, b) for a, b in both if a["status"] == b["status"] == "converged"]
        apart = max(abs(a["energy"] / b["energy"] - 1) for a, b in good)
        found = [f"Energies of the two methods differ by at most {apart:.1e}, relative, where both "
                 "converge."]  # fmt: skip
        for name, title in TITLES.items():
            runs = [r["nested"] for r in records if r["problem"] == title and "nested" in r]
            total = sum(run["iterations"] for run in runs)
            found.append(f"{title}: {total} nested steps on {len(runs)} meshes, the first one "
                         f"started from {BODIES[name].COARSE_NODES} nodes.")  # fmt: skip
        return [NOTE, *found]
