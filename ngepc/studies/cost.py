"""What a solve and a Newton step cost: measured against a linear-elastic solve on the same mesh.

One cell is one solve in a process of its own.  Before and after each of its Newton steps the
linear-elastic problem of the same mesh and order is solved by NGSolve (assembly, factorisation,
solve) and the step is compared with the mean of the two, so that whatever else the machine is doing
weighs on both.  Times are processor times of one thread; a step is everything between two records:
contact, assembly, factorisation, solve, line search, residual norms.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean, median

from ngsolve import (  # fmt: skip
    BilinearForm,
    Grad,
    InnerProduct,
    LinearForm,
    SetNumThreads,
    Sym,
    VectorH1,
    div,
    ds,
    dx,
)

from ngepc.dual.newton import NewtonOptions
from ngepc.model.problem import Problem
from ngepc.results.outcome import IterationRecord
from ngepc.studies.examples import (  # fmt: skip
    METHODS,
    coarse_start,
    example,
    in_own_process,
    peak_memory,
    solved_by,
)
from ngepc.studies.work import Work, exponent, first_of

NODES = (1601, 3201, 6273, 12545, 24833, 49665, 98817)
"""Meshes of Example (a): the paper's from 1601 on, and the next two bisections."""
ORDER_2 = "order 2"
MODES = ("default", ORDER_2, "primal", "1e4")
"""The default method, with displacements of order 2 too (a fourth of the nodes), the primal one,
all cold; the paper's at gamma = 1e4 from 417 nodes."""


def elastic_solve(problem: Problem) -> float:
    """Processor time (s) of one linear-elastic solve: assembly, sparsecholesky, solution."""
    begin, m = time.process_time(), problem.material
    V = VectorH1(problem.mesh, order=problem.order, dirichlet="|".join(problem.clamped_names))
    u, v = V.TnT()
    energy = m.lame_lambda * div(u) * div(v)
    energy += 2 * m.lame_mu * InnerProduct(Sym(Grad(u)), Sym(Grad(v)))
    load = LinearForm(V)
    for name, g in problem.tractions.items():
        load += g * v * ds(name)
    stiffness = BilinearForm(energy * dx, symmetric=True).Assemble().mat
    inverse = stiffness.Inverse(V.FreeDofs(), inverse="sparsecholesky")
    (inverse * load.Assemble().vec).Evaluate()
    return time.process_time() - begin


class StepClock:
    """A monitor that times set-up and each Newton step and solves elastic problems between them."""

    def __init__(self, problem: Problem) -> None:
        self._problem, self.elastic, self.spans = problem, [elastic_solve(problem)], []
        self._begin = time.process_time()

    def __call__(self, record: IterationRecord) -> None:
        """Stop the clock, solve the elastic problem, start the clock."""
        self.spans.append(time.process_time() - self._begin)
        self.elastic.append(elastic_solve(self._problem))
        self._begin = time.process_time()

    @property
    def ratios(self) -> list[float]:
        """Set-up and each step, over the mean of the elastic solves before and after it."""
        around = zip(self.elastic[:-1], self.elastic[1:], strict=True)
        return [s / fmean(pair) for s, pair in zip(self.spans, around, strict=True)]


def measure(mode: str, nodes: int) -> dict:
    """One solve in this process: what it and its clock tell."""
    SetNumThreads(1)
    problem, options, start = example("lshape", nodes), NewtonOptions(), None
    if mode == ORDER_2:
        problem, mode = replace(problem, order=2), "default"
    elif mode not in METHODS:
        start = coarse_start("lshape", float(mode), options)
    clock = StepClock(problem)
    result = solved_by(mode, problem, start, options, clock)
    setup, *ratios = clock.ratios
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "solve_seconds": sum(clock.spans),
        "elastic_seconds": median(clock.elastic),
        "step_seconds": median(clock.spans[1:]),
        "step_ratio": median(ratios),
        "largest_ratio": max(ratios),
        "setup_ratio": setup,
        "peak_megabytes": peak_memory(),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


@dataclass(eq=False)
class Cost(Work):
    """MODES on ``levels`` meshes, order 2 on two less; every run measures anew."""

    levels: int = 3

    name, title, keeps = "cost", "What a solve costs", False
    columns = """method = {mode} | nodes = {nodes} | Newton steps = {steps}
        | whole solve (s) = {solve_seconds:.3g} | elastic solve (s) = {elastic_seconds:.3g}
        | step (s) = {step_seconds:.3g} | step / elastic: median = {step_ratio:.3g}
        | largest = {largest_ratio:.3g} | set-up / elastic = {setup_ratio:.3g}
        | peak memory (MB) = {peak_megabytes:.0f} | load average = {load_average:.3g}"""
    note = (
        "Example (a), tolerance 1e-10. Times are processor times of one thread, medians over a "
        "run; every step is compared with the linear-elastic solves (assembly, sparsecholesky, "
        "solution) right before and after it. A step is assembly, factorisation, contact, line "
        "search and residual norms. Largest is the dearest step of the run, set-up everything "
        "before the first, the whole solve both and the result; peak memory is that of the "
        "process, NGSolve, mesh and elastic solves included. The load average counts everything "
        "that ran on the machine."
    )

    def cells(self) -> list[dict]:
        """The meshes of each method."""
        nodes = first_of(NODES, self.levels)
        meshes = {mode: nodes[: max(1, len(nodes) - 2 * (mode == ORDER_2))] for mode in MODES}
        return [{"mode": mode, "nodes": n} for mode, family in meshes.items() for n in family]

    def solve(self, mode: str, nodes: int) -> dict:
        """A measurement in a new process."""
        return in_own_process(measure, mode, nodes)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """How it was measured, growth, and the part of the primal method's time."""
        seconds, found = {}, [self.note]
        for mode in MODES:
            cells = [r for r in records if r["mode"] == mode]
            seconds[mode] = {r["nodes"]: r["solve_seconds"] for r in cells}
            if len(cells) > 1:
                a = exponent([r["nodes"] for r in cells], [r["step_seconds"] for r in cells])
                found.append(f"Time per step grows like nodes^{a:.2f} ({mode}).")
        return found + [
            f"Whole solve on {nodes} nodes: {seconds['default'][nodes] / primal:.2f} of the primal "
            "one."
            for nodes, primal in seconds.get("primal", {}).items()
        ]
