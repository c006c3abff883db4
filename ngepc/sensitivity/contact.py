"""Contact and friction linearised at a solution, for a given status of each row.

For any stiffness k > 0 the forces of the rows satisfy x = P(x + k (R u - closed_at)), where P
projects normal forces onto n >= 0 and friction onto its bound b.  With the derivative G of P the
changes satisfy

    x' = G (x' + k (R u' - closed_at')) + a',

where a' is the change of the bound b, F' or mu' n, along the direction e of slip, for slipping
rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import diags

from ngepc.checks.sentences import counted
from ngepc.discretisation.rows import HELD
from ngepc.linalg.row_blocks import matrix_of_rows
from ngepc.local.system import State
from ngepc.sensitivity.equations import Tape

BIACTIVE = 1e-6  # relative tolerance within which rows and points count as biactive


class LinearContact:
    """The status of each row, by default that of the solution, and the matrices of the equations.

    For m rows and n forces: ``rows`` is R at the free components; ``slope`` is G, with ``blocks``
    for each row (m, 1 + d, 1 + d); ``pushed`` is - G k.
    """

    closed: np.ndarray  # boolean, shape (m,) like all except the direction
    with_friction: np.ndarray  # boolean: friction acts
    slips: np.ndarray  # boolean
    bound: np.ndarray  # b (force)
    trial: np.ndarray
    """|t + k slip| with the stiffness k of the row, more than b where it slips."""
    along: np.ndarray  # e, zero where it is undetermined, shape (m, d)
    grows: np.ndarray  # boolean: the bound is mu n
    coefficient: np.ndarray  # mu there

    def __init__(
        self,
        state: State,
        closed: np.ndarray | None = None,
        slips: np.ndarray | None = None,
    ) -> None:
        self.state = state
        self.conditions = state.discrete.contact
        self.law = self.conditions.friction
        self.stiffness = state.discrete.row_stiffness
        law = self.law
        tied = state.discrete.rows.tied
        m = len(state.multipliers)
        y = state.contact - self.stiffness * state.gaps
        y[:m], law.split(y)[1][tied] = state.multipliers, 0.0
        slipping, self.along, self.bound, self.trial = law.slipping(y)
        self.grows = law.grows(y[:m])
        self.coefficient = law.growth(y[:m])
        self.closed = (y[:m] > 0) | tied if closed is None else closed
        self.with_friction = law.with_friction(self.closed)
        self.slips = self.with_friction & (slipping if slips is None else slips)
        self.rows = self.conditions.matrix.copy()
        self.rows.data *= state.discrete.free.ravel()[self.rows.indices]
        self.rows.eliminate_zeros()
        movable = law.split(np.sqrt(self.rows.power(2).sum(axis=1)).A1 > HELD)
        self.blocks = (
            law.slope(y, self.closed, self.slips) * np.column_stack(movable)[:, :, None]
        )
        self.slope = matrix_of_rows(self.blocks)
        self.pushed = -self.slope @ diags(self.stiffness)

    def same_sides(self, other: LinearContact) -> bool:
        """Whether all rows have the same status in both."""
        return bool(((self.closed == other.closed) & (self.slips == other.slips)).all())

    def stacked(self, normal: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Normal parts n and tangential parts ``along`` e of the rows, in the order of x."""
        return np.append(normal, along[:, None] * self.along)

    def given(self) -> Tape:
        """Equations of "given" = a' - G k closed_at', (n,), from changes of data and supports.

        "bound" (m,) is the change of b for the same normal forces.
        """
        R = self.conditions
        pushed = self.pushed
        back = self.pushed.T.tocsr()
        tangential = diags(np.arange(len(R)) >= len(self.closed), dtype=float)
        e = np.where(self.slips[:, None], self.along, 0.0)
        split = self.law.split
        dragged = (
            lambda b: np.append(0 * b, b[:, None] * e),
            lambda w: (e * split(w)[1]).sum(1),
        )
        slipped = (
            lambda u: tangential @ R.displacement(u),
            lambda w: R.forces(tangential @ w),
        )
        moved = (lambda u: -R.displacement(u), lambda w: -R.forces(w))
        return Tape(
            [
                ("closed_at", "gaps", 1.0),
                ("closed_at", "start", slipped),
                ("closed_at", "values", moved),
                ("given", "closed_at", (pushed.dot, back.dot)),
                ("bound", "cap", 1.0 - self.grows),
                ("bound", "coefficient", self.grows * self.state.multipliers),
                ("given", "bound", dragged),
            ]
        )


class Biactive(NamedTuple):
    """The weakly active rows and points of a state, by their numbers.

    Up to a tolerance: ``rows`` of contact with lambda = 0 and no gap; ``kinks``, closed rows whose
    friction is at its bound without slip, or whose bound reaches its limit; ``points`` with
    |s| = beta.
    """

    rows: np.ndarray
    kinks: np.ndarray
    points: np.ndarray


def biactive_message(steps: Sequence[Biactive]) -> str:
    """The message about biactive rows and points of the steps; empty if there are none."""
    said = []
    for number, (rows, kinks, points) in enumerate(steps, 1):
        if len(rows) + len(kinks) + len(points):
            step = f"Step {number}: " if len(steps) > 1 else ""
            of_contact = counted(len(rows) + len(kinks), "contact row")
            said.append(
                f"{step}{of_contact} and {counted(len(points), 'point')} are biactive: there the "
                "solution has one-sided derivatives only; tangent(...) computes them for a given "
                "direction."
            )
    return " ".join(said)


def biactive_set(contact: LinearContact) -> Biactive:
    """Rows and points of a solution whose status an arbitrarily small change of data can change.

    A gap is compared with the largest displacement and gap; a contact force with the largest one
    and with the force by which the row's elastic stiffness resists that distance.
    """
    state = contact.state
    law = contact.law
    discrete = contact.state.discrete
    rows = discrete.rows
    forces = state.multipliers
    distance = BIACTIVE * max(np.abs(state.u).max(), np.abs(rows.gaps).max(initial=0.0))
    stiffness = rows.normal.power(2) @ discrete.stiffness_diagonal.ravel()
    largest = BIACTIVE * forces.max(initial=0.0)
    weak = forces <= np.minimum(largest, stiffness * distance)
    weak &= (state.open_gap <= distance) & ~rows.tied
    kinks = np.abs(contact.trial - contact.bound) <= BIACTIVE * contact.bound
    limited = np.isfinite(law.cap) & ~law.given
    at_limit = np.where(limited, law.coefficient, 0.0) * forces - law.cap
    change = np.abs(np.where(limited, at_limit, np.inf)) <= BIACTIVE * law.cap
    kinks |= contact.slips & change & limited
    kinks &= contact.with_friction & (contact.bound > 0) & (law.given | ~weak)
    close = discrete.law.close_to_yielding(state.at, BIACTIVE)
    return Biactive(*map(np.flatnonzero, (weak, kinks, close)))
