"""Copies of a mesh, bisected or cut where two bodies meet.

``parents`` maps each of their elements to the number of the one that it lies in.
"""

from __future__ import annotations

import numpy as np
from netgen.meshing import NetgenGeometry
from ngsolve import CF, L2, GridFunction, Integrate, Mesh

from ngepc.bounds.matching import matched
from ngepc.bounds.simplices import marked
from ngepc.model.problem import Problem

# bisection stops within this factor of its aim: indicators mostly fall faster than expected
CLOSE = 1.03


def bisected(mesh: Mesh, chosen: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """A copy of the mesh with the chosen elements bisected, and neighbours to conform."""
    finer, number = copied(mesh)
    finer.SetRefinementFlags(chosen.tolist())
    finer.Refine()
    return finer, parents_in(number)


def copied(mesh: Mesh) -> tuple[Mesh, GridFunction]:
    """A copy of a mesh for bisection, and a function that ``parents_in`` reads.

    A copy is needed, as on meshes that Netgen refined before functions are transferred wrongly.
    New vertices are not moved to curved boundaries: the body stays the polygon of the mesh.
    """
    netgen_mesh = mesh.ngmesh.Copy()
    netgen_mesh.SetGeometry(NetgenGeometry())
    finer = Mesh(netgen_mesh)
    number = GridFunction(
        L2(finer, order=0, autoupdate=True), autoupdate=True, nested=True
    )
    number.vec.FV().NumPy()[:] = np.arange(mesh.ne)
    return finer, number


def parents_in(number: GridFunction) -> np.ndarray:
    """For each element of a ``copied`` mesh the original element that contains it.

    A search by coordinates could give a neighbour, within 1e-6 of the size of the larger one.
    """
    return number.vec.FV().NumPy().round().astype(int)


def bisected_to(
    mesh: Mesh, indicators: np.ndarray, share: float, left: float
) -> tuple[Mesh, np.ndarray]:
    """A copy of the mesh, bisected until a fraction ``left`` of the indicators should remain.

    A child with the fraction v of an element's volume is expected to have v^(1 + 2/N) of its
    indicator, as for order one and smooth solutions: halving all edges leaves a quarter.  Each pass
    bisects the elements of Doerfler's marking with ``share``, the last pass fewer.
    """
    (finer, number), sums = copied(mesh), np.maximum(indicators, 0.0)

    def scale() -> np.ndarray:
        """The expected ratio of indicators, from the ratio of volumes."""
        return np.array(Integrate(CF(1), finer, element_wise=True)) ** (
            1 + 2 / mesh.dim
        )

    density = sums / scale()
    wanted = left * sums.sum()
    while finer.ne == mesh.ne or sums.sum() > CLOSE * wanted:
        chosen = marked(sums, min(share, (1 - wanted / sums.sum()) / 0.75))
        finer.SetRefinementFlags(chosen.tolist())
        finer.Refine()
        sums = density[parents_in(number)] * scale()
    return finer, parents_in(number)


def with_matching(
    problem: Problem, copy: tuple[Mesh, np.ndarray] | None
) -> tuple[Mesh, np.ndarray] | None:
    """A copy of the mesh of a problem, and its parents, that matches where two bodies meet.

    ``copy`` is one with other changes, None without; None if the mesh itself is to be used.
    """
    if not problem.contact_pairs:
        return copy
    mesh = problem.mesh if copy is None else copy[0]
    found = matched(mesh, problem.contact_pairs)
    if found is None or copy is None:
        return copy if found is None else found
    finer, parents = found
    return finer, copy[1][parents]
