"""What a body remembers from one time step to the next: p_0 and alpha_0 of (2.15) and (2.16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import GridFunction, Norm

from ngepc.checks.arguments import is_number
from ngepc.discretisation.return_mapping import interpolated
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.tensors import coordinates, tensor
from ngepc.results.fields import Fields


@dataclass(frozen=True, eq=False)
class Memory:
    """The internal variables at the end of a step, with the values at the plastic points.

    Piecewise constant on flat simplices, (multi)linear through the Gauss points on other elements.

    Parameters
    ----------
    plastic_strain
        Coordinates of p_0, d components (1).
    back_stress
        Coordinates of dev alpha_2,0, d components (stress).
    hardening_variable
        alpha_1,0 >= 0, scalar (1).
    """

    plastic_strain: GridFunction
    back_stress: GridFunction
    hardening_variable: GridFunction

    @classmethod
    def initial(cls, problem: Problem) -> Memory:
        """The initial state that ``problem`` was given."""
        alpha_1, alpha_2 = problem.alpha_0
        N = problem.N
        return cls(
            interpolated(problem, coordinates(problem.p_0, N)),
            interpolated(problem, coordinates(alpha_2, N)),
            interpolated(problem, alpha_1),
        )

    def after(self, fields: Fields) -> Memory:
        """p_0 + p, alpha_2 + k p and alpha_1 + k_1 H sigma_y |p| after the step of ``fields``."""
        problem, material = fields.problem, fields.problem.material
        p = interpolated(problem, fields.plastic_increment)
        factor = material.hardening_stiffness * material.hardening_modulus * material.yield_stress
        return Memory(
            _sum(self.plastic_strain, p),
            _sum(self.back_stress, interpolated(problem, as_scalar(material.hardening) * p)),
            _sum(self.hardening_variable, interpolated(problem, as_scalar(factor) * Norm(p))),
        )

    def problem(self, base: Problem, changes: Mapping[str, object]) -> Problem:
        """``base`` with the changes of a step and this memory as its initial state."""
        N, material = base.N, base.material
        kinematic = not _is_zero(material.hardening)
        isotropic = not _is_zero(material.isotropic_hardening)
        back_stress = tensor(self.back_stress, N)
        if kinematic and isotropic:
            hardening: object = (self.hardening_variable, back_stress)
        else:
            hardening = back_stress if kinematic else self.hardening_variable
        return replace(
            base,
            **changes,
            initial_plastic_strain=tensor(self.plastic_strain, N),
            initial_hardening=hardening,
        )

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The coefficients by name, for checkpoints and comparisons."""
        return {
            name: getattr(self, name).vec.FV().NumPy().copy()
            for name in ("plastic_strain", "back_stress", "hardening_variable")
        }


def _sum(old: GridFunction, gained: GridFunction) -> GridFunction:
    result = GridFunction(old.space)
    result.vec.data = old.vec + gained.vec
    return result


def _is_zero(value: object) -> bool:
    return is_number(value) and value == 0
