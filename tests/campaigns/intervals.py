"""Intervals of goals of random problems, and verdicts on limits beside fine values.

The limit of a verdict is drawn beside the value on the last mesh, or on that bisected, so that the
verdict is read from the meshes that are there: it is that of the first mesh whose interval does not
contain the limit.  For comparison, the usual practice: halve the mesh width until the number
changes by less than one percent, and compare it with the limit.
"""

import math
import time
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np
from campaigns.crossings import finer, problem_of, random_draws
from campaigns.random_problems import BODIES

from ngepc import MeanDisplacement, Reaction, goal_bound, semismooth_newton, solve_to
from ngepc.bounds.copies import with_matching
from ngepc.bounds.of_state import bound_data_of
from ngepc.bounds.rollers import result_by_nodes
from ngepc.bounds.transfer import on_mesh
from ngepc.goals.goal_terms import terms_of
from ngepc.goals.verdicts import FINEST
from ngepc.studies.work import Work

KINDS = ("order 1", "order 2")
"""Kinds of ``campaigns.crossings``; ``--rows`` chooses others."""
FINER = 2
"""How often cells are bisected for the fine value, which has order two; in space once."""
ROUNDED = 1e-6
"""Tolerance relative to the fine value, as Newton's method stops at its tolerance."""
HEAD = ("group", "problems", "refused", "intervals", "misses", "proved",
        "median percent", "a quarter above")  # fmt: skip
VERDICTS = ("group", "problems", "wrong", "undecided", "refused", "median nodes",
            "median CPU s", "halving h, wrong", "halving h, no answer")  # fmt: skip
BESIDE = (0.02, 0.05, 0.1, 0.2)
"""How far limits are from the fine value, above or below."""
BISECTED = 2000
"""Nodes of the last mesh up to which it is bisected for the value that limits are beside."""
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
    if problem.clamped_names or problem.rollers:
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
    """The goal of a discrete solution; rollers are supports of its nodes, not rows."""
    result = result_by_nodes(result)
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


def drawn_limit(seed, number):
    """Where the limit is: the part by which it differs from the value, and the goal's number."""
    rng = np.random.default_rng([seed, number])
    return float(rng.choice(BESIDE) * rng.choice([-1, 1])), int(rng.integers(100))


def goals_with_values(problem, draw):
    """The goals that are not zero on the mesh of the problem: none has a limit beside zero."""
    result = semismooth_newton(problem)
    goals = goals_of(problem, draw)
    return {
        name: goals[name] for name in sorted(goals) if value_of(result, goals[name])
    }


def value_beside(result, goal):
    """The value beside which limits are: on the mesh bisected, on itself if that is fine."""
    if result.problem.mesh.nv <= BISECTED:
        result = semismooth_newton(finer(result.problem, 1))
    return value_of(result, goal)


@dataclass(eq=False)
class Verdicts(Work):
    """The campaign: one limit beside the fine value of each of ``count`` random problems.

    Parameters
    ----------
    count, seed
        How many problems, and the seed of their sequence.
    """

    count: int = 500
    seed: int = 2

    name, title = "verdicts", "Verdicts on limits, and halving the mesh width"
    columns = " | ".join(
        [" = {group}", *(f"{head} = {{{head}}}" for head in VERDICTS[1:])]
    )

    def cells(self):
        """The problems by number."""
        return [{"seed": self.seed, "number": n} for n in range(1, self.count + 1)]

    def solve(self, seed, number):
        """The verdict on one goal of one problem."""
        problem, draw = drawn(seed, "order 2", number)
        part, turn = drawn_limit(seed, number)
        goals = goals_with_values(problem, draw)
        name = list(goals)[turn % len(goals)]
        begin = time.process_time()
        meshes = []

        def keep(record):
            spent = time.process_time() - begin
            if spent > SECONDS:
                raise StopIteration
            meshes.append((record.nodes, record.lower, record.upper, spent))
            width = record.upper - record.lower
            middle = abs(record.upper + record.lower) / 2
            # the next mesh takes as long as all before
            if width < abs(part) * middle or spent > SECONDS / 2:
                raise StopIteration

        found = {"goal": name, "part": part, "refused": ""}
        try:
            run = solve_to(problem, monitor=keep, goal=goals[name], percent=FINEST)
        except (ValueError, RuntimeError) as error:
            return found | {"refused": str(error)}
        value = value_beside(run.result, goals[name])
        limit = value * (1 + part)
        verdict, nodes, spent = decided(limit, value, meshes)
        found |= {"value": value, "verdict": verdict, "nodes": nodes, "cpu_s": spent}
        last = halved(replace(problem, order=1), goals[name])
        if last is None:
            return found | {"halved": "no answer", "halved_off": math.nan}
        wrong = (last <= limit) != (value <= limit)
        guess = "wrong" if wrong else "right"
        return found | {"halved": guess, "halved_off": last / value - 1}

    def line(self, record):
        """One line about a problem."""
        said = record["refused"] or (
            f"{record['verdict']} after {record['cpu_s']:.3g} s; "
            f"halving {record['halved']}"
        )
        return f"{record['number']} {record['goal']}, {record['part']:+.0%}: {said}"

    def table_rows(self, records):
        """A row for each distance of the limit."""
        rows = []
        for part in BESIDE:
            group = [r for r in records if abs(r["part"]) == part]
            done = [r for r in group if not r["refused"]]
            words = [r["verdict"] for r in done]
            guesses = [r["halved"] for r in done]
            answered = [r for r in done if r["verdict"] != "undecided"] or [
                {"nodes": math.nan, "cpu_s": math.nan}
            ]
            values = [
                f"{100 * part:g} percent from the value",
                len(group),
                words.count("wrong"),
                words.count("undecided"),
                len(group) - len(done),
                f"{np.median([r['nodes'] for r in answered]):.0f}",
                f"{np.median([r['cpu_s'] for r in answered]):.2g}",
                guesses.count("wrong"),
                guesses.count("no answer"),
            ]
            rows.append(dict(zip(VERDICTS, values, strict=True)))
        return rows

    def notes(self, records):
        """What was drawn, how far halving is off, and what has no verdict."""
        done = [r for r in records if not r["refused"]]
        off = [abs(r["halved_off"]) for r in done]
        off = [value for value in off if not math.isnan(value)]
        lines = [
            "Random problems of `tests/campaigns/random_problems.py`; of each one goal that is not "
            "zero, and one limit above or below its value on the last mesh, bisected if it has at "
            f"most {BISECTED} nodes. Verdicts: order two, intervals of the first {SECONDS:g} s of "
            f"CPU time; no mesh is begun after {SECONDS / 2:g} s. Halving: order one, until the "
            f"number changes by less than {100 * CHANGE:g} percent, {HALVINGS} times at most.",
            f"Where halving ends it is off by {100 * np.median(off or [math.nan]):.2g} percent "
            f"(median), {100 * max(off, default=math.nan):.3g} percent at most.",
        ]
        left = [r for r in records if r["refused"] or r["verdict"] == "undecided"]
        return lines + [
            f"- {r['number']} {r['goal']}, {r['part']:+.0%}: {r['refused'] or 'undecided'}"
            for r in left
        ]


def decided(limit, value, meshes):
    """'right', 'wrong' or 'undecided'; nodes and CPU seconds of the mesh that decides."""
    for nodes, lower, upper, spent in meshes:
        if upper < limit or limit < lower:
            right = (upper < limit) == (value < limit)
            return "right" if right else "wrong", nodes, spent
    return "undecided", 0, math.nan


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
