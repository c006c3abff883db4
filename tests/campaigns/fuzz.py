"""Random problems solved by the default method and the primal one, compared and judged.

``examine`` solves each by both and lists everything that is wrong:

- an exception, or a result without a finite state,
- a run that says CONVERGED although the forces, assembled independently (witness.py), do not
  balance to the tolerance,
- energies in the wrong order: -J* must not exceed the minimum that the primal method finds, and J
  of the default method's state must not be below it.

Each of these is a failure.  Runs that end with another status are counted separately.
"""

import math
from dataclasses import asdict, dataclass
from itertools import islice

import numpy as np
from campaigns.random_problems import BODIES, GAPS, HARDENINGS, build, draws
from ngsolve import Integrate
from witness import balance_residual, energy, feasible_bound

from ngepc.methods.newton import semismooth_newton
from ngepc.primal.solver import primal_newton
from ngepc.results.outcome import Status
from ngepc.studies.work import Work

SLACK = 1e-8
"""Rounding allowed in the comparison of energies, relative to the energies."""
RESIDUAL = 2e-10
"""Forces out of balance, relative, that a converged run may leave: twice its tolerance."""

HEAD = ("group", "problems", "failures", "primal converged", "default converged",
        "other statuses", "median gap", "worst gap")  # fmt: skip

EMPTY = {
    "failures": (),
    "nodes": 0,
    "statuses": (),
    "iterations": (),
    "plastic": math.nan,
    "contact": math.nan,
    "gap": math.nan,
    "messages": (),
}


def examine(draw):
    """Solve a random problem by both methods and judge the results; never raises.

    ``failures`` are sentences, one for each thing that is wrong.  ``statuses`` and ``iterations``
    belong to the primal and the default method.  ``plastic`` and ``contact`` are the fractions of
    the body that yields and of Gamma_c in contact.  ``gap`` is the relative difference of the
    energies.
    """
    try:
        problem = build(draw)
        primal = primal_newton(problem).or_interrupted()
        return {
            "draw": asdict(draw),
            **judged(primal, semismooth_newton(problem).or_interrupted()),
        }
    except Exception as error:  # any exception is a failure
        return EMPTY | {
            "draw": asdict(draw),
            "failures": (f"{type(error).__name__}: {error}",),
        }


def judged(primal, default):
    """The verdict of ``examine`` on two results for one problem."""
    problem, last = primal.problem, primal.history.records[-1]
    gap, out_of_order = _energies(primal, default)
    runs = (primal, default)
    return {
        "failures": (*_false_statuses(primal, default), *out_of_order),
        "nodes": problem.mesh.nv,
        "statuses": tuple(run.status.label for run in runs),
        "iterations": tuple(run.iterations for run in runs),
        "plastic": last.plastic_active / Integrate(1.0, problem.mesh),
        "contact": last.contact_active / max(float(primal.rows.weights.sum()), 1e-300),
        "gap": gap,
        "messages": tuple(r.message for r in runs if r.status is not Status.CONVERGED),
    }


def _false_statuses(primal, default):
    """A sentence for each run that reports convergence wrongly or has no finite state."""
    for name, result in {"primal": primal, "default": default}.items():
        residual = balance_residual(result)
        if result.status is Status.CONVERGED and not residual < RESIDUAL:
            yield f"{name} method says converged, its residual is {residual:.3g} > {RESIDUAL:.3g}"
        if not math.isfinite(result.primal_energy + result.dual_energy):
            yield f"no finite state is left: {result.status.label}"


def _energies(primal, default):
    """The relative difference of the energies, and a sentence for each wrong order."""
    distance, above = feasible_bound(primal, default)
    least = energy(primal.problem, primal.displacement, primal.plastic_increment)
    scale = abs(least) + abs(default.dual_energy) + 1e-300
    if not primal.status is default.status is Status.CONVERGED:
        return above / scale, []
    pairs = {
        "solutions are {:.6g} apart, energies allow {:.6g}": (distance, above),
        "-J* is {:.12g}, energies allow {:.12g}": (-default.dual_energy, least),
    }
    return above / scale, [
        text.format(*pair)
        for text, pair in pairs.items()
        if not pair[0] <= pair[1] + SLACK * scale
    ]


@dataclass(eq=False)
class Fuzz(Work):
    """The study: ``count`` random problems, kept one by one.

    Parameters
    ----------
    count, seed
        How many problems, and the seed of their sequence.
    """

    count: int = 200
    seed: int = 1

    name, title = "fuzz", "Random problems"
    columns = " | ".join([" = {group}", *(f"{head} = {{{head}}}" for head in HEAD[1:])])

    def cells(self):
        """The problems by number."""
        return [
            {"seed": self.seed, "number": number} for number in range(1, self.count + 1)
        ]

    def solve(self, seed, number):
        """The verdict on one problem."""
        return examine(next(islice(draws(seed), number - 1, None)))

    def line(self, record):
        """One line about a verdict, and one for each failure and message."""
        d = record["draw"]
        pairs = zip(record["statuses"], record["iterations"], strict=True)
        runs = " and ".join(f"{status} ({steps})" for status, steps in pairs)
        said = (*record["failures"], *record["messages"])
        return (
            f"{d['body']} {record['nodes']} nodes, gap {d['gap']}: {runs}, plastic "
            f"{record['plastic']:.0%}, contact {record['contact']:.0%}, gap {record['gap']:.2g}"
            + "".join(f"\n    {text}" for text in said)
        )

    def table_rows(self, records):
        """Counts over groups of problems."""
        groups = [(label, group) for label, group in _groups(records) if group]
        return [dict(zip(HEAD, _row(*pair), strict=True)) for pair in groups]

    def notes(self, records):
        """What was drawn, what a failure is, and the failures."""
        failures = [
            (k, v["failures"]) for k, v in enumerate(records, 1) if v["failures"]
        ]
        return [
            f"{len(records)} random problems, seed {self.seed}, each solved by the default method "
            "and by the primal one. Materials over six orders of magnitude in stress and four in "
            "length, Poisson's ratio -0.4 to 0.49, yield bound 1e-4 to 3e-2 and hardening 1e-3 to "
            "3 of lame_mu, loads 0.03 to 16 times the yield bound. A failure is a problem with an "
            "exception, a run with the status converged whose residual forces (assembled "
            "independently) exceed twice the tolerance, or energies in the wrong order. Gap: "
            "relative difference of the energies.",
            *[f"- {number}: {'; '.join(texts)}" for number, texts in failures],
        ]


def _groups(table):
    yield "all", list(table)
    for name, values in {
        "gap": GAPS,
        "kind": HARDENINGS,
        "body": tuple(BODIES),
    }.items():
        for value in values:
            yield f"{name} {value}", [v for v in table if v["draw"][name] == value]
    for name, low, high in (
        ("elastic", 0, 1e-12),
        ("yields", 1e-12, 0.5),
        ("deeply", 0.5, 2),
    ):
        yield name, [v for v in table if low <= v["plastic"] < high]


def _row(label, group):
    statuses = [status for v in group for status in v["statuses"]]
    others = sorted(set(statuses) - {"converged"})
    gaps = [v["gap"] for v in group if math.isfinite(v["gap"])] or [math.nan]
    converged = [sum(list(v["statuses"][k : k + 1]) == ["converged"] for v in group)
                 for k in (0, 1)]  # fmt: skip
    return [
        label,
        len(group),
        sum(bool(v["failures"]) for v in group),
        *converged,
        ", ".join(f"{statuses.count(s)} {s}" for s in others) or "none",
        f"{np.median(gaps):.2g}",
        f"{max(gaps):.2g}",
    ]
