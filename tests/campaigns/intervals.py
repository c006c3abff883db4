"""Intervals of goals of random problems, and verdicts on limits beside fine values.

Verdicts on many limits share one run of meshes: a verdict is that of the first mesh whose interval
does not contain the limit.  For comparison, the usual practice: halve the mesh width until the
number changes by less than one percent, and compare it with the limit.
"""

import math
import time
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from campaigns.crossings import finer, problem_of, random_draws
from campaigns.random_problems import BODIES

from ngepc import MeanDisplacement, Reaction, goal_bound, semismooth_newton, solve_to
from ngepc.bounds.bound import bound_data_of
from ngepc.bounds.goal_terms import terms_of
from ngepc.bounds.transfer import on_mesh, with_matching
from ngepc.bounds.verdicts import FINEST
from ngepc.studies.work import Work

KINDS = ("order 1", "order 2")
"""Kinds of ``campaigns.crossings``; ``--rows`` chooses others."""
FINER = 2
"""How often cells are bisected for the fine value, which has order two; in space once."""
ROUNDED = 1e-6
"""Tolerance relative to the fine value, as Newton's method stops at its tolerance."""
HEAD = ("group", "problems", "refused", "intervals", "misses", "proved",
        "median percent", "a quarter above")  # fmt: skip
VERDICTS = ("group", "problems", "verdicts", "wrong", "undecided", "median nodes",
            "halving h, wrong", "halving h, no answer")  # fmt: skip
BESIDE = (0.02, 0.05, 0.1, 0.2)
"""How far limits are from the fine value, above and below."""
SECONDS = 60.0
HALVINGS = 4
CHANGE = 0.01
"""Halving ends where the number changes by less than this part."""


def goals_of(problem, draw):
    """Goals of a random problem, by name."""
    if problem.contact_pairs:
        return goals_of_bodies(problem)
    if problem.contact_names == ("below",):
        displacement = MeanDisplacement("top", 1)
        return {"contact force": "contact_force", "mean displacement": displacement}
    body = BODIES[draw.body]
    goals = {"work": "work"}
    if problem.clamped_names:
        goals["reaction"] = Reaction(body.clamped, 0)
    if "|" not in body.load:
        goals["mean displacement"] = MeanDisplacement(body.load, 0)
    if problem.contact_names:
        goals["contact force"] = "contact_force"
    return goals


def goals_of_bodies(problem):
    """Goals of two blocks, by name."""
    goals = {
        "contact force": "contact_force",
        "reaction": Reaction("bottom", 1),
        "mean displacement": MeanDisplacement("side", 0),
    }
    if "top" in problem.tractions:
        goals["work"] = "work"
    return goals


def fine_problem(problem):
    """The problem with order two on bisected cells, which match where two bodies meet."""
    problem = replace(problem, order=2)
    matching = with_matching(problem, None)
    if matching is not None:
        problem = on_mesh(problem, *matching)
    return finer(problem, FINER if problem.N == 2 else 1)


def value_of(result, goal):
    """The goal of a discrete solution."""
    bound_data = bound_data_of(result.discrete)
    return terms_of(goal, bound_data).value(bound_data, result.state)


def drawn(seed, kind, number):
    """A random problem of a kind and its draw."""
    draw = next(islice(random_draws(seed, kind), number - 1, None))
    return problem_of(draw, kind), draw


@dataclass(eq=False)
class Intervals(Work):
    """The campaign: intervals of all goals of ``count`` random problems of each kind.

    Parameters
    ----------
    count, seed, rows
        How many problems of each kind, the seed of their sequence, and the kinds.
    """

    count: int = 55
    seed: int = 1
    rows: tuple[str, ...] = KINDS

    name, title = "intervals", "Intervals of goals compared with fine values"
    columns = " | ".join([" = {group}", *(f"{head} = {{{head}}}" for head in HEAD[1:])])

    def cells(self):
        """The problems by kind and number."""
        return [
            {"seed": self.seed, "kind": kind, "number": number}
            for number in range(1, self.count + 1)
            for kind in self.rows
        ]

    def solve(self, seed, kind, number):
        """All intervals of one problem, and the fine values."""
        problem, draw = drawn(seed, kind, number)
        result = semismooth_newton(problem)
        fine = semismooth_newton(fine_problem(problem))
        found = []
        refused = ""
        for name, goal in goals_of(problem, draw).items():
            try:
                bound = goal_bound(result, goal)
            except (ValueError, RuntimeError) as error:
                refused = f"{name}: {error}"
                continue
            value = value_of(fine, goal)
            low = bound.lower - value
            high = value - bound.upper
            found.append(
                {
                    "goal": name,
                    "missed": max(low, high, 0.0) / (abs(value) or 1.0),
                    "percent": bound.percent,
                    "proved": bound.guaranteed,
                }
            )
        return {"found": found, "refused": refused}

    def line(self, record):
        """One line about a problem."""
        told = [f"{f['goal']} {f['percent']:.3g} percent" for f in record["found"]]
        return f"{record['number']} {record['kind']}: {', '.join(told)} {record['refused']}"

    def table_rows(self, records):
        """A row for each kind and goal."""
        rows = []
        names = sorted({f["goal"] for r in records for f in r["found"]})
        for kind in self.rows:
            group = [r for r in records if r["kind"] == kind]
            for name in names:
                found = [f for r in group for f in r["found"] if f["goal"] == name]
                widths = [f["percent"] for f in found] or [math.nan]
                values = [
                    f"{name}, {kind}",
                    len(group),
                    sum(r["refused"].startswith(name) for r in group),
                    len(found),
                    sum(f["missed"] > ROUNDED for f in found),
                    sum(f["proved"] for f in found),
                    f"{np.median(widths):.3g}",
                    f"{np.quantile(widths, 0.75):.3g}",
                ]
                rows.append(dict(zip(HEAD, values, strict=True)))
        return rows

    def notes(self, records):
        """What was drawn, and the misses."""
        lines = [
            "Random problems of `tests/campaigns/random_problems.py` on coarse meshes; the fine "
            "value is that of order two on cells that are bisected twice."
        ]
        lines += [
            f"- {r['kind']} {r['number']}: {f['goal']} missed by {f['missed']:.2g} of the value"
            for r in records
            for f in r["found"]
            if f["missed"] > ROUNDED
        ]
        reasons = sorted({r["refused"] for r in records if r["refused"]})
        return [*lines, *(f"- refused: {reason}" for reason in reasons)]


