"""Contact and friction linearised at a solution, with rows that have taken their sides.

With any stiffness k > 0 the forces of the rows are x = P(x + k (R u - closed_at)), in which P lets
no row pull and shortens friction to its bound b.  Changes obey

    x' = G (x' + k (R u' - closed_at')) + F x' + a'

with G the identity for rows that are closed and those that stick, b/|y| (Id - e e') for those that
slip along e = y/|y|, y = t + k slip, and F x' + a' = b' e there, b' = F' or mu' n + mu n'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, diags

from ngepc.discretisation.rows import HELD
from ngepc.linalg.friction import orthogonal
from ngepc.local.system import State
from ngepc.sensitivity.radial import Data

TINY = float(np.finfo(float).tiny)
"""In place of zero in a denominator."""

BIACTIVE = 1e-6
"""Relative distance from the change of side within which a row or point counts as biactive."""


class RowSides:
    """Where the rows of a state are, and which side they take; no tangents without friction."""

    closed: np.ndarray  # boolean, shape (m,) as all but the direction
    slips: np.ndarray  # boolean
    bound: np.ndarray  # b (force)
    slip: np.ndarray  # its length
    trial: np.ndarray  # |t + k slip| with the stiffness k of the row, more than b where it slips
    along: np.ndarray  # e, zero where nothing is known of it, shape (m, d)
    grows: np.ndarray  # boolean: the bound is mu n
    coefficient: np.ndarray  # mu there

    def __init__(self, state: State) -> None:
        law, tied = state.discrete.contact.friction, state.discrete.rows.tied
        (n, t), (_, gaps) = law.split(state.contact), law.split(state.gaps)
        stiffness = law.split(state.discrete.row_stiffness)[1][:, :1]
        trial = np.where(tied[:, None], 0.0, t - stiffness * gaps)
        self.trial = np.linalg.norm(trial, axis=1)
        self.along = trial / np.where(self.trial > 0, self.trial, 1.0)[:, None]
        self.slip = np.maximum(-(self.along * gaps).sum(axis=1), 0.0)
        self.bound, self.grows = law.bound(n), law.coefficient * n < law.cap
        self.coefficient = np.where(self.grows, law.coefficient, 0.0)
        self.closed = (n > 0) | tied
        self.slips = self.trial > self.bound

    def stacked(self, normal: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Numbers n and t = along e of the rows, in the order of x."""
        return np.append(normal, along[:, None] * self.along)


