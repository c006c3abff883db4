"""Random problems solved by two methods, compared and judged.

``examine`` solves each by the primal method and by another and lists everything that is wrong:

- an exception, or a result without a finite state,
- a run that says CONVERGED although the residual, assembled independently (witness.py), does not
  meet the tolerance,
- energies out of order: -J* of the default method must be no more, J of its state no less than the
  minimum; for the paper's method ``witness.distance_bound`` says how far solutions may be apart.

Runs that end in another status are honest but counted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from ngsolve import Integrate

from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.primal import PrimalOptions, primal_newton
from ngepc.primal.result import PrimalResult
from ngepc.results import checkpoint, records
from ngepc.results.outcome import Result, Status
from ngepc.studies.verification.random_problems import (
    BODIES,
    GAPS,
    METHODS,
    Draw,
    build,
    coupled,
    draws,
)
from ngepc.studies.verification.witness import (
    balance_residual,
    distance_bound,
    dual_residual,
    energy,
    feasible_bound,
)
from ngepc.studies.work import Table, Work

SLACK = 1e-8
"""Rounding allowed in the comparison of energies, relative to the energies."""

POINTS = 25

HEAD = ("", "problems", "complaints", "primal converged", "other converged", "other statuses",
        "median gap", "worst gap")  # fmt: skip


EMPTY = {
    "complaints": (),
    "nodes": 0,
    "statuses": (),
    "iterations": (),
    "plastic": math.nan,
    "contact": math.nan,
    "gap": math.nan,
    "messages": (),
}


def examine(draw: Draw) -> dict:
    """Solve a random problem by both methods and judge the results; never raises.

    Returns
    -------
    dict
        ``draw``; ``complaints``, a sentence each, none when all is well; ``nodes``; ``statuses``
        and ``iterations`` of the primal method and the other; ``plastic`` and ``contact``, parts of
        the body that yield and of Gamma_c in contact; ``gap``, what the energies leave between the
        solutions, relative; ``messages`` of runs that did not converge.
    """
    try:
        problem = build(draw)
        primal = primal_newton(problem).or_interrupted()
        options = NewtonOptions(quadrature_points=POINTS)
        R = coupled(draw, problem) if draw.method == "coupled" else None
        other = semismooth_newton(problem, regularisation=R, options=options).or_interrupted()
        return _verdict(draw, primal, other, options)
    except Exception as error:  # any exception at all is a complaint: that is what is looked for
        return EMPTY | {"draw": asdict(draw), "complaints": (f"{type(error).__name__}: {error}",)}


def _verdict(draw: Draw, primal: PrimalResult, other: Result, options: NewtonOptions) -> dict:
    problem, last = primal.problem, primal.history.records[-1]
    gap, out_of_order = _energies(draw, primal, other)
    runs = {"primal": primal, draw.method: other}
    return {
        "draw": asdict(draw),
        "complaints": (*_false_statuses(draw, primal, other, options), *out_of_order),
        "nodes": problem.mesh.nv,
        "statuses": tuple(run.status.label for run in runs.values()),
        "iterations": tuple(run.iterations for run in runs.values()),
        "plastic": last.plastic_active / Integrate(1.0, problem.mesh),
        "contact": last.contact_active / max(float(primal.rows.weights.sum()), 1e-300),
        "gap": gap,
        "messages": tuple(r.message for r in runs.values() if r.status is not Status.CONVERGED),
    }


def _false_statuses(
    draw: Draw, primal: PrimalResult, other: Result, options: NewtonOptions
) -> Iterator[str]:
    """Runs that say converged without being so, and states that are not finite."""
    most = 2 * PrimalOptions().tolerance
    seen = {"primal": (primal, balance_residual(primal), most)}
    if draw.method == "default":
        seen["default"] = other, balance_residual(other), most
    if draw.method == "coupled":
        unit, witness = other.functional.residual_unit, dual_residual(other, POINTS)
        most = options.tolerance + witness.rounding / unit
        seen["coupled"] = other, witness.norm / unit, most
    for name, (result, residual, most) in seen.items():
        if result.status is Status.CONVERGED and not residual < most:
            yield f"{name} method says converged, its residual is {residual:.3g} > {most:.3g}"
    for result in (primal, other):
        if not math.isfinite(result.primal_energy + result.dual_energy):
            yield f"no finite state is left: {result.status.label}"


def _energies(draw: Draw, primal: PrimalResult, other: Result) -> tuple[float, list[str]]:
    """What the energies leave between the solutions, relative, and what is out of order."""
    distance, above = feasible_bound(primal, other)
    least = energy(primal.problem, primal.displacement, primal.plastic_increment)
    pairs = {"solutions are {:.6g} apart, energies allow {:.6g}": (distance, above)}
    if draw.method == "coupled":
        apart, above = distance_bound(primal, other)
        pairs["the regularised solution is {:.6g} away, energies allow {:.6g}"] = apart, above
    else:
        pairs["-J* is {:.12g}, energies allow {:.12g}"] = -other.dual_energy, least
    scale = abs(least) + abs(other.dual_energy) + 1e-300
    if not primal.status is other.status is Status.CONVERGED:
        return above / scale, []
    return above / scale, [
        text.format(*pair) for text, pair in pairs.items() if not pair[0] <= pair[1] + SLACK * scale
    ]


class Fuzz(Work):
    """The study: ``count`` random problems, kept one by one.

    Parameters
    ----------
    folder, progress
        As for ``Work``.
    count, seed
        How many problems, and the seed of their sequence.
    """

    name = "fuzz"

    def __init__(
        self,
        folder: Path,
        count: int = 200,
        seed: int = 1,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(folder, progress, seed=seed)
        self.count, self.seed = count, seed
        self._path = self.folder / f"fuzz-{seed}.npz"

    def run(self) -> list[dict]:
        """Examine the problems that no earlier run has examined; returns all verdicts."""
        records.check_writable(self._path)
        stored = checkpoint.load(self._path, self._settings)
        verdicts = [] if stored is None else stored.record["verdicts"]
        for number, draw in zip(range(self.count), draws(self.seed), strict=False):
            if number < len(verdicts):
                continue
            verdicts.append(examine(draw))
            checkpoint.save(self._path, self._settings, {"verdicts": verdicts}, {})
            self.progress(f"[{number + 1}/{self.count}] {summary(verdicts[-1])}")
        return verdicts[: self.count]

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write fuzz.csv, fuzz.md and fuzz.json; returns their paths."""
        complaints = [(k, v["complaints"]) for k, v in enumerate(table, 1) if v["complaints"]]
        notes = [
            f"{len(table)} random problems, seed {self.seed}, each solved by the primal method and "
            "by another. Materials over six orders of magnitude in stress and four in length, "
            "Poisson's ratio -0.4 to 0.49, yield bound 1e-4 to 3e-2 and hardening 1e-3 to 3 of "
            "lame_mu, loads 0.03 to 16 times the yield bound. Complaints are exceptions, runs that "
            "say converged with a residual (assembled independently) above the tolerance and its "
            "own rounding, and energies out of order; gap: what the energies leave between the "
            "solutions, relative.",
            *[f"- {number}: {'; '.join(texts)}" for number, texts in complaints],
        ]
        return Table(
            name=self.name,
            title="Random problems",
            head=HEAD,
            rows=[_row(label, group) for label, group in _groups(table)],
            notes=notes,
            cells=table,
            seed=self.seed,
        ).write(self.folder)


