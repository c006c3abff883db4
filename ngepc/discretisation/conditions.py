"""The conditions of contact and friction between nodal displacements and the forces of rows.

The forces x of the rows stand one after the other: the normal forces n of all rows, with friction
then the tangential forces t.  R maps displacements to the normal displacements N u and, with
friction, to the tangential ones; the gaps are what it leaves open, (gaps - N u, slip origin - T u).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import H1, GridFunction
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.linalg import spsolve

from ngepc.checks.arguments import Coefficient
from ngepc.discretisation.loads import Supports, nodal
from ngepc.discretisation.mortar import mortar_rows
from ngepc.discretisation.rollers import roller_rows
from ngepc.discretisation.rows import ContactRows, contact_rows, joined
from ngepc.linalg.friction import FrictionCone
from ngepc.model.contact import Coulomb
from ngepc.model.places import Place
from ngepc.model.problem import Problem, as_scalar
from ngepc.model.processes import Team

STEEPEST = 100.0
"""Friction with a given bound is at most so many times the normal force.

Without it friction would jump to its bound when a row closes; the little normal force that it
itself causes could then open and close a row at the edge of contact for ever.
"""

GRIP = 1e2
"""Stiffness of the springs that hold rollers in the tangent, relative to that of the node."""


class ContactConditions:
    """Rows, their law and their matrix."""

    rows: ContactRows  # of rigid obstacles, of pairs, of rollers
    on_obstacles: slice  # the rows of rigid obstacles
    roller_part: slice  # the rows of rollers
    rollers: dict[Place, slice]  # place of each roller -> its rows
    friction: FrictionCone  # the law of the forces, without tangents where there is no friction
    processes: Team  # share the body; rows at common vertices are on all that have the vertex
    own: slice | np.ndarray  # what selects the forces of rows that this process answers for
    matrix: csr_matrix  # R, shape (n, nodes N), n = m without friction and m N with it

    def __init__(self, problem: Problem, supports: Supports) -> None:
        pairs = [mortar_rows(problem, supports, pair) for pair in problem.contact_pairs]
        rollers = roller_rows(problem, supports)
        parts = [contact_rows(problem, supports), *pairs, *rollers.values()]
        rows = self.rows = joined(parts)
        self.on_obstacles = slice(0, len(parts[0]))
        ends = np.cumsum([0, *map(len, parts)])[1 + len(pairs) :].tolist()
        self.roller_part = slice(ends[0], len(rows))
        self.rollers = {p: slice(*ends[k : k + 2]) for k, p in enumerate(rollers)}
        self.friction, self.processes = friction_cone(problem, rows), problem.processes
        self._own_rows = self.processes.owned(rows.vertices)
        tangents = np.repeat(rows.vertices, self.friction.d)
        self.own = self.processes.owned(np.append(rows.vertices, tangents))
        self.matrix, self._closed_at = rows.normal, rows.gaps
        if self.friction.d:
            self.matrix = vstack([rows.normal, rows.tangential], format="csr")
            origin = rows.slip(initial_displacements(problem, supports))
            self._closed_at = np.concatenate([rows.gaps, origin.ravel()])

    def __len__(self) -> int:
        return len(self._closed_at)

    @property
    def N(self) -> int:
        """Components of a displacement."""
        return self.rows.normals.shape[1]

    @property
    def unsolvable(self) -> str:
        """Why there may be no solution."""
        if not self.friction.d:
            return "the contact conditions of neighbouring nodes are dependent"
        return (
            "contact with friction was not solved: for a large coefficient there may be no solution"
            " or several; try a smaller load step"
        )

    @cached_property
    def _transposed(self) -> csr_matrix:
        return self.matrix.T.tocsr()

    def displacement(self, u: np.ndarray) -> np.ndarray:
        """R u for nodal displacements (nodes, N)."""
        return self.matrix @ u.ravel()

    def gaps(self, u: np.ndarray) -> np.ndarray:
        """Open gaps, negative where penetrated, with friction then minus the slip, shape (n,)."""
        return self._closed_at - self.displacement(u)

    def forces(self, x: np.ndarray) -> np.ndarray:
        """R' x, the nodal forces of the body on the obstacle, shape (nodes, N)."""
        return (self._transposed @ x).reshape(-1, self.N)

    def springs(self, row_stiffness: np.ndarray) -> np.ndarray:
        """Stiffness of springs that hold rollers in the tangent, 0 for other rows, shape (n,).

        No step from a displacement that is ``on_rollers`` moves them, so that they change nothing;
        but they hold a body that stands on rollers alone.
        """
        springs = np.zeros(len(self))
        springs[self.roller_part] = GRIP * row_stiffness[self.roller_part]
        return springs

    def grip(self, row_stiffness: np.ndarray) -> csr_matrix:
        """These springs between displacements flattened node by node."""
        on = self.roller_part
        R, springs = self.rows.normal[on], self.springs(row_stiffness)[on]
        return (R.T @ R.multiply(springs[:, None])).tocsr()

    def on_rollers(self, u: np.ndarray, free: np.ndarray) -> np.ndarray:
        """The displacement nearest to ``u`` that the rollers allow, both (nodes, N)."""
        R, gaps = self.rows.normal[self.roller_part], self.rows.gaps[self.roller_part]
        if not R.shape[0]:
            return u
        movable = R @ diags(free.ravel().astype(float))
        missing = spsolve((movable @ movable.T).tocsc(), gaps - R @ u.ravel())
        return u + (movable.T @ missing).reshape(u.shape)

    def roller_forces(self, x: np.ndarray) -> dict[Place, np.ndarray]:
        """Nodal forces of the body on each roller, shape (nodes, N)."""
        normal, rows = self.normal(x), self.rows.normal
        return {p: (rows[on].T @ normal[on]).reshape(-1, self.N) for p, on in self.rollers.items()}

    def sum_of(self, forces: np.ndarray) -> np.ndarray:
        """The sum over all rows of forces, shape (m, ...)."""
        return self.processes.total(forces[self._own_rows].sum(axis=0))

    def area(self, chosen: np.ndarray) -> float:
        """The area that belongs to some rows, boolean of shape (m,)."""
        return float(self.sum_of(np.where(chosen, self.rows.weights, 0.0)))

    def normal(self, x: np.ndarray) -> np.ndarray:
        """The normal forces among the forces or gaps of all rows, shape (m,)."""
        return x[: len(self.rows)]

    def tangential(self, x: np.ndarray) -> np.ndarray:
        """The tangential ones, shape (m, N - 1), zero without friction."""
        t = self.friction.split(x)[1]
        return t if self.friction.d else np.zeros((len(t), self.N - 1))

    def bound(self, x: np.ndarray) -> np.ndarray:
        """The bound of the tangential forces, shape (m,)."""
        return self.friction.bound(self.normal(x))

    def stiffness(self, diagonal: np.ndarray) -> np.ndarray:
        """Stiffness of the nodes of each row (force per length), one number for all its tangents.

        A row whose tangents are held has that of its normal.  ``diagonal`` is that of the stiffness
        matrix, shape (nodes, N).
        """
        each = self.matrix.power(2) @ diagonal.ravel()
        normal, mean = self.normal(each), self.tangential(each).mean(axis=1)
        mean = np.where(mean > 0, mean, normal)
        return np.concatenate([normal, np.repeat(mean, self.friction.d)])

    def defect(self, x: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        """x minus the admissible forces closest to x - k gaps, a force: zero where all holds.

        ``pushed`` is k gaps with any stiffness k > 0.
        """
        return x - self.friction.projected(x - pushed)

    def friction_work(self, x: np.ndarray, gaps: np.ndarray, rounding: float) -> float:
        """The sum of b |slip| over the rows (force times length); less than rounding is no slip."""
        size = np.linalg.norm(self.tangential(gaps), axis=1)
        return float(self.sum_of(self.bound(x) * np.where(size > rounding, size, 0.0)))


def friction_cone(problem: Problem, rows: ContactRows) -> FrictionCone:
    """The law of contact and friction row by row, without tangents where there is no friction."""
    law, d = problem.friction, problem.N - 1
    cap, coefficient = np.full(len(rows), np.inf), np.full(len(rows), STEEPEST)
    if law is None:
        coefficient, d = np.zeros(len(rows)), 0
    elif isinstance(law, Coulomb):
        coefficient = at_rows(problem, rows, law.coefficient)
    else:
        cap = rows.weights * at_rows(problem, rows, law)
    return FrictionCone(cap, np.where(rows.tied, 0.0, coefficient), rows.tied, d)


def at_rows(problem: Problem, rows: ContactRows, value: Coefficient) -> np.ndarray:
    """A coefficient at the vertices of the rows, shape (m,)."""
    space, processes = H1(problem.mesh, order=1), problem.processes
    values, region = GridFunction(space), problem.mesh.Boundaries("|".join(problem.touching_names))
    values.Set(as_scalar(value), definedon=region)
    here = np.array(space.GetDofs(region), dtype=float)  # not on all processes with a vertex
    sums = processes.summed(here * values.vec.FV().NumPy())
    return (sums / np.maximum(processes.summed(here), 1))[rows.vertices]


def initial_displacements(problem: Problem, supports: Supports) -> np.ndarray:
    """Nodal displacements at the begin of the step, shape (nodes, N), zero if none are given."""
    given, space = problem.initial_displacement, supports.space
    if given is None:
        return np.zeros_like(supports.values)
    own = isinstance(given, GridFunction) and given.space.mesh is space.mesh
    if not (own and len(given.vec) == space.ndof):
        given = GridFunction(space)
        given.Set(problem.u_0)
    return problem.processes.spread(nodal(given.vec.FV().NumPy(), problem))
