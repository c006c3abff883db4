"""Checks of what acts at places of a body: loads, prescribed displacements and springs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ngepc.checks.arguments import boundary_names, require_components, require_field, require_finite
from ngepc.checks.kinds import require_instance
from ngepc.model.given import Given
from ngepc.model.places import Place, Roller, places, require_at

Components = tuple | list | np.ndarray


def check_acting(problem: Given) -> None:
    """Existing places, each once and none of them clamped, with legal values."""
    require_apart("contact", problem.contact_names, problem)
    for argument in CHECKS:
        check_places(argument, problem)
    for argument, check in CHECKS.items():
        for place, value in problem.single(argument).items():
            check(f"{argument}[{place!r}]", value, problem, place)
    if problem.body_force is not None:
        f = require_components("body_force", problem.body_force, problem.N)
        require_finite("body_force", f, problem.mesh)


def check_places(argument: str, problem: Given) -> None:
    """A mapping from places that there are, each once, none of them clamped."""
    given, legal = getattr(problem, argument), boundary_names if argument == "pressure" else places
    if given is not None:
        require_instance(argument, given, Mapping, "a mapping of boundary name -> value")
    keys = [place for key in given or {} for place in legal(argument, key, problem.mesh)]
    twice = sorted({str(place) for place in keys if keys.count(place) > 1})
    if twice:
        raise ValueError(f"{argument} names {', '.join(twice)} more than once")
    require_apart(argument, keys, problem)


def require_apart(argument: str, keys: Components, problem: Given) -> None:
    """Refuse places that are clamped."""
    both = sorted(set(problem.clamped_names) & set(keys))
    if both:
        raise ValueError(
            f"{argument} and clamped overlap in {', '.join(both)}: "
            "a clamped boundary carries nothing else"
        )


def _check_traction(argument: str, g: object, problem: Given, place: Place) -> None:
    """A vector; on a boundary it may have a pole at a vertex."""
    load = require_components(argument, g, problem.N)
    if isinstance(place, str):
        require_finite(argument, load, problem.mesh, [place])
    else:
        require_at(argument, load, problem.mesh, place, shapes=[(problem.N,)])


def _check_pressure(argument: str, p: object, problem: Given, place: str) -> None:
    """A scalar."""
    require_field(argument, p, problem.mesh, [place])


def _check_prescribed(argument: str, given: object, problem: Given, place: Place) -> None:
    """N components, some of them None, or a value along a direction."""
    N, direction = problem.N, getattr(given, "direction", None)
    if isinstance(given, Roller):
        values = [given.value]
        if direction is None and not isinstance(place, str):
            raise ValueError(
                f"{argument}=Roller(): a direction is needed, only boundaries have normals"
            )
        if direction is not None and len(direction) != N:
            raise ValueError(f"{argument}: direction={direction!r}: {N} numbers are needed")
    elif not isinstance(given, Components) or len(given) != N:
        raise ValueError(f"{argument}={given!r}: {N} components are needed, None for a free one")
    else:
        values = [component for component in given if component is not None]
        if place in problem.loads and len(values) == N:
            raise ValueError(
                f"traction and prescribed overlap in {place}: all components are held there, a "
                "load would do nothing"
            )
    for value in values:
        require_at(argument, value, problem.mesh, place)


def _check_springs(argument: str, k: object, problem: Given, place: Place) -> None:
    """One stiffness along the normal of a boundary, or one for each component."""
    constants = k if isinstance(k, Components) else [k]
    if len(constants) != problem.N and not (constants is not k and isinstance(place, str)):
        raise ValueError(f"{argument}={k!r}: {problem.N} numbers are needed")
    for one in constants:
        require_at(argument, one, problem.mesh, place, least=0)


CHECKS = {
    "traction": _check_traction,
    "pressure": _check_pressure,
    "prescribed": _check_prescribed,
    "springs": _check_springs,
}
"""Arguments that give a value to each place."""
