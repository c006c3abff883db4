"""What a Newton step costs: measured against a linear-elastic solve on the same mesh.

One cell is one solve in a process of its own.  Before and after each of its Newton steps the
linear-elastic problem of the same mesh is solved (assembly, factorisation, solve) and the step
is compared with the mean of the two, so that whatever else the machine is doing weighs on both.
Times are processor times of one thread; a step is everything between two records: assembly,
factorisation, solve, line search, residual norms.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean, median

import numpy as np
from ngsolve import (
    BilinearForm,
    Grad,
    InnerProduct,
    LinearForm,
    Sym,
    VectorH1,
    div,
    ds,
    dx,
)

from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.dual.regularisation import Coupled
from ngepc.dual.result import DualResult
from ngepc.dual.starts import coarse_start
from ngepc.geometries import lshape
from ngepc.model.examples import lshape_problem
from ngepc.model.problem import Problem
from ngepc.results.outcome import IterationRecord

NODES = (1601, 3201, 6273, 12545, 24833, 49665, 98817)
"""Meshes of Example (a): the paper's from 1601 on, and the next two bisections."""

GAMMA = 1e4
"""gamma of the coupled mode."""


@dataclass(frozen=True)
class Cell:
    """One solve of the benchmark.

    Parameters
    ----------
    mode
        'exact' (default method, cold start) or 'coupled' (gamma = 1e4 from the 417-node solution).
    nodes
        Nodes of the mesh.
    """

    mode: str
    nodes: int


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What one cell gave.

    Parameters
    ----------
    mode, nodes
        The cell.
    unknowns
        Free degrees of freedom of u.
    status, iterations
        How the solve ended and its Newton steps.
    elastic_seconds, step_seconds
        Medians over the run of one linear-elastic solve and of one Newton step (s).
    step_ratio, mean_ratio, largest_ratio
        Median, mean and maximum over the steps of (step / elastic solve) (1).
    setup_ratio
        Everything before the first step, in elastic solves (1).
    peak_megabytes
        Peak resident memory of the process (MB), elastic solves and mesh included.
    load_average
        Load average of the machine at the end of the cell, None where there is none.
    """

    mode: str
    nodes: int
    unknowns: int
    status: str
    iterations: int
    elastic_seconds: float
    step_seconds: float
    step_ratio: float
    mean_ratio: float
    largest_ratio: float
    setup_ratio: float
    peak_megabytes: float | None
    load_average: float | None

    def as_dict(self) -> dict:
        """The fields as a dictionary."""
        return asdict(self)


def elastic_solve(problem: Problem) -> float:
    """Processor time (s) of one linear-elastic solve: assembly, sparsecholesky, solution."""
    begin, m = time.process_time(), problem.material
    V = VectorH1(problem.mesh, order=1, dirichlet="|".join(problem.clamped_names))
    u, v = V.TnT()
    energy = m.lame_lambda * div(u) * div(v)
    energy += 2 * m.lame_mu * InnerProduct(Sym(Grad(u)), Sym(Grad(v)))
    stiffness = BilinearForm(V, symmetric=True)
    stiffness += energy * dx
    load = LinearForm(V)
    for name, g in problem.tractions.items():
        load += g * v * ds(name)
    stiffness.Assemble()
    load.Assemble()
    inverse = stiffness.mat.Inverse(V.FreeDofs(), inverse="sparsecholesky")
    solution = load.vec.CreateVector()
    solution.data = inverse * load.vec
    return time.process_time() - begin


class StepClock:
    """A monitor that times each Newton step and solves the elastic problem between them.

    Parameters
    ----------
    problem
        Its mesh and elastic data.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.elastic, self.spans = [elastic_solve(problem)], []
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


def measure(cell: Cell) -> Measurement:
    """Solve one cell in this process."""
    problem, options = lshape_problem(lshape.paper_mesh(cell.nodes)), NewtonOptions()
    if cell.mode == "coupled":
        regularisation, start = Coupled(GAMMA), coarse_start("lshape", GAMMA, options)
    else:
        regularisation, start = None, None
    clock = StepClock(problem)
    result = semismooth_newton(
        problem, start=start, options=options, monitor=clock, regularisation=regularisation
    )
    return summary(cell, result, clock)


def summary(cell: Cell, result: DualResult, clock: StepClock) -> Measurement:
    """The measurement of a finished run."""
    setup, *ratios = clock.ratios
    return Measurement(
        **asdict(cell),
        unknowns=result.displacement.space.FreeDofs().NumSet(),
        status=result.status.label,
        iterations=result.iterations,
        elastic_seconds=median(clock.elastic),
        step_seconds=median(clock.spans[1:]),
        step_ratio=median(ratios),
        mean_ratio=fmean(ratios),
        largest_ratio=max(ratios),
        setup_ratio=setup,
        peak_megabytes=peak_memory(),
        load_average=load_average(),
    )


def peak_memory() -> float | None:
    """Peak resident memory of this process (MB), None where the system does not tell."""
    status = Path("/proc/self/status")
    if status.is_file():
        peak = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
        return int(peak.split()[1]) / 1024
    try:
        import resource
    except ImportError:
        return None
    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def load_average() -> float | None:
    """Runnable processes over the last minute, None where the system does not tell."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else None


def run_cells(cells: Sequence[Cell], progress: Callable[[Measurement], None]) -> list[Measurement]:
    """Measure the cells one after the other, each in a new process."""
    measurements = []
    for cell in cells:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            measurements.append(pool.submit(measure, cell).result())
        progress(measurements[-1])
    return measurements


def growth(measurements: Sequence[Measurement]) -> float:
    """The exponent a in step_seconds ~ nodes^a, by least squares; NaN for fewer than two."""
    if len(measurements) < 2:
        return float("nan")
    nodes, seconds = zip(*((m.nodes, m.step_seconds) for m in measurements), strict=True)
    return float(np.polyfit(np.log(nodes), np.log(seconds), 1)[0])
