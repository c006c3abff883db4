"""The best stress in three dimensions: face unknowns by conjugate gradients, tractions repaired.

Tractions that jump a little are averaged, brought into equilibrium at each vertex by ``Patches``,
and the stresses are built from them again: they are admissible after any number of iterations.
"""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np

from ngepc.bounds.element import ELEMENTS
from ngepc.bounds.faces import FREE, Faces
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
        self.faces, self.inner_loads = Faces(self.boundary), self.carried.inner

    def best_stress(
        self, state: State, tangent: Factors, P: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """An admissible stress for which the bound is small, its mean on each cell, and P."""
        law, f = self.discrete.law, self.inner_loads
        factorise(state, tangent)
        z = stress_coordinates(3, law.bulk * state.volume, law.stress(state.at))
        self.faces.fill(self.conjugate.compliance(self.conjugate.completed(z[:, None]))[:, 0])
        own = self.constant_moments(z) + self.faces.moments(np.zeros((len(z), FREE)), f)
        own -= self.faces.moments(self.faces.answer(self.faces.pulled(f)))
        P, start = self.sharpened(state, tangent, own, P)
        moments = self.admissible(tangent, own, self.loads(state, P)[0], start)
        reference = np.matmul(moments, self.cells.inverse.transpose(0, 2, 1)).reshape(-1, 36)
        stress = np.concatenate([reference, f], axis=1) @ ELEMENTS[3].of_data.T
        stress = np.matmul(stress.reshape(-1, 16, 6), self.faces.piola)
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
        sums = self.cells.sums(own + faces.moments(faces.answer(faces.work(found.delta))))
        pressed = -(sums[slots] * normals).sum(axis=2) * 12 / self.cells.measure[on, None]
        pressed -= pressed.sum(axis=1, keepdims=True) / 4  # the values of these moments
        return np.where(closed, np.maximum(pressed, 0.0), P), found

    def admissible(
        self, tangent: Factors, own: np.ndarray, given: np.ndarray, start: Search | None
    ) -> np.ndarray:
        """Moments (nt, 12, 3) of the stress for which the quadratic functional is nearly least.

        They are in equilibrium.  ``own`` (nt, 12, 3) are those of the least one without tractions,
        ``given`` (nf, 3, 3) those of the given tractions.
        """
        faces, b = self.faces, given.reshape(-1, 3) - self.cells.sums(own)
        found = self.displacements(tangent, b, self.effort.gain, start)
        own = own + faces.moments(faces.answer(faces.work(found.delta)))
        own = self.balanced_moments(tangent, own, given)
        return self.repaired(own, given)

    def displacements(
        self, tangent: Factors, b: np.ndarray, gain: float, start: Search | None = None
    ) -> Search:
        """Delta of the faces that nearly solves S delta = b, by two-level conjugate gradients.

        Where faces are held the continuous displacements, which are not, are left out.
        """
        faces = self.faces
        torn = faces.closed is not None

        def coarse(r: np.ndarray) -> np.ndarray | float:
            """The part of continuous displacements."""
            return 0.0 if torn else faces.spread(tangent.solve(faces.at_nodes(r)))

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
        faces, points = self.faces, self.discrete.points
        size = np.abs(own).max()
        for _ in range(PASSES):
            missing = faces.at_nodes(faces.kept(given.reshape(-1, 3) - self.cells.sums(own)))
            if np.abs(missing).max() <= BALANCED * size:
                break
            volume, e = points.strain(tangent.solve(missing))
            z = stress_coordinates(3, tangent.moduli.bulk * volume, tangent.moduli(e))
            own = own + self.constant_moments(z)
        return own

    def repaired(self, own: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Moments of the cells (nt, 12, 3) that are in equilibrium and agree on both sides."""
        cells = self.cells
        signs = np.repeat(cells.sign, 3, axis=1)[:, :, None]
        count = np.repeat(np.where(cells.outer, 1.0, 2.0), 3)[:, None]
        mean = self.cells.sums(own * signs) / count
        mu = self.patches.repaired(mean.reshape(-1, 3, 3), np.matmul(CORNER_SUMS, own), given)
        return mu.reshape(-1, 3)[self.cells.slot.reshape(-1, 12)] * signs

    def constant_moments(self, z: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) of constant stresses z (nt, 6)."""
        sigma = ELEMENTS[3].tensors(z)
        size = -self.cells.volume[:, None, None]
        return np.repeat(np.matmul(self.cells.gradients, sigma) * size, 3, axis=1)
