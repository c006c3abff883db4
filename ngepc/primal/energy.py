"""The energy of the displacement alone, its gradient and tangent, as symbolic forms of NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Integrate, LinearForm, dx
from ngsolve.comp import ProxyFunction, SumOfIntegrals
from scipy.sparse import csr_matrix

from ngepc.discretisation.body import DiscreteBody, Iterate
from ngepc.discretisation.spaces import nodal
from ngepc.discretisation.stiffness import Stiffness
from ngepc.discretisation.symbolic_stiffness import SymbolicStiffness
from ngepc.model.elements import plastic_points
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
from ngepc.model.problem import Problem
from ngepc.primal.return_mapping import ReturnMapping

COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | ELEMENT_FEATURES
    | LAW_FEATURES
    | CONTACT_FEATURES
    | SUPPORT_FEATURES
    | (KINEMATICS_FEATURES - {"plane stress"})
)
"""Features that ``primal_newton`` covers."""


class ReducedEnergy(DiscreteBody):
    """min over p of J(u, p), (2.14), as a function of nodal displacements u (nodes, N).

    ``energy.at(u)`` has its value, gradient and matrix at u.  All points share the symbolic forms,
    which are evaluated for one displacement after the other.
    """

    def __init__(self, problem: Problem) -> None:
        require_covered(
            problem, "primal_newton", COVERS, "; semismooth_newton covers it"
        )
        super().__init__(problem)
        space = self.supports.space
        self.rules = plastic_points(problem.mesh, problem.order)
        self._u = GridFunction(space)
        self._mapping = ReturnMapping(problem, self._u)
        self._forces = LinearForm(
            self._integral(self._mapping.power(space.TestFunction()))
        )
        self._density = self._mapping.energy_density.Compile()
        self._yields = self._mapping.plastic.Compile()
        given = problem.mesh, problem.order, self.free
        self._tangent = SymbolicStiffness(*given, self._power, self._enter)

    def __reduce__(self) -> tuple:
        """NGSolve's forms are not pickled, but made again."""
        return ReducedEnergy, (self.problem,)

    def at_rest(self) -> PrimalState:
        """See ``DiscreteBody``."""
        u = self.starting_displacement(None)
        return PrimalState(self, u, np.zeros(len(self.contact)))

    def at(self, u: np.ndarray) -> EnergyPoint:
        """The energy at nodal displacements ``u``."""
        return EnergyPoint(self, u)

    def _enter(self, u: np.ndarray) -> None:
        """Make the forms those at nodal displacements ``u``."""
        self._u.vec.FV().NumPy()[:] = u.T.ravel()
        self._mapping.update()

    def _power(self, u: ProxyFunction, v: ProxyFunction) -> SumOfIntegrals:
        return self._integral(self._mapping.tangent(u, v))

    def _integral(self, density: CoefficientFunction) -> SumOfIntegrals:
        return self.problem.kinematics.weight * density * dx(intrules=self.rules)

    def integral(self, density: CoefficientFunction) -> float:
        """The integral over the body by the rule that carries the plastic strain."""
        return float(Integrate(self._integral(density), self.problem.mesh))

    def elastic_energy(self, u: np.ndarray) -> float:
        """The energy at ``u`` without the loads and springs, smallest over p."""
        self._enter(u)
        return self.integral(self._density)

    def stress_forces(self, u: np.ndarray) -> np.ndarray:
        """Nodal forces of the stress at ``u``, (nodes, N)."""
        self._enter(u)
        return nodal(self._forces.Assemble().vec.FV().NumPy(), self.problem)

    def plastic_measure(self, u: np.ndarray) -> float:
        """Area or volume of what yields at ``u``."""
        self._enter(u)
        return self.integral(self._yields)

    def flowing(self, u: np.ndarray) -> float:
        """The largest |p| at ``u`` where a law hardens no more."""
        self._enter(u)
        return self._mapping.flowing()

    @cached_property
    def stiffness_diagonal(self) -> np.ndarray:
        """Diagonal of the elastic stiffness, see ``DiscreteBody``."""
        blocks = self._tangent.summed(np.zeros(self.free.shape))
        tangent = self._tangent
        diagonal = np.einsum("nii->ni", blocks[tangent.rows == tangent.columns])
        return diagonal + self.supports.stiffness.diagonal().reshape(diagonal.shape)

    @cached_property
    def stiffness(self) -> Stiffness:
        """What assembles the tangents, see ``DiscreteBody``."""
        return self._tangent.with_added(self.added)


@dataclass(frozen=True, eq=False)
class EnergyPoint:
    """The reduced energy at one displacement; it does not depend on later evaluations elsewhere.

    Parameters
    ----------
    reduced
        The energy.
    u
        Nodal displacements (nodes, N).
    """

    reduced: ReducedEnergy
    u: np.ndarray

    def __reduce__(self) -> tuple:
        """Coefficients of NGSolve are not pickled, but made again."""
        return EnergyPoint, (self.reduced, self.u)

    @cached_property
    def value(self) -> float:
        """min over p of J(u, p) (force times length)."""
        reduced = self.reduced
        work = np.vdot(reduced.load - 0.5 * reduced.supports.pull(self.u), self.u)
        return reduced.elastic_energy(self.u) - float(work)

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress and on the springs (nodes, N)."""
        stress = self.reduced.stress_forces(self.u)
        return stress + self.reduced.supports.pull(self.u)

    @property
    def gradient(self) -> np.ndarray:
        """The derivative of ``value`` by the nodal displacements (nodes, N)."""
        return self.internal_forces - self.reduced.load

    @cached_property
    def matrix(self) -> csr_matrix:
        """The Newton derivative of ``gradient``, u flattened node by node.

        Rows and columns of held components are those of the identity.
        """
        stiffness = self.reduced.stiffness
        return stiffness.symmetric(stiffness.values(self.u))

    @cached_property
    def plastic_measure(self) -> float:
        """Area or volume of what yields in this step."""
        return self.reduced.plastic_measure(self.u)

    @cached_property
    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        return self.reduced.flowing(self.u)

    @cached_property
    def mapping(self) -> ReturnMapping:
        """``ReturnMapping`` at this displacement, with coefficients that stay valid."""
        displacement = self.reduced.supports.function(self.u)
        return ReturnMapping(self.reduced.problem, displacement)


@dataclass(frozen=True, eq=False)
class PrimalState(Iterate):
    """An iterate: displacements and contact forces, see ``Iterate``, and the discrete energy."""

    body: ReducedEnergy
    u: np.ndarray
    contact: np.ndarray

    def along(self, change: np.ndarray) -> tuple[Callable, Callable]:
        """The work of the stress at u + t du times du, and the state there, see ``Iterate``."""

        def moved(t: float, contact: np.ndarray) -> PrimalState:
            """The state at a step length."""
            return PrimalState(self.body, self.u + t * change, contact)

        return lambda t: float(
            np.vdot(moved(t, self.contact).internal_forces, change)
        ), moved

    @cached_property
    def here(self) -> EnergyPoint:
        """The discrete energy at u."""
        return self.body.at(self.u)

    @cached_property
    def energy(self) -> float:
        """J, smallest over p, and friction (force times length)."""
        return self.here.value + self.friction_work

    @property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress and on the springs (nodes, N), the gradient plus the load."""
        return self.here.internal_forces

    @property
    def moduli(self) -> np.ndarray:
        """What the tangent is assembled for: the displacement."""
        return self.u

    @property
    def plastic_measure(self) -> float:
        """Area or volume of what yields in this step."""
        return self.here.plastic_measure

    @property
    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        return self.here.flowing
