"""Where to start: from zero, or from a result on this or another mesh of the body."""

from __future__ import annotations

import numpy as np
from ngsolve import GridFunction

from ngepc.discretisation.prolongation import at_points, nodal_values
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
        return discrete.state(supports.values.copy())
    u = np.where(supports.free, nodal_values(start, discrete.problem), supports.values)
    return discrete.state(u, multipliers=carried_forces(discrete, start))


def carried_forces(discrete: DiscreteProblem, start: object) -> np.ndarray | None:
    """Contact forces from the contact pressure of an earlier result, None if it has none."""
    pressure = getattr(start, "contact_pressure", None)
    rows, mesh = discrete.rows, discrete.problem.mesh
    if not isinstance(pressure, GridFunction) or not len(rows):
        return None
    own = pressure.space.mesh
    values = pressure.vec.FV().NumPy()
    if own is mesh:
        there = values[rows.vertices]
    else:
        points = np.asarray(mesh.ngmesh.Coordinates())[rows.vertices, : mesh.dim]
        there = at_points(own, values[:, None], points)[:, 0]
    return np.maximum(there, 0.0) * rows.weights
