"""Why adaptive refinement ends before its tolerance: sentences, empty where it goes on."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ngsolve import Mesh

from ngepc.bounds.outcome import (
    FLOWS,
    NO_BOUND,
    ErrorBound,
    is_free_of_stress,
    why_infinite,
)
from ngepc.goals.goal_interval import GoalBound
from ngepc.goals.refinement import BoundedResult, MeshRecord, Refinement
from ngepc.local.result import ExactResult
from ngepc.results.outcome import Status

HOPELESS = 100.0  # an interval this many times wider than its middle lies around zero

# refinement continues after these statuses of Newton's method
SOLVED = (Status.CONVERGED, Status.BOUNDED, Status.STAGNATED)

MOST_INFINITE = 6
"""Refinement ends after so many successive meshes with an infinite error bound."""

FREE_OF_STRESS = (
    "The body is free of stress, up to rounding errors: no mesh gives its strain energy to a "
    "percentage."
)


def ending(result: ExactResult, stopped: str) -> str:
    """The reason to stop refinement at a result; empty if it can continue."""
    if stopped or result.status in SOLVED:
        return stopped
    return result.ending or result.status.value


def too_fine(mesh: Mesh, bound: ErrorBound, options: Refinement) -> str:
    """Why refinement ends before a mesh with too many nodes."""
    limit = f"The next mesh has {mesh.nv} nodes, max_nodes={options.max_nodes}."
    unknown = "" if math.isfinite(bound.total) else NO_BOUND
    return " ".join(filter(None, (limit, unknown)))


def lost_bound(here: BoundedResult) -> str:
    """Why refinement ends with the mesh before one whose bound is infinite, as that was finite."""
    return f"The next mesh has {here.records[-1].nodes} nodes and no bound. {NO_BOUND}"


def about_zero(before: GoalBound | None, now: GoalBound | None) -> str:
    """Why no mesh gives a percentage of a goal: two intervals lie around zero; empty otherwise.

    One alone may lie around zero by chance.
    """
    found = (before, now)
    if not all(goal is not None and is_around_zero(goal) for goal in found):
        return ""
    return f"The {now.name} is about 0: no mesh gives it to a percentage."


def is_around_zero(goal: GoalBound) -> bool:
    """Whether zero is in the middle of an interval, as the proof has it."""
    lower, upper = goal.proved
    return HOPELESS * abs(lower + upper) / 2 < upper - lower < math.inf


def without_bound(here: BoundedResult) -> str:
    """Why finer meshes have no bound either; empty if they may have one."""
    if math.isfinite(here.bound.total):
        return ""
    why = why_infinite(here.result.state)
    return why if why == FLOWS else never_finite(here.records)


def without_stress(here: BoundedResult) -> str:
    """Why no mesh reaches a part of a strain energy that is a rounding error; empty otherwise."""
    if here.goal is not None or here.reached:
        return ""
    free = is_free_of_stress(here.bound.state, here.bound.total)
    return FREE_OF_STRESS if free else ""


def never_finite(records: Sequence[MeshRecord]) -> str:
    """Why refinement ends if the bound is infinite on the last meshes; empty otherwise."""
    last = records[-MOST_INFINITE:]
    if len(last) < MOST_INFINITE or any(math.isfinite(r.total) for r in last):
        return ""
    return NO_BOUND
