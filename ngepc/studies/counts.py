"""Newton steps over meshes: Tables 1 and 2 of the paper, with rows for other methods.

Rows are numbers (the paper's method at that gamma), 'default' and 'primal'; a star marks nested
iteration, where each mesh starts from the solution on the next coarser one.  The table of the
default method also has small hardening, solids, and measured counts of GetFEM 5.4.2.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from ngepc.checks.sentences import counted
from ngepc.geometries import block
from ngepc.model.hardening import HardeningLaw, Swift, Voce
from ngepc.model.hill import Hill
from ngepc.model.material import Material
from ngepc.model.overlay import Overlay
from ngepc.model.problem import Problem
from ngepc.model.tensile import PEEQ
from ngepc.model.viscosity import Norton
from ngepc.pictures.curves import plot_counts
from ngepc.pictures.style import save_figure
from ngepc.results.options import NewtonOptions
from ngepc.studies import examples
from ngepc.studies.examples import (
    FAMILIES,
    METHODS,
    TITLES,
    example,
    nested,
    solved_by,
    timed,
)
from ngepc.studies.large import LAME_MU, indented_block, pressed
from ngepc.studies.paper import TABLE_1, TABLE_2
from ngepc.studies.work import OverMeshes, chosen, first_of

OWN_ROWS = ("default", "default*", "primal", "primal*")
OPTIONS = NewtonOptions(max_iterations=2000)
OWN_NAMES = {"default": "the exact method", "primal": "the second solver"}
AT_ROUNDING = (
    "'stagnated': the residual has reached its rounding error, above 1e-10 there."
)
FEW = 5
"""Rows with at most so many steps on all meshes are not drawn."""


@dataclass(eq=False)
class CountTable(OverMeshes):
    """A table of the paper with our counts, and rows for other methods.

    ``paper`` maps rows to the paper's counts on the meshes of ``body``; ``about`` describes the
    starting points.
    """

    rows: Sequence[str] | None = None

    body: ClassVar[str]
    paper: ClassVar[Mapping[str, Sequence[int]]]
    about: ClassVar[str]

    columns = "gamma = {row}"
    across = ("{nodes} nodes", "{iterations}{in_paper}{ending}")
    note = (
        "Newton steps for {study.example}, ours (the paper's in parentheses). {study.about} "
        "{study.own}Tolerance 1e-10, 400 quadrature points per triangle for the paper's rows."
    )

    def __post_init__(self) -> None:
        self.nodes = first_of(FAMILIES[self.body], self.levels)
        self.example = TITLES[self.body]
        self.title = f"Table {self.name[-1]}"
        self.rows = chosen(
            [*self.paper, *OWN_ROWS], self.rows or [*self.paper, "default"]
        )

    @property
    def own(self) -> str:
        """What the rows without gamma are, if there are any."""
        own = [row for row in self.rows if row in OWN_ROWS]
        methods = dict.fromkeys(row.rstrip("*") for row in own)
        if not methods:
            return ""
        named = " and ".join(f"'{name}' is {OWN_NAMES[name]}" for name in methods)
        starred = any(row.endswith("*") for row in own)
        nested = "; with * they start from the solution on the next coarser mesh"
        return f"Without gamma: {named}, from zero{nested * starred}. "

    def notes(self, records: Sequence[dict]) -> list[str]:
        """The rows that there are, and the statuses that need an explanation."""
        found = super().notes(records)
        if any(record["status"] == "stagnated" for record in records):
            found[-1] += f" {AT_ROUNDING}"
        return found

    def cells(self) -> list[dict]:
        """All rows on one mesh after the other."""
        return [
            {"row": row, "nodes": nodes} for nodes in self.nodes for row in self.rows
        ]

    def solve(self, row: str, nodes: int) -> dict:
        """One run, nested or from the paper's starting point, and the paper's count."""
        method = row.rstrip("*")
        paper = None
        if row in self.paper:
            paper = self.paper[row][FAMILIES[self.body].index(nodes)]
        if row.endswith("*"):
            result = nested(self.body, method, nodes, OPTIONS)
        else:
            coarse = self.body == "lshape" and method not in METHODS
            start = (
                examples.coarse_start(self.body, method, OPTIONS) if coarse else None
            )
            result = solved_by(
                method, example(self.body, nodes), start, OPTIONS
            ).or_interrupted()
        names = ("iterations", "primal_energy", "dual_energy", "residual_norm")
        return {
            "paper": paper,
            "status": result.status.label,
            **{name: getattr(result, name) for name in names},
            "halvings": result.history.halvings,
        }

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Steps over nodes, the paper's dashed; rows with few steps are named in the title."""
        many = {
            r["row"] for r in records if max(r["iterations"], r["paper"] or 0) > FEW
        }
        ours: dict[str, dict[int, int]] = {}
        paper: dict[str, dict[int, int]] = {}
        for r in (r for r in records if r["row"] in many or not many):
            method = r["row"].rstrip("*")
            label = f"{method} method" if method in METHODS else f"gamma = {method}"
            label += ", nested" if r["row"].endswith("*") else ""
            ours.setdefault(label, {})[r["nodes"]] = r["iterations"]
            if r["paper"]:
                paper.setdefault(label, {})[r["nodes"]] = r["paper"]
        figure = plot_counts(ours, paper)
        if many and (left := [row for row in self.rows if row not in many]):
            title = f"not drawn: gamma = {', '.join(left)}, at most {FEW} steps"
            figure.axes[0].set_title(title, loc="left", fontsize="medium")
        return [save_figure(figure, self.folder / f"{self.name}_steps.png")]


