"""Random problems solved by both methods, compared and judged.

``examine`` solves it by the primal and by the dual method and lists everything that is wrong:

- an exception, or a result without a finite state,
- a run that says CONVERGED although the residual, assembled independently (witness.py), does not
  meet the tolerance,
- solutions further apart than the energies of both allow (``witness.distance_bound`` and
  ``witness.feasible_bound``).

Runs that end in another status are honest but counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from ngsolve import Integrate

from ngepc._version import __version__
from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.model.problem import Problem
from ngepc.primal import PrimalOptions, primal_newton
from ngepc.primal.result import PrimalResult
from ngepc.results import checkpoint, records
from ngepc.results.outcome import Status
from ngepc.studies.output import Table, write_table
from ngepc.studies.random_problems import BODIES, GAPS, METHODS, Draw, build, draws, regularisation
from ngepc.studies.witness import (
    distance_bound,
    dual_residual,
    elastic_product,
    feasible_bound,
    primal_residual,
)

SLACK = 1e-8
"""Rounding allowed in the comparison of energies, relative to the energies."""

POINTS = 25

HEAD = (
    *("", "problems", "complaints", "primal converged", "dual converged", "other statuses"),
    *("median bound", "worst bound"),
)


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What a random problem showed.

    Parameters
    ----------
    draw
        The problem.
    complaints
        What is wrong, a sentence each; empty when all is well.
    nodes
        Vertices of the mesh.
    primal_status, dual_status
        Labels of the statuses.
    primal_iterations, dual_iterations
        Newton steps.
    primal_residual, dual_residual
        Assembled independently; the dual one in reference units.
    plastic, contact
        Parts of the body that yield and of Gamma_c in contact, by the primal solution.
    distance, bound
        1/2 |y - y_gamma|_D^2 and its bound, both over the strain energy of the primal solution.
    messages
        Messages of runs that did not converge.
    """

    draw: Draw
    complaints: tuple[str, ...] = ()
    nodes: int = 0
    primal_status: str = ""
    dual_status: str = ""
    primal_iterations: int = 0
    dual_iterations: int = 0
    primal_residual: float = math.nan
    dual_residual: float = math.nan
    plastic: float = math.nan
    contact: float = math.nan
    distance: float = math.nan
    bound: float = math.nan
    messages: tuple[str, ...] = ()


def examine(draw: Draw) -> Verdict:
    """Solve a random problem by both methods and judge the results; never raises."""
    try:
        problem = build(draw)
        primal = primal_newton(problem, options=PrimalOptions()).or_interrupted()
        R = regularisation(draw, problem)
        options = NewtonOptions(quadrature_points=POINTS)
        dual = semismooth_newton(problem, regularisation=R, options=options).or_interrupted()
        return _judge(draw, primal, dual, options)
    except Exception as error:  # any exception at all is a complaint: that is what is looked for
        return Verdict(draw=draw, complaints=(f"{type(error).__name__}: {error}",))


def _judge(draw: Draw, primal: PrimalResult, dual: DualResult, options: NewtonOptions) -> Verdict:
    unit, witness = dual.functional.residual_unit, dual_residual(dual, POINTS)
    residuals = primal_residual(primal), witness.norm / unit
    tolerances = (
        2 * PrimalOptions().tolerance,
        options.tolerance + witness.rounding / unit,
    )
    complaints = []
    for name, result, residual, tolerance in zip(
        ("primal", "dual"), (primal, dual), residuals, tolerances, strict=True
    ):
        if result.status is Status.CONVERGED and not residual < tolerance:
            complaints.append(
                f"{name} method says converged, its residual is {residual:.3g} > {tolerance:.3g}"
            )
        if not math.isfinite(result.primal_energy + result.dual_energy):
            complaints.append(f"{name} method left no finite state: {result.status.label}")
    distance, bound = distance_bound(primal, dual)
    energy = _strain_energy(primal)
    rounding = SLACK * (abs(primal.primal_energy) + abs(dual.dual_energy) + energy)
    if primal.status is dual.status is Status.CONVERGED:
        for apart, most in ((distance, bound), feasible_bound(primal, dual)):
            if not apart <= most + rounding:
                complaints.append(f"solutions are {apart:.6g} apart, energies allow {most:.6g}")
    last, problem = primal.history.records[-1], primal.problem
    return Verdict(
        draw=draw,
        complaints=tuple(complaints),
        nodes=problem.mesh.nv,
        primal_status=primal.status.label,
        dual_status=dual.status.label,
        primal_iterations=primal.iterations,
        dual_iterations=dual.iterations,
        primal_residual=residuals[0],
        dual_residual=residuals[1],
        plastic=last.plastic_active / _measure(problem),
        contact=last.contact_active / max(float(primal.rows.weights.sum()), 1e-300),
        distance=distance / energy,
        bound=bound / energy,
        messages=tuple(r.message for r in (primal, dual) if r.status is not Status.CONVERGED),
    )


def _strain_energy(primal: PrimalResult) -> float:
    """int C (eps(u) - p) : (eps(u) - p) / 2 + h |p|^2 / 2, something to compare energies with."""
    problem, u, p = primal.problem, primal.displacement, primal.plastic_increment
    h = problem.effective_hardening
    return Integrate(elastic_product(problem, h, u, p, u, p), problem.mesh) / 2 + 1e-300


def _measure(problem: Problem) -> float:
    return Integrate(1.0, problem.mesh)


