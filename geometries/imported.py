"""Meshes from files of gmsh, Abaqus, CalculiX and other programs, and names for their boundaries.

Boundaries and materials are named as the groups, sets and surfaces of the file.  Outer facets that
no group has are called ``free``, in files without any group ``boundary``.  Of elements of second
order the corners are taken: the order of displacements is that of the Problem.  What is left out,
split or renamed is said by a ``UserWarning``.
"""

import io
import os
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
from ngsolve import Mesh

from ngepc.checks.kinds import require_attributes, require_path
from ngepc.checks.sentences import counted

from .cells import SHAPES, Group, facet_rows, facets_of, oriented, with_simplices
from .decks import read_deck
from .naming import Facing as Facing
from .naming import OnPlane as OnPlane
from .naming import legal_name
from .naming import name as name
from .outlines import netgen_mesh

try:
    import meshio
except ImportError:  # said when read() needs it
    meshio = None

INSTALL = "read() needs meshio for other files than decks: 'pip install meshio'"

TAGS = ("gmsh:physical", "medit:ref", "su2:tag", "netgen:index")
"""Data of meshio that number the groups of cells."""

NO_GROUP = 0  # the number that gmsh gives to cells without one


def read(path: str | os.PathLike) -> Mesh:
    """The mesh of a file: decks ``.inp`` of Abaqus and CalculiX, or whatever meshio reads.

    Of a deck the sections become materials; surfaces, node sets and the sets of shells become
    boundaries.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    ImportError
        If meshio is needed and missing.
    OSError
        If there is no such file.
    TypeError, ValueError
        If it cannot be read, or see ``mesh``; with the name of the file.
    """
    path = require_path("path", path)
    if not path.is_file():
        raise FileNotFoundError(f"path={str(path)!r}: there is no such file")
    source = _deck(path) if path.suffix.lower() == ".inp" else _by_meshio(path)
    try:
        return mesh(source)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _deck(path: Path) -> object:
    """A deck; a ValueError with the name of the file if it is damaged."""
    try:
        return read_deck(path)
    except (ValueError, IndexError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error


def _by_meshio(path: Path) -> object:
    """What meshio reads; it ends Python where it cannot, and prints why."""
    if meshio is None:
        raise ImportError(INSTALL)
    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            return meshio.read(path)
    except (Exception, SystemExit) as error:  # damaged files raise almost anything
        texts = f"{said.getvalue()} {error}".split() or [type(error).__name__]
        raise ValueError(f"{path} cannot be read: {' '.join(texts)}") from error


def mesh(source: object) -> Mesh:
    """The mesh that meshio has read, ``imported.mesh(meshio.read("part.msh"))``.

    Parameters
    ----------
    source
        A ``meshio.Mesh``: its groups are physical groups of gmsh, ``cell_sets`` or ``point_sets``.
        A set of points names the outer facets all of whose corners it has, smaller sets first.

    Raises
    ------
    TypeError, ValueError
        If it is none, has no elements or shapes that are not known, is neither plane nor solid, has
        sets that share cells, nodes that are not there, or the same cell or facet twice.
    """
    require_attributes(
        "source", source, ("points", "cells", "cell_sets"), "a meshio.Mesh"
    )
    groups = list(_groups(source))
    N = max((group.dimension for group in groups), default=0)
    if N < 2:
        kinds = sorted({block.type for block in source.cells}) or ["nothing"]
        raise ValueError(
            f"source has {', '.join(kinds)}: triangles, quadrilaterals or solid cells are "
            "needed"
        )
    points = _checked_points(source, N)
    notes: list[str] = list(getattr(source, "notes", ()))
    groups = [group for group in groups if group.dimension >= N - 1]
    if any(group.cells.shape[1] == 5 for group in groups):
        groups, points = with_simplices(groups, points)
        notes.append("has pyramids: all cells are split into tetrahedra")
    body = [g for g in groups if g.dimension == N]
    body = [g._replace(cells=oriented(g.cells, points, N)) for g in body]
    _require_once("cells", [facet_wide(g.cells) for g in body])
    sides = _Sides(body, N)
    sides.add_named([g for g in groups if g.dimension == N - 1])
    sides.add_sets(getattr(source, "point_sets", None) or {}, len(points))
    notes += sides.notes
    named = any(group.name for group in groups) or bool(sides.named)
    sides.add_rest("free" if named else "boundary")
    if not named:
        notes.append("has no groups: its boundary is called 'boundary'")
    if notes:
        warnings.warn(f"source {'; '.join(notes)}", UserWarning, stacklevel=2)
    return _assembled(N, points, body, sides.named)


def _checked_points(source: object, N: int) -> np.ndarray:
    """The points of a mesh in N dimensions, (k, 3) or more columns than it needs."""
    points = np.asarray(source.points, dtype=float)
    used = [b.data for b in source.cells if SHAPES.get(_shape(b), (0,))[0] == N]
    corners = np.unique(np.concatenate([np.ravel(np.asarray(c)) for c in used]))
    if not np.isfinite(points[corners]).all():
        raise ValueError("source has points that are NaN or infinite")
    if N == 2 and points.shape[1] == 3:
        height = points[corners, 2]
        if np.ptp(height) > 1e-9 * np.ptp(points[corners]):
            raise ValueError(
                "source: a plane mesh with constant z, or solid cells, are needed"
            )
    return points


def _shape(block: object) -> str:
    """The name of the shape of a block of cells, without the number of its nodes."""
    return block.type.rstrip("0123456789")


def _groups(source: object) -> Iterator[Group]:
    """The cells of each group in each block, with the name '' for those that have none."""
    tags = next((source.cell_data[k] for k in TAGS if k in source.cell_data), None)
    for number, block in enumerate(source.cells):
        if _shape(block) == "vertex":
            continue
        if _shape(block) not in SHAPES:
            raise ValueError(
                f"source has cells {block.type!r}: one of {', '.join(SHAPES)} is needed"
            )
        dimension, corners = SHAPES[_shape(block)]
        cells = _checked_cells(source, block)[:, :corners]
        rest = np.ones(len(cells), dtype=bool)
        if tags is not None:
            chosen = _by_tag(source, dimension, np.asarray(tags[number]))
        else:
            chosen = _by_set(source, number)
        for label, inside in chosen:
            if not rest[inside].all():
                this = f"source.cell_sets[{label!r}]"
                raise ValueError(
                    f"{this} has {block.type!r} cells that another set has, too: "
                    f"one set for each cell is needed, del {this} leaves it out"
                )
            rest[inside] = False
            yield Group(dimension, label, cells[inside])
        if rest.any():
            yield Group(dimension, "", cells[rest])


def _checked_cells(source: object, block: object) -> np.ndarray:
    """The nodes of a block of cells, all of them there and each once."""
    cells = np.asarray(block.data)
    legal = len(source.points) - 1
    if cells.size and not 0 <= cells.min() <= cells.max() <= legal:
        wrong = cells[(cells < 0) | (cells > legal)][0]
        raise ValueError(
            f"source has {block.type!r} cells with node {wrong}: 0 to {legal} are needed"
        )
    corners = np.sort(cells[:, : SHAPES[_shape(block)][1]], axis=1)
    twice = (corners[:, 1:] == corners[:, :-1]).any(axis=1)
    if twice.any():
        raise ValueError(
            f"source has {twice.sum()} of {len(cells)} {block.type!r} cells with a corner "
            "twice: cells with corners of their own are needed"
        )
    return cells


def _by_tag(
    source: object, dimension: int, tags: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """Name and positions of the cells of each numbered group; 'group 3' if 3 has no name."""
    named = {
        (int(dim), int(tag)): label
        for label, (tag, dim) in getattr(source, "field_data", {}).items()
    }
    for tag in np.unique(tags).tolist():
        if tag != NO_GROUP:
            label = named.get((dimension, int(tag)), f"group {int(tag)}")
            yield label, np.flatnonzero(tags == tag)


def _by_set(source: object, number: int) -> Iterator[tuple[str, np.ndarray]]:
    """Name and positions of the cells of each set in one block, without gmsh's own sets."""
    for label, sets in source.cell_sets.items():
        if label.startswith("gmsh:") or number >= len(sets) or sets[number] is None:
            continue
        inside = np.asarray(sets[number], dtype=int)
        count = len(source.cells[number].data)
        if len(inside) and not 0 <= inside.min() <= inside.max() < count:
            raise ValueError(
                f"source.cell_sets[{label!r}] has cells up to {inside.max()} of {count} "
                f"{source.cells[number].type!r} cells: 0 to {count - 1} are needed"
            )
        if len(inside):
            yield label, inside


def _checked_members(label: str, members: np.ndarray, count: int) -> np.ndarray:
    """The points of a set, all of them there."""
    points = np.asarray(members, dtype=int)
    wrong = points[(points < 0) | (points >= count)]
    if len(wrong):
        raise ValueError(
            f"source.point_sets[{label!r}] has point {wrong[0]}: 0 to {count - 1} are needed"
        )
    return points


def facet_wide(cells: np.ndarray) -> np.ndarray:
    """Sorted corners of cells, shape (k, 8), -1 before those with fewer."""
    rows = np.full((len(cells), 8), -1)
    rows[:, : cells.shape[1]] = cells
    return np.sort(rows, axis=1)


def _require_once(what: str, rows: list[np.ndarray]) -> None:
    """Refuse cells or facets, by their sorted corners, of which one is there twice."""
    found, count = np.unique(np.concatenate(rows), axis=0, return_counts=True)
    if (count > 1).any():
        nodes = found[count > 1][0]
        raise ValueError(
            f"source has {(count > 1).sum()} {what} twice, for example that of the nodes "
            f"{nodes[nodes >= 0].tolist()}: each once is needed"
        )


class _Sides:
    """The facets of a body, and the names that groups and sets of points give to them."""

    def __init__(self, body: list[Group], N: int) -> None:
        self.N = N
        corners, rows = facets_of(body, N)
        self.rows, first, count = np.unique(
            rows, axis=0, return_index=True, return_counts=True
        )
        self.corners = corners[first]
        self.outer = count == 1
        self.free = self.outer.copy()  # outer facets that have no name yet
        self.named: list[Group] = []
        self.notes: list[str] = []
        self.owner = np.full(len(self.rows), "", dtype=object)
        self.numbers = {row.tobytes(): k for k, row in enumerate(self.rows)}

    def add_named(self, groups: list[Group]) -> None:
        """Facets that the source has as cells; those of no element of the body are dropped.

        Facets without a name keep the name that they have or get later.
        """
        dropped: Counter[str] = Counter()
        for group in groups:
            at = [
                self.numbers.get(row.tobytes(), -1) for row in facet_rows(group.cells)
            ]
            found = np.array(at, dtype=int)
            dropped[group.name] += int((found < 0).sum())
            if group.name:
                self._give(group.name, found[found >= 0])
        for label, count in dropped.items():
            if count:
                which = f"of {label!r}" if label else "without a name"
                self.notes.append(
                    f"has {counted(count, 'facet')} {which} that no element of the body has: "
                    "they are left out"
                )

    def add_sets(self, sets: dict[str, np.ndarray], count: int) -> None:
        """Outer facets all of whose corners are in a set of points, the smallest set first."""
        whole = np.unique(self.rows[self.rows >= 0])
        chosen = {}
        for label, members in sets.items():
            inside = np.zeros(count + 1, dtype=bool)  # the last one for 'no corner'
            inside[_checked_members(label, members, count)] = True
            inside[-1] = True
            if not inside[whole].all():
                chosen[label] = np.flatnonzero(
                    self.outer & inside[self.rows].all(axis=1)
                )
        for label in sorted(chosen, key=lambda label: len(chosen[label])):
            facets = chosen[label]
            new = facets[self.free[facets]]
            if len(new) < len(facets):
                others = sorted(set(self.owner[facets]) - {"", label})
                self.notes.append(
                    f"has {counted(len(facets), 'facet')} in the set {label!r}: "
                    f"{len(facets) - len(new)} of them with another name, {', '.join(others)}"
                )
            self._give(label, new)

    def add_rest(self, label: str) -> None:
        """Outer facets that have no name."""
        self._give(label, np.flatnonzero(self.free))

    def _give(self, label: str, facets: np.ndarray) -> None:
        """Name facets by their numbers; a ValueError if one of them has a name."""
        twice = np.sort(facets)
        twice = twice[1:][twice[1:] == twice[:-1]]
        clash = np.concatenate([twice, facets[self.owner[facets] != ""]])
        if len(clash):
            nodes = self.rows[clash[0]]
            others = sorted({label, *self.owner[clash].tolist()} - {""})
            raise ValueError(
                f"source has {counted(len(clash), 'facet')} twice, in {' and '.join(others)}, for "
                f"example that of the nodes {nodes[nodes >= 0].tolist()}: each once is needed"
            )
        self.owner[facets] = label
        self.free[facets] = False
        count = (self.corners[facets] >= 0).sum(axis=1)
        for corners in np.unique(count):
            cells = self.corners[facets[count == corners]][:, :corners]
            self.named.append(Group(self.N - 1, label, cells))


def _assembled(
    N: int, points: np.ndarray, body: list[Group], sides: list[Group]
) -> Mesh:
    """The mesh of named cells and facets, with the points that the cells use."""
    used = np.unique(np.concatenate([group.cells.ravel() for group in body]))
    number = np.full(len(points), -1)
    number[used] = np.arange(len(used))
    kept = np.column_stack([points[used, :N], np.zeros((len(used), 3 - N))])
    body = [group._replace(name=group.name or "body") for group in body]
    groups = [
        (group.dimension, legal_name(group.name), number[group.cells])
        for group in (*body, *sides)
    ]
    return Mesh(netgen_mesh(N, kept, groups))
