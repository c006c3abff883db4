"""The conditions of contact and friction between nodal displacements and the forces of rows.

The forces x of the rows stand one after the other: the normal forces n of all rows, with friction
then the tangential forces t.  R maps displacements to the normal displacements N u and, with
friction, to the tangential ones; the gaps are (gaps - N u, slip origin - T u).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from ngsolve import H1, GridFunction
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.linalg import spsolve

from ngepc.checks.arguments import Coefficient, boundary_names, is_number
from ngepc.discretisation.gap_records import gap_records
from ngepc.discretisation.mortar import mortar_rows
from ngepc.discretisation.roller_rows import not_implied, roller_rows
from ngepc.discretisation.rows import ContactRows, joined, rows_and_gaps
from ngepc.discretisation.spaces import nodal
from ngepc.discretisation.supports import Supports, given_at
from ngepc.linalg.friction import FrictionCone
from ngepc.model.places import Coulomb, Place
from ngepc.model.problem import Problem
from ngepc.model.processes import Team

PROXIMAL = 1e-8
"""Compliance against changes of dependent forces, as a part of that of their nodes."""
GRIP = 1e2  # stiffness of the springs that hold rollers in the tangent, relative to the node's


class ContactConditions:
    """Rows, their law and their matrix."""

    rows: ContactRows  # of rigid obstacles, of pairs, of rollers
    on_obstacles: slice  # the rows of rigid obstacles
    roller_part: slice  # the rows of rollers
    rollers: dict[Place, slice]  # place of each roller -> its rows
    friction: FrictionCone  # the law of the forces, without tangents where there is no friction
    processes: Team
    """The processes that share the body; each has the rows at its vertices."""
    own: slice | np.ndarray  # selects the forces of rows that belong to this process
    held_on_both: list[ContactRows]
    """Rows of two bodies that supports of both hold, for each pair that is not tied."""
    vertex_areas: np.ndarray
    """Integrals of the hat functions over the contact boundaries, shape (vertices,).

    Rows that supports hold belong to them: those beside are shared with their vertices.
    """
    matrix: csr_matrix  # R, shape (n, nodes N), n = m without friction and m N with it
    absent: bool  # whether the problem has neither contact nor rollers, on no process

    def __init__(self, problem: Problem, supports: Supports) -> None:
        pairs = [mortar_rows(problem, supports, pair) for pair in problem.contact_pairs]
        rollers = roller_rows(problem, supports)
        obstacles, self._row_gaps = rows_and_gaps(problem, supports.scalar)
        self.absent = not (problem.touching_names or rollers)
        self._obstacle_names = problem.contact_names
        self._movable = obstacles.movable(supports.free)
        parts = [obstacles.chosen(self._movable)]
        self.held_on_both = []
        for pair in pairs:
            if pair.tied.all():
                parts.append(pair.chosen(not_implied(pair, rollers.values())))
                continue
            movable = pair.movable(supports.free)
            parts.append(pair.chosen(movable))
            held = np.setdiff1d(np.arange(len(pair)), movable)
            self.held_on_both.append(pair.chosen(held))
        parts += rollers.values()
        rows = joined(parts)
        ends = np.cumsum(list(map(len, parts))).tolist()
        self.rows = rows
        self.on_obstacles = slice(0, ends[0])
        self.roller_part = slice(ends[len(pairs)], len(rows))
        self.rollers = {
            p: slice(*ends[k : k + 2]) for k, p in enumerate(rollers, len(pairs))
        }
        self._on_pairs = [
            slice(*ends[k : k + 2]) for k in range(len(problem.contact_pairs))
        ]
        self.friction = self._friction_cone(problem)
        self.processes = problem.nodal_processes
        self._own_rows = self.processes.owned(rows.nodes)
        self._vertices = problem.processes
        self._vertex_count = problem.mesh.nv
        self.vertex_areas = self._areas([obstacles, *pairs])
        tangents = np.repeat(rows.nodes, self.friction.d)
        self.own = self.processes.owned(np.append(rows.nodes, tangents))
        self.matrix = rows.normal
        if self.friction.d:
            self.matrix = vstack([rows.normal, rows.tangential], format="csr")
        self._closed_at = self._closed(problem, supports)
        self._transposed = self.matrix.T.tocsr()

    def _areas(self, boundaries: list[ContactRows]) -> np.ndarray:
        """See ``vertex_areas``; of all rows of obstacles and of pairs."""
        areas = np.zeros(self._vertex_count)
        for rows in boundaries:
            own = np.zeros(len(rows))
            mine = self.processes.owned(rows.nodes)
            own[mine] = rows.weights[mine]
            areas += rows.at_vertices(np.where(rows.tied, 0.0, own), len(areas))
        return self._vertices.summed(areas)

    def _closed(self, problem: Problem, supports: Supports) -> np.ndarray:
        """R u at which the gaps are closed and the slips are zero, shape (n,)."""
        if not self.friction.d:
            return self.rows.gaps
        start = initial_displacements(problem, supports)
        return np.append(self.rows.gaps, self.rows.tangential @ start.ravel())

    def from_displacement(
        self, problem: Problem, supports: Supports
    ) -> ContactConditions:
        """The same conditions in a step that begins with another displacement."""
        other = copy(self)
        other._closed_at = other._closed(problem, supports)
        return other

    def with_gaps(self, problem: Problem, supports: Supports) -> ContactConditions:
        """The same conditions for another gap of the obstacles, and start of the step."""
        gaps = self.rows.gaps.copy()
        if self._row_gaps is not None:
            known = self._row_gaps(gap_records(problem))
            gaps[self.on_obstacles] = known[self._movable]
        other = copy(self)
        other.rows = replace(self.rows, gaps=gaps)
        other._closed_at = other._closed(problem, supports)
        return other

    def __len__(self) -> int:
        return len(self._closed_at)

    def proximal(self, row_stiffness: np.ndarray) -> np.ndarray | None:
        """Compliances (n,) that resist changes of dependent forces, None without these."""
        if self.friction.independent:
            return None
        return PROXIMAL * dependent_forces(self.rows, self.friction.d) / row_stiffness

    def displacement(self, u: np.ndarray) -> np.ndarray:
        """R u for nodal displacements (nodes, N)."""
        return self.matrix @ u.ravel()

    def gaps(self, u: np.ndarray) -> np.ndarray:
        """Open gaps, negative where penetrated, with friction then minus the slip, shape (n,)."""
        return self._closed_at - self.displacement(u)

    def forces(self, x: np.ndarray) -> np.ndarray:
        """R' x, the nodal forces of the body on the obstacle, shape (nodes, N)."""
        own = np.zeros_like(x)
        own[self.own] = x[self.own]
        nodal_forces = self._transposed @ own
        return self.processes.summed(
            nodal_forces.reshape(-1, self.rows.normals.shape[1])
        )

    def compliance(
        self, solve: Callable[[np.ndarray], np.ndarray], chosen: np.ndarray
    ) -> np.ndarray:
        """S = R K^-1 R' for some of the forces, dense, by a solve with K for each of them."""
        unit = np.eye(len(self))[chosen]
        answers = [self.displacement(solve(self.forces(x)))[chosen] for x in unit]
        return np.array(answers)

    def springs(self, row_stiffness: np.ndarray) -> np.ndarray:
        """Stiffness of springs of rollers in the tangent, 0 for other rows, shape (n,).

        Steps from a displacement ``on_rollers`` do not extend them: they only make the tangent
        regular.
        """
        springs = np.zeros(len(self))
        springs[self.roller_part] = GRIP * row_stiffness[self.roller_part]
        return springs

    def friction_springs(self, row_stiffness: np.ndarray) -> csr_matrix:
        """These springs between displacements flattened node by node."""
        R = self.rows.normal[self.roller_part]
        springs = self.springs(row_stiffness)
        return (R.T @ diags(springs[self.roller_part]) @ R).tocsr()

    def on_rollers(self, u: np.ndarray, free: np.ndarray) -> np.ndarray:
        """The displacement nearest to ``u`` that the rollers allow, both (nodes, N)."""
        R = self.rows.normal[self.roller_part]
        gaps = self.gaps(u)[self.roller_part]
        if not len(gaps):
            return u
        movable = R @ diags(free.ravel().astype(float))
        return u + (movable.T @ spsolve((movable @ movable.T).tocsc(), gaps)).reshape(
            u.shape
        )

    def roller_forces(self, x: np.ndarray) -> dict[Place, np.ndarray]:
        """Nodal forces of the body on each roller, shape (nodes, N)."""
        normal = self.rows.normal
        _, N = self.rows.normals.shape
        return {
            p: (normal[on].T @ x[on]).reshape(-1, N) for p, on in self.rollers.items()
        }

    def forced_overlap(self, u: np.ndarray) -> float:
        """The deepest overlap of two bodies that supports of both hold (length), zero if none."""
        depths = [(held.normal @ u.ravel() - held.gaps) for held in self.held_on_both]
        return float(np.concatenate([[0.0], *depths]).max())

    def sum_of(self, forces: np.ndarray) -> np.ndarray:
        """The sum over all rows of forces, shape (m, ...)."""
        return self.processes.total(forces[self._own_rows].sum(axis=0))

    def of_obstacles(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Contact boundary with an obstacle -> its part of the forces x of all rows, shape (n,).

        A row that several boundaries share is divided by their areas.
        """
        shares = self._shares()
        tangents = np.repeat(shares, self.friction.d, axis=1)
        parts = np.hstack([shares, tangents]) * x
        return dict(zip(self._obstacle_names, parts, strict=True))

    def _shares(self) -> np.ndarray:
        """The part of each row that belongs to each boundary with an obstacle, (names, m)."""
        count = len(self._obstacle_names)
        shares = np.zeros((count, len(self.rows)))
        if self._row_gaps is not None:
            known = self._row_gaps.shares(count)[self._movable]
            shares[:, self.on_obstacles] = known.toarray().T
        return shares

    def given_at_rows(self, problem: Problem, value: Coefficient) -> np.ndarray:
        """A coefficient at the nodes of the rows, each on its own boundary, shape (m,).

        Where boundaries meet, it may jump between their rows; of two bodies it is that of the first
        boundary.
        """
        if is_number(value):
            return np.full(len(self.rows), float(value))
        found = np.zeros(len(self.rows))
        for name, share in zip(self._obstacle_names, self._shares(), strict=True):
            found += share * at_rows(problem, self.rows, value, [name])
        for pair, on in zip(problem.contact_pairs, self._on_pairs, strict=True):
            first = boundary_names("contact", pair.first, problem.mesh)
            found[on] = at_rows(problem, self.rows, value, first)[on]
        return found

    def _friction_cone(self, problem: Problem) -> FrictionCone:
        """The law of contact and friction row by row, without tangents if there is no friction."""
        law = problem.friction
        rows = self.rows
        coefficient = np.zeros(len(rows))
        limit = None
        if isinstance(law, Coulomb):
            coefficient = self.given_at_rows(problem, law.coefficient)
            limit = law.limit
        elif law is not None:
            coefficient = np.full(len(rows), np.inf)
            limit = law
        cap = np.full(len(rows), np.inf)
        if limit is not None:
            cap = rows.weights * self.given_at_rows(problem, limit)
        tangents = 0 if law is None else problem.N - 1
        coefficient = np.where(rows.tied, 0.0, coefficient)
        independent = not dependent_forces(rows, tangents).any()
        return FrictionCone(cap, coefficient, rows.tied, tangents, independent)

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Sums at the vertices of values (m, ...) of the rows of all processes."""
        own = np.zeros_like(values)
        own[self._own_rows] = values[self._own_rows]
        return self._vertices.summed(self.rows.at_vertices(own, self._vertex_count))

    def densities(self, forces: np.ndarray) -> np.ndarray:
        """Forces (m, k) of the rows over the area of their vertices (stress), (vertices, k).

        Zero at vertices without area.
        """
        area = self.vertex_areas
        return self.at_vertices(forces) / np.where(area > 0, area, 1.0)[:, None]

    def area(self, chosen: np.ndarray) -> float:
        """The area that belongs to some rows, boolean of shape (m,)."""
        return float(self.sum_of(np.where(chosen, self.rows.weights, 0.0)))

    def normal(self, x: np.ndarray) -> np.ndarray:
        """The normal forces among the forces or gaps of all rows, shape (m,)."""
        return x[: len(self.rows)]

    def tangential(self, x: np.ndarray) -> np.ndarray:
        """The tangential ones, shape (m, N - 1), zero without friction."""
        t = self.friction.split(x)[1]
        return t if self.friction.d else np.zeros(self.rows.tangents.shape[:2])

    def bound(self, x: np.ndarray) -> np.ndarray:
        """The bound of the tangential forces, shape (m,)."""
        return self.friction.bound(self.normal(x))

    def stiffness(self, diagonal: np.ndarray) -> np.ndarray:
        """Stiffness of the nodes of each row (force per length), the same for all its tangents.

        The stiffness along its normal if they are held; from the diagonal of the stiffness matrix
        (nodes, N).
        """
        each = self.matrix.power(2) @ diagonal.ravel()
        normal = self.normal(each)
        mean = self.tangential(each).mean(axis=1)
        mean = np.where(mean > 0, mean, normal)
        return np.concatenate([normal, np.repeat(mean, self.friction.d)])

    def defect(self, x: np.ndarray, pushed: np.ndarray) -> float:
        """Norm of x minus the projection of x - k gaps onto admissible forces, for any k > 0."""
        own = (x - self.friction.projected(x - pushed))[self.own]
        return float(np.sqrt(self.processes.total(float(own @ own))))

    def friction_work(self, x: np.ndarray, gaps: np.ndarray, rounding: float) -> float:
        """The sum of b |slip| over the rows (force times length), without slips below rounding."""
        size = np.linalg.norm(self.tangential(gaps), axis=1)
        return float(self.sum_of(self.bound(x) * np.where(size > rounding, size, 0.0)))


def dependent_forces(rows: ContactRows, tangents: int) -> np.ndarray:
    """Forces at nodes that have more of them than components, boolean of shape (n,).

    With friction the two rows at the edge between two faces are dependent where both stick.
    """
    each = np.where(rows.tied, 1, 1 + tangents)
    several = np.bincount(rows.nodes, each) > rows.normals.shape[1]
    there = several[rows.nodes]
    return np.append(there, np.repeat(there, tangents))


def at_rows(
    problem: Problem, rows: ContactRows, value: Coefficient, names: Sequence[str]
) -> np.ndarray:
    """A coefficient on some boundaries at the nodes of the rows there, shape (m,).

    It is linear between vertices, and means nothing for rows elsewhere.
    """
    space = H1(problem.mesh, order=1)
    nodes, values = given_at(space, "|".join(names), value)
    # values and how many: not on all processes with a vertex
    sums = np.zeros((space.ndof, 2))
    sums[nodes] = np.column_stack([values, np.ones(len(nodes))])
    total, count = problem.processes.summed(sums).T
    return rows.between(total / np.maximum(count, 1))


def initial_displacements(problem: Problem, supports: Supports) -> np.ndarray:
    """Nodal displacements at the start of the step, shape (nodes, N), zero if none are given."""
    given = problem.initial_displacement
    if given is None:
        return np.zeros_like(supports.values)
    space = supports.space
    own = isinstance(given, GridFunction) and given.space.mesh is space.mesh
    if not (own and len(given.vec) == space.ndof):
        given = GridFunction(space)
        given.Set(problem.u_0)
    return problem.nodal_processes.spread(nodal(given.vec.FV().NumPy(), problem))
