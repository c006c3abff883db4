"""What the primal solver gives back: fields, forces, energies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.pointfunctions import interpolated
from ngepc.discretisation.rows import ContactRows
from ngepc.model.problem import Problem
from ngepc.primal.state import PrimalState
from ngepc.results.exact import DiscreteSolution
from ngepc.results.outcome import History, Status


@dataclass(frozen=True, eq=False, repr=False)
class PrimalResult(DiscreteSolution):
    """The last state of ``primal_newton``.

    Parameters
    ----------
    state
        The last iterate.
    status, ending
        How the run ended, and a sentence about it.
    history
        Records of the iterates, start included.
    """

    state: PrimalState
    status: Status
    ending: str
    history: History

    method_label = "exact (primal)"

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.state.reduced.problem

    @property
    def rows(self) -> ContactRows:
        """The contact conditions N u <= gaps."""
        return self.state.reduced.contact.rows

    @cached_property
    def dual_energy(self) -> float:
        """-J at the solution by an identity that only the solution satisfies.

        J = 1/2 (l(u, p) + int beta |p| - contact forces . N u + <reactions, prescribed u>) without
        friction; with friction its work is added.  The sum with ``primal_energy`` is a measure of
        what is left.
        """
        state = self.state
        fixed = np.where(state.frame.free, 0.0, state.missing)
        work = np.vdot(fixed - state.contact_forces, state.u)
        friction = -state.contact @ state.gaps + state.multipliers @ state.open_gap
        return -0.5 * (state.reduced.first_order_energy(state.u) + float(work)) - friction

    @cached_property
    def displacement(self) -> GridFunction:
        """u (length)."""
        return self.state.reduced.supports.function(self.state.u)

    @cached_property
    def plastic_increment(self) -> GridFunction:
        """Coordinates of the plastic strain p gained in this step, d components."""
        reduced = self.state.reduced
        reduced.set(self.state.u)
        return interpolated(self.problem, reduced.mapping.plastic_increment)
