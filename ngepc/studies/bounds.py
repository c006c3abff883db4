"""Guaranteed bounds and errors on uniform and on adaptive meshes."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from ngsolve import x, y

from ngepc.bounds.bound import error_bound
from ngepc.bounds.outcome import ErrorBound
from ngepc.geometries import block
from ngepc.goals.adaptive import solve_to
from ngepc.goals.refinement import MeshRecord
from ngepc.methods.newton import semismooth_newton
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.pictures.fields import plot_mesh
from ngepc.pictures.style import COLOURS, Picture, save_figure, styled
from ngepc.studies.examples import FAMILIES, TITLES, example, timed
from ngepc.studies.large import indented_block
from ngepc.studies.work import OverMeshes, exponent, first_of

CUBES = {
    "elastic": (1e6, {"traction": {"contact": (0.3, 0.1, -0.5)}}),
    "pressed": (
        1e6,
        {"contact": "contact", "gap": 0.5 * ((x - 0.5) ** 2 + (y - 0.5) ** 2) - 0.03},
    ),
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
    "sphere": 0.05917,
}
"""The least energies.

``solve_to`` with order two on 11,570 and 11,356 nodes gives the intervals -0.37524852 to
-0.37524840 and -0.0023607021 to -0.0023606895; in space on 14,305, 14,926, 13,279 and 7703 nodes
-1.7862e-4 to -1.7755e-4, 0.2432 to 0.2470, -0.006730 to -0.006506 and 0.05909 to 0.05921.  Within
these intervals the energies of the last two meshes are extrapolated, in proportion to their bounds.
"""

KINDS = ("uniform", "adaptive", "order 2", "order 2 adaptive")
"""Kinds of runs: uniform and adaptive meshes, displacements of order one and two."""
TARGETS = {
    ("lshape", "adaptive"): 3.71e-4,
    ("wrench", "adaptive"): 2.28e-5,
    ("sphere", "adaptive"): 3e-3,
    ("lshape", "order 2 adaptive"): 1e-6,
    ("wrench", "order 2 adaptive"): 5e-8,
}
"""Relative errors at which adaptive runs end; for order one in the plane those of the finest
uniform meshes."""
STARTS = {"lshape": (225, 0.1366), "wrench": (245, 0.0026), "sphere": (55, 0.238)}
"""Nodes of the first mesh of adaptive runs, and the strain energy."""
ASYMPTOTIC = 400
"""Rates are measured on meshes with at least so many nodes."""
COARSEST = {"lshape": 33, "wrench": 75}
PICTURED = (0.2, 0.1, 0.04, 0.015)
"""Nodes of the first meshes of the runs that are drawn, and tolerances of the drawn meshes."""


def bounded_example(body: str, kind: str, nodes: int) -> Problem:
    """An example on the mesh of its family with this number of nodes."""
    if body in FAMILIES:
        return replace(example(body, nodes), order=2 if "order 2" in kind else 1)
    if body == "sphere":
        return indented_block((55, *SOLIDS[body]).index(nodes))
    yield_stress, data = CUBES[body]
    cells = round(nodes ** (1 / 3)) - 1
    mesh = block.structured_mesh(cells, cells, cells, simplices=True)
    elastic = {"lame_lambda": 1.5e3, "lame_mu": 1e3, "yield_stress": yield_stress}
    return Problem(mesh, Material.kinematic(**elastic, hardening=1e2), **data, order=1)


class Bounds(OverMeshes):
    """Bound and error on ``levels`` meshes of each family and on adaptive ones."""

    name = "bounds"
    title = "Guaranteed bounds of the energy error"
    columns = """example = {example} | nodes = {nodes} | energy error = {error:.3g}
        | bound = {bound:.3g} | bound / error = {effectivity:.3f}
        | of the strain energy = {percent:.2g} percent | Newton steps = {steps}
        | CPU s = {cpu_s:.2f} | bound, CPU s = {apart}"""

    def cells(self) -> list[dict]:
        """Families of uniform meshes, at most three in three dimensions, and adaptive runs."""
        plane = [
            (body, n) for body, f in FAMILIES.items() for n in first_of(f, self.levels)
        ]
        space = [(body, n) for body, f in SOLIDS.items() for n in f[: self.levels]]
        rows = [(b, "uniform", n) for b, n in plane] + [
            (b, "order 2", n) for b, n in plane
        ]
        rows += [(b, "uniform", n) for b, n in space]
        rows += [(body, kind, STARTS[body][0]) for body, kind in TARGETS]
        return [
            {"body": body, "kind": kind, "nodes": nodes} for body, kind, nodes in rows
        ]

    def solve(self, body: str, kind: str, nodes: int) -> list[dict]:
        """The record of a uniform mesh, or those of all meshes of an adaptive run."""
        problem = bounded_example(body, kind, nodes)
        begin = time.process_time()
        run = []

        def note(nodes: int, bound: ErrorBound | MeshRecord, **more: object) -> None:
            """Add a record of a mesh to the run."""
            error = bound.energy - LIMITS[body]
            found = {
                "error": error,
                "bound": bound.total,
                "effectivity": bound.total / error,
            }
            found |= {"relative": bound.relative, "percent": 100 * bound.relative}
            example = f"{body} {kind}".removesuffix(" uniform")
            run.append({"nodes": nodes, **found, "example": example, **more})

        def adapted(mesh: MeshRecord) -> None:
            """Add an adaptive mesh to the run."""
            steps = mesh.iterations + (run[-1]["steps"] if run else 0)
            spent = time.process_time() - begin
            note(mesh.nodes, mesh, steps=steps, cpu_s=spent, apart="with it")
            if run[-1]["error"] <= TARGETS[body, kind]:
                raise StopIteration

        if (body, kind) in TARGETS:
            solve_to(problem, TARGETS[body, kind] / STARTS[body][1], monitor=adapted)
            return run
        result, usage = timed(semismooth_newton, problem)
        solved = time.process_time()
        bound = error_bound(result)
        spent = {"cpu_s": usage["cpu_s"], "bound_cpu_s": time.process_time() - solved}
        spent["apart"] = f"{spent['bound_cpu_s']:.2f}"
        note(nodes, bound, steps=result.iterations, **spent)
        return run

    def table_rows(self, records: Sequence[dict]) -> list[dict]:
        """Uniform meshes, and the last one of adaptive runs."""
        last = {r["example"]: r for r in records if "bound_cpu_s" not in r}
        return [*(r for r in records if "bound_cpu_s" in r), *last.values()]

    def notes(self, records: Sequence[dict]) -> list[str]:
        """The sources of the errors, and their rates."""
        least = ", ".join(f"{value:.8g} for {name}" for name, value in LIMITS.items())
        rates = [f"{name} {rate:.2f}" for name, rate in rates_of(records).items()]
        return [
            f"The error is J - inf J, with inf J = {least}.",
            "Adaptive: all meshes and bounds from the first one on, until the error is that of "
            f"{FAMILIES['lshape'][-1]} and {FAMILIES['wrench'][-1]} nodes of order one, "
            f"{TARGETS['lshape', KINDS[3]]:g} and {TARGETS['wrench', KINDS[3]]:g} with order two, "
            f"{TARGETS['sphere', KINDS[1]]:g} for the sphere on a block.",
            "In space h/mu = 0.1; elastic, pressed and plastic are cubes that are pulled, indented "
            "and pulled beyond yield.",
            f"The error falls like nodes to the power of minus: {', '.join(rates)}.",
        ]

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Draw rates, and meshes of adaptive runs."""
        drawn = {"rates": draw_rates(records)}
        drawn |= {f"{name}_meshes": draw_meshes(name) for name in COARSEST}
        return [
            save_figure(f, self.folder / f"bounds_{name}.png")
            for name, f in drawn.items()
        ]


