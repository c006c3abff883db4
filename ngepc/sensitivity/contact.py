"""Contact and friction linearised at a solution, with rows that have taken their sides.

Changes of displacements and of the forces x = (n, t) of the rows obey

    n . u' = gap'                                           rows that are closed,
    T u' = u_0'                                             those that stick,
    t' = b' e + (b/|slip|) (Id - e e') (T u' - u_0')        those that slip,

with e the direction of the slip and b' = F', or mu' n + mu n'.  With the forces y of the rows left,
x' = E y + e b'_0 and Q' (R u' - closed_at') = D y, in which R is the matrix of all rows.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from ngepc.discretisation.rows import HELD
from ngepc.local.system import State
from ngepc.sensitivity.radial import Data


class RowSides:
    """Where the rows of a state are, and which side they take.

    Attributes
    ----------
    bound, slip, trial
        b (force), |slip| (length) and |t + k slip| with the stiffness k of the row (force), more
        than b where it slips, shape (m,).
    along
        e, zero where nothing is known of it, shape (m, N - 1).
    grows, coefficient
        Whether the bound is mu n, and mu there, shape (m,).
    closed, slips
        Boolean, shape (m,): the sides of the solution.
    """

    def __init__(self, state: State) -> None:
        conditions, rows = state.discrete.contact, state.discrete.rows
        law, m, d = conditions.friction, *state.slip.shape
        self.closed = (state.multipliers > 0) | rows.tied
        self.bound, self.rough = conditions.bound(state.contact), law.d > 0
        trial, self.coefficient = np.zeros((m, d)), np.zeros(m)
        self.grows = np.zeros(m, dtype=bool)
        if self.rough:
            stiffness = state.discrete.row_stiffness[m:].reshape(m, d)[:, :1]
            trial = state.tangential_forces + stiffness * state.slip
            trial[rows.tied] = 0.0
            self.grows = law.coefficient * state.multipliers < law.cap
            self.coefficient = np.where(self.grows, law.coefficient, 0.0)
        self.trial = np.linalg.norm(trial, axis=1)
        self.along = trial / np.where(self.trial > 0, self.trial, 1.0)[:, None]
        self.slip = np.maximum((self.along * state.slip).sum(axis=1), 0.0)
        self.slips = ~rows.tied & (self.trial > self.bound)

    def stacked(self, normal: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Numbers n and t = along e of the rows, in the order of x."""
        if not self.rough:
            return normal
        return np.concatenate([normal, (along[:, None] * self.along).ravel()])