class Fuzz:
    """The study: ``count`` random problems, resumable.

    Parameters
    ----------
    folder
        Where results go.
    count, seed
        How many problems, and the seed of their sequence.
    progress
        Called with a line of text after each problem.
    """

    def __init__(
        self, folder: Path, count: int, seed: int, progress: Callable[[str], None] | None = None
    ) -> None:
        self.folder, self.count, self.seed = Path(folder), count, seed
        self.progress = progress or (lambda line: None)
        self._path = self.folder / f"fuzz-{seed}.npz"
        self._work = {"study": "fuzz", "seed": seed, "ngepc": __version__}

    def run(self) -> list[Verdict]:
        """Examine the problems that no earlier run has examined; returns all verdicts."""
        records.check_writable(self._path)
        stored = checkpoint.load(self._path, self._work)
        verdicts = [] if stored is None else [_from_record(r) for r in stored.record["verdicts"]]
        for number, draw in zip(range(self.count), draws(self.seed), strict=False):
            if number < len(verdicts):
                continue
            verdicts.append(examine(draw))
            checkpoint.save(self._path, self._work, {"verdicts": list(map(asdict, verdicts))}, {})
            self.progress(f"[{number + 1}/{self.count}] {summary(verdicts[-1])}")
        return verdicts[: self.count]

    def write(self, verdicts: list[Verdict]) -> list[Path]:
        """Write fuzz.csv, fuzz.md and fuzz.json; returns their paths."""
        cells = [{**asdict(v.draw), **asdict(v), "draw": None} for v in verdicts]
        notes = [
            f"{len(verdicts)} random problems, seed {self.seed}, each solved by the primal and by "
            "the dual method. Materials over six orders of magnitude in stress and four in length, "
            "Poisson's ratio -0.4 to 0.49, yield bound 1e-4 to 3e-2 and hardening 1e-3 to 3 of "
            "lame_mu, loads 0.03 to 16 times the yield bound.",
            "",
            "*Complaints* are exceptions, runs that say converged with a residual (assembled "
            "independently) above the tolerance and its own rounding (primal: twice the "
            "tolerance), and pairs of solutions further apart than their energies allow. The "
            f"largest residual among the converged runs is {_largest(verdicts):.2g}, primal "
            "relative, dual in reference units; runs that stagnated name the rounding that keeps "
            "them above the tolerance.",
            *[f"- {number}: {'; '.join(v.complaints)}" for number, v in _with(verdicts)],
        ]
        table = Table(
            name="fuzz",
            title="Random problems",
            head=HEAD,
            rows=[_row(label, group) for label, group in _groups(verdicts)],
            notes=notes,
            cells=cells,
        )
        return write_table(self.folder, table, self.seed)


def _largest(verdicts: list[Verdict]) -> float:
    """The largest independent residual of a run that says converged."""
    primal = (v.primal_residual for v in verdicts if v.primal_status == "converged")
    dual = (v.dual_residual for v in verdicts if v.dual_status == "converged")
    return max((*primal, *dual), default=math.nan)


def _with(verdicts: list[Verdict]) -> list[tuple[int, Verdict]]:
    return [(number, v) for number, v in enumerate(verdicts, 1) if v.complaints]


def _groups(verdicts: list[Verdict]) -> Iterator[tuple[str, list[Verdict]]]:
    yield "all", verdicts
    for name, values in {"method": METHODS, "gap": GAPS, "body": tuple(BODIES)}.items():
        for value in values:
            yield f"{name} {value}", [v for v in verdicts if getattr(v.draw, name) == value]
    deep = {"elastic": (0.0, 1e-12), "partly plastic": (1e-12, 0.5), "deeply plastic": (0.5, 2.0)}
    for name, (low, high) in deep.items():
        yield name, [v for v in verdicts if low <= v.plastic < high]
    touching = {"one part in contact": (1e-12, 0.95), "full contact": (0.95, 2.0)}
    for name, (low, high) in touching.items():
        yield name, [v for v in verdicts if low <= v.contact < high]


def _row(label: str, group: list[Verdict]) -> list[object]:
    statuses = [s for v in group for s in (v.primal_status, v.dual_status)]
    others = sorted({s for s in statuses if s not in ("converged", "")})
    bounds = [v.bound for v in group if math.isfinite(v.bound)]
    return [
        label,
        len(group),
        sum(bool(v.complaints) for v in group),
        sum(v.primal_status == "converged" for v in group),
        sum(v.dual_status == "converged" for v in group),
        ", ".join(f"{statuses.count(s)} {s}" for s in others) or "none",
        f"{np.median(bounds):.2g}" if bounds else "",
        f"{max(bounds):.2g}" if bounds else "",
    ]


def summary(verdict: Verdict) -> str:
    """One line about a verdict."""
    d = verdict.draw
    return (
        f"{d.body} {verdict.nodes} nodes, {d.method}, gap {d.gap}: primal {verdict.primal_status} "
        f"({verdict.primal_iterations}), dual {verdict.dual_status} ({verdict.dual_iterations}), "
        f"plastic {verdict.plastic:.0%}, contact {verdict.contact:.0%}, distance "
        f"{verdict.distance:.2g} of {verdict.bound:.2g}"
        + "".join(f"\n    {text}" for text in (*verdict.complaints, *verdict.messages))
    )


def _from_record(record: dict) -> Verdict:
    texts = {name: tuple(record[name]) for name in ("complaints", "messages")}
    return Verdict(**{**record, **texts, "draw": Draw(**record["draw"])})
