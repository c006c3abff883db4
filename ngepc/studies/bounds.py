"""Guaranteed bounds measured: beside the error, on uniform meshes and on those that follow them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from ngsolve import x, y

from ngepc.bounds.adaptive import MeshRecord, solve_to
from ngepc.bounds.bound import error_bound
from ngepc.dual.newton import semismooth_newton
from ngepc.geometries import block
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.pictures.fields import plot_mesh
from ngepc.pictures.style import COLOURS, Picture, save_figure, styled
from ngepc.studies.examples import FAMILIES, TITLES, example
from ngepc.studies.large import indented_block
from ngepc.studies.work import Cell, Work, first_of

CUBES = {
    "elastic": (1e6, {"traction": {"contact": (0.3, 0.1, -0.5)}}),
    "pressed": (1e6, {"contact": "contact", "gap": 0.5 * ((x - 0.5) ** 2 + (y - 0.5) ** 2) - 0.03}),
    "plastic": (1.25, {"traction": {"contact": (1.0, 0.1, -0.5)}}),
}
"""Yield stress, loads and obstacles of unit cubes, clamped below, h/mu = 0.1; two stay elastic."""

SOLIDS = {name: (125, 729, 4913) for name in CUBES} | {"sphere": (281, 1745, 12193)}
"""Nodes of uniform meshes in space."""

LIMITS = {
    "lshape": -0.37524851,
    "wrench": -0.0023607,
    "elastic": -1.7858e-4,
    "pressed": 0.2437,
    "plastic": -6.69e-3,
    "sphere": 0.0587,
}
"""The least energies.

