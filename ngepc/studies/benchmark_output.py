"""The table and the plot of ``ngepc benchmark``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ngepc.pictures.figures import save
from ngepc.results import records
from ngepc.studies.benchmark import GAMMA, Measurement, growth
from ngepc.studies.output import Table, write_table

LIMITS = {"exact": 3.0, "coupled": 8.0}
"""Elastic solves that a step may cost, the bounds that the solver was designed for."""

_HEAD = {
    "mode": "mode",
    "nodes": "nodes",
    "unknowns": "unknowns",
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


def write_benchmark(folder: Path, measurements: Sequence[Measurement]) -> list[Path]:
    """Write benchmark.csv, .md, .json and .png into ``folder``; returns their paths."""
    rows = [[_text(getattr(m, key)) for key in _HEAD] for m in measurements]
    table = Table(
        name="benchmark",
        title="What a Newton step costs",
        head=list(_HEAD.values()),
        rows=rows,
        notes=_notes(measurements),
        cells=[m.as_dict() for m in measurements],
    )
    picture = save(plot_benchmark(measurements), folder / "benchmark.png")
    return [*write_table(folder, table), picture]


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if isinstance(value, float) and abs(value) < 100 else _plain(value)


def _plain(value: object) -> str:
    return f"{value:.0f}" if isinstance(value, float) else str(value)


def by_mode(measurements: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    """Mode -> its measurements."""
    modes = dict.fromkeys(m.mode for m in measurements)
    return {mode: [m for m in measurements if m.mode == mode] for mode in modes}


def _notes(measurements: Sequence[Measurement]) -> list[str]:
    notes = [
        "Example (a).  exact: default method, cold start; coupled: gamma = "
        f"{GAMMA:g} from the 417-node solution, 400 points per triangle.  Tolerance 1e-10.",
        "Times are processor times of one thread, medians over a run; every step is compared with "
        "the linear-elastic solves (assembly, sparsecholesky, solution) right before and after it.",
        "A step is assembly, factorisation, solve, line search and residual norms.  Largest is the "
        "dearest step of the run: the first one, which builds the symbolic factorisation, or with "
        "exact contact one where many nodes come into contact.",
    ]
    for mode, group in by_mode(measurements).items():
        if len(group) > 1:
            notes.append(f"Time per step grows like nodes^{growth(group):.2f} ({mode}).")
    return [f"- {note}" for note in notes]


def plot_benchmark(measurements: Sequence[Measurement]) -> Figure:
    """Time per step, cost in elastic solves and memory over the number of nodes."""
    figure = Figure(figsize=(10, 3.4), layout="constrained")
    time, ratio, memory = figure.subplots(1, 3)
    nodes = sorted({m.nodes for m in measurements})
    for mode, group in by_mode(measurements).items():
        own = [m.nodes for m in group]
        (line,) = time.loglog(own, [m.step_seconds for m in group], "o-", label=f"step, {mode}")
        time.loglog(own, [m.elastic_seconds for m in group], "s:", label=f"elastic solve, {mode}")
        colour = line.get_color()
        ratio.semilogx(own, [m.step_ratio for m in group], "o-", color=colour, label=mode)
        ratio.axhline(LIMITS[mode], color=colour, linestyle="--", linewidth=0.8)
        peak = [np.nan if m.peak_megabytes is None else m.peak_megabytes for m in group]
        memory.loglog(own, peak, "o-", color=colour, label=mode)
    for axes, label in ((time, "seconds"), (ratio, "step / elastic solve"), (memory, "MB")):
        axes.set_xticks(nodes, [str(n) for n in nodes], rotation=30, fontsize=7)
        axes.minorticks_off()
        axes.set_xlabel("nodes")
        axes.set_ylabel(label)
        axes.grid(color="#e3e6ea", linewidth=0.6)
        axes.legend(fontsize=7)
    ratio.set_ylim(bottom=0)
    stamp = records.provenance()
    figure.suptitle(
        f"ngepc {stamp['version']}, NGSolve {stamp['ngsolve']}: {stamp['command']}", fontsize=8
    )
    return figure
