"""The same problem with displacements of another order, or on a finer mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ngsolve import ET, CoefficientFunction, IfPos, Mesh

from ngepc.bounds.transfer import check_carried
from ngepc.model.data import DefaultOrder
from ngepc.model.problem import Problem


def with_order_two(problem: Problem) -> Problem:
    """The problem with displacements of order two, if its order is a default that may be two."""
    if problem.order == 1 and isinstance(problem.order, DefaultOrder):
        return of_order_two(problem) or problem
    return problem


def of_order_two(problem: Problem) -> Problem | None:
    """The problem with displacements of order two; None if bounds do not cover it then."""
    other = with_history(problem, order=2)
    try:
        check_carried(other)
    except ValueError:
        return None
    return other


def other_order(problem: Problem) -> Problem | None:
    """The problem with order two; None where it has that."""
    return with_history(problem, order=2) if problem.order == 1 else None


def with_history(problem: Problem, **changes: object) -> Problem:
    """A changed problem with the same hardening and PEEQ, which may fall below zero between points.

    They are polynomials with values at the points of the step before, and have new points here.
    """
    changes["initial_accumulated"] = _not_negative(problem.initial_accumulated)
    changes["initial_hardening"] = _not_negative(problem.initial_hardening)
    return replace(problem, **changes)


def _not_negative(value: Any) -> Any:
    """A scalar coefficient, or the first of a pair, with zero where it is negative."""
    if isinstance(value, Sequence) and len(value) == 2:
        return _not_negative(value[0]), value[1]
    if isinstance(value, CoefficientFunction) and value.dim == 1:
        return IfPos(value, value, 0.0)
    return value


def lower_order(problem: Problem) -> Problem | None:
    """The problem with order one; None where it has that."""
    return with_history(problem, order=1) if problem.order > 1 else None


def refined_once(problem: Problem) -> Problem | None:
    """The problem on a mesh that is refined once; None for cells that Netgen cannot divide."""
    shapes = {element.type for element in problem.mesh.Elements()}
    if problem.N == 3 and shapes != {ET.TET}:
        return None
    finer = Mesh(problem.mesh.ngmesh.Copy())
    finer.Refine()
    finer.Curve(problem.mesh.GetCurveOrder())  # copies are straight
    return with_history(problem, mesh=finer)
