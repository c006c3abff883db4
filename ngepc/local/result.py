"""The result of the method at the integration points: the discrete solution and what it tells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.pointfunctions import PointFunctions
from ngepc.discretisation.points import Moduli
from ngepc.discretisation.rows import ContactRows
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem
from ngepc.results.exact import DiscreteSolution
from ngepc.results.outcome import History, Status


@dataclass(frozen=True, eq=False, repr=False)
class ExactResult(DiscreteSolution):
    """What ``semismooth_newton`` returns without gamma; the state is there whatever the status.

    Parameters
    ----------
    state
        The last iterate: u, q and the contact forces.
    status
        How the run ended.
    ending
        A sentence about it, empty for a run that converged.
    history
        Records of all iterates.
    """

    state: State
    status: Status
    ending: str
    history: History

    method_label = "exact"

    @property
    def discrete(self) -> DiscreteProblem:
        """The discrete problem that was solved."""
        return self.state.discrete

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.discrete.problem

    @property
    def rows(self) -> ContactRows:
        """The contact conditions N u <= gaps."""
        return self.discrete.rows

    @property
    def largest_strain(self) -> float:
        """The largest |eps(u)| at the points."""
        state, size = self.state, self.problem.kinematics.size
        squared = state.volume**2 / size + (state.deviator**2).sum(1)
        return float(np.sqrt(self.discrete.points.processes.most(squared)))

    @cached_property
    def dual_energy(self) -> float:
        """J*(lambda, q), the dual functional of the discrete problem (force times length).

        J + J* >= 0 bounds the energy error of any state, and is zero at the solution.  It takes one
        factorisation: y with D y = (l - N' lambda, q).
        """
        return dual_energy(self.state)

    @cached_property
    def displacement(self) -> GridFunction:
        """u (length)."""
        return self.discrete.supports.function(self.state.u)

    @cached_property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        return self._functions.function(self.state.at.plastic_strain, "plastic_increment")

    @cached_property
    def plastic_dual(self) -> GridFunction:
        """The dual variable q = h p - dev sigma + dev alpha_2 (3.8), d components (stress)."""
        return self._functions.function(self.discrete.law.dual_variable(self.state.at), "q")

    @cached_property
    def _functions(self) -> PointFunctions:
        return PointFunctions(self.discrete.points)


def dual_energy(state: State) -> float:
    """J*(lambda, q) at a state (force times length).

    It is minus the least value over y = (u, p) of

        1/2 <D y, y> + l(y) - int q . p + lambda . (N u - gaps),

    where the p that is best for u is p = (q + s) / (2 mu_2 + h) at each point.
    """
    discrete, law, points = state.discrete, state.discrete.law, state.discrete.points
    tangent = Factors(discrete, "sparsecholesky")
    h, two_mu, q = law.hardening, law.two_mu, -law.projected(state.yielding)
    zero, direction = np.zeros_like(two_mu), np.zeros_like(q)
    tangent.update(Moduli(law.bulk, two_mu * h / (two_mu + h), zero, direction))
    u = state.u
    for _ in range(2):
        volume, e = points.strain(u)
        p = (q + law.returned(e).trial) / (two_mu + h)[:, None]
        stress = two_mu[:, None] * (e - law.initial - p)
        forces = points.forces(law.bulk * volume, stress) + discrete.supports.pull(u)
        u = u + tangent.solve(discrete.load - state.contact_forces - forces)
    volume, e = points.strain(u)
    p = (q + law.returned(e).trial) / (two_mu + h)[:, None]
    elastic = e - p - law.initial
    density = 0.5 * (law.bulk * volume**2 + two_mu * (elastic**2 - law.initial**2).sum(1))
    density += 0.5 * h * (p**2).sum(1) + ((law.back - q) * p).sum(1)
    work = np.vdot(discrete.load - 0.5 * discrete.supports.pull(u), u)
    work += state.contact @ discrete.contact.gaps(u)
    return -(points.integral(density) - float(work))
