"""Where loads and supports act besides whole boundaries, and supports along oblique directions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import Mesh

from ngepc.checks.arguments import (
    Coefficient,
    boundary_names,
    is_number,
    require_coefficient,
    require_field,
    require_in,
    require_vector,
    sample,
)
from ngepc.checks.declared import Datum, Declared, Text
from ngepc.model.elements import corner_vertices, vertex_coordinates, vertices_of

AT = 1e-6
"""Part of the extent of the body by which a vertex may miss the coordinates of a point."""


@dataclass(frozen=True)
class Point:
    """A point of the body, for ``prescribed``, ``springs`` and ``traction``, there a force.

    Displacements at a point under a force, or held there, grow without bound under refinement in
    theory, like log h in two dimensions: forces are exact, the stress beside it means nothing.

    Parameters
    ----------
    where
        Coordinates of a vertex of the mesh (length), or the name of a point.

    Raises
    ------
    TypeError, ValueError
        If it is neither.
    """

    where: Sequence[float] | str

    def __post_init__(self) -> None:
        if not isinstance(self.where, str):
            object.__setattr__(self, "where", require_vector("where", self.where, (2, 3)))

    def vertices(self, mesh: Mesh) -> np.ndarray:
        """The vertex with these coordinates, or all of this name; a ValueError if there is none."""
        if isinstance(self.where, str):
            return _named(self, self.where, "BBBoundaries"[3 - mesh.dim :], mesh)
        if len(self.where) != mesh.dim:
            raise ValueError(f"{self!r}: {mesh.dim} coordinates are needed on this mesh")
        x = vertex_coordinates(mesh)
        away = np.linalg.norm(x - np.array(self.where), axis=1)
        nearest = int(away.argmin())
        if away[nearest] > AT * np.ptp(x, axis=0).max():
            raise ValueError(
                f"{self!r}: a vertex of the mesh is needed there, the nearest one is at "
                f"{tuple(x[nearest].round(6).tolist())}"
            )
        return np.array([nearest])


@dataclass(frozen=True)
class Edge(Declared):
    """Edges of a solid, for ``prescribed``, ``springs`` and ``traction``, there force per length.

    Parameters
    ----------
    name
        Name of the edges, in three dimensions.

    Raises
    ------
    TypeError
        If it is no text.
    """

    name: Text

    def vertices(self, mesh: Mesh) -> np.ndarray:
        """The vertices on these edges; a ValueError if the mesh is plane or has none."""
        if mesh.dim != 3:
            raise ValueError(f"{self!r}: edges are needed, which are boundaries by name in 2D")
        return _named(self, self.name, "BBoundaries", mesh)


Place = str | Point | Edge
"""The name of one boundary, or a point, or edges."""


@dataclass(frozen=True)
class Roller(Declared):
    """A support along one direction, for ``prescribed``: u . direction = value.

    Parameters
    ----------
    direction
        N numbers, of any length; None for the outer normal of a boundary.
    value
        The displacement along the unit vector (length), a number or scalar coefficient.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """

    direction: Sequence[float] | None = None
    value: Datum = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.direction is not None:
            given = require_vector("direction", self.direction, (2, 3))
            if not any(given):
                raise ValueError(f"direction={self.direction!r}: a vector other than 0 is needed")
            object.__setattr__(self, "direction", given)


def places(argument: str, key: object, mesh: Mesh) -> tuple[Place, ...]:
    """The single places of a key: 'a|b' are two boundaries."""
    if not isinstance(key, Point | Edge):
        return boundary_names(argument, key, mesh)
    try:
        key.vertices(mesh)
    except ValueError as error:
        raise ValueError(f"{argument}: {error}") from None
    return (key,)


def vertices_at(place: Place, mesh: Mesh) -> np.ndarray:
    """Sorted numbers of the vertices of a place."""
    if isinstance(place, str):
        return np.array(sorted(vertices_of(mesh, (place,))), dtype=int)
    return place.vertices(mesh)


def values_at(value: Coefficient, mesh: Mesh, place: Place) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the vertices of a place and the values of a coefficient there, (k, components).

    On a boundary once for each corner of its elements, elsewhere once for each vertex.
    """
    if is_number(value):
        vertices = vertices_at(place, mesh)
        return vertices, np.full((len(vertices), 1), float(value))
    if isinstance(place, str):
        return corner_vertices(mesh, [place]), sample(value, mesh, [place], corners=True)
    vertices = place.vertices(mesh)
    found = value(mesh(*vertex_coordinates(mesh)[vertices].T))
    return vertices, np.asarray(found, dtype=float).reshape(len(vertices), -1)


def require_at(
    argument: str,
    value: Coefficient,
    mesh: Mesh,
    place: Place,
    *,
    shapes: Sequence[tuple[int, ...]] = ((),),
    least: float = -math.inf,
) -> None:
    """Refuse values that are not finite, or < ``least``, at the vertices of a place, or on it."""
    if isinstance(place, str):
        require_field(argument, value, mesh, [place], shapes=shapes, corners=True, least=least)
    else:
        require_coefficient(argument, value, shapes)
        require_in(argument, values_at(value, mesh, place)[1], repr(place), least)


def _named(place: Point | Edge, name: str, kind: str, mesh: Mesh) -> np.ndarray:
    """The vertices of what has this name among the ``BBoundaries`` or ``BBBoundaries``."""
    known = getattr(mesh, f"Get{kind}")()
    if name not in known:
        raise ValueError(
            f"{place!r}: there is no such {type(place).__name__.lower()}; this mesh has "
            f"{', '.join(map(repr, sorted(set(known)))) or 'none'}"
        )
    elements = getattr(mesh, kind)(name).Elements()
    return np.unique([vertex.nr for element in elements for vertex in element.vertices])
