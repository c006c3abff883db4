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
from ngepc.local.factors import TangentError
from ngepc.local.system import State
from ngepc.sensitivity.biactive import Biactive, biactive_set, told
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.forms import Form, as_functional
from ngepc.sensitivity.functionals import Functional
from ngepc.sensitivity.held import HeldSystem
from ngepc.sensitivity.parameters import Constants, Direction, changed_data, directions
from ngepc.sensitivity.radial import Data, RadialDerivative, paired, summed
from ngepc.sensitivity.shape import MovingBody
from ngepc.sensitivity.states import Solution, states_of

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
    data
        The change of the discrete data.
    u, contact
        The changes of nodal displacements (nodes, N) and of the forces of contact and friction.
    plastic_strain, stress, mean
        The changes of p, of the deviatoric stress (points, d) and of the mean stress (points,).
    biactive, before
        The rows and points that chose their side, and those of the time steps before.
    """

    state: State
    rows: LinearContact
    data: Data
    u: np.ndarray
    contact: np.ndarray
    plastic_strain: np.ndarray
    stress: np.ndarray
    mean: np.ndarray
    biactive: Biactive
    before: tuple[Biactive, ...] = ()

    @property
    def message(self) -> str:
        """What is one-sided; empty where the solution is differentiable."""
        return told((*self.before, self.biactive))

    @property
    def displacement(self) -> GridFunction:
        """The change of u."""
        return self.state.discrete.supports.function(self.u, "displacement_change")

    @property
    def contact_force(self) -> float:
        """The change of the resultant contact force."""
        return self.of("contact_force")

    def of(self, functional: str | Form | Functional) -> float:
        """The derivative of a functional, see ``gradient``."""
        functional, points = as_functional(functional), self.state.discrete.points
        slope = functional.slope(self.state)
        result = slope.of_points(self.state, self.plastic_strain, self.stress, self.mean)
        result += float(np.sum(slope.u * self.u) + np.sum(slope.contact * self.contact))
        if "shape" in self.data:
            moving = MovingBody(self.state, self.data["shape"])
            result += moving.explicit(functional, moving.data())
        return result + paired(points, slope.explicit, self.data)


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
    found: list[TangentResult] = []
    memory: Data = {}
    for number, state in enumerate(states):
        constants = Constants(state)
        data = summed(total_change(constants, rates, number == 0), memory)
        data["beta"] = data.get("beta", 0.0) + constants.memory * data.pop("alpha_1", 0.0)
        before = tuple(step.biactive for step in found)
        found.append(replace(change_of(state, data), before=before))
        memory = left_behind(found[-1], constants, memory)
    return found


def change_of(state: State, data: Data) -> TangentResult:
    """The derivative of a solution for a change of its data, with sides that fit.

    Newton's method for the convex energy of the change, which is quadratic for given sides.
    """
    biactive, contact = biactive_set(state), LinearContact(state)
    for _ in range(EXCHANGES):
        found = change_with_sides(state, contact, data, biactive)
        chosen, yields = chosen_rows(found), chosen_points(found)
        if chosen.same_sides(contact) and (yields == state.at.yields).all():
            return found
        contact, state = chosen, replace(state, at=replace(state.at, yields=yields))
    raise TangentError(f"the sides of biactive rows and points did not settle: {biactive.message}")


def left_behind(found: TangentResult, constants: Constants, memory: Data) -> Data:
    """The change of p_0, dev alpha_2, alpha_1 and u_0 that a step leaves to the next one."""
    at, data, p = found.state.at, found.data, found.plastic_strain
    back = np.reshape(data.get("kinematic", 0.0), (-1, 1)) * at.plastic_strain
    scalar = data.get("isotropic", 0.0) * at.gained
    return {
        "initial": data.get("initial", 0.0) + p,
        "back": data.get("back", 0.0) + constants.k[:, None] * p + back,
        "alpha_1": memory.get("alpha_1", 0.0)
        + constants.growth * np.einsum("pd,pd->p", at.direction, p)
        + scalar,
        "start": found.u,
    }


def total_change(constants: Constants, rates: Mapping, first: bool) -> dict[str, np.ndarray]:
    """The change of the discrete data with the rates of several parameters, in one time step."""
    pairs = {n: r if isinstance(r, tuple) else (r, Direction(n)) for n, r in rates.items()}
    total: Data = {}
    for name, direction in directions({n: d for n, (_, d) in pairs.items()}).items():
        rate = require_number(f"parameters[{name!r}]", pairs[name][0])
        if first or not direction.inherited:
            change = changed_data(constants, direction)
            total = summed(total, {key: rate * value for key, value in change.items()})
    return total


def change_with_sides(
    state: State, contact: LinearContact, data: Data, biactive: Biactive
) -> TangentResult:
    """The change with given sides: those of ``contact``, and points where ``state.at.yields``."""
    discrete, radial = state.discrete, RadialDerivative(state)
    moved = np.zeros_like(state.u) + data.get("values", 0.0)
    _, stress, mean = radial.forward(moved, data)
    pushed = contact.pushed(data)
    force = data.get("load", 0.0) - discrete.points.forces(mean, stress)
    force = force - discrete.contact.forces(pushed)
    u, y = HeldSystem(state, contact).solve(force, contact.shift(data, moved))
    u, x = u + moved, contact.given @ y + pushed
    return TangentResult(state, contact, data, u, x, *radial.forward(u, data), biactive)


def chosen_rows(found: TangentResult) -> LinearContact:
    """The sides that the change asks for: biactive rows may change theirs.

    TangentError if a row that comes into contact would slip from where it is: no derivative is
    known then.
    """
    contact, rows, data = found.rows, found.biactive.rows, found.data
    conditions, start = found.state.discrete.contact, found.state.discrete.rows.slip
    closed, slips, sides = contact.closed.copy(), contact.slips.copy(), contact.sides
    normal = conditions.normal(found.contact)
    apart = data.get("gaps", 0.0) - found.state.discrete.rows.normal @ found.u.ravel()
    least = -NEUTRAL * np.abs(normal).max(initial=0.0)
    moves = NEUTRAL * np.abs(found.u).max()
    closed[rows] = np.where(closed[rows], normal[rows] >= least, apart[rows] < -moves)
    slips[rows] = sides.slips[rows]
    if sides.rough:
        kinks = found.biactive.kinks
        tangential = conditions.tangential(found.contact)
        over = (tangential * sides.along).sum(axis=1)
        over -= contact.growth(data) + sides.coefficient * normal
        way = (start(found.u - data.get("start", 0.0)) * sides.along).sum(axis=1)
        slips[kinks] = np.where(slips[kinks], way[kinks] >= -moves, over[kinks] > -least)
        stuck = rows[closed[rows] & ~slips[rows]]
        limit = sides.coefficient[stuck] * normal[stuck]
        if (np.linalg.norm(tangential[stuck], axis=1) > limit - least).any():
            raise TangentError("a row that comes into contact slips from rest: " + found.message)
    return LinearContact(found.state, closed, slips)


def chosen_points(found: TangentResult) -> np.ndarray:
    """The yielding points that the change asks for: biactive ones may change side."""
    yields, radial = found.state.at.yields.copy(), RadialDerivative(found.state)
    _, e = radial.strain(found.u, found.data)
    over = radial.overshoot(e, found.data)
    neutral = np.abs(over) <= NEUTRAL * np.abs(radial.two_mu * e).max()
    points = found.biactive.points
    yields[points] = np.where(neutral, yields, over > 0)[points]
    return yields
