"""The size of the cuts that halve a body: what factors of its matrices cost.

Elimination by nested dissection ends with the unknowns on a cut, whose matrix is dense.  A cube
with n unknowns has cuts of 3^(1/3) n^(2/3).  Those of slender bars and thin plates are far smaller,
and factors of theirs cost as much for each unknown as those of a smaller cube.
"""

from __future__ import annotations

import numpy as np
from ngsolve import CF, x, y, z

from ngepc.discretisation.points import Points
from ngepc.local.system import DiscreteProblem

HALVINGS = 3
"""Halves and quarters are cut, too, as the first cut may pass between two bodies."""


def unknowns_of_cube(body: DiscreteProblem) -> float:
    """Free components of displacements of a cube with cuts as large as those of a solid.

    At most those of the solid itself.
    """
    free = body.free.sum(axis=1)
    largest = max(cut_sizes(body.points, free))
    return min(float(free.sum()), 3 * (largest / 3) ** 1.5)


def cut_sizes(points: Points, free: np.ndarray) -> list[int]:
    """The numbers of unknowns on cuts through a body, its halves and its quarters.

    ``free`` is the number of unknowns of each node, shape (nodes,).
    """
    nodes, centres = _cells(points)
    parts = [np.arange(len(nodes))]
    sizes = []
    for _ in range(HALVINGS):
        cuts = [_smallest_cut(part, centres, nodes, free) for part in parts]
        sizes += [size for size, _ in cuts]
        parts = [half for _, halves in cuts for half in halves if len(half) > 1]
    return sizes


def _cells(points: Points) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and centres of all elements, (elements, k), (elements, N).

    Rows with fewer nodes repeat one.
    """
    k = max(block.nodes.shape[1] for block in points.blocks)
    nodes = [
        np.resize(block.nodes.T, (k, len(block.nodes))).T for block in points.blocks
    ]
    where = points.at(CF((x, y, z)[: points.mesh.dim]))
    centres = [where[block.points].mean(axis=1) for block in points.blocks]
    return np.concatenate(nodes), np.concatenate(centres)


def _smallest_cut(
    part: np.ndarray, centres: np.ndarray, nodes: np.ndarray, free: np.ndarray
) -> tuple[int, list[np.ndarray]]:
    """The fewest unknowns between halves of a part, across axes and principal axes; the halves."""
    offsets = centres[part] - centres[part].mean(axis=0)
    N = offsets.shape[1]
    principal = np.linalg.eigh(offsets.T @ offsets)[1]
    heights = offsets @ np.hstack([np.eye(N), principal])
    found = [np.array_split(part[order], 2) for order in np.argsort(heights.T, axis=1)]
    sizes = [_shared(halves, nodes, free) for halves in found]
    best = int(np.argmin(sizes))
    return sizes[best], found[best]


def _shared(halves: list[np.ndarray], nodes: np.ndarray, free: np.ndarray) -> int:
    """The number of unknowns that two sets of elements have in common."""
    reached = np.zeros((2, len(free)), dtype=bool)
    for seen, half in zip(reached, halves, strict=True):
        seen[nodes[half]] = True
    return int(free[reached.all(axis=0)].sum())
