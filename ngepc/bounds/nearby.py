"""Nodal forces balanced by stresses on few cells.

The displacement of a result is a function on a bisected copy of its mesh, too.  It is in
equilibrium with the functions of the mesh itself, so that its residual on the copy belongs to nodes
of cells that were bisected, and does no work on rigid motions.  Take the cells around these nodes
as a body of their own, without supports but those of the whole.  It is in equilibrium under the
residual: with the tangent C there are displacements w of its nodes such that C eps(w) on these
cells alone has the residual as nodal forces.  No factors for the whole body are needed.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags
from scipy.sparse.linalg import splu

from ngepc.discretisation.element_strains import Elements
from ngepc.discretisation.moduli import Moduli
from ngepc.linalg.direct import WITHOUT_PIVOTS
from ngepc.local.system import State

FEW = 0.3
"""Largest share of the cells that count as few."""
RINGS = 2
"""Rings of cells around the nodes with residual forces."""
WEAK = 1e-8
"""Springs that hold rigid motions of the cells, relative to the diagonal of their stiffness."""
PASSES = 10
"""Most solves until the springs carry no more than rounding errors."""


def strain_nearby(
    state: State, missing: np.ndarray, allowed: float
) -> np.ndarray | None:
    """Strains eps(w) (points, 1 + d) on few cells, zero elsewhere, for forces ``missing``.

    The forces have the shape (nodes, N); at most ``allowed`` of each is left.  None where more
    would be left, and where not few cells have forces.
    """
    discrete = state.discrete
    points = discrete.points
    if len(points.blocks) > 1:
        return None
    block = points.blocks[0]
    loaded = np.any([np.abs(f) > allowed for f in missing.T], axis=0)
    cells = cells_around(block, loaded)
    if len(cells) > FEW * len(block.nodes):
        return None
    part = block.of(cells)
    inside = np.zeros_like(discrete.free)
    inside[part.nodes] = True
    basis = discrete.supports.basis(inside[:, 0])
    K = basis.T @ stiffness_of(part, state.moduli, inside.shape) @ basis
    unknowns = floating_solution(K, basis.T @ missing.ravel(), allowed)
    w = (basis @ unknowns).reshape(missing.shape)
    left = discrete.supports.kept(missing)
    left -= (basis @ (K @ unknowns)).reshape(missing.shape)
    if not np.abs(left).max() <= allowed:
        return None
    strain = np.zeros((len(points), len(part.basis)))
    strain[part.points] = part.strain(w)
    return strain


def cells_around(block: Elements, chosen: np.ndarray) -> np.ndarray:
    """Numbers of the elements around the chosen nodes, and of rings around these."""
    there = chosen.copy()
    columns = [column.copy() for column in block.nodes.T]
    for _ in range(1 + RINGS):
        cells = np.flatnonzero(reduce(np.logical_or, [there[v] for v in columns]))
        there[block.nodes[cells]] = True
    return cells


def stiffness_of(part: Elements, moduli: Moduli, shape: tuple[int, int]) -> csr_matrix:
    """The stiffness of some elements alone, for displacements (nodes, N) of this shape."""
    N = shape[1]
    count, k = part.nodes.shape
    products, turned = (K.reshape(count, k, N, k, N) for K in part.stiffness(moduli))
    K = products + turned.swapaxes(2, 4)
    both = np.einsum("eicjc->eij", turned)
    for a in range(N):
        K[:, :, a, :, a] += both
    unknowns = N * part.nodes[:, :, None] + np.arange(N)
    row = unknowns[:, :, :, None, None]
    column = unknowns[:, None, None]
    places = [np.broadcast_to(v, K.shape).ravel() for v in (row, column)]
    size = shape[0] * N
    return csr_matrix((K.ravel(), places), shape=(size, size))


def floating_solution(K: csc_matrix, forces: np.ndarray, allowed: float) -> np.ndarray:
    """A solution of K x = forces, which do no work where K is zero.

    Weak springs hold the rest; what they carry is given back until no force is above ``allowed``.
    """
    springs = WEAK * K.diagonal()
    factors = splu((K + diags(springs)).tocsc(), **WITHOUT_PIVOTS)
    x = np.zeros_like(forces)
    for _ in range(PASSES):
        left = forces - K @ x
        if np.abs(left).max(initial=0.0) <= allowed / 2:
            break
        x = x + factors.solve(left)
    return x
