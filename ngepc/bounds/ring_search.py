"""The search for the admissible stress of a body of revolution with the smallest bound.

The functional is int 2 pi r [phi*(sigma) - sigma : eps(u)] + int 2 pi r P (psi - u . n), with the
contact pressure P = -sigma_nn >= 0 as an unknown.  Stresses have the same tractions from both sides
of each edge, and the given ones on the boundary.  P is continuous, affine on facets, and zero
except near the vertices that the displacement presses.  Newton's method starts with the tangent at
the stress of the displacement.  In each step the functional is a quadratic one of the vertex values
of P, whose minimum for values >= 0 is found first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ngepc.bounds.polynomials import portions
from ngepc.bounds.ring_density import RingConjugate
from ngepc.bounds.ring_element import TO_COORDINATES
from ngepc.bounds.ring_stress import Conditions, RingStresses

STEPS = 8
"""Most steps of Newton's method."""
ENDED = 0.01
"""The search ends at a step that lowers the bound by a smaller fraction."""
SHORTEST = 1e-3
CORRECTIONS = 2
"""Most solves for what rounding errors have left of the jumps."""
ROUNDED = 1e-12
"""Jumps of this size, relative to the largest traction, are not corrected."""
SINGULAR = 1e-12
"""Relative size of eigenvalues that are raised where vertex values of P have no effect."""
BALANCED = 1e-9
"""Largest jump of the tractions that is left, relative to the largest traction."""
AT_ONCE = 500
"""Triangles whose arrays are made at once."""


@dataclass(frozen=True, eq=False)
class RingContact:
    """The contact facets of the triangles of stresses.

    ``facets`` (m,) are their numbers, ``opened`` (m, k + 1) the integrals of 2 pi (psi - u . n)
    times Bernstein's polynomials, ``hats`` (m, k + 1, vertices) the coefficients of r times
    the hat functions of the vertices where P may be positive.
    """

    facets: np.ndarray
    opened: np.ndarray
    hats: np.ndarray


