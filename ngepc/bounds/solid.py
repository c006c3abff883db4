"""The best stress in three dimensions, by a hybrid method with unknowns on the faces.

Each tetrahedron has the stresses of ``element``.  Continuity of the tractions, and given tractions,
are constraints with the multiplier delta: a displacement that is affine on each face and
independent from face to face.  For given delta the best stress x of a tetrahedron solves

    A x = B' delta - c,     A its compliance, B x its moments,

and delta solves  S delta = b  with  S = sum of B A^-1 B'.  On continuous delta S is the stiffness
matrix of displacements of order one, which is the coarse space of conjugate gradients.

For displacements of order two the stress is computed from the solution of order one on the same
mesh.

On facets with springs of stiffness K the traction is g - K (u + delta), so that S contains K there.

After the iteration the tractions still jump a little.  They are averaged, brought into equilibrium
at each vertex by ``Patches``, and the stresses are built from them again: they are admissible after
any number of iterations.
"""

from __future__ import annotations

import logging
from copy import copy
from itertools import islice
from typing import NamedTuple

import numpy as np

from ngepc._deprecated import old_names
from ngepc.bounds.balance import BALANCED, PASSES, factorise
from ngepc.bounds.coordinates import Displaced, strain_coordinates
from ngepc.bounds.data import (
    AdjointStress,
    BestStress,
    BoundData,
    Effort,
    feasible_state,
)
from ngepc.bounds.faces import ELEMENT, MOST_FACTORISED, Faces, is_soft
from ngepc.bounds.polynomials import RULE, TO_NODES
from ngepc.bounds.rollers import by_nodes
from ngepc.bounds.simplices import FACETS
from ngepc.bounds.transfer import lowered_problem
from ngepc.discretisation.factors import Factors
from ngepc.linalg.descent import conjugate_gradients
from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem, State
from ngepc.results.iteration import newton_iteration

log = logging.getLogger(__name__)

# which of the twelve moments of a tetrahedron belong to a vertex, shape (4, 12)
CORNER_SUMS = (np.ravel(FACETS[3])[None] == np.arange(4)[:, None]).astype(float)
LENGTHS = 0.5 ** np.arange(10)
"""Lengths of Newton steps that are tried."""
NEWTON_BY_FACTORS = 12  # most Newton steps with factors of S
REFINED = 2  # solves with the factors of S, each for what the one before has left
LOOSER = 15  # factor of ``gain`` for the conjugate gradients that search the pressure

TOLERANCE = 1e-8
"""Residual of the solution of order one that belongs to one of order two."""

MOST_STEPS = 100


class SolidSearch(NamedTuple):
    """The matrices of the tetrahedra at one tangent, and its compliances (nt, 6, 6)."""

    faces: Faces
    compliance: np.ndarray


class Balanced(NamedTuple):
    """A stress (nt, 16, 6) at nodes with the pressure and the w of ``foundation`` it balances."""

    stress: np.ndarray
    pressure: np.ndarray
    sprung: np.ndarray


