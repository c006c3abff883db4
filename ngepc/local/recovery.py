"""Where the mesh is too coarse: stresses against their recovered, continuous ones.

Zienkiewicz and Zhu (Int. J. Numer. Meth. Eng. 24, 1987): what the stress of an element differs from
the mean of those around its vertices, in the norm of the elastic energy.  It costs next to nothing
on any mesh and estimates; it bounds nothing, ``error_bound`` does.
"""

from __future__ import annotations

import numpy as np
from ngsolve import L2, GridFunction

from ngepc.checks.kinds import require_instance
from ngepc.discretisation.law import SOFTEST
from ngepc.local.result import ExactResult
from ngepc.model.elements import element_numbers


def error_indicators(result: ExactResult) -> GridFunction:
    """An estimate of the part of each element in the energy error (force times length).

    An indicator for elements of every shape: it guarantees nothing, ``error_bound`` does.  Where
    processes share the mesh each has those of its own elements: a collective call.

    Parameters
    ----------
    result
        Of order one, of one material: elsewhere stresses jump, and it is more.

    Returns
    -------
    GridFunction
        Constant on elements; the sum of ``vec`` estimates the error of ``primal_energy``.

    Raises
    ------
    TypeError, ValueError
        For other results and other orders.
    """
    require_instance("result", result, ExactResult, "an ExactResult")
    discrete, state = result.discrete, result.state
    points, law, mesh = discrete.points, discrete.law, discrete.problem.mesh
    if points.order > 1:
        raise ValueError(f"order={points.order}: error_indicators needs order 1")
    stress = np.column_stack([law.bulk * state.volume, law.stress(state.at)])
    around = np.zeros((mesh.nv, 1 + stress.shape[1]))
    given = points.weights[:, None] * np.column_stack([np.ones(len(points)), stress])
    for block in points.blocks:
        shares = np.einsum("pk,epc->ekc", block.shapes, given[block.points])
        np.add.at(around, block.nodes, shares)
    around = points.processes.summed(around)
    recovered = around[:, 1:] / around[:, :1]
    slope = state.at.slope
    stiff = law.hardening + slope * (law.two_mu + law.hardening) / (1 - slope)
    soft = state.at.yields / np.maximum(stiff, SOFTEST * law.two_mu)
    indicators = GridFunction(L2(mesh, order=0), name="error_indicators")
    values = indicators.vec.FV().NumPy()
    for numbers, block in zip(element_numbers(mesh), points.blocks, strict=True):
        places, at = block.shapes, block.points
        if len(places) == 1:  # a rule of degree two for simplices, whose one stress is constant
            k = block.nodes.shape[1]
            share = (1 - (k + 1) ** -0.5) / k
            places, at = share + (1 - k * share) * np.eye(k), np.repeat(at, k, axis=1)
        left = np.einsum("pk,ekc->epc", places, recovered[block.nodes]) - stress[at]
        along = np.einsum("epd,epd->ep", left[:, :, 1:], state.at.direction[at])
        density = left[:, :, 0] ** 2 / law.bulk[at] + soft[at] * along**2
        density += (left[:, :, 1:] ** 2).sum(axis=2) / law.two_mu[at]
        weights = points.weights[at] * block.points.shape[1] / len(places)
        values[numbers] = 0.5 * (weights * density).sum(axis=1)
    return indicators
