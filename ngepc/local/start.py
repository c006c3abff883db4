"""The state from which an exact solve starts."""

from __future__ import annotations

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.prolongation import at_vertices
from ngepc.local.system import DiscreteProblem, State
from ngepc.results.result import DiscreteSolution


def starting_state(discrete: DiscreteProblem, start: object | None) -> State:
    """The initial state: prescribed displacements, and elsewhere those of ``start`` or zero.

    ``start`` is a displacement or a result that has one, on this or another mesh; contact forces
    are transferred as stresses.  TypeError or ValueError if it is no displacement.
    """
    u = discrete.starting_displacement(start)
    pressure = getattr(start, "contact_pressure", None)
    rows = discrete.rows
    if not isinstance(pressure, GridFunction) or not len(rows):
        return discrete.state(u)
    if isinstance(start, DiscreteSolution) and _same_rows(start, discrete):
        return discrete.state(u, contact=start.state.contact)

    def on_rows(function: GridFunction) -> np.ndarray:
        """A P1 function, on this or another mesh, at the nodes of the rows: (m, components)."""
        own = function.space.mesh
        mesh = discrete.problem.mesh
        values = function.vec.FV().NumPy().reshape(-1, own.nv).T
        if own is mesh:
            return rows.between(values)
        vertices, where = np.unique(rows.corners, return_inverse=True)
        there = at_vertices(own, values, mesh, vertices)
        return there[where.reshape(rows.corners.shape)].mean(axis=1)

    forces = np.where(
        rows.tied, 0.0, np.maximum(on_rows(pressure)[:, 0], 0.0) * rows.weights
    )
    if discrete.contact.friction.d:
        tangential = np.zeros(rows.tangents.shape[:2])
        friction = getattr(start, "friction_stress", None)
        if isinstance(friction, GridFunction):
            stress = on_rows(friction)
            tangential = -np.einsum("mdj,mj,m->md", rows.tangents, stress, rows.weights)
        forces = np.concatenate([forces, tangential.ravel()])
    return discrete.state(u, contact=forces)


def _same_rows(start: DiscreteSolution, discrete: DiscreteProblem) -> bool:
    """Whether a result has the same rows, so that its contact forces can be used directly."""
    same = start.state.body.problem.mesh is discrete.problem.mesh
    alike = len(start.state.contact) == len(discrete.contact)
    nodes = start.rows.nodes
    tied = start.rows.tied.any() or discrete.rows.tied.any()
    return same and alike and not tied and np.array_equal(nodes, discrete.rows.nodes)
