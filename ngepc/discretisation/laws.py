"""Which law a problem has."""

from ngepc.discretisation.hill_law import HillLaw
from ngepc.discretisation.law import Law, VonMisesLaw
from ngepc.discretisation.points import Points
from ngepc.model.data import ProblemData


def law_of(problem: ProblemData, points: Points) -> Law:
    """The law of a problem at the points."""
    kind = VonMisesLaw if problem.material.hill is None else HillLaw
    return kind(problem, points)
