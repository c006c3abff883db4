"""A problem as it is at the moment of a solve: what changes later does not change its result.

An ``ngsolve.Parameter`` becomes its number, a GridFunction among the loads, gaps and material data
a copy.  The mesh is shared: that it has been refined since is refused by name.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from functools import partial

from ngsolve import CoefficientFunction, Mesh

from ngepc.checks.coefficients import with_numbers, with_own_functions
from ngepc.model.data import ProblemData

INITIAL = "initial_"
"""Prefix of arguments that come from an earlier step; users do not change these."""

Change = Callable[[str, CoefficientFunction], CoefficientFunction]


def own_copy(problem: ProblemData) -> ProblemData:
    """The problem with data of its own, and with the size that its mesh has now.

    ValueError if a ``Parameter`` is in a part of a coefficient that cannot be rebuilt.
    """
    own = copy.copy(problem)
    for name, value in problem.given.items():
        change = with_numbers if name.startswith(INITIAL) else with_own_functions
        vars(own)[name] = _changed(name, value, change)
    vars(own)["solved_on"] = size_of(problem.mesh)
    return own


def _changed(name: str, value: object, change: Change) -> object:
    """A datum with each coefficient in it changed, itself if there is none."""
    if isinstance(value, CoefficientFunction):
        return change(name, value)
    again = partial(_changed, name, change=change)
    if isinstance(value, Mapping):
        new = {key: again(entry) for key, entry in value.items()}
        same = all(new[key] is value[key] for key in new)
    elif isinstance(value, tuple | list):
        new = type(value)(map(again, value))
        same = all(a is b for a, b in zip(new, value, strict=True))
    elif is_dataclass(value) and not isinstance(value, type):
        new = copy.copy(value)
        vars(new).update({key: again(entry) for key, entry in vars(value).items()})
        same = all(vars(new)[key] is entry for key, entry in vars(value).items())
    else:
        return value
    return value if same else new


def size_of(mesh: Mesh) -> tuple[int, int]:
    """Numbers of vertices and elements, which refinement changes."""
    return mesh.nv, mesh.ne


def require_same_mesh(problem: ProblemData) -> ProblemData:
    """``problem``; a ValueError if its mesh was refined since it was solved."""
    before = getattr(problem, "solved_on", None)
    now = size_of(problem.mesh)
    if before is not None and before != now:
        raise ValueError(
            f"mesh had {before[0]} vertices and {before[1]} elements when this problem was "
            f"solved, and has {now[0]} and {now[1]} now: solve again, or refine a copy, "
            "Mesh(mesh.ngmesh.Copy())"
        )
    return problem
