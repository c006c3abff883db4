"""The choice of the law at the integration points for a problem."""

from ngepc.discretisation.finer import seen_problem
from ngepc.discretisation.hill_law import HillLaw
from ngepc.discretisation.law import Law
from ngepc.discretisation.overlay_law import OverlayLaw
from ngepc.discretisation.points import Points
from ngepc.discretisation.von_mises_law import VonMisesLaw
from ngepc.model.data import ProblemData


def law_of(problem: ProblemData, points: Points) -> Law:
    """The law of a problem at the points, with data that these may miss as ``finer`` has them."""
    problem = seen_problem(problem, points)
    material = problem.material
    kind: type[Law] = VonMisesLaw
    if material.hill is not None:
        kind = HillLaw
    if material.overlay is not None:
        kind = OverlayLaw
    return kind(problem, points)
