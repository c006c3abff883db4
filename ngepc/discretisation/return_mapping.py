"""Names that histories use for the points of a problem."""

from ngsolve import ET, IntegrationRule, Mesh
from ngsolve.comp import DifferentialSymbol

from ngepc.discretisation import rules
from ngepc.discretisation.pointfunctions import interpolated as interpolated
from ngepc.model.problem import Problem


def plastic_points(mesh: Mesh) -> dict[ET, IntegrationRule]:
    """``rules.plastic_points`` for displacements of order one."""
    return rules.plastic_points(mesh, 1)


def at_plastic_points(problem: Problem, dx: DifferentialSymbol) -> DifferentialSymbol:
    """``dx`` on the points that carry plastic strain."""
    return dx(intrules=rules.plastic_points(problem.mesh, problem.order))
