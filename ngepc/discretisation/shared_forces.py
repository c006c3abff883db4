"""The forces of nodes where contact boundaries with friction meet.

There the rows of both boundaries have more components than the node.  Displacements and stresses do
not depend on how the boundaries share its force, but the contact force does: it is known up to an
interval, which shrinks with the area of these nodes.
"""

from __future__ import annotations

import numpy as np
import scipy
from scipy.sparse import csr_matrix, eye, hstack, vstack

from ngepc.discretisation.body import Iterate
from ngepc.discretisation.conditions import dependent_forces


def range_of_force(here: Iterate) -> tuple[float, float]:
    """The least and the largest contact force with the nodal forces of a solution.

    Forces obey the law of friction; in space the components of tangential forces do, one by one, so
    that the interval is too wide rather than too narrow.  On several processes it is a point.
    """
    conditions = here.body.contact
    cone = conditions.friction
    tied = conditions.rows.tied
    pressing = np.where(tied, 0.0, conditions.normal(here.contact))
    force = float(conditions.sum_of(pressing))
    if cone.independent or conditions.processes.size > 1:
        return force, force
    dependent = dependent_forces(conditions.rows, cone.d)
    size = float(np.abs(here.contact[dependent]).max())
    if size == 0:
        return force, force
    rows = np.flatnonzero(dependent[: len(tied)])
    program = _program(here, rows, size)
    cost = np.append(~tied[rows], np.zeros(len(rows) * cone.d))
    ends = [scipy.optimize.linprog(sign * cost, **program) for sign in (1, -1)]
    if not all(end.success for end in ends):
        return force, force
    others = force - float(pressing[rows].sum())
    low, high = (others + size * float(cost @ end.x) for end in ends)
    return low, high


def _program(here: Iterate, rows: np.ndarray, size: float) -> dict:
    """The conditions on the forces (n, t) of some rows, divided by ``size``, for ``linprog``."""
    conditions = here.body.contact
    cone = conditions.friction.of(rows)
    numbers = conditions.friction.numbers(rows)
    x = here.contact[numbers] / size
    n, t = cone.split(x)
    slips = np.repeat(here.sliding[rows], cone.d)
    row = np.repeat(np.arange(len(rows)), cone.d)

    # the nodal forces, and those of rows that slip: t = mu n e
    nodal = conditions.matrix[numbers].T.tocsr()
    nodal = nodal[np.flatnonzero(nodal.getnnz(axis=1))]
    mu = np.where(cone.given, 0.0, cone.coefficient)
    share = (t / np.where(n > 0, n, 1.0)[:, None]).ravel() * ~cone.given[row]
    tangents = eye(len(row), format="csr")
    by_pressure = csr_matrix((share, (np.arange(len(row)), row)), (len(row), len(rows)))
    slipping = hstack([-by_pressure, tangents], format="csr")[np.flatnonzero(slips)]
    equations = vstack([nodal, slipping], format="csr")

    # -mu n <= t <= mu n, and |t| at most the limit
    coulomb = np.flatnonzero(~cone.given[row])
    bound = csr_matrix((mu[row], (np.arange(len(row)), row)), by_pressure.shape)
    limits = [hstack([-bound, s * tangents], format="csr")[coulomb] for s in (1, -1)]
    open_rows = here.open_gap[rows] > here.touching_distance
    most = np.where(cone.tied, 0.0, cone.cap / size)[row]
    least_normal = np.where(cone.tied, -np.inf, 0.0)
    largest_normal = np.where(open_rows & ~cone.tied, 0.0, np.inf)
    return {
        "A_eq": equations,
        "b_eq": equations @ x,
        "A_ub": vstack(limits),
        "b_ub": np.zeros(2 * len(coulomb)),
        "bounds": [
            *zip(least_normal, largest_normal, strict=True),
            *zip(-most, most, strict=True),
        ],
    }
