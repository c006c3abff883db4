"""Checks of what acts on a body: loads, prescribed displacements and springs."""

from __future__ import annotations

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import (
    require_coefficient,
    require_field,
    require_finite,
    require_least,
)
from ngepc.model.elements import vertices_of
from ngepc.model.given import Given, as_vector
from ngepc.model.places import require_finite_at, values_at


def check_loads(problem: Given) -> None:
    """Finite loads and pressures, prescribed displacements of N components or along a direction."""
    N, mesh = problem.N, problem.mesh
    for place, g in problem.single("traction").items():
        argument = f"traction[{place!r}]"
        require_vector_load(argument, g, N)
        if isinstance(place, str):
            require_finite(argument, as_vector(g), mesh, [place])
        else:
            require_finite_at(argument, as_vector(g), mesh, place)
    for name, p in problem.single("pressure").items():
        require_field(f"pressure[{name!r}]", p, mesh, [name])
    if problem.body_force is not None:
        require_vector_load("body_force", problem.body_force, N)
        require_finite("body_force", problem.f, mesh)
    for place, components in problem.held_components.items():
        argument = f"prescribed[{place!r}]"
        if not isinstance(components, tuple | list | np.ndarray) or len(components) != N:
            raise ValueError(
                f"{argument}={components!r}: {N} components are needed, None for a free one"
            )
        for c in components:
            if c is not None:
                require_coefficient(argument, c)
                require_finite_at(argument, c, mesh, place)
        if place in problem.loads and all(c is not None for c in components):
            raise ValueError(
                f"traction and prescribed overlap in {place}: all components are held there, a "
                "load would do nothing"
            )
    for place, roller in problem.rollers.items():
        argument, direction = f"prescribed[{place!r}]", roller.direction
        if direction is None and not isinstance(place, str):
            raise ValueError(
                f"{argument}=Roller(): a direction is needed, only boundaries have normals"
            )
        if direction is not None and len(direction) != N:
            raise ValueError(f"{argument}: direction={direction!r}: {N} numbers are needed")
        require_finite_at(argument, roller.value, mesh, place)


def check_springs(problem: Given) -> None:
    """Stiffnesses >= 0: one along the normal of a boundary, or one for each component."""
    for place, k in problem.spring_constants.items():
        argument = f"springs[{place!r}]"
        several = isinstance(k, tuple | list | np.ndarray)
        if (several and len(k) != problem.N) or (not several and not isinstance(place, str)):
            raise ValueError(f"{argument}={k!r}: {problem.N} numbers are needed")
        for one in k if several else [k]:
            require_coefficient(argument, one)
            require_finite_at(argument, one, problem.mesh, place)
            found = values_at(one, problem.mesh, place)[1].min(initial=0.0)
            require_least(argument, found, 0)


def require_vector_load(argument: str, value: object, N: int) -> None:
    """A vector coefficient, or a sequence of N numbers and scalar coefficients."""
    if isinstance(value, CoefficientFunction):
        require_coefficient(argument, value, [(N,)])
    elif isinstance(value, tuple | list | np.ndarray):
        if len(value) != N:
            raise ValueError(f"{argument}={value!r}: {N} components are needed")
        for component in value:
            require_coefficient(argument, component)
    else:
        raise TypeError(f"{argument}={value!r}: a vector of {N} components is needed")


def require_plain(problem: Given, advice: str) -> None:
    """Refuse springs, points, edges, rollers and contact that meets a clamped boundary, by name."""
    mesh, clamped, contact = problem.mesh, problem.clamped_names, problem.contact_names
    for place, value in (problem.spring_constants | problem.rollers).items():
        argument = "prescribed" if place in problem.rollers else "springs"
        raise ValueError(f"{argument}[{place!r}]={value!r}: {advice}")
    for place in problem.concentrated:
        argument = "traction" if place in problem.loads else "prescribed"
        raise ValueError(f"{argument}[{place!r}]: {advice}")
    if contact and clamped and vertices_of(mesh, clamped) & vertices_of(mesh, contact):
        raise ValueError(
            f"contact={problem.contact!r} meets clamped={problem.clamped!r}, it must keep away "
            f"from the clamped boundary, (2.2): {advice}"
        )


def require_linear(problem: Given, what: str) -> None:
    """Refuse a law of hardening and an initial strain, by name: ``what`` needs problems without."""
    if problem.material.law is not None:
        raise ValueError(
            f"material.law={problem.material.law!r}: {what} linear hardening, without a law"
        )
    if problem.initial_strain is not None:
        raise ValueError(
            f"initial_strain={problem.initial_strain!r}: {what} bodies without an initial strain"
        )
