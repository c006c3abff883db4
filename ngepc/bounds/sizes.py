"""Refusal of problems whose numbers are so large or small that floating-point numbers lose them.

Bounds have squares and third powers of stresses, forces and energies.  Third powers of numbers
below 1e-107 are zero, those of numbers above 1e102 are infinite: a bound would prove nothing.
"""

from __future__ import annotations

import math

import numpy as np

from ngepc.discretisation.body import DiscreteBody
from ngepc.local.system import State
from ngepc.model.elements import vertex_coordinates

LEAST = 1e-100
MOST = 1e100
"""Numbers that bounds can compute with."""


def check_sizes(state: State) -> None:
    """Refuse states and data that are too large or too small, with a ValueError."""
    discrete = state.discrete
    problem = discrete.problem
    length = float(np.ptp(vertex_coordinates(problem.mesh), axis=0).max())
    moved = float(np.abs(state.u).max(initial=0.0))
    moduli = discrete.law.two_mu
    stiff = float(moduli.max()) * length ** (problem.N - 2)
    loaded = float(np.abs(discrete.load).max(initial=0.0))
    if moved < LEAST and nothing_moves(discrete):
        moved = 0.0
    found = {
        "the least shear modulus": float(moduli.min()) / 2,
        "the largest shear modulus": float(moduli.max()) / 2,
        "the volume of the body": length**problem.N,
        "the largest force at a node": loaded,
        "the largest displacement": moved,
        "stiffness times displacement": stiff * moved,
        "stiffness times the square of the displacement": stiff * moved**2,
    }
    for name, value in found.items():
        if value == 0 and (name.startswith("the largest") or moved == 0):
            continue
        if not LEAST <= value <= MOST:
            raise ValueError(
                f"{name} is {value:.1e}: a bound needs numbers between {LEAST:g} and {MOST:g}, "
                "as powers of others are zero or infinite in computers (other units may help)"
            )


def nothing_moves(discrete: DiscreteBody) -> bool:
    """Whether nothing moves a body: its displacement is zero, and what was computed is rounding."""
    problem = discrete.problem
    strained = (
        problem.initial_strain is not None or problem.initial_plastic_strain is not None
    )
    moved = discrete.load.any() or discrete.supports.values.any()
    rows = discrete.rows
    pressed = np.where(rows.tied, rows.gaps != 0, rows.gaps < 0).any()
    return not (strained or moved or pressed)


def power_of_two(value: float) -> float:
    """The largest power of two that is not above a positive number; one for zero."""
    return math.ldexp(0.5, math.frexp(value)[1]) if value else 1.0
