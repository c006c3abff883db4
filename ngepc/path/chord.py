"""A predictor along the path by the factors at hand."""

from __future__ import annotations

from dataclasses import dataclass

from ngsolve.la import BaseVector

from ngepc.dual.functional import DualFunctional, NewtonSystem
from ngepc.dual.iterates import Iterate
from ngepc.krylov.iterative import KrylovError


@dataclass(frozen=True)
class Chord:
    """One chord step for the next gamma, taken where it lowers the energy.

    The residual of the next problem at the last solution, solved with the last factors of the
    problem before: where only the Tichonov term depends on gamma that is Euler's step in
    1/gamma.  It costs one back-substitution and no factorisation.
    """

    def start(self, system: NewtonSystem, functional: DualFunctional, v: BaseVector) -> BaseVector:
        """The better of v and the predicted start.

        Parameters
        ----------
        system
            Newton system of the problem before, with its last factors.
        functional
            J*_gamma of the next problem.
        v
            Solution of the problem before.
        """
        if not system.has_factors:
            return v
        here = Iterate.at(functional, v)
        try:
            _, dv = system.direction(v, here.residual)
        except KrylovError:
            return v
        predicted = v.CreateVector()
        predicted.data = v + dv
        functional.make_feasible(predicted)
        return predicted if Iterate.at(functional, predicted).energy < here.energy else v
