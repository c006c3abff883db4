"""One step of the primal-dual Newton method: tangent, contact, step length.

With w = -q a variable of its own, the conditions at a point that yields,

    2 mu_2 (dev eps(u) - p) = stress(s, w),    |s| w = r(|s|) s,

are linearised together.  Elimination of w point by point leaves an elasticity-like matrix in u that
is symmetric and positive definite for every w with |w| <= r (``Law.moduli``).  Contact is kept
exact in each step: u + du minimises Newton's model over N u <= gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ngepc.discretisation.balance import EPSILON
from ngepc.discretisation.contact_step import ROUNDING, ContactWork, with_contact
from ngepc.local.factors import Tangent, TangentError
from ngepc.local.system import DiscreteProblem, State

NOISE = 1e-14
"""Rounding of a slope relative to the terms that it is summed from."""


@dataclass(frozen=True, eq=False)
class Target:
    """Where Newton's model is smallest: the change of u, and contact there.

    Parameters
    ----------
    change
        du, shape (nodes, N).
    contact
        The forces of contact and friction at u + du.
    """

    change: np.ndarray
    contact: np.ndarray


class TargetFinder(Protocol):
    """What finds where Newton's model is smallest."""

    def __call__(self, here: State, tangent: Tangent) -> Target:
        """Take the tangent at a state and solve Newton's model there."""
        ...


class ExactTarget:
    """Newton's model solved exactly, contact and friction included.

    Parameters
    ----------
    discrete
        The discrete problem; what its contact rows answer is learned from step to step.
    """

    def __init__(self, discrete: DiscreteProblem) -> None:
        self._compliance = discrete.compliance()

    def __call__(self, here: State, tangent: Tangent) -> Target:
        """Factorise the tangent at a state and solve Newton's model with contact and friction.

        Raises
        ------
        TangentError
            If the linear solver gives up, or contact rows are dependent.
        """
        tangent.linearise(here)
        change = tangent.solve(-here.imbalance)
        found = with_contact(here, tangent.solve, change, here.contact, self._compliance)
        if found is None:
            raise TangentError(here.discrete.contact.unsolvable)
        return Target(*found)


@dataclass(frozen=True, eq=False)
class Line:
    """The states u + t du with their energies' slope; strains are affine in t.

    Parameters
    ----------
    here, target
        Where the step starts and where it points.
    """

    here: State
    target: Target

    def __post_init__(self) -> None:
        points = self.here.discrete.points
        volume, e = points.strain(self.target.change)
        object.__setattr__(self, "_strain_change", (volume, e))
        here, target = self.here, self.target
        contact = ContactWork(here, target.change, target.contact)
        object.__setattr__(self, "_contact", contact)
        processes = points.processes
        work = processes.dot(here.discrete.load - contact.held, target.change)
        object.__setattr__(self, "_work", work)
        pull = self.here.discrete.supports.pull(target.change)
        springs = processes.dot(pull, here.u), processes.dot(pull, target.change)
        object.__setattr__(self, "_springs", springs)

    def slope(self, t: float) -> float:
        """d/dt of J(u + t du), friction with the bounds of the target included."""
        discrete, (volume, e) = self.here.discrete, self._strain_change
        at = discrete.law.returned(self.here.deviator + t * e)
        stress = discrete.law.stress(at)
        mean = discrete.law.bulk * (self.here.volume + t * volume) * volume
        start, rise = self._springs
        work = self._work - self._contact.slope(t) - start - t * rise
        return discrete.points.integral(mean + np.einsum("pd,pd->p", stress, e)) - work

    @property
    def noise(self) -> float:
        """What rounding leaves of a slope, also where du is nothing but rounding of u itself."""
        contact = self.here.discrete.contact
        processes, size = contact.processes, np.abs(self.here.u)
        terms = NOISE * np.abs(self.target.change) + 2 * EPSILON * size
        pressing = processes.total(float(np.abs(self.target.contact[contact.own]).sum()))
        summed = processes.dot(np.abs(self.here.internal_forces), terms)
        answers = np.abs(self.target.contact) / self.here.discrete.row_stiffness
        return summed + pressing * ROUNDING * max(processes.most(size), processes.most(answers))

    def state(self, t: float) -> State:
        """The state at u + t du, with w and lambda moved along."""
        here, discrete = self.here, self.here.discrete
        u = here.u + t * self.target.change
        contact = here.contact + t * (self.target.contact - here.contact)
        if t == 1.0:
            contact = self.target.contact
        ds = discrete.law.two_mu[:, None] * self._strain_change[1]
        moved = discrete.law.linearised(here.at, here.yielding, ds)
        return discrete.state(u, here.yielding + t * (moved - here.yielding), contact)
