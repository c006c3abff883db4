"""Meshes from files of gmsh and other programs, as meshio reads them.

Boundaries and materials are named as the groups of the file; outer facets without a group are
called ``free``.  Of elements of second order the corners are taken: the order of displacements is
that of the Problem.
"""

from collections.abc import Iterator

import numpy as np
from ngsolve import Mesh

from ngepc.checks.kinds import require_attributes

from .outlines import netgen_mesh

SHAPES = {
    "line": (1, 2),
    "triangle": (2, 3),
    "quad": (2, 4),
    "tetra": (3, 4),
    "hexahedron": (3, 8),
    "wedge": (3, 6),
}
"""Name of a cell without the number of its nodes -> dimension and corners."""

_TURNED = {
    3: (0, 2, 1),
    4: (0, 3, 2, 1),
    8: (0, 3, 2, 1, 4, 7, 6, 5),
    6: (0, 2, 1, 3, 5, 4),
}
_TURNED_TETRA = (0, 2, 1, 3)

_SIDES = {
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    (3, 8): (
        (0, 3, 2, 1),
        (4, 5, 6, 7),
        (0, 1, 5, 4),
        (1, 2, 6, 5),
        (2, 3, 7, 6),
        (3, 0, 4, 7),
    ),
    (3, 6): ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
}


def mesh(source: object) -> Mesh:
    """The mesh that meshio has read, ``imported.mesh(meshio.read("part.msh"))``.

    Parameters
    ----------
    source
        A ``meshio.Mesh``: named groups are physical groups of gmsh, or ``cell_sets``.

    Raises
    ------
    TypeError, ValueError
        If it is none, has no elements or shapes that are not known, is neither plane nor solid, has
        groups without a name, or sets that share cells.
    """
    require_attributes(
        "source", source, ("points", "cells", "cell_sets"), "a meshio.Mesh"
    )
    groups = list(_groups(source))
    N = max((dimension for dimension, *_ in groups), default=0)
    if N < 2:
        raise ValueError(
            f"source={source!r}: triangles, quadrilaterals or solid cells are needed"
        )
    points = np.asarray(source.points, dtype=float)
    if N == 2 and points.shape[1] == 3 and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points):
        raise ValueError(
            "source: a plane mesh with constant z, or solid cells, are needed"
        )
    used = np.unique(
        np.concatenate([cells.ravel() for d, _, cells in groups if d == N])
    )
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    points = np.column_stack([points[used, :N], np.zeros((len(used), 3 - N))])
    body = [
        (name or "body", _oriented(number[c], points, N))
        for d, name, c in groups
        if d == N
    ]
    sides = [(name, number[c]) for d, name, c in groups if d == N - 1 and name]
    return _assembled(N, points, body, sides)


def _groups(source: object) -> Iterator[tuple[int, str, np.ndarray]]:
    """Dimension, name, '' for none, and corners of the cells of each group in each block."""
    named = {
        (int(dim), int(tag)): n
        for n, (tag, dim) in getattr(source, "field_data", {}).items()
    }
    tags = source.cell_data.get("gmsh:physical")
    for number, block in enumerate(source.cells):
        shape = block.type.rstrip("0123456789")
        if shape == "vertex":
            continue
        if shape not in SHAPES:
            raise ValueError(
                f"source has cells {block.type!r}: one of {', '.join(SHAPES)} is needed"
            )
        dimension, corners = SHAPES[shape]
        cells = np.asarray(block.data)[:, :corners]
        rest = np.ones(len(cells), dtype=bool)
        for tag in np.unique(tags[number]) if tags is not None else ():
            if (dimension, int(tag)) not in named:
                raise ValueError(
                    f"source: group {int(tag)} of dimension {dimension} has no name, a physical "
                    f"group with a name is needed; named are {', '.join(named.values()) or 'none'}"
                )
            yield dimension, named[dimension, int(tag)], cells[tags[number] == tag]
            rest[tags[number] == tag] = False
        for name, sets in source.cell_sets.items() if tags is None else ():
            inside = np.asarray([] if sets[number] is None else sets[number], dtype=int)
            if not rest[inside].all():
                this = f"source.cell_sets[{name!r}]"
                raise ValueError(
                    f"{this} has {block.type!r} cells that another set has, too: "
                    f"one set for each cell is needed, del {this} leaves it out"
                )
            if len(inside):
                yield dimension, name, cells[inside]
                rest[inside] = False
        if rest.any():
            yield dimension, "", cells[rest]


def _oriented(cells: np.ndarray, points: np.ndarray, N: int) -> np.ndarray:
    """The cells with a positive determinant at their first corner."""
    x = points[cells]
    if N == 2:
        a = x[:, 1, :2] - x[:, 0, :2]
        b = x[:, -1, :2] - x[:, 0, :2]
        size = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        turned = _TURNED[cells.shape[1]]
    else:
        third = {4: (1, 2, 3), 8: (1, 3, 4), 6: (1, 2, 3)}[cells.shape[1]]
        size = np.linalg.det(np.stack([x[:, k] - x[:, 0] for k in third], axis=1))
        turned = _TURNED_TETRA if cells.shape[1] == 4 else _TURNED[cells.shape[1]]
    return np.where((size < 0)[:, None], cells[:, turned], cells)


def _assembled(N: int, points: np.ndarray, body: list, sides: list) -> Mesh:
    """The mesh of named cells and sides; outer sides without a name are ``free``."""
    outer = _outer([cells for _, cells in body], N)
    given = {tuple(sorted(side)) for _, cells in sides for side in cells.tolist()}
    rest = [side for key, side in outer.items() if key not in given]
    named = [
        (name, [outer.get(tuple(sorted(side)), side) for side in cells.tolist()])
        for name, cells in sides
    ]
    for corners in sorted({len(side) for side in rest}):
        named.append(("free", [side for side in rest if len(side) == corners]))
    groups = [(N, *group) for group in body] + [(N - 1, *group) for group in named]
    return Mesh(netgen_mesh(N, points, groups))


def _outer(blocks: list[np.ndarray], N: int) -> dict[tuple, list]:
    """Sorted corners -> corners of the facets that belong to one element."""
    found: dict[tuple, list] = {}
    twice = set()
    for cells in blocks:
        for side in _SIDES[N, cells.shape[1]]:
            for facet in cells[:, side].tolist():
                key = tuple(sorted(facet))
                if key in found:
                    twice.add(key)
                found[key] = facet
    return {key: facet for key, facet in found.items() if key not in twice}