def curves_of(records: Sequence[dict]) -> dict[str, np.ndarray]:
    """Arrays of nodes, errors and bounds for each family of meshes."""
    curves: dict[str, list] = {}
    for r in records:
        curves.setdefault(r["example"], []).append([r["nodes"], r["error"], r["bound"]])
    return {
        label: np.transpose(curve) for label, curve in curves.items() if len(curve) > 1
    }


def rates_of(records: Sequence[dict]) -> dict[str, float]:
    """Minus the slope of the error over nodes, both logarithmic, from ASYMPTOTIC nodes on."""
    late = {label: c[:, c[0] >= ASYMPTOTIC] for label, c in curves_of(records).items()}
    return {label: -exponent(c[0], c[1]) for label, c in late.items() if len(c[0]) > 1}


@styled
def draw_rates(records: Sequence[dict]) -> Picture:
    """Bound and error over nodes, uniform and adaptive, one panel for each example."""
    figure = Picture(figsize=(12.0, 3.6), layout="constrained")
    titles = TITLES | {"sphere": "Sphere on a block"}
    for (name, title), axes in zip(titles.items(), figure.subplots(1, 3), strict=True):
        for label, (nodes, error, bound) in curves_of(records).items():
            body, _, kind = label.partition(" ")
            if body == name:
                style = {"color": COLOURS[KINDS.index(kind or "uniform")]}
                axes.loglog(
                    nodes, bound, "-", marker="", label=kind or "uniform", **style
                )
                axes.loglog(nodes, error, "o", ms=3, **style)
        axes.set(title=title, xlabel="nodes", ylabel="bound (lines), error (dots)")
        axes.tick_params("x", which="minor", labelbottom=False)
        if axes.get_lines():
            axes.legend(frameon=False, loc="lower left")
    return figure


@styled
def draw_meshes(name: str) -> Picture:
    """Meshes of an adaptive run, from coarse to fine."""
    figure = Picture(
        figsize=(8.0, 7.2 if name == "lshape" else 3.8), layout="constrained"
    )
    for axes, asked in zip(figure.subplots(2, 2).ravel(), PICTURED, strict=True):
        solved = solve_to(example(name, COARSEST[name]), asked)
        plot_mesh(solved.result, axes=axes)
        nodes = solved.result.problem.mesh.nv
        percent = 100 * solved.bound.relative
        axes.set(title=f"{nodes} nodes: {percent:.2g} percent", xlabel="", ylabel="")
    return figure
