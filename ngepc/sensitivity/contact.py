"""Contact and friction linearised at a solution, with rows that have taken their sides.

Changes of displacements and of the forces x = (n, t) of the rows obey

    n . u' = gap'                                           rows that are closed,
    T u' = u_0'                                             those that stick,
    t' = b' e + (b/|slip|) (Id - e e') (T u' - u_0')        those that slip,

with e the direction of the slip and b' = F', or mu' n + mu n'.  With the forces y of the rows left,
x' = E y + e b'_0 and Q' (R u' - closed_at') = D y, in which R is the matrix of all rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags

from ngepc.discretisation.rows import HELD
from ngepc.local.system import State
from ngepc.sensitivity.radial import Data

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
    """The equations above for given sides, by default those of the solution.

    ``chosen`` and ``given`` are Q and E; ``rows`` and ``forces`` are Q' R and E' R at the free
    components, sparse, shape (k, nodes N): the second balances y, another one for Coulomb's law.
    ``soft`` is D (length per force), shape (k,).
    """

    def __init__(
        self, state: State, closed: np.ndarray | None = None, slips: np.ndarray | None = None
    ) -> None:
        self.sides, self.state = RowSides(state), state
        self.conditions, self.law = state.discrete.contact, state.discrete.contact.friction
        self.closed = self.sides.closed if closed is None else closed
        self.slips = self.closed & (self.sides.slips if slips is None else slips)
        turned, kept, soft = self._turned(), self._kept(), self._softness()
        movable = self.conditions.matrix @ diags(state.discrete.free.ravel().astype(float))
        movable.eliminate_zeros()
        rows = (turned.T @ movable).tocsr()
        kept &= np.sqrt(rows.power(2).sum(axis=1)).A1 > HELD  # not by supports
        follows = self._following()
        self.symmetric = not follows.nnz
        self.chosen, self.soft = turned[:, kept], soft[kept]
        self.given = self.chosen + follows @ self.chosen
        self.rows = self.forces = rows[kept]
        if not self.symmetric:
            self.forces = (self.given.T @ movable).tocsr()

    @property
    def _tangents(self) -> np.ndarray:
        """Their numbers in x, shape (m, d)."""
        m, d = self.sides.along.shape
        return m + np.arange(m * d).reshape(m, d)

    def _turned(self) -> csr_matrix:
        """Normals, and orthonormal tangents that begin with e, in the order of x, (n, n)."""
        frames, tangents = frames_along(self.sides.along), self._tangents
        m, (to, at) = len(tangents), np.broadcast_arrays(tangents[:, :, None], tangents[:, None])
        values = np.append(np.ones(m), frames)
        where = np.append(np.arange(m), at), np.append(np.arange(m), to)
        return csr_matrix((values, where), shape=(len(self.conditions),) * 2)

    def _kept(self) -> np.ndarray:
        """Which of them have equations: normals of closed rows, tangents that stick or bend."""
        sticks = self.closed & ~self.slips & ~self.state.discrete.rows.tied
        tangents = np.repeat(sticks[:, None], self.law.d, axis=1)
        tangents[:, 1:] |= (self.slips & (self.sides.bound > 0))[:, None]
        return np.append(self.closed, tangents)

    def _softness(self) -> np.ndarray:
        """|slip| / b of tangents across a slip, else 0, shape (n,)."""
        bound, slip = self.sides.bound, np.where(self.slips, self.sides.slip, 0.0)
        each = slip / np.where(bound > 0, bound, 1.0)
        return np.append(np.zeros(len(each)), np.repeat(each, self.law.d))

    def _following(self) -> csr_matrix:
        """The friction of rows that slip, per normal force, shape (n, n)."""
        follows = np.where(self.slips, self.sides.coefficient, 0.0)[:, None] * self.sides.along
        row, _ = np.nonzero(follows)
        where = self._tangents[follows != 0], row
        return csr_matrix((follows[follows != 0], where), shape=(len(self.conditions),) * 2)

    @property
    def gripped(self) -> np.ndarray:
        """The springs of ``ContactConditions.grip`` in the tangent, shape (k,)."""
        return self.chosen.T @ self.conditions.springs(self.state.discrete.row_stiffness)

    def growth(self, data: Data) -> np.ndarray:
        """b'_0 of the rows, as if all slipped, shape (m,)."""
        n = self.state.multipliers
        return np.where(self.sides.grows, n * data["coefficient"], data["cap"])

    def same_sides(self, other: LinearContact) -> bool:
        """Whether all rows take the same sides in both."""
        return bool(((self.closed == other.closed) & (self.slips == other.slips)).all())

    def pushed(self, data: Data) -> np.ndarray:
        """e b'_0 in the order of x, shape (n,)."""
        growth = np.where(self.slips, self.growth(data), 0.0)
        return self.sides.stacked(np.zeros_like(growth), growth)

    def shift(self, data: Data, moved: np.ndarray) -> np.ndarray:
        """Q' (closed_at' - R moved) for a given part of the displacement, shape (k,)."""
        gaps, at_rest = np.zeros(len(self.closed)) + data["gaps"], np.zeros_like(moved)
        start = self.law.split(self.conditions.displacement(at_rest + data["start"]))[1]
        closed_at = np.append(gaps, start + data["origin"])
        return self.chosen.T @ (closed_at - self.conditions.displacement(moved))

    def slopes(self, zeta: np.ndarray, on_forces: np.ndarray) -> Data:
        """Derivatives by the data of contact from those by closed_at and by given x, (n,)."""
        gaps, origin = self.law.split(zeta)
        on_bound = (self.law.split(on_forces)[1] * self.sides.along).sum(axis=1)
        on_bound, grows = np.where(self.slips, on_bound, 0.0), self.sides.grows
        return Data(
            gaps=gaps,
            origin=origin,
            start=self.conditions.forces(np.append(np.zeros_like(gaps), origin)),
            cap=np.where(grows, 0.0, on_bound),
            coefficient=np.where(grows, self.state.multipliers, 0.0) * on_bound,
        )


def frames_along(along: np.ndarray) -> np.ndarray:
    """Orthonormal frames (m, d, d) of the tangents whose first vectors are ``along``."""
    m, d = along.shape
    if d < 2:
        return np.ones((m, d, d))
    first = np.where(along.any(axis=1)[:, None], along, [1.0, 0.0])
    return np.stack([first, np.stack([-first[:, 1], first[:, 0]], axis=1)], axis=1)


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
