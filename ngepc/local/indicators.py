"""Error indicators: an estimate of the error of each element from recovered stresses."""

from __future__ import annotations

import numpy as np
from ngsolve import L2, ElementId, GridFunction, IntegrationRule, specialcf
from ngsolve import VOL as BODY
from ngsolve.fem import L2FE

from ngepc.checks.kinds import require_instance
from ngepc.discretisation.element_strains import Elements
from ngepc.discretisation.law import SOFTEST
from ngepc.discretisation.points import Points
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.model.elements import (
    SHAPES,
    determinants,
    elements_by_shape,
    has_straight_simplices,
    plastic_order,
)
from ngepc.model.features import (
    BASIC_FEATURES,
    CONTACT_FEATURES,
    ELEMENT_FEATURES,
    HISTORY_FEATURES,
    KINEMATICS_FEATURES,
    LAW_FEATURES,
    SUPPORT_FEATURES,
    require_covered,
)

COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | ELEMENT_FEATURES
    | LAW_FEATURES
    | CONTACT_FEATURES
    | SUPPORT_FEATURES
    | (KINEMATICS_FEATURES - {"other kinematics"})
    | {"shared mesh"}
)
"""Features that ``error_indicators`` covers."""

AT_ONCE = 8000
"""Elements that are treated together: arrays for all would be new memory each time."""


@one_blas_thread
def error_indicators(result: ExactResult) -> GridFunction:
    """Estimate the contribution of each element to the energy error (force times length).

    Zienkiewicz and Zhu (Int. J. Numer. Meth. Eng. 24, 1987): the difference between the stress of
    an element and a continuous stress, in the norm of the elastic energy, for elements of every
    shape and both orders.  The continuous stress has the degree of the displacements; at each node
    it is the mean over the elements that meet there, weighted by their volume.  It costs next to
    nothing and guarantees nothing, ``error_bound`` does.  Where processes share the mesh each has
    those of its own elements: a collective call.

    Parameters
    ----------
    result
        Of one material: where materials meet stresses jump, and the estimate is too large.

    Returns
    -------
    GridFunction
        Constant on elements; the sum of ``vec`` estimates the error of ``primal_energy``.

    Raises
    ------
    TypeError, ValueError
        For other results and what is not covered.
    """
    require_instance("result", result, ExactResult, "an ExactResult")
    require_covered(result.problem, "error_indicators", COVERS)
    space = L2(result.problem.mesh, order=0)
    indicators = GridFunction(space, name="error_indicators")
    indicators.vec.FV().NumPy()[:] = indicators_of(result.state)
    return indicators


