"""Where to start: from zero, or from a result on this or another mesh of the body."""

from __future__ import annotations

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.prolongation import at_vertices, nodal_values
from ngepc.local.system import DiscreteProblem, State


def starting_state(discrete: DiscreteProblem, start: object | None) -> State:
    """The state to start from: prescribed displacements alone, or those of ``start`` inside.

    Contact forces are carried over by their pressure.

    Parameters
    ----------
    discrete
        The discrete problem.
    start
        A displacement or a result that has one, on this or another mesh; None for zero.

    Raises
    ------
    TypeError, ValueError
        If ``start`` is no displacement in N dimensions.
    """
    supports = discrete.supports
    if start is None:
        return discrete.state(discrete.contact.on_rollers(supports.values.copy(), supports.free))
    u = np.where(supports.free, nodal_values(start, discrete.problem), supports.values)
    u = discrete.contact.on_rollers(u, supports.free)
    return discrete.state(u, contact=carried_forces(discrete, start))


def carried_forces(discrete: DiscreteProblem, start: object) -> np.ndarray | None:
    """Forces of contact from the stresses of an earlier result, None if it has none."""
    pressure, rows = getattr(start, "contact_pressure", None), discrete.rows
    if not isinstance(pressure, GridFunction) or not len(rows):
        return None
    normal = np.maximum(_at_vertices(pressure, discrete)[:, 0], 0.0) * rows.weights
    normal = np.where(rows.tied, 0.0, normal)
    if not discrete.contact.friction.d:
        return normal
    friction = getattr(start, "friction_stress", None)
    tangential = np.zeros((len(rows), rows.tangents.shape[1]))
    if isinstance(friction, GridFunction):
        stress = _at_vertices(friction, discrete)
        tangential = -np.einsum("mdj,mj,m->md", rows.tangents, stress, rows.weights)
    return np.concatenate([normal, tangential.ravel()])


def _at_vertices(function: GridFunction, discrete: DiscreteProblem) -> np.ndarray:
    """A P1 function, on this or another mesh, at the vertices of the rows: (m, components)."""
    own, mesh, vertices = function.space.mesh, discrete.problem.mesh, discrete.rows.vertices
    values = function.vec.FV().NumPy().reshape(-1, own.nv).T
    if own is mesh:
        return values[vertices]
    return at_vertices(own, values, mesh, vertices)
