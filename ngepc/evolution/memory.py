"""What a body remembers from one time step to the next: p_0 and alpha_0 of (2.15) and (2.16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ngepc.checks.arguments import is_number
from ngepc.discretisation.pointfunctions import PointFunctions, on_children
from ngepc.discretisation.points import Points
from ngepc.model.material import PEEQ, Material
from ngepc.model.problem import Problem


@dataclass(frozen=True, eq=False)
class Memory:
    """The internal variables at the integration points at the end of a step.

    Coordinates of p_0 (1) and of dev alpha_2,0 (stress), shape (points, d), alpha_1,0 >= 0 (1) and
    PEEQ (1), shape (points,); ``functions`` are the points, and the polynomials through them.
    """

    functions: PointFunctions
    plastic_strain: np.ndarray
    back_stress: np.ndarray
    hardening_variable: np.ndarray
    accumulated: np.ndarray

    @classmethod
    def initial(cls, problem: Problem) -> Memory:
        """The initial state that ``problem`` was given."""
        points = Points(problem.mesh, problem.kinematics, problem.order)
        alpha_1, alpha_2 = problem.alpha_0
        coordinates = problem.kinematics.coordinates
        return cls(
            PointFunctions(points),
            points.at(coordinates(problem.p_0)),
            points.at(coordinates(alpha_2)),
            points.at(alpha_1),
            points.at(problem.accumulated_0),
        )

    def after(self, material: Material, p: np.ndarray) -> Memory:
        """p_0 + p, alpha_2 + k p, alpha_1 + k_1 H sigma_y |p| and PEEQ after a step."""
        at, size = self.functions.points.at, np.linalg.norm(p, axis=1)
        return replace(
            self,
            plastic_strain=self.plastic_strain + p,
            back_stress=self.back_stress + at(material.hardening)[:, None] * p,
            hardening_variable=self.hardening_variable + at(material.scalar_growth) * size,
            accumulated=self.accumulated + PEEQ * size,
        )

    def on(self, problem: Problem, parents: np.ndarray) -> Memory:
        """The same functions on a mesh whose simplices lie in these ones; PEEQ stays >= 0."""
        points = Points(problem.mesh, problem.kinematics, problem.order)
        before = self.functions.points
        carried = {k: on_children(v, before, points, parents) for k, v in self.arrays.items()}
        carried["accumulated"] = np.maximum(carried["accumulated"], 0.0)
        return Memory(PointFunctions(points), **carried)

    def problem(self, base: Problem, changes: Mapping[str, object]) -> Problem:
        """``base`` with the changes of a step and this memory as its initial state."""
        material, tensor = base.material, base.kinematics.tensor
        function = self.functions.function
        hardening = back_stress = tensor(function(self.back_stress))
        if not is_zero(material.isotropic_hardening):
            scalar = function(self.hardening_variable)
            hardening = scalar if is_zero(material.hardening) else (scalar, back_stress)
        return replace(
            base,
            **changes,
            initial_plastic_strain=tensor(function(self.plastic_strain)),
            initial_hardening=hardening,
            initial_accumulated=function(self.accumulated),
        )

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """Copies of the values by name, for comparisons."""
        names = ("plastic_strain", "back_stress", "hardening_variable", "accumulated")
        return {name: getattr(self, name).copy() for name in names}


def is_zero(value: object) -> bool:
    """Whether a coefficient is the number 0."""
    return is_number(value) and value == 0
