"""Whether forces of contact rows can balance loads on rigid motions.

The least sum of |l(z) - x . R z| over the motions z is that of a linear program for the forces x,
with polygons in place of the circles |t| <= b(n) of friction in space.  Polygons inside of them
prove that nothing is missing, those around them that something is; where neither do, tangents of
the circles are added at the forces that leave them most.
"""

from __future__ import annotations

import numpy as np
import scipy
from scipy.sparse import coo_matrix, csr_matrix, hstack, vstack

from ngepc.linalg.friction import FrictionCone

SIDES = 8  # of polygons inside of circles
PROGRAMS = 6  # the most linear programs with polygons around them
TANGENTS = 4  # the most directions in which each of them adds tangents
OUTSIDE = 1e-7  # forces leave a circle by more than this part of its radius


def missing(
    wanted: np.ndarray, on_rows: np.ndarray, law: FrictionCone, enough: float
) -> float:
    """The least sum of |wanted - x . on_rows|, or a smaller number that is not ``enough``.

    ``on_rows`` are values of k motions on m rows and their d tangents, shape (m + m d, k).
    """
    around = Program(wanted, on_rows, law)
    if law.d:
        around.add(np.vstack([np.eye(law.d), -np.eye(law.d)]))
    least, forces = around.solved()
    if least > enough or law.d < 2 or held_inside(wanted, on_rows, law, enough):
        return least
    for _ in range(PROGRAMS):
        n, t = law.split(forces)
        size = law.sizes(t)
        excess = size - (1 + OUTSIDE) * law.bound(n)
        most = np.argsort(-excess)[:TANGENTS]
        most = most[excess[most] > 0]
        if not len(most):
            break
        around.add(t[most] / size[most, None])
        least, forces = around.solved()
        if least > enough:
            break
    return least


def held_inside(
    wanted: np.ndarray, on_rows: np.ndarray, law: FrictionCone, enough: float
) -> bool:
    """Whether tangential forces within polygons inside of the circles miss less than ``enough``."""
    inside = Program(wanted, on_rows, law)
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    inside.add(directions, np.cos(np.pi / SIDES))
    return inside.solved()[0] <= enough


class Program:
    """The forces x, and positive and negative parts of wanted - x . on_rows, with their limits."""

    def __init__(
        self, wanted: np.ndarray, on_rows: np.ndarray, law: FrictionCone
    ) -> None:
        n, k = on_rows.shape
        normal = [(-np.inf if tied else 0.0, np.inf) for tied in law.tied]
        free = [(-np.inf, np.inf)] * (n - len(normal))
        self._law = law
        self._left = 2 * k
        self._limits: list[tuple[csr_matrix, np.ndarray]] = []
        self._given = {
            "c": np.append(np.zeros(n), np.ones(2 * k)),
            "A_eq": np.hstack([on_rows.T, np.eye(k), -np.eye(k)]),
            "b_eq": wanted,
            "bounds": [*normal, *free, *[(0.0, np.inf)] * (2 * k)],
        }

    def add(self, directions: np.ndarray, part: float = 1.0) -> None:
        """Limit all tangential forces along directions (count, d) by this part of their bounds."""
        law = self._law
        m = len(law.cap)
        rows = np.tile(np.arange(m), len(directions))
        along = np.repeat(directions, m, axis=0)
        count = np.arange(len(rows))
        columns = m + law.d * rows[:, None] + np.arange(law.d)
        entries = along.ravel(), (np.repeat(count, law.d), columns.ravel())
        pulls = csr_matrix(entries, (len(rows), m + m * law.d))
        slope = part * np.where(law.given, 0.0, law.coefficient)[rows]
        by_pressure = pulls - coo_matrix((slope, (count, rows)), pulls.shape)
        coulomb = ~law.given[rows]
        capped = np.isfinite(law.cap[rows])
        self._limit(by_pressure[coulomb], np.zeros(coulomb.sum()))
        self._limit(pulls[capped], part * law.cap[rows][capped])

    def _limit(self, matrix: csr_matrix, most: np.ndarray) -> None:
        """Limit products with the forces."""
        idle = csr_matrix((len(most), self._left))
        self._limits.append((hstack([matrix, idle], format="csr"), most))

    def solved(self) -> tuple[float, np.ndarray]:
        """The least sum, and the forces; zeros if the solver fails, which proves nothing."""
        limits = {}
        if self._limits:
            matrices, most = zip(*self._limits, strict=True)
            limits = {"A_ub": vstack(matrices), "b_ub": np.concatenate(most)}
        found = scipy.optimize.linprog(**self._given, **limits)
        if found.x is None:
            return 0.0, np.zeros(len(self._given["c"]) - self._left)
        return float(found.fun), found.x[: -self._left]
