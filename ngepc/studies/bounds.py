"""Guaranteed bounds measured: effectivities, adaptive meshes, random problems."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
from ngsolve import Mesh

from ngepc.bounds.adaptive import MeshRecord, Refinement, solve_to
from ngepc.bounds.bound import ErrorBound, error_bound
from ngepc.bounds.transfer import bisected, on_mesh
from ngepc.dual.newton import semismooth_newton
from ngepc.model.problem import Problem
from ngepc.pictures.fields import plot_mesh
from ngepc.pictures.style import COLOURS, Picture, save_figure, styled
from ngepc.studies.examples import FAMILIES, example
from ngepc.studies.verification.random_problems import Draw, build, draws
from ngepc.studies.work import Cell, Outcome, Table, Work, first_of

LIMITS = {"lshape": -0.3752486, "wrench": -0.0023607}
"""Energies of Examples (a) and (b), seven digits.

``solve_to`` on 72,129 and 62,717 nodes leaves -0.3752490 to -0.3752313 and -0.00236074 to
-0.00235969; the lower bounds extrapolated.
"""


STARTS = {"lshape": 225, "wrench": 245}
"""Nodes of the meshes where adaptive runs begin."""

TARGETS = {"lshape": 3.71e-4, "wrench": 2.28e-5}
"""The errors on the finest meshes of the families, where adaptive runs end."""

TITLES = {"lshape": "Example (a)", "wrench": "Example (b)"}

ASYMPTOTIC = 400
"""Nodes from which rates are measured."""

PICTURED = (0.2, 0.1, 0.04, 0.015)
"""Relative errors whose meshes are drawn."""

COARSEST = {"lshape": 33, "wrench": 75}
"""Nodes of the meshes where the runs begin that are drawn."""


@dataclass(frozen=True)
class Effectivity:
    """A bound beside the error.

    Parameters
    ----------
    nodes
        Vertices of the mesh.
    error, bound, effectivity
        J - inf J, the bound, and their quotient.
    relative
        The bound over the strain energy.
    steps, seconds, bound_seconds
        Newton steps, and CPU seconds for them and for the bound.
    """

    nodes: int
    error: float
    bound: float
    effectivity: float
    relative: float
    steps: int
    seconds: float
    bound_seconds: float


def uniform_effectivities(name: str, family: list[int]) -> list[Effectivity]:
    """The table of bounds on uniform meshes of "lshape" or "wrench"."""
    return [_measured(example(name, nodes), LIMITS[name]) for nodes in family]


def _measured(problem: Problem, limit: float) -> Effectivity:
    start = time.process_time()
    result = semismooth_newton(problem)
    solved = time.process_time()
    bound = error_bound(result)
    end, error = time.process_time(), bound.energy - limit
    parts = (bound.total, bound.total / error, bound.relative, result.iterations)
    return Effectivity(problem.mesh.nv, error, *parts, solved - start, end - solved)


def adaptive_effectivities(
    name: str, start: int, relative_error: float, max_nodes: int, error: float = 0.0
) -> list[tuple[MeshRecord, float, float]]:
    """Records of ``solve_to`` on "lshape" or "wrench", each with the true error and CPU seconds.

    It ends at a true error of ``error``, too.
    """
    rows, begun = [], time.process_time()

    def note(record: MeshRecord) -> None:
        rows.append((record, record.energy - LIMITS[name], time.process_time() - begun))
        if rows[-1][1] <= error:
            raise StopIteration

    solve_to(example(name, start), relative_error, Refinement(max_nodes=max_nodes), note)
    return rows


@dataclass(frozen=True)
class Crossing:
    """A random problem's energies on two meshes.

    Parameters
    ----------
    draw
        The problem.
    bound, fine
        Bounds on its mesh and on one bisected everywhere several times.
    """

    draw: Draw
    bound: ErrorBound
    fine: ErrorBound

    @property
    def margin(self) -> float:
        """Energy on the fine mesh less the lower bound, in units of the bound: >= 0."""
        return (self.fine.energy - self.bound.least_energy) / self.bound.total

    @property
    def effectivity(self) -> float:
        """The bound over the largest error that the fine mesh allows."""
        return self.bound.total / (self.bound.energy - self.fine.least_energy)


def random_crossings(
    seed: int, count: int, bisections: int = 3, dimension: int = 2
) -> Iterator[Crossing]:
    """Random problems in two or three dimensions, each with its bound and a fine reference."""
    drawn = (d for d in draws(seed) if (d.body == "cube") == (dimension == 3))
    for draw in islice(drawn, count):
        problem = build(draw)
        bound = error_bound(semismooth_newton(problem))
        yield Crossing(draw, bound, error_bound(semismooth_newton(finer(problem, bisections))))


def finer(problem: Problem, bisections: int) -> Problem:
    """The problem on a mesh all of whose elements are bisected several times."""
    mesh: Mesh = problem.mesh
    for _ in range(bisections):
        mesh = bisected(mesh, np.ones(mesh.ne, dtype=bool))
    return on_mesh(problem, mesh)


@dataclass(eq=False)
class Bounds(Work):
    """The study: bounds beside the error, on the paper's meshes and on those that follow them.

    Parameters
    ----------
    levels
        Meshes of each family.
    figures
        Whether pictures are wanted, too.
    """

    levels: int = 3
    figures: bool = False

    name = "bounds"
    title = "Guaranteed bounds of the energy error"
    head = ("example", "nodes", "energy error", "bound", "bound / error", "of the strain energy",
            "Newton steps", "CPU s", "bound, CPU s")  # fmt: skip

    def cells(self) -> list[Cell]:
        """Both examples on their families of meshes, and adaptive from a coarse one."""
        uniform = [Cell(name, n) for name in LIMITS for n in first_of(FAMILIES[name], self.levels)]
        return uniform + [Cell(f"{name} adaptive", STARTS[name]) for name in LIMITS]

    def solve(self, cell: Cell) -> Outcome:
        """One mesh, or a run of adaptive ones; the time of its bounds is that of the whole run."""
        name, _, adaptive = cell.row.partition(" ")
        if not adaptive:
            (found,) = uniform_effectivities(name, [cell.nodes])
            return Outcome({"example": name, **asdict(found)})
        rows = adaptive_effectivities(name, cell.nodes, 1e-9, 200_000, TARGETS[name])
        history = [[r.nodes, error, r.total] for r, error, _ in rows]
        record, error, seconds = rows[-1]
        steps = sum(r.iterations for r, _, _ in rows)
        parts = (record.total, record.total / error, record.relative, steps, seconds, 0.0)
        last = Effectivity(record.nodes, error, *parts)
        return Outcome({"example": cell.row, **asdict(last), "history": history})

    def line(self, r: dict) -> str:
        """Effectivity and size."""
        return f"{r['example']} {r['nodes']} nodes: bound / error {r['effectivity']:.3f}"

    def row(self, r: dict) -> list[str]:
        """The entries."""
        with_bound = "with it" if "history" in r else f"{r['bound_seconds']:.2f}"
        return [
            *(r["example"], f"{r['nodes']}", f"{r['error']:.3g}", f"{r['bound']:.3g}"),
            *(f"{r['effectivity']:.3f}", f"{100 * r['relative']:.2g} percent", f"{r['steps']}"),
            *(f"{r['seconds']:.2f}", with_bound),
        ]

    def notes(self, records: Sequence[dict]) -> list[str]:
        """Where the errors come from, and how fast they fall."""
        notes = [
            f"Errors are J + {-limit:g} for {name}: see LIMITS." for name, limit in LIMITS.items()
        ]
        rates = [f"{name} {rate:.2f}" for name, rate in rates_of(records).items()]
        adaptive = "Adaptive: all meshes and bounds from the first one on, until the error is"
        return [
            *notes,
            f"{adaptive} that of {FAMILIES['lshape'][-1]} and {FAMILIES['wrench'][-1]} nodes.",
            f"The error falls like nodes to the power of minus: {', '.join(rates)}.",
        ]

    def table(self, records: Sequence[dict]) -> Table:
        """The table; the histories of adaptive runs are for pictures."""
        cells = [{key: r[key] for key in r if key != "history"} for r in records]
        return replace(super().table(records), cells=cells)

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write the table, and pictures if they were asked for; returns the paths."""
        written = super().write(table)
        if not self.figures:
            return written
        pictures = {"bounds_rates": draw_rates(table)}
        pictures |= {f"bounds_{name}_meshes": draw_meshes(name) for name in LIMITS}
        return written + [save_figure(f, self.folder / f"{n}.png") for n, f in pictures.items()]


