"""Places and conditions there: points, edges, rollers, contact of two bodies, friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngepc.checks.arguments import (
    Coefficient,
    boundary_names,
    corner_rules,
    require_vector,
    sample,
)
from ngepc.checks.declared import Along, Datum, Declared, Flag, NotNegativeDatum, Text
from ngepc.checks.sentences import in_words
from ngepc.model.elements import corner_vertices, vertex_coordinates
from ngepc.model.located import located

AT = 1e-6
"""Fraction of the extent of the body by which a vertex may miss the coordinates of a point."""


@dataclass(frozen=True)
class Point:
    """A point of the body, for ``prescribed``, ``springs`` and ``traction``, there a force.

    Displacements at a point under a force, or held there, grow without bound under refinement in
    theory, like log h in two dimensions: forces are exact, but stresses near the point are not.

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
            vars(self)["where"] = require_vector("where", self.where, (2, 3))


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

    direction: Along | None = None
    value: Datum = 0.0


@dataclass(frozen=True)
class Contact(Declared):
    """Two parts of the boundary that may touch, with small sliding; their gap is that of the mesh.

    The contact conditions belong to the nodes of the first one: choose the finer or softer side,
    or the one that lies within the other.  Bodies that share nodes are refused.

    Parameters
    ----------
    first, second
        Boundary names, 'a' or 'a|b'.
    tied
        Whether the two are glued: no gap opens, nothing slips, also where they do not touch.

    Raises
    ------
    TypeError
        If a name is no text, or ``tied`` neither True nor False.
    """

    first: Text
    second: Text
    tied: Flag = False


@dataclass(frozen=True)
class Coulomb(Declared):
    """Coulomb's law: the tangential traction is at most the coefficient times the pressure.

    With a limit F the law is |t| <= min(mu lambda, F) for the pressure lambda.  For large
    coefficients there may be several solutions, reported by the status NOT_UNIQUE, or none that is
    reached from the last load step.

    Parameters
    ----------
    coefficient
        mu >= 0, a number or a scalar coefficient (1).
    limit
        F >= 0, the largest tangential traction (stress), a number or a scalar coefficient, such as
        the shear strength of the softer body; None for no limit.

    Raises
    ------
    TypeError, ValueError
        If one of them is neither, negative, infinite or NaN.
    """

    coefficient: NotNegativeDatum
    limit: NotNegativeDatum | None = None


def places(argument: str, key: object, mesh: Mesh) -> tuple[Place, ...]:
    """The single places of a key: 'a|b' are two boundaries."""
    if not isinstance(key, Point | Edge):
        return boundary_names(argument, key, mesh)
    try:
        vertices_at(key, mesh)
    except ValueError as error:
        raise ValueError(f"{argument}: {error}") from None
    return (key,)


def vertices_at(place: Place, mesh: Mesh) -> np.ndarray:
    """Sorted numbers of the vertices of a place; a ValueError if the mesh has no such place."""
    if isinstance(place, str):
        return np.unique(corner_vertices(mesh, [place]))
    edges = isinstance(place, Edge)
    if edges and mesh.dim != 3:
        raise ValueError(
            f"{place!r}: edges are needed, which are boundaries by name in 2D"
        )
    where, kind = (place.name, "edge") if edges else (place.where, "point")
    if not isinstance(where, str):
        return _nearest(place, mesh)
    regions = "BBoundaries" if edges else "BBBoundaries"[3 - mesh.dim :]
    known = getattr(mesh, f"Get{regions}")()
    if where not in known:
        legal = ", ".join(map(repr, sorted(set(known)))) or "none"
        raise ValueError(f"{place!r}: there is no such {kind}; this mesh has {legal}")
    elements = getattr(mesh, regions)(where).Elements()
    return np.unique([vertex.nr for element in elements for vertex in element.vertices])


def _nearest(point: Point, mesh: Mesh) -> np.ndarray:
    """The vertex with the coordinates of a point; a ValueError if there is none."""
    if len(point.where) != mesh.dim:
        raise ValueError(f"{point!r}: {mesh.dim} coordinates are needed on this mesh")
    x = vertex_coordinates(mesh)
    away = np.linalg.norm(x - np.array(point.where), axis=1)
    nearest = int(away.argmin())
    if away[nearest] > AT * np.ptp(x, axis=0).max():
        at = tuple(x[nearest].round(6).tolist())
        raise ValueError(
            f"{in_words(point)}: a vertex of the mesh is needed there, the nearest is at {at}"
        )
    return np.array([nearest])


def values_at(
    value: Coefficient | Sequence[float], mesh: Mesh, place: Place
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the vertices of a place and the values there, shape (k, components).

    Those of a coefficient on a boundary once for each corner of its elements, others once for each
    vertex.
    """
    if isinstance(place, str) and isinstance(value, CoefficientFunction):
        rules = corner_rules(mesh.dim - 1)
        return corner_vertices(mesh, [place]), sample(value, mesh, [place], rules)
    vertices = vertices_at(place, mesh)
    if not isinstance(value, CoefficientFunction):
        return vertices, np.tile(np.array(value, dtype=float), (len(vertices), 1))
    found = value(located(mesh, vertex_coordinates(mesh)[vertices]))
    return vertices, np.asarray(found, dtype=float).reshape(len(vertices), -1)