def indicators_of(state: State) -> np.ndarray:
    """The same for a state, an array (elements,)."""
    points = state.discrete.points
    mean, deviator = state.discrete.law.stress(state.at)
    stress = np.vstack([mean, deviator.T])
    soft = plastic_compliance(state)

    alike = elements_by_shape(points.mesh)
    pairs = zip(points.blocks, alike, strict=True)
    shapes = [ShapeIndicators(points, block, *of) for block, of in pairs]
    recovered = averaged(points, shapes, stress)

    values = np.empty(points.mesh.ne)
    for shape in shapes:
        weights = shape.weights()
        for first in range(0, len(weights), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            block = shape.block.of(part)
            left = shape.difference(block, recovered, stress)
            density = compliance_density(state, block, left, soft)
            total = np.einsum("eq,qe->e", weights[part], density)
            values[shape.numbers[part]] = 0.5 * total
    return values


def compliance_density(
    state: State, block: Elements, stress: np.ndarray, soft: np.ndarray
) -> np.ndarray:
    """The square (q, elements) of stresses (s, q, elements) in the tangent's compliance.

    ``soft`` is ``plastic_compliance``.
    """
    law = state.discrete.law
    at = block.points
    share = block.weights / block.weights.sum(axis=1, keepdims=True)
    bulk = np.einsum("ep,ep->e", share, 1 / law.bulk[at])
    shear = np.einsum("ep,ep->e", share, 1 / law.two_mu[at])
    flow = np.sqrt(share * soft[at])[:, :, None] * state.at.direction[at]
    deviator = stress[1:]
    density = bulk * stress[0] ** 2
    density += shear * np.einsum("iqe,iqe->qe", deviator, deviator)
    for direction in np.moveaxis(flow, 1, 0):
        density += np.einsum("iqe,ei->qe", deviator, direction) ** 2
    return density


def plastic_compliance(state: State) -> np.ndarray:
    """Plastic strain by stress along its direction at the points, 0 where nothing yields."""
    law = state.discrete.law
    slope = state.at.slope
    stiffness = law.hardening + slope * (law.two_mu + law.hardening) / (1 - slope)
    return state.at.yields / np.maximum(stiffness, SOFTEST * law.two_mu)


class ShapeIndicators:
    """The elements of one shape, with a rule that is finer than their plastic points."""

    def __init__(
        self, points: Points, block: Elements, numbers: np.ndarray, corners: np.ndarray
    ) -> None:
        mesh = points.mesh
        order = points.order
        self.points = points
        self.block = block
        self.numbers = numbers
        self.kind = SHAPES[mesh.dim, corners.shape[1]][0]
        self.rule = IntegrationRule(self.kind, 2 * order)
        places = [*points.rules[self.kind].points]
        fine = [*self.rule.points]

        # The polynomial through the values at the plastic points, evaluated at the finer rule.
        polynomials = L2FE(self.kind, plastic_order(mesh, order))
        known = np.array([np.array(polynomials.CalcShape(*p)) for p in places])
        wanted = np.array([np.array(polynomials.CalcShape(*p)) for p in fine])
        self.extended = wanted @ np.linalg.inv(known)

        # Coefficients of this polynomial in the space of the displacements.
        nodal = points.scalar.GetFE(ElementId(BODY, int(numbers[0])))
        self.shapes = np.array([np.array(nodal.CalcShape(*p)) for p in fine])
        self.coefficients = np.linalg.pinv(self.shapes) @ self.extended

    def weights(self) -> np.ndarray:
        """Volume that belongs to the points of the finer rule, (elements, points)."""
        mesh = self.points.mesh
        weights = np.array(self.rule.weights)
        if has_straight_simplices(mesh) and not self.points.kinematics.hoop:
            volume = self.block.weights.sum(axis=1)
            return volume[:, None] * weights / weights.sum()
        mapped = mesh.MapToAllElements({self.kind: self.rule}, mesh.Materials(".*"))
        jacobian = specialcf.JacobianMatrix(mesh.dim)(mapped)
        size = np.abs(determinants(jacobian.reshape(-1, mesh.dim, mesh.dim)))
        size *= np.ravel(self.points.kinematics.weight(mapped))
        return size.reshape(len(self.numbers), -1) * weights

    def difference(
        self, block: Elements, recovered: np.ndarray, stress: np.ndarray
    ) -> np.ndarray:
        """Recovered nodal stresses less those at the points, (s, fine points, elements).

        ``block`` are some of the elements.
        """
        nodal = recovered.take(block.nodes.T, axis=1)
        own = stress.take(block.points.T, axis=1)
        functions = np.hstack([self.shapes, -self.extended])
        return np.matmul(functions, np.concatenate([nodal, own], axis=1))

    def nodal_weights(self) -> np.ndarray:
        """The weight of each element in the means at its nodes, (elements, nodes)."""
        block = self.block
        if self.points.order == 1:
            return block.weights @ block.shapes
        volume = block.weights.sum(axis=1, keepdims=True)
        return np.broadcast_to(volume, block.nodes.shape)

    def nodal_shares(self, values: np.ndarray) -> np.ndarray:
        """The shares (elements, nodes) of values at the points in sums over the elements."""
        block = self.block
        own = values[block.points]
        if self.points.order == 1:
            return (block.weights * own) @ block.shapes
        return self.nodal_weights() * (own @ self.coefficients.T)


def averaged(
    points: Points, shapes: list[ShapeIndicators], stress: np.ndarray
) -> np.ndarray:
    """Nodal coefficients (s, nodes) of the continuous stress, from stresses (s, points).

    For order 1 means weighted with hat functions: for bilinear stresses they are better than values
    at the corners.
    """
    count = points.scalar.ndof
    sums = np.zeros((1 + len(stress), count))
    for shape in shapes:
        nodes = shape.block.nodes.ravel()
        shares = [shape.nodal_weights(), *map(shape.nodal_shares, stress)]
        for total, own in zip(sums, shares, strict=True):
            total += np.bincount(nodes, own.ravel(), count)
    weights, *sums = points.processes.summed(sums.T).T
    return np.array(sums) / weights
