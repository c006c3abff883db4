"""Newton steps over meshes: Tables 1 and 2 of the paper, and the default method in all its places.

Rows of the paper's tables are numbers (its method at that gamma), 'default' and 'primal'; a star
marks nested iteration, each mesh started from the solution on the next coarser one.  The table of
the default method has small hardening and solids beside, and GetFEM 5.4.2 as it was measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from ngepc.dual.newton import NewtonOptions
from ngepc.geometries import block
from ngepc.model.problem import Problem
from ngepc.pictures.curves import plot_counts
from ngepc.pictures.style import save_figure
from ngepc.results.result import Result
from ngepc.studies.examples import (
    BODIES,
    FAMILIES,
    TITLES,
    coarse_start,
    example,
    nested,
    solved_by,
    timed,
)
from ngepc.studies.large import LAME_MU, indented_block, pressed
from ngepc.studies.paper import TABLE_1, TABLE_2
from ngepc.studies.work import Work, chosen, ending, first_of, pivoted, steps

OWN_ROWS = ("default", "default*", "primal", "primal*")
OPTIONS = NewtonOptions(max_iterations=2000)
ALWAYS_ONE_STEP = 1e2
"""Up to this gamma Example (a) is elastic and takes one step on every mesh."""


@dataclass(eq=False)
class CountTable(Work):
    """A table of the paper with our counts; its rows and further ones of other methods.

    ``paper`` has its counts on the meshes of the family of ``body`` by rows, ``about`` says from
    where the runs start.
    """

    levels: int = 3
    rows: Sequence[str] | None = None

    body: ClassVar[str]
    paper: ClassVar[Mapping[str, Sequence[int]]]
    about: ClassVar[str]

    note = (
        "Newton steps for {study.example}, ours (the paper's in parentheses). {study.about} Rows "
        "'default' are the default method and 'primal' the primal one, cold or with * nested. "
        "Tolerance 1e-10, 400 quadrature points per triangle for the paper's rows."
    )

    def __post_init__(self) -> None:
        self.nodes = first_of(FAMILIES[self.body], self.levels)
        self.example, self.title = TITLES[self.body], f"Table {self.name[-1]}"
        heads = [f"{n} nodes" for n in self.nodes]
        self.columns = [("gamma", "{row}"), *((head, f"{{{head}}}") for head in heads)]
        self.rows = chosen([*self.paper, *OWN_ROWS], self.rows or [*self.paper, "default"])

    def cells(self) -> list[dict]:
        """All rows on one mesh after the other."""
        return [{"row": row, "nodes": nodes} for nodes in self.nodes for row in self.rows]

    def solve(self, row: str, nodes: int) -> dict:
        """One run, and the paper's count."""
        result, paper = self.result(row, nodes), self.paper.get(row, ())
        names = ("iterations", "primal_energy", "dual_energy", "residual_norm")
        return {
            "paper": paper[FAMILIES[self.body].index(nodes)] if paper else None,
            "status": result.status.label,
            **{name: getattr(result, name) for name in names},
            "halvings": result.history.halvings,
        }

    def result(self, row: str, nodes: int) -> Result:
        """Nested, or from where the paper starts."""
        method, problem = row.rstrip("*"), example(self.body, nodes)
        if row.endswith("*"):
            return nested(self.body, method, nodes, OPTIONS)
        coarse = self.body == "lshape" and math.isfinite(gamma_of(row))
        start = coarse_start(self.body, method, OPTIONS) if coarse else None
        return solved_by(method, problem, start, OPTIONS).or_interrupted()

    def told(self, records: Sequence[dict]) -> list[dict]:
        """Rows over meshes."""
        return pivoted(records, ("row",), "{nodes} nodes", beside_paper)

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """Steps over nodes, the paper's dashed; rows of an elastic body are named in the title."""
        rows = [row for row in self.rows if gamma_of(row) > ALWAYS_ONE_STEP] or self.rows
        ours, paper = (
            {label_of(row): {r["nodes"]: r[key] for r in records if r["row"] == row} for row in of}
            for key, of in (("iterations", rows), ("paper", [r for r in rows if r in self.paper]))
        )
        figure = plot_counts(ours, paper)
        if left_out := [row for row in self.rows if row not in rows]:
            most = max(r["iterations"] for r in records if r["row"] in left_out)
            title = f"not drawn: gamma = {', '.join(left_out)}, at most {most} steps"
            figure.axes[0].set_title(title, loc="left", fontsize="medium")
        return [save_figure(figure, self.folder / f"{self.name}_steps.png")]


class Table1(CountTable):
    """Example (a); the paper's rows start from the prolongated solution on 417 nodes."""

    name, body, paper = "table1", "lshape", TABLE_1
    about = (
        "The paper's method starts from the prolongated solution on 417 nodes, rows with * from "
        "the next coarser mesh."
    )


class Table2(CountTable):
    """Example (b); the paper's rows start from v = 0."""

    name, body, paper = "table2", "wrench", TABLE_2
    about = (
        "The paper's method starts from v = 0. The paper prints 24927 nodes for the mesh with "
        "24993; its polygon is lost, ours is reconstructed (docs/reading.md)."
    )


def beside_paper(record: dict) -> str:
    """Ours (paper), with the status where the run did not converge."""
    paper = "" if record["paper"] is None else f" ({record['paper']})"
    return f"{record['iterations']}{paper}{ending(record)}"