class Table1(CountTable):
    """Example (a); the paper's rows start from the prolongated solution on 417 nodes."""

    name = "table1"
    body = "lshape"
    paper = TABLE_1
    about = (
        "The paper's method starts from the prolongated solution on 417 nodes, rows with * from "
        "the next coarser mesh. The paper does not say which start gives its counts at 1e2 and "
        "1e3 (docs/reading.md)."
    )


class Table2(CountTable):
    """Example (b); the paper's rows start from v = 0."""

    name = "table2"
    body = "wrench"
    paper = TABLE_2
    about = (
        "The paper's method starts from v = 0. The paper prints 24927 nodes for the mesh with "
        "24993; its polygon is lost, ours is reconstructed (docs/reading.md)."
    )


RATIOS = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
HARDENED_NODES = (833, 3201)
GETFEM = {833: (11, 0.1), 3201: (15, 0.8), 12545: (22, 4.7)}
"""Nodes of Example (a) -> Newton steps and CPU seconds of GetFEM 5.4.2 with its best parameter."""

BLOCK_RATIOS = (1e-1, 1e-3)
BLOCKS = {
    "tetrahedra": {281: 1, 1745: 2, 12193: 3},
    "hexahedra": {343: 6, 1728: 11, 12167: 22},
}
"""Shape of elements -> nodes -> refinements of the coarse mesh, or cells along an edge."""


BOUND = 1.25
"""Yield bound of |dev sigma| in Example (a) (stress)."""
LIMIT = BOUND / PEEQ
"""The corresponding yield stress of a bar (stress)."""


def _elastic(problem: Problem) -> dict[str, object]:
    """The Lame parameters of Example (a)."""
    material = problem.material
    return {"lame_lambda": material.lame_lambda, "lame_mu": material.lame_mu}


def _with_law(law: HardeningLaw, problem: Problem, hardening: float) -> dict:
    """A law of isotropic hardening combined with linear kinematic hardening."""
    elastic = _elastic(problem)
    return {"material": Material.with_law(**elastic, law=law, hardening=hardening)}


def _with_rate(problem: Problem, hardening: float) -> dict:
    """Norton's rate law, with the load applied within one unit of time."""
    elastic = _elastic(problem)
    given = {"yield_stress": BOUND, "hardening": hardening, "rate": Norton(1.0, 5.0)}
    return {"material": Material(**elastic, **given), "duration": 1.0}


def _with_axes(problem: Problem, hardening: float) -> dict:
    """Hill's ellipsoid of a rolled sheet whose axes are turned by 45 degrees."""
    hill = Hill.r_values(1.8, 1.2, 2.3, angle=math.pi / 4)
    given = {"yield_stress": BOUND, "hardening": hardening, "hill": hill}
    return {"material": Material(**_elastic(problem), **given)}


def _cyclic(problem: Problem, hardening: float) -> dict:
    """Four sub-elements and an elastic one, which hardens like k."""
    two_mu = 2 * problem.material.lame_mu
    parts = 4
    share = two_mu / (two_mu + hardening) / parts
    bounds = [BOUND * (1 + 0.5 * k) for k in range(parts)]
    overlay = Overlay([share] * parts, bounds)
    material = Material(**_elastic(problem), yield_stress=BOUND, overlay=overlay)
    return {"material": material}


def _thin(problem: Problem, hardening: float) -> dict:
    """Linear kinematic hardening in plane stress."""
    material = replace(problem.material, hardening=hardening)
    return {"material": material, "kinematics": "plane stress"}


LAWS: dict[str, Callable[[Problem, float], dict]] = {
    "Voce": partial(_with_law, Voce(LIMIT, LIMIT, 50.0)),
    "Swift": partial(_with_law, Swift(LIMIT, 0.01, 0.3)),
    "Norton": _with_rate,
    "Hill": _with_axes,
    "cyclic": _cyclic,
    "plane stress": _thin,
}
"""Name of a law -> function that changes Example (a) in plane strain, with kinematic hardening
k."""
LAW_RATIOS = (1e-1, 1e-3)
LAW_NODES = (833, 3201)


