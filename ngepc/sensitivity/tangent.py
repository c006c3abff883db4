"""Directional derivatives of solutions, step by step, one-sided where they are biactive.

In a direction the biactive rows and points choose their side: the derivative of the solution has

    N u' <= gaps',  lambda' >= 0  with equality in one of them    for biactive rows,
    p' = [s' . s/|s| - beta']_+ / (2 mu_2 + h) s/|s|              for biactive points,

and rows where friction is at its bound without slip stick or slip.  Without friction it is the
minimiser of a strictly convex, piecewise quadratic energy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import GridFunction

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_mapping
from ngepc.local.system import State
from ngepc.sensitivity.contact import Biactive, LinearContact, biactive_set, told
from ngepc.sensitivity.functionals import Form, Functional, as_functional
from ngepc.sensitivity.gradient import Solution, states_of
from ngepc.sensitivity.linear import LinearStep, TangentError
from ngepc.sensitivity.parameters import Direction, changed_data, directions
from ngepc.sensitivity.radial import Data, RadialDerivative
from ngepc.sensitivity.shape import by_the_mesh

EXCHANGES = 50
"""Most exchanges of sides."""

NEUTRAL = 1e-9
"""Relative change below which either side is right: a body that waits stays on its yield bound."""


@dataclass(frozen=True, eq=False)
class TangentResult:
    """The derivative of a solution in one direction.

    Parameters
    ----------
    state, rows
        The solution with the sides that biactive points (``state.at.yields``) and rows take.
    change
        Name -> change: "u" of nodal displacements (nodes, N), "contact" of the forces of contact
        and friction, "p" and "stress" of the plastic strain and the deviatoric stress at the
        points (points, d), "mean" of the mean stress (points,), and those of the data.
    biactive
        The rows and points that chose their side, in this time step and those before.
    """

    state: State
    rows: LinearContact
    change: Data
    biactive: tuple[Biactive, ...]

    @property
    def message(self) -> str:
        """What is one-sided; empty where the solution is differentiable."""
        return told(self.biactive)

    @property
    def displacement(self) -> GridFunction:
        """The change of u."""
        return self.state.discrete.supports.function(self.change["u"], "displacement_change")

    @property
    def contact_force(self) -> float:
        """The change of the resultant contact force."""
        return self.of("contact_force")

    def of(self, functional: str | Form | Functional) -> float:
        """The derivative of a functional, see ``gradient``."""
        functional = as_functional(functional)
        by = functional.slope(self.state).by
        explicit = by_the_mesh(functional, self.state, self.change)
        return by.paired(self.change, self.state.discrete.points) + explicit


Rates = str | Mapping[str, float | tuple[float, Direction]]
"""Name of a datum, or name -> rate: {"gap": -1.0, "hardening": 5.0}, or -> (rate, Direction)."""


def tangent(result: Solution, parameters: Rates) -> TangentResult:
    """The derivative of the solution in a direction; at biactive solutions the one-sided one.

    Parameters
    ----------
    result
        A converged result of ``semismooth_newton`` without gamma, or of ``evolve``, of which the
        derivative of the last step is returned.
    parameters
        The name of a datum, or name -> rate, or name -> (rate, Direction), then the name is free.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or the problem lacks such data.
    SolverError
        If the result is not that of a converged run.
    TangentError
        If the tangent is singular, or the sides of biactive rows and points were not found.
    """
    states = (give_state() for give_state in states_of(result))
    rates = {parameters: 1.0} if isinstance(parameters, str) else parameters
    require_mapping("parameters", rates, "the name of a datum, or name -> rate")
    return tangents_at(states, rates)[-1]


def tangents_at(states: Iterable[State], rates: Mapping) -> list[TangentResult]:
    """The derivatives of the solutions of time steps, in time."""
    pairs = {n: r if isinstance(r, tuple) else (r, Direction(n)) for n, r in rates.items()}
    wanted = directions({name: direction for name, (_, direction) in pairs.items()})
    numbers = {name: require_number(f"parameters[{name!r}]", r) for name, (r, _) in pairs.items()}
    found: list[TangentResult] = []
    data = Data()
    for state in states:
        for name, direction in wanted.items():
            if not (found and direction.inherited):
                data += numbers[name] * changed_data(state, direction)
        found.append(change_of(state, data, found[-1].biactive if found else ()))
        data = RadialDerivative(found[-1].state).left(found[-1].change)
    return found


def change_of(state: State, data: Data, before: tuple[Biactive, ...]) -> TangentResult:
    """The derivative of a solution for a change of its data, with sides that fit.

    Newton's method for the convex energy of the change, which is quadratic for given sides.
    """
    biactive, contact = (*before, biactive_set(state)), LinearContact(state)
    for _ in range(EXCHANGES):
        change = LinearStep(state, contact).forward(data)
        found = TangentResult(state, contact, change, biactive)
        chosen, yields = chosen_rows(found), chosen_points(found)
        if chosen.same_sides(contact) and (yields == state.at.yields).all():
            return found
        contact, state = chosen, replace(state, at=replace(state.at, yields=yields))
    raise TangentError(f"the sides of biactive rows and points did not settle: {found.message}")


def chosen_rows(found: TangentResult) -> LinearContact:
    """The sides that the change asks for: biactive rows may change theirs.

    TangentError if a row that comes into contact would slip from where it is: no derivative is
    known then.
    """
    contact, change, biactive = found.rows, found.change, found.biactive[-1]
    rows, kinks, sides = biactive.rows, biactive.kinks, contact.sides
    closed, slips = contact.closed.copy(), contact.slips.copy()
    split, moved = contact.law.split, contact.conditions.displacement
    (normal, tangential), (across, along) = split(change["contact"]), split(moved(change["u"]))
    least = -NEUTRAL * np.abs(normal).max(initial=0.0)
    moves = NEUTRAL * np.abs(change["u"]).max()
    apart = change["gaps"] - across
    closed[rows] = np.where(closed[rows], normal[rows] >= least, apart[rows] < -moves)
    slips[rows] = sides.slips[rows]
    over = (tangential * sides.along).sum(axis=1)
    over -= contact.growth(change) + sides.coefficient * normal
    start = split(moved(np.zeros_like(change["u"]) + change["start"]))[1]
    way = ((along - start) * sides.along).sum(axis=1)
    slips[kinks] = np.where(slips[kinks], way[kinks] >= -moves, over[kinks] > -least)
    stuck = rows[closed[rows] & ~slips[rows]]
    limit = sides.coefficient[stuck] * normal[stuck]
    if (np.linalg.norm(tangential[stuck], axis=1) > limit - least).any():
        raise TangentError("a row that comes into contact slips from rest: " + found.message)
    return LinearContact(found.state, closed, slips)


def chosen_points(found: TangentResult) -> np.ndarray:
    """The yielding points that the change asks for: biactive ones may change side."""
    yields, points = found.state.at.yields.copy(), found.biactive[-1].points
    over, size = RadialDerivative(found.state).overshoot(found.change["u"], found.change)
    neutral = np.abs(over) <= NEUTRAL * size
    yields[points] = np.where(neutral, yields, over > 0)[points]
    return yields