class LinearContact:
    """The equations above for given sides, by default those of the solution.

    Attributes
    ----------
    rows, forces
        Q' R and E' R at the free components, sparse, shape (k, nodes N): the second balances y,
        another one for Coulomb's law.
    soft
        D (length per force), shape (k,).
    symmetric
        Whether both are the same.
    """

    def __init__(
        self, state: State, closed: np.ndarray | None = None, slips: np.ndarray | None = None
    ) -> None:
        self.sides, self.state = RowSides(state), state
        self.conditions = state.discrete.contact
        self.closed = self.sides.closed if closed is None else closed
        self.slips = self.closed & (self.sides.slips if slips is None else slips)
        self._free = diags(state.discrete.free.ravel().astype(float)).tocsr()
        chosen, soft = self._chosen()
        kept = np.sqrt(self._on_free(chosen).power(2).sum(axis=1)).A1 > HELD  # not by supports
        given, self.symmetric = self._given(chosen)
        self.chosen, self.given, self.soft = chosen[:, kept], given[:, kept], soft[kept]
        self.rows = self._on_free(self.chosen)
        self.forces = self.rows if self.symmetric else self._on_free(self.given)

    def _on_free(self, columns: csr_matrix) -> csr_matrix:
        result = (columns.T @ self.conditions.matrix @ self._free).tocsr()
        result.eliminate_zeros()
        return result

    def _given(self, chosen: csr_matrix) -> tuple[csr_matrix, bool]:
        """E: Q, and the friction that follows the normal forces; whether there is none."""
        follows = np.where(self.slips, self.sides.coefficient, 0.0)[:, None] * self.sides.along
        pressed, (m, d) = follows[self.closed], follows.shape
        column, axis = np.nonzero(pressed)
        row = m + d * np.flatnonzero(self.closed)[column] + axis
        more = csr_matrix((pressed[column, axis], (row, column)), shape=chosen.shape)
        return chosen + more, not len(row)

    def _chosen(self) -> tuple[csr_matrix, np.ndarray]:
        """Q and D: normals of closed rows, tangents that stick, those across a slip."""
        m, d = self.sides.along.shape
        pressed = np.flatnonzero(self.closed)
        at, to = [pressed], [np.arange(len(pressed))]
        values, soft = [np.ones(len(pressed))], [np.zeros(len(pressed))]
        if self.sides.rough:
            frames = frames_along(self.sides.along)
            bound, slip = self.sides.bound, np.where(self.slips, self.sides.slip, 0.0)
            kept = np.repeat((self.closed & ~self.slips)[:, None], d, axis=1)
            kept[:, 1:] |= (self.slips & (bound > 0))[:, None]
            row, axis = np.nonzero(kept & ~self.state.discrete.rows.tied[:, None])
            at.append((m + d * row[:, None] + np.arange(d)).ravel())
            to.append(np.repeat(len(pressed) + np.arange(len(row)), d))
            values.append(frames[row, axis].ravel())
            soft.append(slip[row] / np.where(bound[row] > 0, bound[row], 1.0))
        soft = np.concatenate(soft)
        entries = np.concatenate(values), (np.concatenate(at), np.concatenate(to))
        return csr_matrix(entries, shape=(len(self.conditions), len(soft))), soft

    @property
    def gripped(self) -> np.ndarray:
        """The springs of ``ContactConditions.grip`` in the tangent, shape (k,)."""
        return self.chosen.T @ self.conditions.springs(self.state.discrete.row_stiffness)

    def growth(self, data: Data) -> np.ndarray:
        """b'_0 of the rows, as if all slipped, shape (m,)."""
        n, grows = self.state.multipliers, self.sides.grows
        return np.where(grows, n * data.get("coefficient", 0.0), data.get("cap", 0.0))

    def same_sides(self, other: LinearContact) -> bool:
        """Whether all rows take the same sides in both."""
        return bool(((self.closed == other.closed) & (self.slips == other.slips)).all())

    def slopes(self, zeta: np.ndarray, on_forces: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives by the data of contact from those by closed_at and by given x, (n,)."""
        sides, found = self.sides, {"gaps": self.conditions.normal(zeta)}
        if sides.rough:
            origin = self.conditions.tangential(zeta)
            on_bound = (self.conditions.tangential(on_forces) * sides.along).sum(axis=1)
            on_bound = np.where(self.slips, on_bound, 0.0)
            found |= {
                "origin": origin,
                "start": self.state.discrete.rows.friction_forces(origin),
                "cap": np.where(sides.grows, 0.0, on_bound),
                "coefficient": np.where(sides.grows, self.state.multipliers, 0.0) * on_bound,
            }
        return found

    def pushed(self, data: Data) -> np.ndarray:
        """e b'_0 in the order of x, shape (n,)."""
        growth = np.where(self.slips, self.growth(data), 0.0)
        return self.sides.stacked(np.zeros_like(growth), growth)

    def shift(self, data: Data, moved: np.ndarray) -> np.ndarray:
        """Q' (closed_at' - R moved) for a given part of the displacement, shape (k,)."""
        rows = self.state.discrete.rows
        start = np.zeros_like(self.state.u) + data.get("start", 0.0)
        shift = np.zeros(len(rows)) + data.get("gaps", 0.0)
        if self.sides.rough:
            shift = np.concatenate([shift, (rows.slip(start) + data.get("origin", 0.0)).ravel()])
        return self.chosen.T @ (shift - self.conditions.displacement(moved))


def frames_along(along: np.ndarray) -> np.ndarray:
    """Orthonormal frames (m, d, d) of the tangents whose first vectors are ``along``."""
    if along.shape[1] == 1:
        return np.ones((len(along), 1, 1))
    first = np.where(along.any(axis=1)[:, None], along, [1.0, 0.0])
    return np.stack([first, np.stack([-first[:, 1], first[:, 0]], axis=1)], axis=1)
