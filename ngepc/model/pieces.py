"""Straight simplices as arrays: what a process is sent of a mesh, and how it halves their edges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import netgen.meshing as netgen
import numpy as np

from ngepc.geometries.outlines import netgen_mesh

Numbered = tuple[np.ndarray, np.ndarray]
"""Vertices of simplices, shape (k, corners), and the number of the region of each."""

_CHILDREN = {
    2: (("0", "01"), ("01", "1")),
    3: (("0", "01", "02"), ("01", "1", "12"), ("02", "12", "2"), ("01", "12", "02")),
    4: (
        ("0", "01", "02", "03"),
        ("01", "1", "12", "13"),
        ("02", "12", "2", "23"),
        ("03", "13", "23", "3"),
    ),
}
"""Children of a simplex by its corners, with their corners; 01 is the middle of corners 0 and 1."""

_RINGS = {
    ("01", "23"): ("02", "12", "13", "03"),
    ("02", "13"): ("01", "12", "23", "03"),
    ("03", "12"): ("01", "13", "23", "02"),
}
"""Diagonals of the octahedron that is left inside a tetrahedron, and the corners around each."""


@dataclass(frozen=True, eq=False)
class Piece:
    """Some of the simplices of a mesh."""

    points: np.ndarray  # coordinates of the vertices, shape (vertices, N)
    materials: tuple[str, ...]  # names of all regions, also of those without anything here
    boundaries: tuple[str, ...]
    elements: Numbered  # simplices of the body
    facets: Numbered  # and of its boundaries
    copies: dict[int, np.ndarray]  # number of another process -> the vertices it has as well
    interfaces: frozenset[str]  # names of boundaries inside the body

    def mesh(self) -> netgen.Mesh:
        """The piece as a mesh of Netgen."""
        N = self.points.shape[1]
        kinds = (N, self.materials, self.elements), (N - 1, self.boundaries, self.facets)
        groups = [
            (d, name, nodes[index == number])
            for d, names, (nodes, index) in kinds
            for number, name in enumerate(names)
        ]
        return netgen_mesh(N, self.points, groups)

    def refined(self) -> tuple[Piece, np.ndarray]:
        """The piece with all edges halved, and the ends of each edge, in the order of middles."""
        corners, count = self.elements[0], len(self.points)
        pairs = list(combinations(range(corners.shape[1]), 2))
        ends = np.sort(np.concatenate([corners[:, pair] for pair in pairs]), axis=1)
        keys = np.unique(ends[:, 0] * count + ends[:, 1])
        parents = np.column_stack(np.divmod(keys, count))
        points = np.concatenate([self.points, self.points[parents].mean(axis=1)])
        elements, facets = (_halved(*kind, keys, points) for kind in (self.elements, self.facets))
        fine = replace(self, points=points, elements=elements, facets=facets, copies={})
        return fine, parents


def _halved(corners: np.ndarray, index: np.ndarray, keys: np.ndarray, points: np.ndarray) -> tuple:
    """Simplices cut at the middles of their edges: the middle of edge k is vertex count + k."""
    k, count = corners.shape[1], len(points) - len(keys)
    at = {str(i): corners[:, i] for i in range(k)}
    for a, b in combinations(range(k), 2):
        low, high = np.sort(corners[:, [a, b]], axis=1).T
        at[f"{a}{b}"] = count + np.searchsorted(keys, low * count + high)
    children = [np.stack([at[name] for name in child], axis=1) for child in _CHILDREN[k]]
    if k == 4:
        children += _inner(at, points)
        sign = np.sign(_volume(points[corners]))
        children = [_turned(child, _volume(points[child]) * sign < 0) for child in children]
    return np.concatenate(children), np.tile(index, len(children))


def _inner(at: dict[str, np.ndarray], points: np.ndarray) -> list[np.ndarray]:
    """The four tetrahedra inside, around the shortest diagonal of the octahedron (Bey, 1995)."""
    choices, lengths = [], []
    for (a, b), ring in _RINGS.items():
        around = zip(ring, (*ring[1:], ring[0]), strict=True)
        choices.append([np.stack([at[name] for name in (a, b, c, d)], axis=1) for c, d in around])
        lengths.append(np.linalg.norm(points[at[a]] - points[at[b]], axis=1))
    shortest = np.argmin(np.round(lengths, 12), axis=0)[:, None]
    return [np.choose(shortest, [choice[i] for choice in choices]) for i in range(4)]


def _volume(x: np.ndarray) -> np.ndarray:
    """Six times the signed volume of tetrahedra, corners (k, 4, 3)."""
    return np.linalg.det(x[:, 1:] - x[:, :1])


def _turned(corners: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Simplices with two corners exchanged where asked."""
    corners[where, :2] = corners[where, 1::-1]
    return corners
