"""The result of the exact method."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from ngsolve import GridFunction

from ngepc._deprecated import old_names
from ngepc.discretisation.points import PointFunctions, Points
from ngepc.linalg.secants import Compliance
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.own import require_same_mesh
from ngepc.results.result import DiscreteSolution


@dataclass(frozen=True, eq=False, repr=False)
class ExactResult(DiscreteSolution):
    """What ``semismooth_newton`` returns without gamma, see ``DiscreteSolution``."""

    state: State
    method_label: ClassVar[str] = "exact"
    compliance: Compliance | None = None
    """What the solve has learned of the compliance of few contact rows, a guess for adjoints."""

    @property
    def discrete(self) -> DiscreteProblem:
        """The discrete problem that was solved."""
        return self.state.discrete

    @property
    def _points(self) -> Points:
        return self.discrete.points

    @property
    def largest_strain(self) -> float:
        """The largest |eps(u)| at the points."""
        state = self.state
        size = self.problem.kinematics.size
        squared = state.volume**2 / size + (state.deviator**2).sum(1)
        return float(np.sqrt(self.discrete.points.processes.maximum(squared)))

    @property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        require_same_mesh(self.discrete.problem)
        return self._plastic_increment

    @property
    def plastic_dual(self) -> GridFunction:
        """The dual variable q = h p + dev alpha_2,0 - dev sigma, d components (stress), (3.8).

        With sub-elements it is the sum of theirs.
        """
        require_same_mesh(self.discrete.problem)
        return self._plastic_dual

    @cached_property
    def _plastic_increment(self) -> GridFunction:
        return self._functions.function(
            self.state.at.plastic_strain, "plastic_increment"
        )

    @cached_property
    def _plastic_dual(self) -> GridFunction:
        w = self.discrete.law.yielding_part(self.state.at)
        d = self.problem.kinematics.d
        q = -w.reshape(len(w), -1, d).sum(axis=1)
        return self._functions.function(q, "q")

    @property
    def _functions(self) -> PointFunctions:
        return self.discrete.points.functions

    @cached_property
    def dual_energy(self) -> float:
        """J*(lambda, sigma), the dual functional (force times length); it may be inf.

        J + J* >= 0 bounds the energy error of any state, and is zero at the solution.  The stress
        of the state is brought into balance by an elastic solve.  For every sigma in balance, and
        every force of contact and friction within its bounds, weak duality says that

            J* = int phi*(sigma) + lambda . gaps(0) - (forces of supports) . (prescribed u) >= -J,

        with the conjugate phi* of the density of J, smallest over p, as a function of the strain.
        """
        state = self.state
        discrete = self.discrete
        law = discrete.law
        points = discrete.points
        supports = discrete.supports
        elastic = law.elastic_moduli
        pressure, stress = law.stress(state.at)
        u = state.u
        missing = state.residual_force
        for _ in range(2):
            change = discrete.elastic.solve(-missing)
            more = elastic.stress(*points.strain(change))
            pressure = pressure + more[0]
            stress = stress + more[1]
            u = u + change
            forces = points.forces(pressure, stress) + supports.pull(u)
            missing = forces + state.contact_forces - discrete.load
        held = np.where(discrete.free, 0.0, supports.values)
        work = 0.5 * np.vdot(supports.pull(u), u) - np.vdot(missing, held)
        work += state.contact @ discrete.contact.gaps(np.zeros_like(held))
        return points.integral(law.complementary_density(pressure, stress)) + float(
            work
        )


__getattr__ = old_names(__name__)