@dataclass(eq=False)
class Verdicts(Work):
    """The campaign: limits beside fine values of ``count`` random problems.

    Parameters
    ----------
    count, seed
        How many problems, and the seed of their sequence.
    """

    count: int = 63
    seed: int = 2

    name, title = "verdicts", "Verdicts on limits, and halving the mesh width"
    columns = " | ".join(
        [" = {group}", *(f"{head} = {{{head}}}" for head in VERDICTS[1:])]
    )

    def cells(self):
        """The problems by number."""
        return [{"seed": self.seed, "number": n} for n in range(1, self.count + 1)]

    def solve(self, seed, number):
        """All verdicts of one goal of one problem."""
        problem, draw = drawn(seed, "order 2", number)
        goals = goals_of(problem, draw)
        name = sorted(goals)[number % len(goals)]
        goal = goals[name]
        begin = time.process_time()
        intervals = []

        def keep(record):
            spent = time.process_time() - begin
            if spent > SECONDS:
                raise StopIteration
            intervals.append((record.nodes, record.lower, record.upper))
            width = record.upper - record.lower
            middle = abs(record.upper + record.lower) / 2
            narrow = width / 2 < min(BESIDE) / 2 * middle
            # the next mesh takes as long as all before
            if narrow or spent > SECONDS / 2:
                raise StopIteration

        try:
            run = solve_to(problem, monitor=keep, goal=goal, percent=FINEST)
        except (ValueError, RuntimeError) as error:
            return {"goal": name, "refused": str(error)}
        value = value_of(semismooth_newton(finer(run.result.problem, 1)), goal)
        limits = [value * (1 + s * part) for part in BESIDE for s in (-1, 1)]
        verdicts = [decided(limit, value, intervals) for limit in limits]
        last = halved(replace(problem, order=1), goal)
        guesses = [] if last is None else [(last <= m) != (value <= m) for m in limits]
        return {
            "goal": name,
            "refused": "",
            "value": value,
            "verdicts": verdicts,
            "halved": guesses,
            "halved_off": math.nan if last is None else last / value - 1,
        }

    def line(self, record):
        """One line about a problem."""
        if record["refused"]:
            return f"{record['number']} {record['goal']}: {record['refused']}"
        words = [verdict for verdict, _ in record["verdicts"]]
        return (
            f"{record['number']} {record['goal']}: {words.count('right')} right, "
            f"{words.count('wrong')} wrong; halving {sum(record['halved'])} wrong"
        )

    def table_rows(self, records):
        """A row for each distance of the limit."""
        done = [r for r in records if not r["refused"]]
        rows = []
        for place, part in enumerate(BESIDE):
            both = (2 * place, 2 * place + 1)
            found = [r["verdicts"][k] for r in done for k in both]
            words = [word for word, _ in found]
            nodes = [count for word, count in found if word != "undecided"]
            guesses = [r["halved"][k] for r in done for k in both if r["halved"]]
            values = [
                f"{100 * part:g} percent from the value",
                len(done),
                len(found),
                words.count("wrong"),
                words.count("undecided"),
                f"{np.median(nodes or [math.nan]):.0f}",
                sum(guesses),
                len(found) - len(guesses),
            ]
            rows.append(dict(zip(VERDICTS, values, strict=True)))
        return rows

    def notes(self, records):
        """What was drawn, how far halving is off, and what is refused."""
        off = [abs(r["halved_off"]) for r in records if not r["refused"]]
        off = [value for value in off if not math.isnan(value)]
        lines = [
            "Random problems of `tests/campaigns/random_problems.py`, one goal each, limits above "
            "and below the value on the last mesh bisected. Verdicts: order two, intervals of "
            f"the first {SECONDS:g} s of CPU time. Halving: order one, until the "
            f"number changes by less than {100 * CHANGE:g} percent, {HALVINGS} times at most.",
            f"Where halving ends it is off by {100 * np.median(off or [math.nan]):.2g} percent "
            f"(median), {100 * max(off, default=math.nan):.3g} percent at most.",
        ]
        refused = [r for r in records if r["refused"]]
        lines += [f"- {r['number']} {r['goal']}: {r['refused']}" for r in refused]
        return lines


def decided(limit, value, intervals):
    """'right', 'wrong' or 'undecided', and the vertices of the mesh that decides."""
    for nodes, lower, upper in intervals:
        if upper < limit or limit < lower:
            return ("right" if (upper < limit) == (value < limit) else "wrong"), nodes
    return "undecided", 0


def halved(problem, goal):
    """The number where halving the mesh width changes it by less than one percent, or None."""
    before = math.nan
    for _ in range(HALVINGS + 1):
        number = value_of(semismooth_newton(problem), goal)
        if abs(number - before) < CHANGE * abs(number):
            return number
        before = number
        problem = finer(problem, 1)
    return None
