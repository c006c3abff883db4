"""Cost of a solve and of a Newton step, relative to a linear-elastic solve on the same mesh.

One cell is one solve in its own process.  Before and after each Newton step the linear-elastic
problem of the same mesh and order is solved by NGSolve (assembly, factorisation, solve), and the
step is compared with the mean of the two, so that other load of the machine affects both.  Times
are processor times of one thread; a step is everything between two records: contact, assembly,
factorisation, solve, line search, residual norms.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import fmean, median

import ngsolve as ng

from ngepc.model.problem import Problem
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import IterationRecord
from ngepc.studies import examples
from ngepc.studies.work import OverMeshes, exponent, first_of

NODES = (1601, 3201, 6273, 12545, 24833, 49665, 98817)
"""Meshes of Example (a): the paper's from 1601 on, and the next two bisections."""
ORDER_2 = "order 2"
MODES = ("default", ORDER_2, "primal", "1e4")
"""Methods: the default one with displacements of order 1 and 2 (on a fourth of the nodes), the
primal one, all from zero; the paper's at gamma = 1e4 from the solution on 417 nodes."""


def elastic_solve(problem: Problem) -> float:
    """Processor time (s) of one linear-elastic solve: assembly, sparsecholesky, solution."""
    begin = time.process_time()
    m = problem.material
    V = ng.VectorH1(
        problem.mesh, order=problem.order, dirichlet="|".join(problem.clamped_names)
    )
    u, v = V.TnT()
    energy = m.lame_lambda * ng.div(u) * ng.div(v)
    energy += 2 * m.lame_mu * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v)))
    load = ng.LinearForm(V)
    for name, g in problem.tractions.items():
        load += g * v * ng.ds(name)
    stiffness = ng.BilinearForm(energy * ng.dx, symmetric=True).Assemble().mat
    inverse = stiffness.Inverse(V.FreeDofs(), inverse="sparsecholesky")
    (inverse * load.Assemble().vec).Evaluate()
    return time.process_time() - begin


def measure(mode: str, nodes: int) -> dict:
    """One solve in this process, with an elastic solve before it and after each Newton step."""
    ng.SetNumThreads(1)
    problem = examples.example("lshape", nodes)
    options = NewtonOptions()
    start = None
    if mode == ORDER_2:
        problem = replace(problem, order=2)
        mode = "default"
    elif mode not in examples.METHODS:
        start = examples.coarse_start("lshape", float(mode), options)
    elastic = [elastic_solve(problem)]
    spans = []
    begin = time.process_time()

    def clock(record: IterationRecord) -> None:
        """Take the time of a step, and of an elastic solve after it."""
        nonlocal begin
        spans.append(time.process_time() - begin)
        elastic.append(elastic_solve(problem))
        begin = time.process_time()

    result = examples.solved_by(mode, problem, start, options, clock)
    setup, *ratios = (
        s / fmean(pair) for s, pair in zip(spans, pairwise(elastic), strict=True)
    )
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "solve_seconds": sum(spans),
        "elastic_seconds": median(elastic),
        "step_seconds": median(spans[1:]),
        "step_ratio": median(ratios),
        "largest_ratio": max(ratios),
        "setup_ratio": setup,
        "peak_megabytes": examples.peak_memory(),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


class Cost(OverMeshes):
    """MODES on ``levels`` meshes, order 2 on two fewer; each run measures again."""

    name = "cost"
    title = "What a solve costs"
    keeps = False
    columns = """method = {mode} | nodes = {nodes} | Newton steps = {steps}
        | whole solve (s) = {solve_seconds:.3g} | elastic solve (s) = {elastic_seconds:.3g}
        | step (s) = {step_seconds:.3g} | step / elastic: median = {step_ratio:.3g}
        | largest = {largest_ratio:.3g} | set-up / elastic = {setup_ratio:.3g}
        | peak memory (MB) = {peak_megabytes:.0f} | load average = {load_average:.3g}"""
    note = (
        "Example (a), tolerance 1e-10. Times are processor times of one thread, medians over a "
        "run; every step is compared with the linear-elastic solves (assembly, sparsecholesky, "
        "solution) right before and after it. A step is assembly, factorisation, contact, line "
        "search and residual norms. 'Largest' is the most expensive step of the run. 'Set-up' is "
        "everything before the first step. The whole solve consists of set-up, steps and result. "
        "Peak memory is that of the process, with NGSolve, mesh and elastic solves. The load "
        "average counts everything that ran on the machine."
    )

    def cells(self) -> list[dict]:
        """The meshes of each method."""
        nodes = first_of(NODES, self.levels)
        meshes = {
            mode: nodes[: max(1, len(nodes) - 2 * (mode == ORDER_2))] for mode in MODES
        }
        return [
            {"mode": mode, "nodes": n}
            for mode, family in meshes.items()
            for n in family
        ]

    def solve(self, mode: str, nodes: int) -> dict:
        """A measurement in a new process."""
        return examples.in_own_process(measure, mode, nodes)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """How it was measured, growth, and the part of the primal method's time."""
        seconds = {(r["mode"], r["nodes"]): r["solve_seconds"] for r in records}
        growth = []
        parts = []
        for mode in dict.fromkeys(r["mode"] for r in records):
            cells = [
                (r["nodes"], r["step_seconds"]) for r in records if r["mode"] == mode
            ]
            if len(cells) > 1:
                a = exponent(*zip(*cells, strict=True))
                growth.append(f"Time per step grows like nodes^{a:.2f} ({mode}).")
        for n in (n for mode, n in seconds if mode == "primal"):
            part = seconds["default", n] / seconds["primal", n]
            parts.append(f"Whole solve on {n} nodes: {part:.2f} of the primal one.")
        return [self.note, *growth, *parts]
