"""Where the mesh is too coarse: stresses against their recovered, continuous ones.

Zienkiewicz and Zhu (Int. J. Numer. Meth. Eng. 24, 1987): what the stress of an element differs from
the mean of those around its vertices, in the norm of the elastic energy.  It costs next to nothing
on any mesh and estimates; it bounds nothing, ``error_bound`` does.
"""

from __future__ import annotations

import numpy as np
from ngsolve import L2, GridFunction

from ngepc.discretisation.law import SOFTEST
from ngepc.local.result import ExactResult
from ngepc.model.rules import has_straight_simplices


def error_indicators(result: ExactResult) -> GridFunction:
    """An estimate of the part of each element in the energy error (force times length).

    Where processes share the mesh each has those of its own elements, and all must call this.

    Parameters
    ----------
    result
        Of order one on straight simplices of one material: elsewhere stresses jump, and it is more.

    Returns
    -------
    GridFunction
        Constant on elements; the sum of ``vec`` estimates the error of ``primal_energy``.

    Raises
    ------
    ValueError
        For other elements.
    """
    discrete, state = result.discrete, result.state
    points, law, mesh = discrete.points, discrete.law, discrete.problem.mesh
    if points.order > 1 or not has_straight_simplices(mesh):
        raise ValueError("error_indicators: straight triangles or tetrahedra of order 1 are needed")
    (block,) = points.blocks
    weights, nodes = points.weights, block.nodes
    stress = np.column_stack([law.bulk * state.volume, law.stress(state.at)])
    moduli = np.repeat(law.two_mu[:, None], stress.shape[1], axis=1)
    moduli[:, 0] = law.bulk
    around = np.zeros((mesh.nv, 1 + stress.shape[1]))
    given = weights[:, None] * np.column_stack([np.ones(len(points)), stress])
    for corner in nodes.T:
        np.add.at(around, corner, given)
    around = points.processes.summed(around)
    left = (around[:, 1:] / around[:, :1])[nodes] - stress[:, None, :]
    squares = (left**2).sum(axis=1) + left.sum(axis=1) ** 2  # linear on a simplex
    along = np.einsum("ekd,ed->ek", left[:, :, 1:], state.at.direction)
    along = (along**2).sum(axis=1) + along.sum(axis=1) ** 2
    slope = state.at.slope
    stiff = law.hardening + slope * (law.two_mu + law.hardening) / (1 - slope)
    plastic = np.where(state.at.yields, along / np.maximum(stiff, SOFTEST * law.two_mu), 0.0)
    k = nodes.shape[1]
    indicators = GridFunction(L2(mesh, order=0), name="error_indicators")
    density = 0.5 * ((squares / moduli).sum(axis=1) + plastic) / (k * (k + 1))
    indicators.vec.FV().NumPy()[:] = weights * density
    return indicators
