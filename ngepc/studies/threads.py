"""Wall time of a solve by default options with one and with several threads."""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

from ngsolve import SetNumThreads

from ngepc.geometries import block, lshape
from ngepc.linalg.cores import crew
from ngepc.methods.newton import semismooth_newton
from ngepc.model.problem import Problem, lshape_problem
from ngepc.studies.examples import in_own_process
from ngepc.studies.large import pressed
from ngepc.studies.work import Work

REPEATED = 3
"""Runs of each body with each number of threads; the fastest one is taken."""


def plane() -> Problem:
    """Example (a) of the paper on 24,833 nodes."""
    return lshape_problem(lshape.paper_mesh(24833))


def solid() -> Problem:
    """A sphere pressed into a block, tetrahedra of order two."""
    return pressed(block.structured_mesh(8, 8, 8, simplices=True), 100.0, order=2)


def larger_solid() -> Problem:
    """The same on a finer mesh, where less of the time is spent between compiled loops."""
    return pressed(block.structured_mesh(12, 12, 12, simplices=True), 100.0, order=2)


BODIES = {
    "Example (a), 24,833 nodes": plane,
    "sphere, 4,913 nodes of order 2": solid,
    "sphere, 15,625 nodes of order 2": larger_solid,
}


def solved_by_threads(body: str, threads: int) -> dict:
    """Steps, numbers and times of the fastest of some runs."""
    SetNumThreads(threads)
    problem = BODIES[body]()
    wall = []
    cpu = []
    for _ in range(REPEATED):
        begin = time.perf_counter()
        used = time.process_time()
        with crew(threads):  # workers would use one
            result = semismooth_newton(problem)
        wall.append(time.perf_counter() - begin)
        cpu.append(time.process_time() - used)
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "energy": result.primal_energy,
        "contact_force": result.contact_force,
        "wall_s": min(wall),
        "cpu_s": min(cpu),
    }


@dataclass(eq=False)
class Threads(Work):
    """Each body with one thread and with one for each core, in a process of its own."""

    name = "threads"
    title = "Threads"
    columns = """body = {body} | threads = {threads} | Newton steps = {steps}
        | wall s = {wall_s:.2f} | of one thread = {ratio:.2f} | CPU s = {cpu_s:.2f}
        | J = {energy:.12f}
        | force = {contact_force:.10f}"""
    note = (
        f"Default options, the fastest of {REPEATED} runs. NGSolve's own threads help only where "
        "cores are free."
    )

    def cells(self) -> list[dict]:
        """One thread, then all cores, for each body."""
        cores = len(os.sched_getaffinity(0))
        counts = sorted({1, 2, cores})
        return [{"body": body, "threads": count} for body in BODIES for count in counts]

    def solve(self, body: str, threads: int) -> dict:
        """One body with a number of threads."""
        return in_own_process(solved_by_threads, body, threads)

    def table_rows(self, records: Sequence[dict]) -> list[dict]:
        """The records with the ratio of wall times."""
        alone = {r["body"]: r["wall_s"] for r in records if r["threads"] == 1}
        return [r | {"ratio": r["wall_s"] / alone[r["body"]]} for r in records]