def curves_of(records: Sequence[dict]) -> dict[str, np.ndarray]:
    """Columns nodes, error and bound for each family of meshes."""
    curves = {
        name: [[r["nodes"], r["error"], r["bound"]] for r in records if r["example"] == name]
        for name in LIMITS
    }
    curves |= {r["example"]: r["history"] for r in records if "history" in r}
    return {name: np.array(curve) for name, curve in curves.items() if len(curve) > 1}


def rates_of(records: Sequence[dict]) -> dict[str, float]:
    """Minus the slope of the error over nodes, both logarithmic, from ASYMPTOTIC nodes on."""
    rates = {}
    for name, curve in curves_of(records).items():
        late = np.log(curve[curve[:, 0] >= ASYMPTOTIC])
        if len(late) > 1:
            rates[name] = -float(np.polyfit(late[:, 0], late[:, 1], 1)[0])
    return rates


@styled
def draw_rates(records: Sequence[dict]) -> Picture:
    """Bound and error over nodes, uniform and adaptive, one panel for each example."""
    figure = Picture(figsize=(8.4, 3.6), layout="constrained")
    for axes, (example_name, title) in zip(figure.subplots(1, 2), TITLES.items(), strict=True):
        for name, curve in curves_of(records).items():
            if not name.startswith(example_name):
                continue
            label = "adaptive" if name.endswith("adaptive") else "uniform"
            colour = COLOURS[label == "adaptive"]
            axes.loglog(
                curve[:, 0], curve[:, 2], "-", marker="", color=colour, label=f"bound, {label}"
            )
            axes.loglog(curve[:, 0], curve[:, 1], "o", ms=3, color=colour, label=f"error, {label}")
        axes.set(title=title, xlabel="nodes", ylabel="energy (force times length)")
        axes.legend(frameon=False)
    return figure


@styled
def draw_meshes(name: str) -> Picture:
    """Meshes that follow the bound, coarse to fine."""
    figure = Picture(figsize=(8.0, 7.2 if name == "lshape" else 3.8), layout="constrained")
    for axes, asked in zip(figure.subplots(2, 2).ravel(), PICTURED, strict=True):
        solved = solve_to(example(name, COARSEST[name]), asked)
        plot_mesh(solved.result, axes=axes)
        nodes, percent = solved.result.problem.mesh.nv, 100 * solved.bound.relative
        axes.set(title=f"{nodes} nodes: {percent:.2g} percent", xlabel="", ylabel="")
    return figure
