"""The derivative of a solution in one direction, from each time step to the next one.

Each biactive row and point is active or inactive: the derivative satisfies

    N u' <= gaps',  lambda' >= 0  with equality in one of them    for biactive rows,
    p' = [s' . d - beta']_+ / (2 mu_2 + h + slope of beta) d      for biactive points,

and rows whose friction is at its bound without slip stick or slip.  Without friction the derivative
is the minimiser of a strictly convex, piecewise quadratic energy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_mapping
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.system import State
from ngepc.model.problem import Problem
from ngepc.sensitivity.contact import (
    BIACTIVE,
    Biactive,
    LinearContact,
    biactive_message,
    biactive_set,
)
from ngepc.sensitivity.equations import INHERITED, Data
from ngepc.sensitivity.functionals import Form, Functional, as_functional, slope_by_mesh
from ngepc.sensitivity.gradient import Solution, require_data, states_of
from ngepc.sensitivity.law_equations import YieldSurface, yield_surfaces_of
from ngepc.sensitivity.linear import LinearStep, TangentError
from ngepc.sensitivity.parameters import Direction, change_in_step, directions

EXCHANGES = 50  # largest number of changes of the active set


NEUTRAL = 1e-9  # smaller relative changes leave the status undetermined, as for a body at rest


@dataclass(frozen=True, eq=False)
class TangentResult:
    """The derivative of a solution in one direction.

    Parameters
    ----------
    state, rows
        The solution; ``state.at.yields`` and ``rows`` have the status that biactive points and rows
        take in this direction.
    change
        Name -> change: "u" of nodal displacements (nodes, N), "contact" of the forces of contact
        and friction, "p" and "stress" of the plastic strain and the deviatoric stress at the
        points (points, d), "mean" of the mean stress (points,), and those of the data.
    biactive
        The biactive rows and points of this time step and those before.
    """

    state: State
    rows: LinearContact
    change: Data
    biactive: tuple[Biactive, ...]

    @property
    def message(self) -> str:
        """A message if the derivative is one-sided; empty if the solution is differentiable."""
        return biactive_message(self.biactive)

    @property
    def displacement(self) -> GridFunction:
        """The change of the displacement."""
        return self.state.discrete.supports.function(
            self.change["u"], "displacement_change"
        )

    @property
    def contact_force(self) -> float:
        """The change of the resultant contact force."""
        return self.of("contact_force")

    def of(self, functional: str | Form | Functional) -> float:
        """The derivative of a functional, see ``gradient``."""
        functional = as_functional(functional)
        slope = functional.slope(self.state).by.paired(self.change)
        return slope + slope_by_mesh(functional, self.state, self.change)


Rates = str | Mapping[str, float | tuple[float, Direction]]
"""Name of a datum, or name -> rate: {"gap": -1.0, "hardening": 5.0}, or -> (rate, Direction)."""


@one_blas_thread
def tangent(result: Solution, parameters: Rates) -> TangentResult:
    """The derivative of the solution in a direction; at biactive solutions the one-sided one.

    Parameters
    ----------
    result
        A converged result of ``semismooth_newton`` without gamma, or of ``evolve``, of which the
        derivative of the last step is returned.
    parameters
        The name of a datum, or name -> rate, or any name -> (rate, Direction).

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem lacks such data.
    SolverError
        If the result is not that of a converged run.
    TangentError
        If the tangent is singular, or no consistent status of biactive rows and points was found.
    """
    states = (give_state() for give_state in states_of(result))
    rates = {parameters: 1.0} if isinstance(parameters, str) else parameters
    require_mapping("parameters", rates, "the name of a datum, or name -> rate")
    wanted = Derivatives(rates, result.problem).directions
    require_data(result, wanted.values())
    return tangents_at(states, [rates], result.problem)[0][-1]


def tangents_at(
    states: Iterable[State], several: Sequence[Mapping], problem: Problem
) -> list[list[TangentResult]]:
    """The derivatives of the solutions of all time steps, in order, for several changes of data.

    The matrix of a step is factorised once for all of them.  ``problem`` is that of the history.
    """
    found = [Derivatives(rates, problem) for rates in several]
    for state in states:
        system = LinearStep(state)
        for derivatives in found:
            derivatives.append(system)
    return [derivatives.steps for derivatives in found]


class Derivatives:
    """The derivatives in one direction, from each time step to the next one.

    Parameters
    ----------
    rates
        Name -> rate or (rate, Direction), as for ``tangent``.
    problem
        The problem of the history.
    """

    def __init__(self, rates: Mapping, problem: Problem) -> None:
        pairs = {
            n: r if isinstance(r, tuple) else (r, Direction(n))
            for n, r in rates.items()
        }
        self.directions = directions(
            {name: direction for name, (_, direction) in pairs.items()}
        )
        self.rates = {
            name: require_number(f"parameters[{name!r}]", r)
            for name, (r, _) in pairs.items()
        }
        self.steps: list[TangentResult] = []
        self._problem = problem

    def append(self, system: LinearStep) -> None:
        """Add the derivative of the next step, with the system at its solution."""
        data = self._inherited()
        for name, direction in self.directions.items():
            number = len(self.steps)
            change = change_in_step(system.state, direction, self._problem, number)
            if change is not None:
                data += self.rates[name] * change
        before = self.steps[-1].biactive if self.steps else ()
        self.steps.append(_change_of(system, data, before))

    def _inherited(self) -> Data:
        """What the last step leaves to the next one."""
        if not self.steps:
            return Data()
        change = self.steps[-1].change
        return Data(
            {n: change[f"next_{n}"] for n in INHERITED if f"next_{n}" in change}
        )


def _change_of(
    system: LinearStep, data: Data, before: tuple[Biactive, ...]
) -> TangentResult:
    """The derivative of a solution for a change of its data, with a consistent active set.

    An active-set method for the convex energy of the change, which is quadratic for a fixed set.
    """
    biactive = (*before, biactive_set(system.contact))
    for _ in range(EXCHANGES):
        state = system.state
        change = system.forward(data)
        found = TangentResult(state, system.contact, change, biactive)
        chosen = _chosen_rows(found)
        surfaces = yield_surfaces_of(state)
        sides = [_chosen_sides(surface, change) for surface in surfaces]
        kept = zip(sides, surfaces, strict=True)
        same = all((side == surface.at.yields).all() for side, surface in kept)
        if same and chosen.same_sides(system.contact):
            return found
        at = state.discrete.law.with_sides(state.at, *sides)
        system = LinearStep(replace(state, at=at), chosen)
    raise TangentError(
        f"the active set of the one-sided derivative was not found: {found.message}"
    )


def _chosen_sides(surface: YieldSurface, change: Data) -> np.ndarray:
    """The points that yield under the change; only biactive points may change their status."""
    law, at, _ = surface
    named = surface.named
    pushed = np.einsum("pd,pd->p", at.direction, change[named("trial")])
    if "form" in change:
        normal = at.normal
        turned = np.einsum("pij,pi,pj->p", change["form"], normal, normal)
        pushed = pushed + 0.5 * at.size * turned
    over = pushed - change[named("radius")]
    size = np.abs(law.two_mu[:, None] * change["strain"]).max()
    kept = np.where(np.abs(over) <= NEUTRAL * size, at.yields, over > 0)
    return np.where(law.close_to_yielding(at, BIACTIVE), kept, at.yields)


def _chosen_rows(found: TangentResult) -> LinearContact:
    """The status of the rows under the change; only biactive rows may change theirs.

    TangentError if a row with friction that comes into contact would slip: its derivative is not
    known.
    """
    contact = found.rows
    change = found.change
    rows, kinks, _ = found.biactive[-1]
    closed = contact.closed.copy()
    slips = contact.slips.copy()
    mu = contact.coefficient
    split = contact.law.split
    moved = contact.conditions.displacement
    normal, tangential = split(change["contact"])
    across, along = split(moved(change["u"]))
    least = -NEUTRAL * np.abs(normal).max(initial=0.0)
    moves = NEUTRAL * np.abs(change["u"]).max()
    apart = split(np.zeros_like(found.state.contact) + change["gaps"])[0] - across
    closed[rows] = np.where(closed[rows], normal[rows] >= least, apart[rows] < -moves)
    # Tresca friction acts without contact as well
    by_pressure = rows[~contact.law.given[rows]]
    slips[by_pressure] = (contact.trial > contact.bound)[by_pressure]
    over = (tangential * contact.along).sum(axis=1) - change["bound"] - mu * normal
    start = split(moved(np.zeros_like(change["u"]) + change["start"]))[1]
    way = ((along - start) * contact.along).sum(axis=1)
    slips[kinks] = np.where(slips[kinks], way[kinks] >= -moves, over[kinks] > -least)
    stuck = by_pressure[closed[by_pressure] & ~slips[by_pressure]]
    if (
        np.linalg.norm(tangential[stuck], axis=1) > mu[stuck] * normal[stuck] - least
    ).any():
        raise TangentError(
            "a contact row closes and slips at once, a derivative is not known: "
            + found.message
        )
    return LinearContact(found.state, closed, slips)