def problem_with(law: str, nodes: int, ratio: float) -> Problem:
    """Example (a) with another law and order two, k being ``ratio`` times mu."""
    problem = replace(example("lshape", nodes), kinematics="plane strain", order=2)
    return replace(problem, **LAWS[law](problem, ratio * problem.material.lame_mu))


def problem_of(body: str, nodes: int, ratio: float | None) -> Problem:
    """An example, its hardening ``ratio`` times mu if that is given, or a block of elements."""
    if body in LAWS:
        return problem_with(body, nodes, ratio)
    if body == "tetrahedra":
        return indented_block(BLOCKS[body][nodes], ratio * LAME_MU)
    if body == "hexahedra":
        return pressed(
            block.structured_mesh(*[BLOCKS[body][nodes]] * 3), ratio * LAME_MU
        )
    problem = example(body, nodes)
    if ratio is None:
        return problem
    harder = replace(problem.material, hardening=ratio * problem.material.lame_mu)
    return replace(problem, material=harder)


class NewtonCounts(OverMeshes):
    """``levels`` meshes of each family, 1 to 6, blocks, at most 3, and other laws."""

    name = "counts"
    title = "Newton steps of the default method"
    columns = """problem = {problem} | h / mu = {hardening:g} | nodes = {nodes}
        | steps = {default[steps]} | of order one before = {default[order_one]}
        | CPU s = {default[cpu_s]:.2f}
        | nested: steps = {nested[steps]} | CPU s = {nested[cpu_s]:.2f}
        | primal: steps = {primal[steps]} | CPU s = {primal[cpu_s]:.2f}
        | GetFEM: steps = {getfem[0]} | CPU s = {getfem[1]}"""
    note = (
        "Cold starts, nested ones from the next coarser mesh, and the primal method; tolerance "
        "1e-10 (relative forces out of balance); CPU seconds of one thread, set-up included. Rows "
        "with h / mu are Example (a) with other hardening, a sphere of radius 1 pressed 0.03 "
        "into a unit cube, and Example (a) in plane strain (or plane stress), order two, with "
        "other laws by the default method. With k = 1e-3 mu these go by way of displacements of "
        "order one, whose steps have a column of their own. "
        "GetFEM 5.4.2 with its best parameter: measured earlier, on a quiet "
        f"machine, not here. {AT_ROUNDING}"
    )

    def cells(self) -> list[dict]:
        """Both examples, then small hardening, then blocks, then other laws."""
        found = [
            (b, None, n) for b, f in FAMILIES.items() for n in first_of(f, self.levels)
        ]
        found += [("lshape", ratio, n) for n in HARDENED_NODES for ratio in RATIOS]
        meshes = [
            (shape, n) for shape, f in BLOCKS.items() for n in list(f)[: self.levels]
        ]
        found += [(shape, ratio, n) for ratio in BLOCK_RATIOS for shape, n in meshes]
        found += [(law, r, n) for law in LAWS for r in LAW_RATIOS for n in LAW_NODES]
        return [{"body": b, "hardening": ratio, "nodes": n} for b, ratio, n in found]

    def solve(self, body: str, hardening: float | None, nodes: int) -> dict:
        """Solve by all methods that the table shows for the problem."""
        problem = problem_of(body, nodes, hardening)
        methods = METHODS[:1] if body in LAWS else METHODS
        runs = {m: timed(solved_by, m, problem) for m in methods}
        found = {m: numbers for m, (_, numbers) in runs.items()}
        order_one = runs[methods[0]][0].order_one
        if order_one is not None:
            found["default"]["order_one"] = order_one.records[-1].iteration
        if hardening is None:
            family = (examples.BODIES[body].COARSE_NODES, *FAMILIES[body])
            nested(body, "default", family[family.index(nodes) - 1])
            found["nested"] = timed(nested, body, "default", nodes)[1]
            found["getfem"] = GETFEM.get(nodes) if body == "lshape" else None
        title = f"Example (a), {body}" if body in LAWS else f"block, {body}"
        return found | {"problem": TITLES.get(body, title)}

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Always True: the table also shows runs that do not converge."""
        return bool(records)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """How counts were measured, differences of energies, totals of nested iteration."""
        both = [(r["default"], r["primal"]) for r in records if "primal" in r]
        good = [(a, b) for a, b in both if a["status"] == b["status"] == "converged"]
        apart = max(abs(a["energy"] / b["energy"] - 1) for a, b in good)
        found = [f"Energies of the two methods differ by at most {apart:.1e}, relative, where both "
                 "converge."]  # fmt: skip
        for body, title in TITLES.items():
            runs = [r["nested"] for r in records if r["body"] == body and "nested" in r]
            total = sum(run["iterations"] for run in runs)
            meshes = counted(len(runs), "mesh", "meshes")
            found.append(f"{title}: {total} nested steps on {meshes}, the first one "
                         f"started from {examples.BODIES[body].COARSE_NODES} nodes.")  # fmt: skip
        return [self.note, *found]
