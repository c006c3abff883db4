"""Coordinates of the gradient of an Airy function at vertices of rollers along no axis.

Where the traction of an edge is free along d only, the derivative along d is constant on the edge.
At such vertices the two unknowns of the gradient g are its parts along d and across it, Q' g with
the orthonormal columns of Q, so that the first one alone is held.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from ngepc.bounds.boundary import Boundary

PARALLEL = 1e-9
"""Sine of the angle below which two directions count as one."""


class RollerFrames:
    """The frames Q (k, 2, 2) of some ``vertices`` (k,), and which coordinates are ``held`` (k, 2).

    Along the slanted edges the derivative along their direction is constant; ``components`` (nv, 2)
    are derivatives along the axes that other edges hold.
    """

    def __init__(self, boundary: Boundary, components: np.ndarray) -> None:
        c = boundary.cells
        self._directions = boundary.directions
        self._ends = c.facets[boundary.slanted]
        ends = self._ends.ravel()
        along = np.repeat(self._directions, 2, axis=0)
        self.vertices, first = np.unique(ends, return_index=True)
        d = along[first]
        self.frames = np.stack([d, np.stack([-d[:, 1], d[:, 0]], axis=1)], axis=2)
        self._place = np.full(len(c.points), -1)
        self._place[self.vertices] = np.arange(len(d))
        across = self.frames[:, :, 1]
        of_edges = np.abs(np.einsum("ei,ei->e", along, across[self._place[ends]]))
        both = np.zeros(len(d), dtype=bool)
        np.logical_or.at(both, self._place[ends], of_edges > PARALLEL)
        both |= (components[self.vertices] & (np.abs(across) > PARALLEL)).any(axis=1)
        self.held = np.column_stack([np.ones(len(d), dtype=bool), both])

    def into(self, x: np.ndarray) -> np.ndarray:
        """Unknowns, forces on them or equations (..., n), from those along the axes."""
        return self._turned(x, self.frames.swapaxes(1, 2))

    def out_of(self, x: np.ndarray) -> np.ndarray:
        """The map back."""
        return self._turned(x, self.frames)

    def _turned(self, x: np.ndarray, by: np.ndarray) -> np.ndarray:
        """x with the gradients at the vertices multiplied by matrices (k, 2, 2)."""
        if not len(self.vertices):
            return x
        x = x.copy()
        places = 3 * self.vertices[:, None] + np.array([1, 2])
        x[..., places] = np.einsum("kij,...kj->...ki", by, x[..., places])
        return x

    def _coordinates(self, vertices: np.ndarray) -> np.ndarray:
        """The directions of the two unknowns of the gradient at some vertices, (., 2, 2)."""
        result = np.tile(np.eye(2), (len(vertices), 1, 1))
        place = self._place[vertices]
        result[place >= 0] = self.frames[place[place >= 0]].swapaxes(1, 2)
        return result

    def missing(self, held: np.ndarray, body: np.ndarray, at: int) -> np.ndarray:
        """Unknowns (3,) of a vertex ``at`` that determine affine functions on a body, as booleans.

        They are needed in addition to those that are ``held`` (nv, 3) at the vertices ``body``.
        """
        found = ~held[body].any(axis=0)
        if not len(self.vertices):
            return found
        known = self._coordinates(body)[held[body, 1:]]
        own = self._coordinates(np.array([at]))[0]
        found[1:] = ~held[at, 1:]
        if not len(known):
            return found
        first = known[0]
        across = np.where(found[1:], np.abs(sine(own, first)), 0.0)
        found[1:] = False
        if not (np.abs(sine(known, first)) > PARALLEL).any():
            found[1 + across.argmax()] = True
        return found

    def pinned(self, held: np.ndarray, body: np.ndarray) -> np.ndarray:
        """Three ``held`` unknowns (numbers) of a body that determine affine functions."""
        count = held[body] * held[body].sum(axis=1, keepdims=True)
        pinned = 3 * body[count.argmax(axis=0)] + np.arange(3)
        if not len(self.vertices):
            return pinned
        directions = self._coordinates(body)
        place, k = np.unravel_index(count[:, 1:].argmax(), (len(body), 2))
        apart = np.abs(sine(directions, directions[place, k])) > PARALLEL
        other, j = np.unravel_index((count[:, 1:] * apart).argmax(), apart.shape)
        pinned[1:] = 3 * body[place] + 1 + k, 3 * body[other] + 1 + j
        return pinned

    def equations(self, count: int) -> np.ndarray:
        """Rows (edges, count) along the axes: the derivative along d is the same at both ends."""
        rows = np.zeros((len(self._ends), count))
        each = np.arange(len(rows))
        for end, sign in zip(self._ends.T, (-1.0, 1.0), strict=True):
            for k in (0, 1):
                rows[each, 3 * end + 1 + k] += sign * self._directions[:, k]
        return rows

    def among(self, vertices: np.ndarray) -> RollerFrames:
        """The frames at those of some vertices of the mesh, which get new numbers."""
        part = copy(self)
        place = self._place[vertices]
        part.vertices = np.flatnonzero(place >= 0)
        part.frames = self.frames[place[part.vertices]]
        part._place = np.full(len(vertices), -1)
        part._place[part.vertices] = np.arange(len(part.vertices))
        return part

    def turn(
        self,
        corners: np.ndarray,
        beside: np.ndarray,
        vertices: np.ndarray,
        pairs: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Turn stiffness matrices of triangles with these ``vertices`` (3, nt), in place.

        ``corners`` (3, 3, pairs, nt) are the blocks of ``pairs`` of vertices, ``beside`` (9, ., nt)
        those of vertices with other unknowns.
        """
        for corner, own in enumerate(vertices):
            place = self._place[own]
            there = np.flatnonzero(place >= 0)
            if not len(there):
                continue
            Q = self.frames[place[there]]
            rows = slice(3 * corner + 1, 3 * corner + 3)
            part = beside[rows][..., there]
            beside[rows, :, there] = np.einsum("tia,ijt->ajt", Q, part)
            for pair, ends in enumerate(zip(*pairs, strict=True)):
                block = corners[:, :, pair]
                if ends[0] == corner:
                    part = block[1:][..., there]
                    block[1:, :, there] = np.einsum("tia,ijt->ajt", Q, part)
                if ends[1] == corner:
                    part = block[:, 1:][..., there]
                    block[:, 1:, there] = np.einsum("tja,ijt->iat", Q, part)


def sine(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The sine of the angle between plane unit vectors (..., 2) and b (2,)."""
    return a[..., 0] * b[1] - a[..., 1] * b[0]