class LinearContact:
    """The matrices of these equations for given sides, by default those of the solution, (n, n).

    ``rows`` is R at the free components; ``along`` projects onto what G keeps, ``kept`` are the
    eigenvalues of G there, ``follows`` is F.
    """

    def __init__(
        self, state: State, closed: np.ndarray | None = None, slips: np.ndarray | None = None
    ) -> None:
        self.sides, self.state = RowSides(state), state
        self.conditions, self.law = state.discrete.contact, state.discrete.contact.friction
        self.closed = self.sides.closed if closed is None else closed
        self.slips = self.closed & (self.sides.slips if slips is None else slips)
        self.stiffness = state.discrete.row_stiffness
        free = diags(state.discrete.free.ravel().astype(float))
        self.rows = (self.conditions.matrix @ free).tocsr()
        self.rows.eliminate_zeros()
        e, d = self.sides.along, self.law.d
        movable = np.sqrt(self.rows.power(2).sum(axis=1)).A1 > HELD  # not held by supports
        normal, tangents = self.law.split(movable)
        sticks = self.closed & ~self.slips & ~state.discrete.rows.tied
        kept = np.where(self.slips, self.sides.bound / np.maximum(self.sides.trial, TINY), sticks)
        across = np.where(self.slips[:, None, None], orthogonal(e), tangents[:, None] * np.eye(d))
        pressed = np.where(self.slips, self.sides.coefficient, 0.0)[:, None] * e
        self.kept = np.append(self.closed & normal, np.repeat(kept, d))
        m, size = len(e), (len(self.conditions),) * 2
        numbers, t = np.arange(m), m + np.arange(m * d).reshape(m, d)
        row, column = np.broadcast_arrays(t[:, :, None], t[:, None])
        where = np.append(numbers, row), np.append(numbers, column)
        self.along = csr_matrix((np.append(np.ones(m), across), where), shape=size)
        where = t.ravel(), np.repeat(numbers, d)
        self.follows = csr_matrix((pressed.ravel(), where), shape=size)

    def same_sides(self, other: LinearContact) -> bool:
        """Whether all rows take the same sides in both."""
        return bool(((self.closed == other.closed) & (self.slips == other.slips)).all())

    def growth(self, data: Data) -> np.ndarray:
        """The part of b' that data give, as if all rows slipped, shape (m,)."""
        n = self.state.multipliers
        return np.where(self.sides.grows, n * data["coefficient"], data["cap"])

    def given(self, data: Data, moved: np.ndarray) -> np.ndarray:
        """a' - k G (closed_at' - R moved) for a given part of the displacement, shape (n,)."""
        gaps, at_rest = np.zeros(len(self.closed)) + data["gaps"], np.zeros_like(moved)
        start = self.law.split(self.conditions.displacement(at_rest + data["start"]))[1]
        closed_at = np.append(gaps, start + data["origin"])
        growth = np.where(self.slips, self.growth(data), 0.0)
        pushed = self.sides.stacked(np.zeros_like(growth), growth)
        return pushed + self.by_closed_at @ (closed_at - self.conditions.displacement(moved))

    @cached_property
    def kept_part(self) -> csr_matrix:
        """G, shape (n, n)."""
        return diags(self.kept) @ self.along

    @cached_property
    def by_closed_at(self) -> csr_matrix:
        """- k G, shape (n, n)."""
        return diags(-self.stiffness) @ self.kept_part

    def slopes(self, w: np.ndarray) -> tuple[np.ndarray, Data]:
        """Derivatives by closed_at and by the data of contact from those by ``given``, (n,)."""
        zeta = self.by_closed_at.T @ w
        gaps, origin = self.law.split(zeta)
        on_bound = (self.law.split(w)[1] * self.sides.along).sum(axis=1)
        on_bound, grows = np.where(self.slips, on_bound, 0.0), self.sides.grows
        return zeta, Data(
            gaps=gaps,
            origin=origin,
            start=self.conditions.forces(np.append(np.zeros_like(gaps), origin)),
            cap=np.where(grows, 0.0, on_bound),
            coefficient=np.where(grows, self.state.multipliers, 0.0) * on_bound,
        )


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
        return (
            f"{len(self.rows) + len(self.kinks)} contact rows and {len(self.points)} points are "
            "biactive: there the solution has one-sided derivatives only, which tangent(...) "
            "gives for a direction."
        )


def told(steps: Sequence[Biactive]) -> str:
    """What is biactive, step by step; empty if nothing is."""
    if len(steps) == 1:
        return steps[0].message
    said = [f"Step {k}: {found.message}" for k, found in enumerate(steps, 1) if len(found)]
    return " ".join(said)


def biactive_set(state: State) -> Biactive:
    """Rows and points of a solution that an arbitrarily small change of data takes either way.

    A gap is compared with the largest displacement and gap, a contact force with the largest one
    and with the force that the row's elastic stiffness answers that distance with.
    """
    rows, law, sides = state.discrete.rows, state.discrete.contact.friction, RowSides(state)
    lengths = np.abs(state.u).max(), np.abs(rows.gaps).max(initial=0.0)
    distance = BIACTIVE * max(lengths)
    stiffness = rows.normal.power(2) @ state.discrete.stiffness_diagonal.ravel()
    largest = BIACTIVE * state.multipliers.max(initial=0.0)
    weak = state.multipliers <= np.minimum(largest, stiffness * distance)
    weak &= (state.open_gap <= distance) & ~rows.tied
    kinks = np.abs(sides.trial - sides.bound) <= BIACTIVE * sides.bound
    change = np.abs(law.coefficient * state.multipliers - law.cap) <= BIACTIVE * law.cap
    kinks |= sides.slips & change & np.isfinite(law.cap)
    kinks &= sides.closed & ~weak & (sides.bound > 0)
    beta = state.discrete.law.beta
    close = np.abs(state.at.size - beta) <= BIACTIVE * beta
    return Biactive(*map(np.flatnonzero, (weak, kinks, close)))