class SolidBoundData(BoundData):
    """``BoundData`` on tetrahedra."""

    effort = Effort(newton=0, gain=3e-4, steps=60)

    def __init__(self, discrete: DiscreteProblem) -> None:
        super().__init__(discrete)
        if self.problem.order == 1:
            self.faces = Faces(self.boundary, self.foundation, self.piola)
            return
        self.weights = np.full(len(TO_NODES[4]), 1 / len(TO_NODES[4]))
        lower = by_nodes(DiscreteProblem(lowered_problem(self.problem)))
        self.lower = SolidBoundData(lower)
        self.lower.effort = Effort(newton=2, gain=3e-5, steps=100)

    def best_stress(self, state: State, tangent: Factors, P: np.ndarray) -> BestStress:
        """An admissible stress with a small bound, the same at points, and its pressure P."""
        if self.problem.order == 2:
            return self._best_of_lower(state)
        z = self.stress(state)
        factorise(state, tangent)
        found, H = self._nearest(state, tangent, z, P)
        steps = self._newton_steps(found)
        search = None if steps else SolidSearch(self.faces, H)
        for _ in range(steps):
            mean = found.stress.mean(axis=1)
            step, _ = self._nearest(state, tangent, mean, found.pressure)
            better = self._between(state, found, step)
            if better is None:
                break
            found = better
        stress, P, w = found
        return BestStress(stress, stress.mean(axis=1, keepdims=True), P, search, w)

    def _newton_steps(self, found: Balanced) -> int:
        """The most Newton steps from a stress; more where S there is ill-conditioned, on few faces.

        What the stress of a cell exceeds the yield bound by costs much there, also where the
        discrete stress does not yield.
        """
        cheap = min(NEWTON_BY_FACTORS, MOST_FACTORISED // len(self.cells.facets))
        if cheap <= self.effort.newton:
            return self.effort.newton
        at = self.conjugate.completed(found.stress.mean(axis=1)[:, None])
        soft = is_soft(self.conjugate.compliance(at))
        return cheap if soft else self.effort.newton

    def _between(
        self, state: State, found: Balanced, step: Balanced
    ) -> Balanced | None:
        """The first of 1, 1/2, 1/4, ... of the way to ``step`` with a smaller bound, or None.

        All of them are in equilibrium, as its equations are linear.
        """
        bound = self._estimated(state, found)
        for length in LENGTHS:
            pairs = zip(found, step, strict=True)
            trial = Balanced(*(old + length * (new - old) for old, new in pairs))
            if self._estimated(state, trial) < bound:
                return trial
        return None

    def _estimated(self, state: State, found: Balanced) -> float:
        """The bound with phi*, which is convex, by its means over the nodes of the parts."""
        stress, P, w = found
        density = self.at_nodes.value(self.at_nodes.completed(stress)).mean(axis=1)
        inside = self.gaps(state, stress.mean(axis=1, keepdims=True))
        inside += self.cells.volume * density
        return float(inside.sum() + self.boundary_gaps(state, P, w).sum())

    def _nearest(
        self, state: State, tangent: Factors, z: np.ndarray, P: np.ndarray
    ) -> tuple[Balanced, np.ndarray]:
        """The best admissible stress, at nodes, for phi* expanded around stresses z (nt, 6).

        The pressure is optimised as well, starting from P, and so is the w of ``foundation``.  The
        second result are the compliances (nt, 6, 6) there.
        """
        faces = self.faces
        log.info("stress of an error bound on %d tetrahedra", len(z))
        at = self.conjugate.completed(z[:, None])
        H = self.conjugate.compliance(at)[:, 0]
        off = strain_coordinates(state) - self.conjugate.gradient(at)[:, 0]
        aim = z + np.linalg.solve(H, off[:, :, None])[:, :, 0]
        own = self.constant_moments(aim) + faces.fill(H, self.carried.inner)
        w = self.foundation.affine(state.u)
        P, found = self.sharpened(state, tangent, own, P)
        given = self.loads(state, P)[0]
        b = self.foundation.added(given, w).reshape(-1, 3) - self.cells.sums(own)
        found = self.displacements(tangent, b, self.effort.gain, found)
        stress, w = self._built_from(tangent, own, given, w, found[0])
        return Balanced(stress, P, w), H

    def _built_from(
        self,
        tangent: Factors,
        own: np.ndarray,
        given: np.ndarray,
        w: np.ndarray,
        delta: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The admissible stress, at nodes, that the displacements delta lead to, and its w.

        ``own`` are the moments for delta = 0, w the displacement of the foundation then, ``given``
        the moments of tractions without springs.
        """
        faces = self.faces
        own = own + faces.moments(faces.stresses(delta))
        w = w + delta.reshape(-1, 3, 3)[self.foundation.facets]
        own, w = self.balanced_moments(tangent, own, given, w)
        needed = np.matmul(CORNER_SUMS, own)
        given = self.foundation.added(given, w)
        return self.built(own.reshape(-1, 4, 3, 3), needed, given, ELEMENT.of_data), w

    def _best_of_lower(self, state: State) -> BestStress:
        """The same for displacements of order two."""
        lower = self.lower
        tangent = Factors(lower.discrete, "sparsecholesky")
        start = lower.discrete.state(state.u[: len(self.cells.points)].copy())
        given = start, tangent, ExactResult, TOLERANCE, MOST_STEPS
        found = newton_iteration(*given).or_interrupted()
        self.lower_state, _ = feasible_state(lower, found.state)
        P = lower.contact.from_rows.pressure(found.state.multipliers)
        found = lower.best_stress(self.lower_state, tangent, P)
        at_points = at_points_of_parts(found.nodal)
        return BestStress(found.nodal, at_points, found.pressure, None, found.sprung)

    def tangential(self, state: State) -> np.ndarray:
        """See ``BoundData``; for order two the stress is that of order one."""
        if self.lower is None:
            return super().tangential(state)
        return self.lower.tangential(self.lower_state)

    def search(self, state: State) -> SolidSearch:
        """The matrices of the tetrahedra for the tangent of a state."""
        at = self.conjugate.completed(self.stress(state)[:, None])
        H = self.conjugate.compliance(at)[:, 0]
        faces = self.faces.another()
        faces.fill(H, np.zeros_like(self.carried.inner))
        return SolidSearch(faces, H)

    def adjoint_stress(
        self,
        state: State,
        tangent: Factors,
        search: SolidSearch,
        near: Displaced,
        z: Displaced,
        moments: np.ndarray,
    ) -> AdjointStress:
        """An admissible stress near the tangent's stress of z, at nodes, and its error.

        ``near`` are displacements whose stress is in equilibrium with the facet
        ``moments``, tested with hat functions; springs are added to these.  The error is half the
        squared difference of the stresses in the tangent's compliance.
        """
        faces = search.faces
        other = copy(self)
        other.faces = faces
        own = self.constant_moments(near.stress_change(tangent))
        added = np.zeros_like(own)
        if self.carried.inner.any():
            added = faces.fill(search.compliance, self.carried.inner)
        w = self.foundation.affine(near.u)
        b = self.foundation.added(moments, w).reshape(-1, 3)
        b = b - self.cells.sums(own + added)
        delta, _ = other.displacements(tangent, b, self.effort.gain)
        tau, w = other._built_from(tangent, own + added, moments, w, delta)
        return AdjointStress(tau, w, self.missed_energy(state, tangent, z, tau, w))

    def missed_energy(
        self,
        state: State,
        tangent: Factors,
        z: Displaced,
        tau: np.ndarray,
        w: np.ndarray,
    ) -> float:
        """Half the squared difference of stresses tau at nodes and the tangent's stress of z.

        It includes the energy of the springs at z - w.
        """
        at = self.conjugate.completed(self.on_parts(self.stress(state)))
        H = self.conjugate.compliance(at)
        wanted = self.on_parts(z.stress_change(tangent))
        left = at_points_of_parts(tau) - wanted
        square = np.einsum(
            "tqc,tqcd,tqd->t", left, np.broadcast_to(H, (*left.shape, 6)), left
        )
        sprung = float(self.foundation.gaps(z.u, w).sum())
        return float(self.cells.volume @ square) / (2 * left.shape[1]) + sprung

    def sharpened(
        self, state: State, tangent: Factors, own: np.ndarray, P: np.ndarray
    ) -> tuple[np.ndarray, tuple | None]:
        """The pressure of a body with delta . n held where P > 0, and the state of the search."""
        faces = self.faces
        on = self.boundary.contact
        closed = (P > 0).all(axis=1)[:, None]
        if not closed.any():
            return P, None
        slots = 3 * on[:, None] + np.arange(3)
        normals = self.cells.normal[on][:, None]
        along = np.zeros(faces.free.shape)
        along[slots] = closed[:, :, None] * normals
        w = self.foundation.affine(state.u)
        given = self.foundation.added(self.loads(state, P)[0], w)
        b = given.reshape(-1, 3) - self.cells.sums(own)
        start = np.zeros(faces.free.shape)
        left = self.contact.affine_slack(state.u)
        start[slots] = (closed * left)[:, :, None] * normals
        with faces.holding(along):
            gain = LOOSER * self.effort.gain
            found = self.displacements(tangent, b, gain, (start, 0.0))
        sums = self.cells.sums(own + faces.moments(faces.stresses(found[0])))
        pulled = self.foundation.added(np.zeros_like(given), w).reshape(-1, 3)
        sums = sums - pulled + self.foundation.pulled(found[0])
        pressed = (
            -(sums[slots] * normals).sum(axis=2) * 12 / self.cells.measure[on, None]
        )
        pressed -= pressed.sum(axis=1, keepdims=True) / 4  # the values of these moments
        return np.where(closed, np.maximum(pressed, 0.0), P), found

    def displacements(
        self, tangent: Factors, b: np.ndarray, gain: float, start: tuple | None = None
    ) -> tuple[np.ndarray, float]:
        """Delta of the faces that nearly solves S delta = b, by two-level conjugate gradients.

        If faces are held, the coarse space of continuous displacements is not used.  ``start`` and
        the result are delta (3 nf, 3) and the decrease of the energy.  Where S is ill-conditioned
        they are found by its factors, on meshes that are not too large.
        """
        faces = self.faces
        c = self.cells
        if faces.has_factors:
            return self._by_factors(b, start)

        def coarse(r: np.ndarray) -> np.ndarray | float:
            """The part of continuous displacements."""
            if faces.closed is not None:
                return 0.0
            return tangent.solve(c.at_nodes(r, c.facets))[c.facets.ravel()]

        b = faces.kept(b)
        delta, total = (0 * b, 0.0) if start is None else start
        delta = delta + coarse(b if start is None else b - faces.product(delta))
        r = b - faces.product(delta)
        change = 0.0
        steps = conjugate_gradients(
            faces.product, lambda r: faces.smooth(r) + coarse(r), r
        )
        for step in islice(steps, self.effort.steps):
            change, _, gained = step
            total += gained
            if gained <= gain * total:
                break
        return delta + change, total

    def _by_factors(
        self, b: np.ndarray, start: tuple | None
    ) -> tuple[np.ndarray, float]:
        """The same by the factors of S."""
        faces = self.faces
        b = faces.kept(b)
        delta = np.zeros_like(b) if start is None else start[0]
        for _ in range(REFINED):
            delta = delta + faces.solve(b - faces.product(delta))
        return delta, float(np.vdot(b, delta)) / 2

    def balanced_moments(
        self, tangent: Factors, own: np.ndarray, given: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Moments with the given sums at the vertices: moments of constant stresses are added.

        The given moments are without springs; those at w (elastic facets, 3, 3) are added.  The
        second result is w after the change.
        """
        c = self.cells
        size = np.abs(own).max()
        for _ in range(PASSES):
            wanted = self.foundation.added(given, w).reshape(-1, 3)
            missing = self.faces.kept(wanted - c.sums(own))
            missing = c.at_nodes(missing, c.facets)
            if np.abs(missing).max() <= BALANCED * size:
                break
            change = tangent.solve(missing)
            own = own + self.constant_moments(self.answer(tangent, change))
            w = w + change[self.foundation.nodes]
        return own, w

    def constant_moments(self, z: np.ndarray) -> np.ndarray:
        """Outward moments (nt, 12, 3) of constant stresses z (nt, 6)."""
        sigma = ELEMENT.tensors(z)
        size = -self.cells.volume[:, None, None]
        return np.repeat(np.matmul(self.cells.gradients, sigma) * size, 3, axis=1)


def at_points_of_parts(stress: np.ndarray) -> np.ndarray:
    """Stresses at the nodes of the parts (nt, 16, c) at the points of the rule for tetrahedra."""
    parts = stress.reshape(len(stress), 4, 4, -1)
    return np.matmul(RULE[4], parts).reshape(stress.shape)


__getattr__ = old_names(__name__)
