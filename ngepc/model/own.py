"""A problem as it is at the moment of a solve: what changes later does not change its result.

An ``ngsolve.Parameter`` becomes its number; a GridFunction among the loads, gaps and material data,
dictionaries, the lists in them, and arrays become copies.  The mesh is shared: that it has been
refined, curved or moved since is refused by name.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import partial
from typing import NamedTuple
from zlib import crc32

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Mesh, Parameter

from ngepc.checks.arguments import is_number
from ngepc.checks.coefficients import (
    FUNCTION,
    PARAMETER,
    leaves_of,
    with_numbers,
    with_own_functions,
)
from ngepc.checks.sentences import counted
from ngepc.model.data import ProblemData

INITIAL = "initial_"
"""Prefix of arguments that come from an earlier step; users do not change these."""

Change = Callable[[str, CoefficientFunction], CoefficientFunction]


def own_copy(problem: ProblemData) -> ProblemData:
    """The problem with data of its own, and with the state that its mesh has now.

    ValueError if a ``Parameter`` is in a part of a coefficient that cannot be rebuilt.
    """
    return OwnCopies().of(problem)


class OwnCopies:
    """Own copies of the problems of several steps.

    Steps share a datum if the given one is the same object and has not changed in between.
    """

    def __init__(self) -> None:
        self._last: dict[str, tuple[object, list, object]] = {}

    def of(self, problem: ProblemData) -> ProblemData:
        """The problem with data of its own, see ``own_copy``."""
        own = copy.copy(problem)
        for name, value in problem.given.items():
            vars(own)[name] = self._own(name, value)
        return own.as_solved_on(MeshState.of(problem.mesh))

    def _own(self, name: str, value: object) -> object:
        """A datum that no later change reaches."""
        of_a_step = name.startswith(INITIAL)  # its functions are not copied
        change = with_numbers if of_a_step else with_own_functions
        state = list(_contents(value, functions=not of_a_step))
        last = self._last.get(name)
        if last is None or last[0] is not value or last[1] != state:
            last = value, state, _changed(name, _copied(value), change)
            self._last[name] = last
        return last[2]


def _contents(value: object, *, functions: bool) -> Iterator[object]:
    """What may change in a datum: numbers, those of parameters, and of functions if they count."""
    if isinstance(value, CoefficientFunction):
        yield from _values_in(value, functions=functions)
    elif is_number(value) or value is None or isinstance(value, str):
        yield value
    else:
        for part in _parts(value):
            yield from _contents(part, functions=functions)


def _values_in(
    coefficient: CoefficientFunction, *, functions: bool
) -> Iterator[object]:
    """Numbers of the parameters of a coefficient, and checksums of its functions."""
    kinds = (PARAMETER, FUNCTION) if functions else (PARAMETER,)
    for leaf in leaves_of(coefficient, *kinds):
        if isinstance(leaf, Parameter):
            yield leaf.Get()
        elif functions and isinstance(leaf, GridFunction):
            yield hash(leaf.vec.FV().NumPy().tobytes())


def _parts(value: object) -> Iterable[object]:
    """What a datum is made of; nothing if it is a whole."""
    if isinstance(value, Mapping):
        return (*map(str, value), *value.values())
    if isinstance(value, tuple | list):
        return value
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return vars(value).values()
    return ()


def _copied(value: object) -> object:
    """A copy of a dictionary and the lists and arrays in it, of a list or an array; else itself."""
    if isinstance(value, Mapping):
        return {key: _copied(entry) for key, entry in value.items()}
    return copy.copy(value) if isinstance(value, list | np.ndarray) else value


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


class MeshState(NamedTuple):
    """What a result on a mesh relies on, and what can change afterwards."""

    vertices: int
    elements: int
    curve_order: int
    deformation: int
    points: int
    """Checksums of the deformation, 0 without one, and of the coordinates of the vertices."""

    @classmethod
    def of(cls, mesh: Mesh) -> MeshState:
        """The state that a mesh has now."""
        moved = mesh.deformation
        return cls(
            vertices=mesh.nv,
            elements=mesh.ne,
            curve_order=mesh.GetCurveOrder(),
            deformation=0 if moved is None else crc32(moved.vec.FV().NumPy()),
            points=crc32(mesh.ngmesh.Coordinates().tobytes()),
        )

    def change_to(self, now: MeshState) -> str:
        """What differs, in words; empty if nothing does."""
        before = self
        if before[:2] != now[:2]:
            return (
                f"had {before.vertices} vertices and {counted(before.elements, 'element')} when "
                f"this problem was solved, and has {now.vertices} and {now.elements} now"
            )
        if before.curve_order != now.curve_order:
            return (
                f"had elements of order {before.curve_order} when this problem was solved, and "
                f"has order {now.curve_order} now (mesh.Curve)"
            )
        if before.deformation != now.deformation:
            return "has another deformation than when this problem was solved"
        if before.points != now.points:
            return "has other points than when this problem was solved"
        return ""


def require_same_mesh(problem: ProblemData) -> ProblemData:
    """``problem``; a ValueError if its mesh has changed since it was solved."""
    before = problem.solved_on
    if before is not None:
        _require_no_change(before.change_to(MeshState.of(problem.mesh)))
    return problem


def require_same_elements(problem: ProblemData) -> None:
    """A ValueError if the mesh has other elements; nodal values may follow points that move."""
    before = problem.solved_on
    if before is not None:
        mesh = problem.mesh
        _require_no_change(
            before.change_to(before._replace(vertices=mesh.nv, elements=mesh.ne))
        )


def _require_no_change(change: str) -> None:
    if change:
        raise ValueError(
            f"mesh {change}: solve again, or change a copy, Mesh(mesh.ngmesh.Copy())"
        )
