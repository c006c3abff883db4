"""Section 6 in numbers: Figure 4, and Newton steps without the Tichonov term.

Figure 4 has convergence quotients of the last Newton steps on several meshes of both examples,

    Q_j = ||v^(omega-5+j) - v*||_H / ||v^(omega-6+j) - v*||_H,  j = 1, ..., 5,

where omega is the number of steps to the tolerance 1e-10 and v* the solution to 1e-14.  If rounding
keeps the residual above 1e-14, v* is the last iterate before the residual stops decreasing.  The
next Newton correction estimates the rounding errors; distances below ten times that estimate are
dominated by rounding, and their quotients are marked.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from ngsolve import BaseVector, InnerProduct

from ngepc.dual.result import DualResult
from ngepc.dual.spaces import Coupled
from ngepc.methods.newton import semismooth_newton
from ngepc.model.problem import Problem
from ngepc.pictures.style import GUIDE, beside, line_style, save_figure
from ngepc.results.options import NewtonOptions
from ngepc.studies.examples import FAMILIES, TITLES, coarse_start, example
from ngepc.studies.work import OverMeshes, Work, first_of

LAST = 6
"""Iterates that enter the five quotients."""
OPTIONS = NewtonOptions(max_iterations=2000)
GAMMA = 1e4
PRECISE = replace(OPTIONS, tolerance=1e-14)


def convergence_quotients(
    problem: Problem, gamma: float, start: DualResult | None = None
) -> dict:
    """Compare the last iterates of Algorithm 7.1 with v*; arguments as of ``semismooth_newton``.

    The record has 'iterations' omega, 'quotients' Q_1, ..., Q_5 (fewer for fewer steps),
    'distances' ||v^j - v*||_H of the last six iterates (stress), 'meaningful' for distances above
    ten times the rounding, and 'reference_residual' and 'rounding' of v*.
    """
    duals: list = []
    result = semismooth_newton(
        problem, gamma, start, PRECISE, lambda r: duals.append(r.snapshot().v)
    ).or_interrupted()
    residuals = result.history.residual_norms
    reached = [
        k for k, residual in enumerate(residuals) if residual < OPTIONS.tolerance
    ]
    omega = reached[0] if reached else len(residuals) - 1
    best = omega + int(np.argmin(residuals[omega:]))

    def distance(v: BaseVector) -> float:
        """||v - v*||_H = b(v - v*, v - v*)^(1/2)."""
        apart = (v - duals[best]).Evaluate()
        return math.sqrt(
            max(0.0, InnerProduct(result.functional.blocks.B * apart, apart))
        )

    distances = [distance(v) for v in duals[: omega + 1][-LAST:]]
    rounding = (
        distance(duals[min(best + 1, len(duals) - 1)]) or result.residual_rounding
    )
    return {
        "iterations": omega,
        "status": "converged" if reached else result.status.label,
        "quotients": [b / a if a > 0 else 0.0 for a, b in pairwise(distances)],
        "distances": distances,
        "meaningful": [after > 10 * rounding for after in distances[1:]],
        "reference_residual": residuals[best],
        "rounding": rounding,
    }


class Figure4(OverMeshes):
    """Example (a) from the 417-node solution, Example (b) from v = 0, on ``levels`` meshes."""

    name = "figure4"
    title = "Figure 4: convergence quotients"
    columns = """example = {example} | nodes = {nodes} | steps = {iterations} | Q_1 = {Q_1}
        | Q_2 = {Q_2} | Q_3 = {Q_3} | Q_4 = {Q_4} | Q_5 = {Q_5}
        | residual of v* = {reference_residual:.1e} | rounding of v* = {rounding:.1e}"""
    note = (
        "Quotients of the H norms of v^j - v* at gamma = 1e4. v* is the solution for "
        "the tolerance 1e-14, or the last iterate before the residual stops falling (its residual "
        "is in the table). In parentheses: the distance is below ten times the rounding of v*, the "
        "quotient says nothing."
    )

    def cells(self) -> list[dict]:
        """All meshes of both examples."""
        meshes = [
            (body, n) for body, f in FAMILIES.items() for n in first_of(f, self.levels)
        ]
        return [{"body": body, "nodes": n} for body, n in meshes]

    def solve(self, body: str, nodes: int) -> dict:
        """The quotients of one run."""
        start = coarse_start(body, GAMMA, OPTIONS) if body == "lshape" else None
        return convergence_quotients(example(body, nodes), GAMMA, start)

    def table_rows(self, records: Sequence[dict]) -> list[dict]:
        """The records with Q_j, in parentheses where rounding dominates; fewer for fewer steps."""
        rows = []
        for r in records:
            pairs = zip(r["quotients"], r["meaningful"], strict=True)
            said = [f"{q:.3g}" if good else f"({q:.2g})" for q, good in pairs]
            Q = {f"Q_{j}": text for j, text in enumerate(said, LAST - len(said))}
            rows.append(r | Q | {"example": TITLES[r["body"]]})
        return rows

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """The quotients of both examples beside each other, one curve for each mesh."""
        bodies = dict.fromkeys(r["body"] for r in records)
        panels = [
            partial(draw_quotients, [r for r in records if r["body"] == b])
            for b in bodies
        ]
        return [
            save_figure(
                beside(*panels, width=4.2, height=3.2), self.folder / "figure4.png"
            )
        ]


def draw_quotients(records: Sequence[dict], axes: Axes) -> None:
    """Curves of the quotients of an example, without undefined ones."""
    for index, record in enumerate(records):
        quotients = np.where(record["meaningful"], record["quotients"], np.nan)
        j = np.arange(LAST - len(quotients), LAST)
        label = f"{record['nodes']} nodes"
        axes.plot(j, quotients, label=label, **line_style(index, LAST))
    axes.axhline(1.0, color=GUIDE, linewidth=0.8, linestyle=":")
    axes.set(yscale="log", xticks=range(1, LAST), title=TITLES[records[0]["body"]])
    axes.set_xlabel(r"$j$, Newton step $\omega - 5 + j$")
    axes.set_ylabel(r"convergence quotient $Q_j$")
    axes.legend()


COARSER = (113, 225, 417)
WITHOUT = 1e12
"""gamma_T of a negligible Tichonov term: the Moreau-Yosida regularisation remains, whose max
functions map L2 to L2."""


def with_and_without(
    problem: Problem, gamma: float, options: NewtonOptions | None = None
) -> dict:
    """Newton steps from v = 0 with the Tichonov term, and, named ``_without``, without it."""
    record: dict = {}
    kinds = {"": Coupled(gamma), "_without": Coupled(gamma, gamma_tichonov=WITHOUT)}
    for suffix, kind in kinds.items():
        result = semismooth_newton(
            problem, options=options, regularisation=kind
        ).or_interrupted()
        record[f"iterations{suffix}"] = result.iterations
        record[f"halvings{suffix}"] = result.history.halvings
        record[f"status{suffix}"] = result.status.label
    return record


@dataclass(eq=False)
class WithoutTichonov(Work):
    """Newton steps with and without the Tichonov term on meshes of Example (a) up to ``nodes``."""

    nodes: int = 1601
    gamma: float = 1e4

    name = "without_tichonov"
    title = "Newton steps with and without the Tichonov term"
    note = "Example (a) from v = 0; without the term the counts grow with the mesh."
    columns = """nodes = {nodes} | iterations = {iterations} | halvings = {halvings}
        | status = {status} | iterations_without = {iterations_without}
        | halvings_without = {halvings_without} | status_without = {status_without}"""

    def cells(self) -> list[dict]:
        """The meshes."""
        example("lshape", self.nodes)
        meshes = [n for n in (*COARSER, *FAMILIES["lshape"]) if n <= self.nodes]
        return [{"nodes": n, "gamma": self.gamma} for n in meshes]

    def solve(self, nodes: int, gamma: float) -> dict:
        """Both counts."""
        return with_and_without(example("lshape", nodes), gamma)
