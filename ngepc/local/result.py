"""The result of the method at the integration points, and where its mesh is too coarse."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import L2, GridFunction

from ngepc.checks.kinds import require_instance
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.law import SOFTEST
from ngepc.discretisation.points import PointFunctions
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.elements import elements_by_shape
from ngepc.model.features import require_covered
from ngepc.model.own import require_same_mesh
from ngepc.results.result import DiscreteSolution

COVERS = frozenset(
    {
        "plane strain",
        "two-dimensional",
        "axisymmetric",
        "solid",
        "other shapes",
        "curved elements",
        "shared mesh",
        "kinematic hardening",
        "isotropic hardening",
        "hardening law",
        "initial plastic strain",
        "initial hardening",
        "initial strain",
        "obstacle",
        "two bodies",
        "friction",
        "Coulomb friction",
        "contact at a clamp",
        "rollers",
        "edges and points",
        "springs",
    }
)
"""Features that ``error_indicators`` covers."""


class ExactResult(DiscreteSolution):
    """What ``semismooth_newton`` returns without gamma, see ``DiscreteSolution``."""

    state: State
    method_label = "exact"

    @property
    def discrete(self) -> DiscreteProblem:
        """The discrete problem that was solved."""
        return self.state.discrete

    @property
    def largest_strain(self) -> float:
        """The largest |eps(u)| at the points."""
        state = self.state
        size = self.problem.kinematics.size
        squared = state.volume**2 / size + (state.deviator**2).sum(1)
        return float(np.sqrt(self.discrete.points.processes.maximum(squared)))

    @property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        require_same_mesh(self.discrete.problem)
        return self._plastic_increment

    @property
    def plastic_dual(self) -> GridFunction:
        """The dual variable q = h p - dev sigma + dev alpha_2 (3.8), d components (stress)."""
        require_same_mesh(self.discrete.problem)
        return self._plastic_dual

    @cached_property
    def _plastic_increment(self) -> GridFunction:
        return self._functions.function(
            self.state.at.plastic_strain, "plastic_increment"
        )

    @cached_property
    def _plastic_dual(self) -> GridFunction:
        return self._functions.function(
            -self.discrete.law.yielding_part(self.state.at), "q"
        )

    @cached_property
    def _functions(self) -> PointFunctions:
        return PointFunctions(self.discrete.points)

    @cached_property
    def dual_energy(self) -> float:
        """J*(lambda, sigma), the dual functional (force times length), inf if no stress allows it.

        J + J* >= 0 bounds the energy error of any state, and is zero at the solution.  The state's
        stress is put into balance by an elastic solve.  For every sigma in balance, and every force
        of contact and friction within its bounds, weak duality says that

            J* = int phi*(sigma) + lambda . gaps(0) - (forces of supports) . (prescribed u) >= -J,

        with the conjugate phi* of the density of J, smallest over p, as a function of the strain.
        """
        state = self.state
        discrete = self.discrete
        law = discrete.law
        points = discrete.points
        supports = discrete.supports
        elastic = law.elastic_moduli
        tangent = Factors(discrete, "sparsecholesky")
        tangent.update(elastic)
        pressure, stress = law.stress(state.at)
        u = state.u
        missing = state.residual_force
        for _ in range(2):
            change = tangent.solve(-missing)
            more = elastic.stress(*points.strain(change))
            pressure = pressure + more[0]
            stress = stress + more[1]
            u = u + change
            forces = points.forces(pressure, stress) + supports.pull(u)
            missing = forces + state.contact_forces - discrete.load
        held = np.where(discrete.free, 0.0, supports.values)
        work = 0.5 * np.vdot(supports.pull(u), u) - np.vdot(missing, held)
        work += state.contact @ discrete.contact.gaps(np.zeros_like(held))
        return points.integral(law.complementary_density(pressure, stress)) + float(
            work
        )


def error_indicators(result: ExactResult) -> GridFunction:
    """An estimate of the part of each element in the energy error (force times length).

    Zienkiewicz and Zhu (Int. J. Numer. Meth. Eng. 24, 1987): what the stress of an element differs
    from the mean of those around its vertices, in the norm of the elastic energy, for elements of
    every shape.  It costs next to nothing and guarantees nothing, ``error_bound`` does.  Where
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
    discrete = result.discrete
    state = result.state
    points = discrete.points
    law = discrete.law
    mesh = result.problem.mesh
    require_covered(discrete.problem, "error_indicators", COVERS)
    stress = np.column_stack(law.stress(state.at))
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
    for (numbers, _), block in zip(elements_by_shape(mesh), points.blocks, strict=True):
        places = block.shapes
        at = block.points
        if (
            len(places) == 1
        ):  # a rule of degree two for simplices, whose one stress is constant
            k = block.nodes.shape[1]
            share = (1 - (k + 1) ** -0.5) / k
            places = share + (1 - k * share) * np.eye(k)
            at = np.repeat(at, k, axis=1)
        left = np.einsum("pk,ekc->epc", places, recovered[block.nodes]) - stress[at]
        along = np.einsum("epd,epd->ep", left[:, :, 1:], state.at.direction[at])
        density = left[:, :, 0] ** 2 / law.bulk[at] + soft[at] * along**2
        density += (left[:, :, 1:] ** 2).sum(axis=2) / law.two_mu[at]
        weights = points.weights[at] * block.points.shape[1] / len(places)
        values[numbers] = 0.5 * (weights * density).sum(axis=1)
    return indicators