``solve_to`` with order two on 11,570 and 11,356 nodes leaves -0.37524852 to -0.37524840 and
-0.0023607021 to -0.0023606895; in space on 14,305, 14,926, 13,279 and 6925 nodes -1.7862e-4 to
-1.7755e-4, 0.2432 to 0.2470, -0.006730 to -0.006506 and 0.0577 to 0.0615.  Within that the energies
of the last two meshes are extrapolated, in proportion to their bounds.
"""

ORDER_2 = " order 2"
"""What rows with displacements of order two add to the name of an example."""

ADAPTIVE = " adaptive"

TARGETS = {
    "lshape": 3.71e-4,
    "wrench": 2.28e-5,
    "sphere": 3e-3,
    "lshape order 2": 1e-6,
    "wrench order 2": 5e-8,
}
"""Errors where adaptive runs end: of order one in the plane those on the finest uniform meshes."""

STRAIN_ENERGIES = {"lshape": 0.1366, "wrench": 0.0026, "sphere": 0.238}
"""What relative errors are relative to: bounds below TARGETS are asked for."""

STARTS = {"lshape": 225, "wrench": 245, "sphere": 55}
"""Nodes of the meshes where they begin."""

KINDS = ("uniform", "adaptive", "order 2", "order 2 adaptive")
"""Of curves in the picture, each with its colour."""

ASYMPTOTIC = 400
"""Nodes from which rates are measured."""

PICTURED = (0.2, 0.1, 0.04, 0.015)
"""Relative errors whose meshes are drawn."""

COARSEST = {"lshape": 33, "wrench": 75}
"""Nodes of the meshes where the runs begin that are drawn."""


def beside_limit(label: str, nodes: int, energy: float, bound: float, **more: object) -> dict:
    """A bound beside the error J - inf J of an example."""
    error = energy - LIMITS[label.split()[0]]
    parts = {"error": error, "bound": bound, "effectivity": bound / error}
    return {"example": label, "nodes": nodes, **parts, **more}


def bounded_example(label: str, nodes: int) -> Problem:
    """An example on the mesh of its family with so many nodes."""
    name = label.split()[0]
    if label.endswith(ORDER_2):
        return replace(example(name, nodes), order=2)
    if name in FAMILIES:
        return example(name, nodes)
    if name == "sphere":
        return indented_block((55, *SOLIDS[name]).index(nodes))
    yield_stress, data = CUBES[name]
    cells = round(nodes ** (1 / 3)) - 1
    mesh = block.structured_mesh(cells, cells, cells, simplices=True)
    elastic = {"lame_lambda": 1.5e3, "lame_mu": 1e3, "yield_stress": yield_stress}
    return Problem(mesh, Material.kinematic(**elastic, hardening=1e2), **data)


def on_uniform_mesh(name: str, nodes: int) -> dict:
    """The record of a mesh of a family."""
    problem, start = bounded_example(name, nodes), time.process_time()
    result = semismooth_newton(problem)
    solved = time.process_time()
    bound = error_bound(result)
    return beside_limit(
        name,
        nodes,
        bound.energy,
        bound.total,
        relative=bound.relative,
        steps=result.iterations,
        seconds=solved - start,
        bound_seconds=time.process_time() - solved,
    )


def on_adaptive_meshes(label: str, nodes: int) -> dict:
    """The record of a whole run to the error in ``TARGETS``, its meshes as "history"."""
    run: list[MeshRecord] = []
    name = label.split()[0]
    least, asked = LIMITS[name], TARGETS[label] / STRAIN_ENERGIES[name]

    def note(record: MeshRecord) -> None:
        run.append(record)
        if record.energy - least <= TARGETS[label]:
            raise StopIteration

    start = time.process_time()
    solve_to(bounded_example(label, nodes), asked, monitor=note)
    last = run[-1]
    return beside_limit(
        label + ADAPTIVE,
        last.nodes,
        last.energy,
        last.total,
        relative=last.relative,
        steps=sum(record.iterations for record in run),
        seconds=time.process_time() - start,
        bound_seconds=0.0,
        history=[[r.nodes, r.energy - least, r.total] for r in run],
    )


@dataclass(eq=False)
class Bounds(Work):
    """All examples on ``levels`` meshes of their families, and on meshes that follow the bound."""

    levels: int = 3
    figures: bool = False

    name, title = "bounds", "Guaranteed bounds of the energy error"
    columns = (
        ("example", "{example}"),
        ("nodes", "{nodes}"),
        ("energy error", "{error:.3g}"),
        ("bound", "{bound:.3g}"),
        ("bound / error", "{effectivity:.3f}"),
        ("of the strain energy", lambda r: f"{100 * r['relative']:.2g} percent"),
        ("Newton steps", "{steps}"),
        ("CPU s", "{seconds:.2f}"),
        ("bound, CPU s", lambda r: "with it" if "history" in r else f"{r['bound_seconds']:.2f}"),
    )
    internal = ("history",)

    def cells(self) -> list[Cell]:
        """Families of meshes, in space three at most, and adaptive runs from a coarse one."""
        plane = [
            Cell(name + order, nodes)
            for order in ("", ORDER_2)
            for name in FAMILIES
            for nodes in first_of(FAMILIES[name], self.levels)
        ]
        solid = [Cell(name, n) for name, family in SOLIDS.items() for n in family[: self.levels]]
        followed = [Cell(label + ADAPTIVE, STARTS[label.split()[0]]) for label in TARGETS]
        return plane + solid + followed

    def solve(self, cell: Cell) -> dict:
        """One mesh, or a run of adaptive ones."""
        if cell.row.endswith(ADAPTIVE):
            return on_adaptive_meshes(cell.row.removesuffix(ADAPTIVE), cell.nodes)
        return on_uniform_mesh(cell.row, cell.nodes)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """Where the errors come from, and how fast they fall."""
        least = ", ".join(f"{value:.8g} for {name}" for name, value in LIMITS.items())
        rates = [f"{name} {rate:.2f}" for name, rate in rates_of(records).items()]
        return [
            f"The error is J - inf J, with inf J = {least}.",
            "Adaptive: all meshes and bounds from the first one on, until the error is that of "
            f"{FAMILIES['lshape'][-1]} and {FAMILIES['wrench'][-1]} nodes of order one, "
            f"{TARGETS['lshape order 2']:g} and {TARGETS['wrench order 2']:g} with order two, "
            f"{TARGETS['sphere']:g} for the sphere on a block.",
            "In space h/mu = 0.1; elastic, pressed and plastic are cubes that are pulled, indented "
            "and pulled beyond yield.",
            f"The error falls like nodes to the power of minus: {', '.join(rates)}.",
        ]

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Rates, and meshes that follow the bound, if they were asked for."""
        if not self.figures:
            return []
        drawn = {"rates": draw_rates(records)}
        drawn |= {f"{name}_meshes": draw_meshes(name) for name in COARSEST}
        return [save_figure(f, self.folder / f"bounds_{name}.png") for name, f in drawn.items()]


def curves_of(records: Sequence[dict]) -> dict[str, np.ndarray]:
    """Columns nodes, error and bound for each family of meshes."""
    curves: dict[str, list] = {}
    for r in records:
        found = r["history"] if "history" in r else [[r["nodes"], r["error"], r["bound"]]]
        curves.setdefault(r["example"], []).extend(found)
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
    figure = Picture(figsize=(12.0, 3.6), layout="constrained")
    titles = TITLES | {"sphere": "Sphere on a block"}
    panels = dict(zip(titles, figure.subplots(1, 3), strict=True))
    for name, (nodes, error, bound) in ((n, c.T) for n, c in curves_of(records).items()):
        if name in CUBES:
            continue
        body, _, kind = name.partition(" ")
        axes, label = panels[body], kind or "uniform"
        style = {"color": COLOURS[KINDS.index(label)]}
        axes.loglog(nodes, bound, "-", marker="", label=label, **style)
        axes.loglog(nodes, error, "o", ms=3, **style)
    for name, axes in panels.items():
        axes.set(title=titles[name], xlabel="nodes", ylabel="bound (lines), error (dots)")
        axes.legend(frameon=False, loc="lower left")
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