@dataclass(frozen=True, eq=False)
class RingSearch:
    """The functional, and its minimisation.

    ``shares`` (q, 3) are points of each triangle, ``radii`` (cells, q) their radii, ``weights``
    (cells, q) those of int 2 pi r,
    ``strain`` and ``centre`` (cells, q, 4) the strain and the stress of the displacement there,
    ``stored`` is the sum of the energy density.  ``fixed`` (facets, n) marks the tractions with a
    condition, ``given`` (facets, n) are their values.
    """

    stresses: RingStresses
    conjugate: RingConjugate
    shares: np.ndarray
    radii: np.ndarray
    weights: np.ndarray
    strain: np.ndarray
    centre: np.ndarray
    stored: float
    fixed: np.ndarray
    given: np.ndarray
    contact: RingContact

    def rows(self, cells: slice) -> tuple[np.ndarray, np.ndarray]:
        """Mean and deviator at the points of some triangles by y, and for y = 0."""
        rows, load = stress_rows(self.stresses, self.shares, cells)
        r = self.radii[cells]
        return rows / r[..., None, None], load / r[..., None]

    def stress(self, y: np.ndarray) -> np.ndarray:
        """Mean and deviator at the points, (cells, q, 4)."""
        return stresses_at(self.stresses, self.shares, y) / self.radii[..., None]

    @property
    def _owners(self) -> np.ndarray:
        return self.stresses.cells.owners[self.contact.facets, 0]

    @property
    def _slots(self) -> np.ndarray:
        """The places of the normal tractions among those of the owners, (m, k + 1)."""
        place = self.stresses.cells.facet_of[self._owners]
        edge = (place == self.contact.facets[:, None]).argmax(axis=1)
        each = self.contact.opened.shape[1]
        return 2 * each * edge[:, None] + np.arange(each)

    def value(self, y: np.ndarray) -> float:
        """The bound by a rule."""
        z = self.stress(y)
        density = self.conjugate.sought(self.conjugate.completed(z))
        density = density - np.einsum("tqc,tqc->tq", z, self.strain)
        found = self.stresses.tractions(y)[self._owners[:, None], self._slots]
        pressed = np.vdot(-found, self.contact.opened)
        return float((self.weights * density).sum() + pressed) + self.stored

    def system(
        self, y: np.ndarray, centre: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        """The second-order model around stresses ``centre``, at y: A, b, and if anything yields."""
        count, free = y.shape
        A = np.empty((count, free, free))
        b = np.empty((count, free))
        yields = False
        for cells in portions(count, AT_ONCE):
            rows, load = self.rows(cells)
            conjugate = self.conjugate.of(cells)
            at = conjugate.completed(centre[cells])
            yields = yields or bool((at.over > 0).any())
            C = self.weights[cells][..., None, None] * conjugate.compliance(at)
            z = load + np.matmul(rows, y[cells][:, None, :, None])[..., 0]
            off = conjugate.gradient(at) - self.strain[cells]
            slope = self.weights[cells][..., None] * off
            slope += np.einsum("tqij,tqj->tqi", C, z - centre[cells])
            flat = rows.reshape(len(rows), -1, free)
            pulled = np.matmul(C, rows).reshape(flat.shape)
            A[cells] = np.matmul(flat.transpose(0, 2, 1), pulled)
            b[cells] = np.matmul(slope.reshape(len(rows), 1, -1), flat)[:, 0]
            sizes = np.einsum("tff->t", A[cells]) / free
            A[cells] += sizes[:, None, None] * self.stresses.element.of(cells).forbidden
        opened = np.zeros_like(self.stresses.edge_load)
        opened[self._owners[:, None], self._slots] = self.contact.opened
        b -= np.matmul(opened[:, None], self.stresses.edge_rows)[:, 0]
        return A, b, yields

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """The numbers y of the stress (cells, free), and the vertex values of P.

        RuntimeError if no stress is in equilibrium with the loads.
        """
        conditions = Conditions(self.stresses, self.fixed)
        y = np.zeros((len(self.strain), self.stresses.element.free))
        values = np.zeros(self.contact.hats.shape[2])
        centre = self.centre
        before = np.inf
        for _ in range(STEPS):
            A, b, yields = self.system(y, centre)
            change, wanted = self._step(conditions, A, b, y)
            length = self._length(y, change, before)
            y = y + length * change
            values = values + length * (wanted - values)
            after = self.value(y)
            centre = self.stress(y)
            yields = yields or (self.conjugate.completed(centre).over > 0).any()
            if not yields or before - after <= ENDED * abs(after):
                break
            before = after
        self._check(conditions, y, values)
        return y, values

    def _step(
        self, conditions: Conditions, A: np.ndarray, b: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The change of y in a step, and the vertex values of P after it."""
        system = conditions.system(A)
        missing = conditions.missing(y, self.given)
        multipliers = system.multipliers(b, missing)
        hats = self.contact.hats
        values = np.zeros(hats.shape[2])
        if len(values):
            given = np.zeros((*self.given.shape, len(values)))
            given[self.contact.facets, : hats.shape[1]] = hats
            columns = given[conditions.active]
            answers = system.solved(columns)
            values = least_nonnegative(columns.T @ answers, columns.T @ multipliers)
            multipliers = multipliers + answers @ values
        change = system.minimiser(b, multipliers)
        given = self._tractions(values)
        for _ in range(CORRECTIONS):
            left = conditions.missing(y + change, given)
            size = np.abs(self.stresses.tractions(y + change)).max(initial=0.0)
            if np.abs(left).max(initial=0.0) <= ROUNDED * size:
                break
            rest = system.solved(left)
            change = change + system.minimiser(np.zeros_like(b), -rest)
        return change, values

    def _tractions(self, values: np.ndarray) -> np.ndarray:
        """The tractions with a condition (facets, n), for these vertex values of P."""
        given = self.given.copy()
        hats = self.contact.hats
        given[self.contact.facets, : hats.shape[1]] = -hats @ values
        return given

    def _length(self, y: np.ndarray, change: np.ndarray, before: float) -> float:
        """The longest of 1, 1/2, 1/4, ... that does not increase the value."""
        length = 1.0
        while length > SHORTEST and self.value(y + length * change) > before:
            length /= 2
        return length

    def _check(self, conditions: Conditions, y: np.ndarray, values: np.ndarray) -> None:
        """RuntimeError if tractions jump by more than rounding errors."""
        missing = conditions.missing(y, self._tractions(values))
        left = np.abs(missing).max(initial=0.0)
        size = np.abs(self.stresses.tractions(y)).max(initial=0.0)
        if left > BALANCED * size:
            raise RuntimeError(
                "no stress could be brought into equilibrium with the loads: relative "
                f"jump of the tractions {left / size:.1e}"
            )


def least_nonnegative(H: np.ndarray, g: np.ndarray) -> np.ndarray:
    """The x >= 0 for which x . H x/2 + g . x is smallest, with a symmetric H >= 0."""
    sizes, vectors = np.linalg.eigh((H + H.T) / 2)
    roots = np.sqrt(np.maximum(sizes, SINGULAR * sizes.max()))
    matrix = roots[:, None] * vectors.T
    right = -(vectors.T @ g) / roots
    return scipy.optimize.nnls(matrix, right)[0]


def stress_rows(
    stresses: RingStresses, shares: np.ndarray, cells: slice
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and deviator of r sigma at points of some triangles by the numbers, and without them.

    (cells, q, 4, free) and (cells, q, 4).
    """
    element = stresses.element.of(cells)
    rows, load = element.rows(np.matmul(shares, element.corners))
    return np.matmul(TO_COORDINATES, rows), load @ TO_COORDINATES.T


def stresses_at(
    stresses: RingStresses, shares: np.ndarray, numbers: np.ndarray
) -> np.ndarray:
    """Mean and deviator of r sigma at points of all triangles, (cells, q, 4)."""
    result = np.empty((len(numbers), len(shares), 4))
    for cells in portions(len(numbers), AT_ONCE):
        rows, load = stress_rows(stresses, shares, cells)
        result[cells] = load + np.matmul(rows, numbers[cells][:, None, :, None])[..., 0]
    return result