def _groups(table: Sequence[dict]) -> Iterator[tuple[str, list[dict]]]:
    yield "all", list(table)
    for name, values in {"method": METHODS, "gap": GAPS, "body": tuple(BODIES)}.items():
        for value in values:
            yield f"{name} {value}", [v for v in table if v["draw"][name] == value]
    for name, low, high in (("elastic", 0, 1e-12), ("yields", 1e-12, 0.5), ("deeply", 0.5, 2)):
        yield name, [v for v in table if low <= v["plastic"] < high]


def _row(label: str, group: list[dict]) -> list[object]:
    statuses = [status for v in group for status in v["statuses"]]
    others = sorted(set(statuses) - {"converged"})
    gaps = [v["gap"] for v in group if math.isfinite(v["gap"])] or [math.nan]
    converged = [sum(v["statuses"][k : k + 1] == ["converged"] for v in map(_listed, group))
                 for k in (0, 1)]  # fmt: skip
    return [
        label,
        len(group),
        sum(bool(v["complaints"]) for v in group),
        *converged,
        ", ".join(f"{statuses.count(s)} {s}" for s in others) or "none",
        f"{np.median(gaps):.2g}",
        f"{max(gaps):.2g}",
    ]


def _listed(verdict: dict) -> dict:
    return {**verdict, "statuses": list(verdict["statuses"])}


def summary(verdict: dict) -> str:
    """One line about a verdict, and one for each complaint and message."""
    d = verdict["draw"]
    runs = " and ".join(
        f"{status} ({steps})"
        for status, steps in zip(verdict["statuses"], verdict["iterations"], strict=True)
    )
    return (
        f"{d['body']} {verdict['nodes']} nodes, {d['method']}, gap {d['gap']}: {runs}, plastic "
        f"{verdict['plastic']:.0%}, contact {verdict['contact']:.0%}, gap {verdict['gap']:.2g}"
        + "".join(f"\n    {text}" for text in (*verdict["complaints"], *verdict["messages"]))
    )
