"""The best stress in three dimensions: face unknowns by conjugate gradients, tractions repaired.

Tractions that jump a little are averaged, brought into equilibrium at each vertex by ``Patches``,
and the stresses are built from them again: they are admissible after any number of iterations.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np

from ngepc.bounds.element import ELEMENTS
from ngepc.bounds.faces import Faces
from ngepc.bounds.setting import BALANCED, PASSES, Setting, factorise, stress_coordinates
from ngepc.bounds.simplices import FACETS
from ngepc.bounds.tightening import Effort
from ngepc.linalg.descent import conjugate_gradients
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State

CORNER_SUMS = (np.ravel(FACETS[3])[None] == np.arange(4)[:, None]).astype(float)
"""Which of the twelve moments of a tetrahedron belong to a vertex, shape (4, 12)."""

LOOSER = 15
"""Times the gain at which conjugate gradients stop where the pressure is sought."""


class Search(NamedTuple):
    """What conjugate gradients found: displacements of faces (3 nf, 3), the energy gained."""

    delta: np.ndarray
    gained: float


class SolidSetting(Setting):
    """``Setting`` on tetrahedra."""

    effort = Effort(newton=0, gain=3e-4, steps=60)

    def __init__(self, discrete: DiscreteProblem) -> None:
        super().__init__(discrete)
        self.faces = Faces(self.boundary, self.piola)

    def best_stress(
        self, state: State, tangent: Factors, P: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An admissible stress for which the bound is small, its mean on each cell, and P."""
        c, faces, law = self.cells, self.faces, self.discrete.law
        factorise(state, tangent)
        z = stress_coordinates(3, law.bulk * state.volume, law.stress(state.at))
        H = self.conjugate.compliance(self.conjugate.completed(z[:, None]))[:, 0]
        own = self.constant_moments(z) + faces.fill(H, self.carried.inner)
        P, found = self.sharpened(state, tangent, own, P)
        given = self.loads(state, P)[0]
        b = given.reshape(-1, 3) - c.sums(own)
        found = self.displacements(tangent, b, self.effort.gain, found)
        own = own + faces.moments(faces.stresses(found.delta))
        own = self.balanced_moments(tangent, own, given)
        needed, table = np.matmul(CORNER_SUMS, own), ELEMENTS[3].of_data
        stress = self.built(own.reshape(-1, 4, 3, 3), needed, given, table)
        return stress, stress.mean(axis=1, keepdims=True), P

    def sharpened(
        self, state: State, tangent: Factors, own: np.ndarray, P: np.ndarray
    ) -> tuple[np.ndarray, Search | None]:
        """The pressure of a body that is held where P > 0, as far as it presses, and its search."""
        faces, on = self.faces, self.boundary.contact
        closed = (P > 0).all(axis=1)[:, None]
        if not closed.any():
            return P, None
        slots, normals = 3 * on[:, None] + np.arange(3), self.cells.normal[on][:, None]
        faces.closed = np.zeros(faces.free.shape)
        faces.closed[slots] = closed[:, :, None] * normals
        b = self.loads(state, P)[0].reshape(-1, 3) - self.cells.sums(own)
        found = self.displacements(tangent, b, LOOSER * self.effort.gain)
        faces.closed = None
        sums = self.cells.sums(own + faces.moments(faces.stresses(found.delta)))
        pressed = -(sums[slots] * normals).sum(axis=2) * 12 / self.cells.measure[on, None]
        pressed -= pressed.sum(axis=1, keepdims=True) / 4  # the values of these moments
        return np.where(closed, np.maximum(pressed, 0.0), P), found

    def displacements(
        self, tangent: Factors, b: np.ndarray, gain: float, start: Search | None = None
    ) -> Search:
        """Delta of the faces that nearly solves S delta = b, by two-level conjugate gradients.

        Where faces are held the continuous displacements, which are not, are left out.
        """
        faces, c = self.faces, self.cells

        def coarse(r: np.ndarray) -> np.ndarray | float:
            """The part of continuous displacements."""
            if faces.closed is not None:
                return 0.0
            return tangent.solve(c.at_nodes(r, c.facets))[c.facets.ravel()]

        b = faces.kept(b)
        start = start or Search(np.zeros_like(b), 0.0)
        delta, r = start.delta, b - faces.product(start.delta) if start.gained else b
        delta = delta + coarse(r)
        r, total, change = b - faces.product(delta), start.gained, 0.0
        steps = conjugate_gradients(faces.product, lambda r: faces.smooth(r) + coarse(r), r)
        for step in islice(steps, self.effort.steps):
            change, _, gained = step
            total += gained
            if gained <= gain * total:
                break
        return Search(delta + change, total)

    def balanced_moments(self, tangent: Factors, own: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Moments whose sums at the vertices are those of the given ones: constants are added."""
        c, points, size = self.cells, self.discrete.points, np.abs(own).max()
        for _ in range(PASSES):
            missing = self.faces.kept(given.reshape(-1, 3) - c.sums(own))
            missing = c.at_nodes(missing, c.facets)
            if np.abs(missing).max() <= BALANCED * size:
                break
            volume, e = points.strain(tangent.solve(missing))
            z = stress_coordinates(3, tangent.moduli.bulk * volume, tangent.moduli(e))
            own = own + self.constant_moments(z)
        return own

    def constant_moments(self, z: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) of constant stresses z (nt, 6)."""
        sigma = ELEMENTS[3].tensors(z)
        size = -self.cells.volume[:, None, None]
        return np.repeat(np.matmul(self.cells.gradients, sigma) * size, 3, axis=1)
