"""The result of the method at the integration points: the discrete solution and what it tells."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.points import Moduli, PointFunctions
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State
from ngepc.results.result import DiscreteSolution


class ExactResult(DiscreteSolution):
    """What ``semismooth_newton`` returns without gamma, see ``DiscreteSolution``."""

    state: State
    method_label = "exact"

    @property
    def discrete(self) -> DiscreteProblem:
        """The discrete problem that was solved."""
        return self.state.discrete

    @property
    def largest_strain(self) -> float:
        """The largest |eps(u)| at the points."""
        state, size = self.state, self.problem.kinematics.size
        squared = state.volume**2 / size + (state.deviator**2).sum(1)
        return float(np.sqrt(self.discrete.points.processes.most(squared)))

    @cached_property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        return self._functions.function(self.state.at.plastic_strain, "plastic_increment")

    @cached_property
    def plastic_dual(self) -> GridFunction:
        """The dual variable q = h p - dev sigma + dev alpha_2 (3.8), d components (stress)."""
        return self._functions.function(-self.discrete.law.yielding_part(self.state.at), "q")

    @cached_property
    def _functions(self) -> PointFunctions:
        return PointFunctions(self.discrete.points)

    @cached_property
    def dual_energy(self) -> float:
        """J*(lambda, sigma), the dual functional (force times length), inf if no stress allows it.

        J + J* >= 0 bounds the energy error of any state, and is zero at the solution.  The state's
        stress is put into balance by an elastic solve.  For every sigma in balance, and every force
        of contact and friction within its bounds, weak duality says that

            J* = int phi*(sigma) + lambda . gaps(0) - (forces of supports) . (prescribed u) >= -J,

        with the conjugate phi* of the density of J, smallest over p, as a function of the strain.
        """
        state, discrete = self.state, self.discrete
        law, points, supports = discrete.law, discrete.points, discrete.supports
        tangent, zero = Factors(discrete, "sparsecholesky"), np.zeros_like(law.two_mu)
        tangent.update(Moduli(law.bulk, law.two_mu, zero, np.zeros_like(state.deviator)))
        pressure, stress, u = law.bulk * state.volume, law.stress(state.at), state.u
        missing = state.missing
        for _ in range(2):
            change = tangent.solve(-missing)
            volume, e = points.strain(change)
            pressure, stress = pressure + law.bulk * volume, stress + law.two_mu[:, None] * e
            u = u + change
            forces = points.forces(pressure, stress) + supports.pull(u)
            missing = forces + state.contact_forces - discrete.load
        held = np.where(discrete.free, 0.0, supports.values)
        work = 0.5 * np.vdot(supports.pull(u), u) - np.vdot(missing, held)
        work += state.contact @ discrete.contact.gaps(np.zeros_like(held))
        return points.integral(law.complementary_density(pressure, stress)) + float(work)