def gamma_of(row: str) -> float:
    """Gamma of a row, infinity for the methods without one."""
    method = row.rstrip("*")
    return math.inf if method in ("default", "primal") else float(method)


def label_of(row: str) -> str:
    """What a row is called in pictures."""
    method = row.rstrip("*")
    name = f"{method} method" if math.isinf(gamma_of(row)) else f"gamma = {method}"
    return f"{name}, nested" if row.endswith("*") else name


RATIOS = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
HARDENED_NODES = (833, 3201)
GETFEM = {833: (11, 0.1), 3201: (15, 0.8), 12545: (22, 4.7)}
"""Nodes of Example (a) -> Newton steps and CPU seconds of GetFEM 5.4.2 with its best parameter."""

BLOCK_RATIOS = (1e-1, 1e-3)
BLOCKS = {"tetrahedra": {281: 1, 1745: 2, 12193: 3}, "hexahedra": {343: 6, 1728: 11, 12167: 22}}
"""Elements -> nodes -> refinements of a coarse mesh, or cells along an edge."""

NAMES = TITLES | {shape: f"block, {shape}" for shape in BLOCKS}

NOTE = (
    "Cold starts, nested ones from the next coarser mesh, and the primal method; tolerance 1e-10 "
    "(relative forces out of balance); CPU seconds of one thread, set-up included. Rows with h / "
    "mu are Example (a) with other hardening, and a sphere of radius 1 pressed 0.03 into a unit "
    "cube. GetFEM 5.4.2 with its best parameter: measured earlier, on a quiet machine, not here. "
    "'stagnated': the residual has come down to its own rounding, which is above 1e-10 there."
)


def problem_of(body: str, nodes: int, ratio: float | None = None) -> Problem:
    """An example, with the kinematic hardening ``ratio`` mu if given, or a block of BLOCKS."""
    if body in FAMILIES:
        problem = example(body, nodes)
        if ratio is None:
            return problem
        hardening = ratio * problem.material.lame_mu
        return replace(problem, material=replace(problem.material, hardening=hardening))
    size = BLOCKS[body][nodes]
    if body == "tetrahedra":
        return indented_block(size, ratio * LAME_MU)
    return pressed(block.structured_mesh(size, size, size), ratio * LAME_MU)


@dataclass(eq=False)
class NewtonCounts(Work):
    """``levels`` meshes of each family, 1 to 6, and blocks, at most 3."""

    levels: int = 3

    name, title = "counts", "Newton steps of the default method"
    columns = (
        ("problem", lambda r: NAMES[r["body"]]),
        ("h / mu", "{hardening:g}"),
        ("nodes", "{nodes}"),
        ("steps", lambda r: steps(r["default"])),
        ("CPU s", "{default[cpu_s]:.2f}"),
        ("nested: steps", lambda r: steps(r["nested"]) if "nested" in r else ""),
        ("CPU s", "{nested[cpu_s]:.2f}"),
        ("primal: steps", lambda r: steps(r["primal"])),
        ("CPU s", "{primal[cpu_s]:.2f}"),
        ("GetFEM: steps", "{getfem[0]}"),
        ("CPU s", "{getfem[1]}"),
    )

    def cells(self) -> list[dict]:
        """Both examples, then small hardening, then blocks."""
        found = [(b, None, n) for b, f in FAMILIES.items() for n in first_of(f, self.levels)]
        found += [("lshape", ratio, n) for n in HARDENED_NODES for ratio in RATIOS]
        found += [
            (shape, ratio, n)
            for ratio in BLOCK_RATIOS
            for shape, sizes in BLOCKS.items()
            for n in list(sizes)[: self.levels]
        ]
        return [{"body": b, "hardening": ratio, "nodes": n} for b, ratio, n in found]

    def solve(self, body: str, hardening: float | None, nodes: int) -> dict:
        """By all methods that the table shows for it."""
        problem = problem_of(body, nodes, hardening)
        found = {m: timed(lambda m=m: solved_by(m, problem))[1] for m in ("default", "primal")}
        if hardening is None:
            family = (BODIES[body].COARSE_NODES, *FAMILIES[body])
            nested(body, "default", family[family.index(nodes) - 1])
            found["nested"] = timed(lambda: nested(body, "default", nodes))[1]
            found["getfem"] = GETFEM.get(nodes) if body == "lshape" else None
        return found

    def succeeded(self, records: Sequence[dict]) -> bool:
        """Runs that do not converge are part of what is shown."""
        return bool(records)

    def notes(self, records: Sequence[dict]) -> list[str]:
        """How it was measured, how far energies differ, totals of nested iteration."""
        both = [(r["default"], r["primal"]) for r in records]
        good = [(a, b) for a, b in both if a["status"] == b["status"] == "converged"]
        apart = max(abs(a["energy"] / b["energy"] - 1) for a, b in good)
        found = [f"Energies of the two methods differ by at most {apart:.1e}, relative, where both "
                 "converge."]  # fmt: skip
        for body, title in TITLES.items():
            runs = [r["nested"] for r in records if r["body"] == body and "nested" in r]
            total = sum(run["iterations"] for run in runs)
            found.append(f"{title}: {total} nested steps on {len(runs)} meshes, the first one "
                         f"started from {BODIES[body].COARSE_NODES} nodes.")  # fmt: skip
        return [NOTE, *found]
