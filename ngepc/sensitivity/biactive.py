"""Where a solution has no derivative: contact rows and points that are about to change side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ngepc.local.system import State
from ngepc.sensitivity.contact import RowSides

BIACTIVE = 1e-6
"""Relative distance from the change of side within which a row or point counts as biactive."""


@dataclass(frozen=True, eq=False)
class Biactive:
    """The weakly active rows and points of a state, by their numbers.

    ``rows`` of contact have lambda = 0 and no gap, up to the tolerance; ``kinks`` are closed rows
    where friction is at its bound without slip, or the bound changes its law; ``points`` are those
    with |s| = beta up to the tolerance.
    """

    rows: np.ndarray
    kinks: np.ndarray
    points: np.ndarray

    def __len__(self) -> int:
        return len(self.rows) + len(self.kinks) + len(self.points)

    @property
    def message(self) -> str:
        """A sentence about them, empty if there are none."""
        if not len(self):
            return ""
        rows = len(self.rows) + len(self.kinks)
        return (
            f"{rows} contact rows and {len(self.points)} points are biactive: there the "
            "solution has one-sided derivatives only, which tangent(...) gives for a direction."
        )


def told(steps: Sequence[Biactive]) -> str:
    """What is biactive, step by step; empty if nothing is."""
    said = [(number, found.message) for number, found in enumerate(steps, 1) if len(found)]
    if len(steps) == 1:
        return "".join(text for _, text in said)
    return " ".join(f"Step {number}: {text}" for number, text in said)


def biactive_set(state: State, tolerance: float = BIACTIVE) -> Biactive:
    """Rows and points of a solution that an arbitrarily small change of data takes either way.

    A gap is compared with the largest displacement and gap, a contact force with the largest one
    and with the force that the row's elastic stiffness answers that distance with.
    """
    rows, radial, at = state.discrete.rows, state.discrete.law, state.at
    weak = np.zeros(len(rows), dtype=bool)
    if len(rows):
        distance = tolerance * max(np.abs(state.u).max(), np.abs(rows.gaps).max())
        stiffness = rows.normal.power(2) @ state.discrete.stiffness_diagonal.ravel()
        force = np.minimum(tolerance * state.multipliers.max(), stiffness * distance)
        weak = (state.multipliers <= force) & (state.open_gap <= distance)
        weak &= ~rows.tied
    sides = RowSides(state)
    kinks = np.abs(sides.trial - sides.bound) <= tolerance * sides.bound
    if sides.rough:
        law = state.discrete.contact.friction
        change = np.abs(law.coefficient * state.multipliers - law.cap) <= tolerance * law.cap
        kinks |= sides.slips & change & np.isfinite(law.cap)
    kinks &= sides.closed & ~weak & (sides.bound > 0)
    close = np.abs(at.size - radial.beta) <= tolerance * radial.beta
    return Biactive(*map(np.flatnonzero, (weak, kinks, close)))
