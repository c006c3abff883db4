"""A Newton step under contact, as both exact methods take it: tangent, contact, step length.

Each step goes towards the minimum of Newton's model over N u <= gaps, friction included, as far as
the energy falls.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from ngepc.discretisation.balance import EPSILON, Balance, Frame
from ngepc.discretisation.contact_step import ROUNDING, ContactWork, rival, with_contact
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.linesearch import nearly_flat

NOISE = 1e-14
"""Rounding of a slope relative to the terms that it is summed from."""


class Tangent(Protocol):
    """What a Newton step asks of a linear solver.

    ``examined`` are the most solves that tell whether friction allows other equilibria; for that
    ``stiffened``, if there is one, makes ``solve`` with springs of the rows.
    """

    examined: int
    stiffened: Callable[[np.ndarray], Callable[[np.ndarray], np.ndarray]] | None

    def linearise(self, here: Any) -> None:
        """Take the tangent at a state."""
        ...

    def solve(self, forces: np.ndarray) -> np.ndarray:
        """Displacements, zero where held, that answer nodal forces; both (nodes, N)."""
        ...


class Target(NamedTuple):
    """Where Newton's model is smallest: du, shape (nodes, N), and forces of the rows there."""

    change: np.ndarray
    contact: np.ndarray


class ExactTarget:
    """Newton's model solved exactly; what the rows answer is learned from step to step."""

    def __init__(self, frame: Frame) -> None:
        self._compliance = frame.compliance()

    def __call__(self, here: Balance, tangent: Tangent) -> Target:
        """Take the tangent at a state and solve; FactorisationError if that cannot be done."""
        tangent.linearise(here)
        change = tangent.solve(-here.imbalance)
        found = with_contact(here, tangent.solve, change, here.contact, self._compliance)
        if found is None:
            raise FactorisationError(here.frame.contact.unsolvable)
        return Target(*found)


class Line:
    """The states u + t du; each method knows the work of its stress and how states follow."""

    def __init__(self, here: Any, target: Target) -> None:
        self.here, self.target, frame = here, target, here.frame
        self._contact = ContactWork(here, *target)
        work = frame.load - self._contact.held, target.change
        self._work = frame.contact.processes.dot(*work)

    def internal_work(self, t: float) -> float:
        """The internal forces at u + t du times du."""
        raise NotImplementedError

    def state(self, t: float) -> Any:
        """The state at u + t du."""
        raise NotImplementedError

    def forces(self, t: float) -> np.ndarray:
        """Those of the rows at t."""
        start, end = self.here.contact, self.target.contact
        return end if t == 1.0 else start + t * (end - start)

    def slope(self, t: float) -> float:
        """d/dt of J(u + t du), friction with the bounds of the target included."""
        return self.internal_work(t) + self._contact.slope(t) - self._work

    @property
    def noise(self) -> float:
        """What rounding leaves of a slope, also where du is nothing but rounding of u itself."""
        frame, contact = self.here.frame, self.here.frame.contact
        processes, size, forces = (
            contact.processes,
            np.abs(self.here.u),
            np.abs(self.target.contact),
        )
        terms = NOISE * np.abs(self.target.change) + 2 * EPSILON * size
        summed = processes.dot(np.abs(self.here.internal_forces), terms)
        pressing = processes.total(float(forces[contact.own].sum()))
        answers = processes.most(forces / frame.row_stiffness)
        return summed + pressing * ROUNDING * max(processes.most(size), answers)


class ContactStep:
    """A step with a tangent towards what ``target`` finds, see ``NewtonStep``."""

    line: type[Line]

    def __init__(self, tangent: Any, target: Callable[[Any, Any], Target]) -> None:
        self.tangent, self.target = tangent, target

    def __call__(self, here: Any) -> tuple[Any, float, int] | None:
        """The next state, the step length and its trials; None if no length lowers J."""
        line = self.line(here, self.target(here, self.tangent))
        if here.penetration > here.touching_distance:
            return line.state(1.0), 1.0, 0  # the first step makes u feasible
        found = nearly_flat(line.slope, line.noise)
        return None if found is None else (line.state(found[0]), *found)

    def rival(self, state: Any) -> tuple[bool, str]:
        """Whether friction allows other equilibria beside a solution, see ``NewtonStep``."""
        tangent = self.tangent
        if not state.frame.contact.friction.d:
            return False, ""
        tangent.linearise(state)
        return rival(state, tangent.solve, tangent.examined, tangent.stiffened)
