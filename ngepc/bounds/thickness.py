"""Results of plane bodies of thickness one, which the bounds of other thicknesses are made from.

With the thickness t all energies and forces are t times those of a body of thickness one with the
same displacements, stresses and contact pressures.
"""

from __future__ import annotations

from dataclasses import replace

from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.model.problem import Problem


def with_other_thickness(result: ExactResult, thickness: float | None) -> ExactResult:
    """The result for a body of another thickness, None for one."""
    problem = result.problem
    made = replace(problem, thickness=thickness)
    share = made.kinematics.thickness / problem.kinematics.thickness
    forces = result.state.contact * share
    state = DiscreteProblem(made).state(result.state.u, contact=forces)
    return ExactResult(state, result.status, result.ending, result.history)


def of_thickness_one(result: ExactResult) -> ExactResult:
    """The result itself, or that for a body of thickness one."""
    if is_of_thickness_one(result.problem):
        return result
    return with_other_thickness(result, None)


def is_of_thickness_one(problem: Problem) -> bool:
    """Whether forces and energies are those of a thickness of one, or of a solid."""
    return problem.kinematics.thickness == 1
