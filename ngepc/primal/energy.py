"""The energy of the displacement alone, its gradient and tangent, as symbolic forms of NGSolve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Integrate, LinearForm, dx
from ngsolve.comp import ProxyFunction, SumOfIntegrals

from ngepc.discretisation.body import DiscreteBody, Iterate
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.stiffness import Stiffness, SymbolicStiffness
from ngepc.model.elements import plastic_points
from ngepc.model.features import require_covered
from ngepc.model.problem import Problem
from ngepc.primal.return_mapping import ReturnMapping

COVERS = frozenset(
    {
        "plane strain",
        "thickness",
        "two-dimensional",
        "axisymmetric",
        "solid",
        "other kinematics",
        "order 2",
        "other shapes",
        "curved elements",
        "kinematic hardening",
        "isotropic hardening",
        "hardening law",
        "rate",
        "initial plastic strain",
        "initial hardening",
        "initial strain",
        "obstacle",
        "two bodies",
        "held by contact",
        "friction",
        "Coulomb friction",
        "contact at a clamp",
        "rollers",
        "edges and points",
        "springs",
    }
)
"""Features that ``primal_newton`` covers."""


class ReducedEnergy(DiscreteBody):
    """min over p of J(u, p), (2.14), for nodal displacements u of shape (nodes, N).

    ``displacement`` and ``mapping`` are the GridFunction that holds the displacement looked at
    last, and ``ReturnMapping`` there, ``forces``, ``density`` and ``plastic`` the forms of forces,
    of the energy and of what yields.
    """

    def __init__(self, problem: Problem) -> None:
        require_covered(problem, "primal_newton", COVERS)
        super().__init__(problem)
        space = self.supports.space
        self.displacement = GridFunction(space, name="displacement")
        self.mapping = ReturnMapping(problem, self.displacement)
        self.rules = plastic_points(problem.mesh, problem.order)
        self.forces = LinearForm(
            self._integral(self.mapping.power(space.TestFunction()))
        )
        self.density = self.mapping.energy_density.Compile()
        self.plastic = self.mapping.plastic.Compile()
        given = problem.mesh, problem.order, self.free
        self._tangent = SymbolicStiffness(*given, self._power, self.at)

    def __reduce__(self) -> tuple:
        """NGSolve's forms are not pickled: they are made again."""
        return ReducedEnergy, (self.problem,)

    def _power(self, u: ProxyFunction, v: ProxyFunction) -> SumOfIntegrals:
        return self._integral(self.mapping.tangent(u, v))

    def _integral(self, density: CoefficientFunction) -> SumOfIntegrals:
        return self.problem.kinematics.weight * density * dx(intrules=self.rules)

    def integral(self, density: CoefficientFunction) -> float:
        """The integral over the body by the rule that carries the plastic strain."""
        return float(Integrate(self._integral(density), self.problem.mesh))

    def at(self, u: np.ndarray) -> ReducedEnergy:
        """The energy itself, looking at the nodal displacements ``u``."""
        self.displacement.vec.FV().NumPy()[:] = u.T.ravel()
        self.mapping.update()
        return self

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
class PrimalState(Iterate):
    """An iterate: displacements and contact forces, see ``Iterate``, and the discrete energy."""

    body: ReducedEnergy
    u: np.ndarray
    contact: np.ndarray

    def along(self, change: np.ndarray) -> tuple[Callable, Callable]:
        """The work of the stress at u + t du times du, and the state there, see ``Iterate``."""

        def moved(t: float, contact: np.ndarray) -> PrimalState:
            return PrimalState(self.body, self.u + t * change, contact)

        return lambda t: float(
            np.vdot(moved(t, self.contact).internal_forces, change)
        ), moved

    @cached_property
    def energy(self) -> float:
        """J, smallest over p, and friction (force times length)."""
        reduced = self.body.at(self.u)
        u = self.u
        work = np.vdot(reduced.load - 0.5 * reduced.supports.pull(u), u)
        return reduced.integral(reduced.density) - float(work) + self.friction_work

    @cached_property
    def internal_forces(self) -> np.ndarray:
        """Nodal forces of the stress and on the springs (nodes, N), the gradient plus the load."""
        reduced = self.body.at(self.u)
        stress = nodal(reduced.forces.Assemble().vec.FV().NumPy(), reduced.problem)
        return stress + reduced.supports.pull(self.u)

    @property
    def moduli(self) -> np.ndarray:
        """What the tangent is assembled for: the displacement."""
        return self.u

    @property
    def plastic_measure(self) -> float:
        """Area or volume of what yields in this step."""
        reduced = self.body.at(self.u)
        return reduced.integral(reduced.plastic)

    @property
    def flowing(self) -> float:
        """The largest |p| where a law hardens no more."""
        return self.body.at(self.u).mapping.flowing()
