"""What a Newton step costs: measured against a linear-elastic solve on the same mesh.

One cell is one solve in a process of its own.  Before and after each of its Newton steps the
linear-elastic problem of the same mesh is solved (assembly, factorisation, solve) and the step
is compared with the mean of the two, so that whatever else the machine is doing weighs on both.
Times are processor times of one thread; a step is everything between two records: assembly,
factorisation, solve, line search, residual norms.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean, median

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
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
from ngepc.dual.starts import coarse_start
from ngepc.model.problem import Problem
from ngepc.pictures.style import COLOURS, Picture, save_figure
from ngepc.results.outcome import IterationRecord
from ngepc.studies.examples import example, solved
from ngepc.studies.work import Table, Work, first_of

NODES = (1601, 3201, 6273, 12545, 24833, 49665, 98817)
"""Meshes of Example (a): the paper's from 1601 on, and the next two bisections."""
MODES = ("default", "primal", "1e4")
"""The default method and the primal one cold, the paper's at gamma = 1e4 from 417 nodes."""
HEAD = {
    "mode": "method",
    "nodes": "nodes",
    "iterations": "Newton steps",
    "elastic_seconds": "elastic solve (s)",
    "step_seconds": "step (s)",
    "step_ratio": "step / elastic: median",
    "mean_ratio": "mean",
    "largest_ratio": "largest",
    "setup_ratio": "set-up / elastic",
    "peak_megabytes": "peak memory (MB)",
    "load_average": "load average",
}
NOTES = (
    "Example (a), tolerance 1e-10. Times are processor times of one thread, medians over a run; "
    "every step is compared with the linear-elastic solves (assembly, sparsecholesky, solution) "
    "right before and after it. A step is assembly, factorisation, solve, line search and residual "
    "norms. Largest is the dearest step of the run, set-up everything before the first; peak "
    "memory is that of the process, mesh and elastic solves included.",
)


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


def measure(mode: str, nodes: int) -> dict:
    """One solve in this process: the record of a cell."""
    SetNumThreads(1)
    problem, options = example("lshape", nodes), NewtonOptions()
    own = mode in ("default", "primal")
    start = None if own else coarse_start("lshape", float(mode), options)
    clock = StepClock(problem)
    result = solved(mode, problem, start, options, clock)
    setup, *ratios = clock.ratios
    return {
        "mode": mode,
        "nodes": nodes,
        "status": result.status.label,
        "iterations": result.iterations,
        "elastic_seconds": median(clock.elastic),
        "step_seconds": median(clock.spans[1:]),
        "step_ratio": median(ratios),
        "mean_ratio": fmean(ratios),
        "largest_ratio": max(ratios),
        "setup_ratio": setup,
        "peak_megabytes": peak_memory(),
        "load_average": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def peak_memory() -> float | None:
    """Peak resident memory of this process (MB), None where Linux does not tell."""
    status = Path("/proc/self/status")
    if not status.is_file():
        return None
    peak = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(peak.split()[1]) / 1024


def growth(cells: Sequence[dict]) -> float:
    """The exponent a in step_seconds ~ nodes^a, by least squares; NaN for fewer than two."""
    if len(cells) < 2:
        return float("nan")
    nodes, seconds = ([c[key] for c in cells] for key in ("nodes", "step_seconds"))
    return float(np.polyfit(np.log(nodes), np.log(seconds), 1)[0])


class Benchmark(Work):
    """The study.

    Parameters
    ----------
    folder, progress
        As for ``Work``; nothing is kept, every run measures anew.
    levels
        Meshes, 1 to 7.
    modes
        From MODES; None for all.
    """

    name = "benchmark"

    def __init__(
        self,
        folder: Path,
        levels: int = 3,
        modes: Sequence[str] | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(folder, progress)
        self.modes, self.nodes = tuple(modes or MODES), first_of(NODES, levels)
        if set(self.modes) - set(MODES):
            raise ValueError(f"modes={self.modes}: {', '.join(MODES)} are available")

    def run(self) -> list[dict]:
        """Measure the cells one after the other, each in a new process."""
        table = []
        for mode, nodes in [(mode, n) for mode in self.modes for n in self.nodes]:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                cell = pool.submit(measure, mode, nodes).result()
            self.progress(
                f"{mode:8s} {nodes:6d} nodes: {cell['iterations']} steps, {cell['status']}; a step "
                f"costs {cell['step_ratio']:.2f} elastic solves, {cell['step_seconds']:.3f} s"
            )
            table.append(cell)
        return table

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write benchmark.csv, .md, .json and .png; returns their paths."""
        grown = [
            f"Time per step grows like nodes^{growth(cells):.2f} ({mode})."
            for mode, cells in by_mode(table).items()
            if len(cells) > 1
        ]
        written = Table(
            name=self.name,
            title="What a Newton step costs",
            head=list(HEAD.values()),
            rows=[[_text(cell[key]) for key in HEAD] for cell in table],
            notes=[*NOTES, *grown],
            cells=table,
        ).write(self.folder)
        return [*written, save_figure(plot_benchmark(table), self.folder / "benchmark.png")]


def by_mode(table: Sequence[dict]) -> dict[str, list[dict]]:
    """Mode -> its cells."""
    return {mode: [c for c in table if c["mode"] == mode] for mode in MODES
            if any(c["mode"] == mode for c in table)}  # fmt: skip


def plot_benchmark(table: Sequence[dict]) -> Figure:
    """Time per step, cost in elastic solves and memory over the number of nodes."""
    figure = Picture(figsize=(10, 3.4))
    panels = figure.subplots(1, 3)
    for colour, (mode, cells) in zip(COLOURS, by_mode(table).items(), strict=False):
        label = mode if mode in ("default", "primal") else f"gamma = {mode}"
        for axes, key in zip(panels, ("step_seconds", "step_ratio", "peak_megabytes"), strict=True):
            _curve(axes, cells, key, color=colour, marker="o", label=label)
        if mode == next(iter(by_mode(table))):
            style = {"color": "#6b7680", "linestyle": ":", "label": "elastic solve"}
            _curve(panels[0], cells, "elastic_seconds", **style)
    panels[1].axhline(1.0, color="#6b7680", linestyle=":", label="an elastic solve")
    nodes = sorted({cell["nodes"] for cell in table})
    units = ("seconds per step", "step / elastic solve", "peak memory (MB)")
    for axes, label in zip(panels, units, strict=True):
        axes.set(xscale="log", xlabel="nodes of the mesh", ylabel=label)
        axes.set_xticks(nodes, [str(n) for n in nodes], rotation=30)
        axes.minorticks_off()
    panels[0].set_yscale("log")
    for axes in panels[1:]:
        axes.set_ylim(bottom=0)
    panels[0].legend()
    panels[1].legend()
    return figure


def _curve(axes: Axes, cells: Sequence[dict], key: str, **style: object) -> None:
    values = [np.nan if cell[key] is None else cell[key] for cell in cells]
    axes.plot([cell["nodes"] for cell in cells], values, **style)


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return "" if value is None else str(value)
