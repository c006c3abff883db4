"""The lower bound: stresses in equilibrium that satisfy the yield condition everywhere.

The stresses are affine on each cell.  Equilibrium and continuity of tractions are linear equations;
the yield condition is convex, so that it holds on a cell if it holds at its vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, hstack, vstack

from ngepc.bounds.simplices import FACETS
from ngepc.limit.data import LimitData
from ngepc.limit.repair import Projection
from ngepc.limit.statics_proof import Defect, StressDefects
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.conic import ConeProgram

TOUCHES = 1e-7
"""Contact pressure, relative to the largest yield bound, below which it is set to zero."""

SAFE = 2.0
"""Room that a stress is given for its defect, over the defect."""

ATTEMPTS = 4
"""How often the room for the defect is made larger."""

ROUNDED = 1e-14
"""Relative rounding error of sizes of stresses; they take less than 40 operations."""


@dataclass(frozen=True, eq=False)
class AdmissibleStress:
    """A stress in equilibrium with the constant loads and ``factor`` times the growing ones.

    Parameters
    ----------
    coordinates
        Coordinates of the stress in the basis of the yield condition, at the vertices of the cells,
        (nc, N + 1, s).
    factor
        The load factor; if supports move, the power of their reactions.
    """

    coordinates: np.ndarray
    factor: float


class Statics:
    """Equilibrium, obstacles and strength for x = (stress coordinates, load factor).

    Parameters
    ----------
    data
        Loads, supports, strength.
    shape
        The yield condition.
    """

    def __init__(self, data: LimitData, shape: YieldShape) -> None:
        self.data = data
        self.shape = shape
        cells = data.cells
        self.count = len(cells.nodes) * (cells.N + 1) * shape.size
        self.traction = traction_rows(data, shape)
        self._given = self._given_tractions()
        normals, dragged = self._obstacle_rows()
        known, known_load, known_value = self._boundary_rows(normals | dragged)
        inner, inner_load, inner_value = self._equilibrium_rows()
        grown = np.concatenate([inner_load, known_load])
        self.equations = self._with_factor(vstack([inner, known]), -grown)
        self.values = np.concatenate([inner_value, known_value])
        growing, staying = self._given
        self.equilibrium = StressDefects(data)
        self.pressed = self._with_factor(-self.traction[normals], growing[normals])
        self.least = -staying[normals]
        self._drag_rows(dragged)

    def _with_factor(self, rows: csr_matrix, column: np.ndarray) -> csr_matrix:
        """Append the column of the load factor to rows for the stress."""
        return csr_matrix(hstack([rows, column[:, None]]))

    def _given_tractions(self) -> np.ndarray:
        """Growing and constant tractions in the frames of facets, (2, nf N N)."""
        data = self.data
        inside = np.where(data.cells.outer, 1.0, 0.0)[:, None, None]
        given = np.einsum("frp,kfjp->kfjr", data.frame, data.traction) * inside
        return given.reshape(2, -1)

    def _obstacle_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the normal and of the tangential tractions on obstacles, as booleans (nf N N)."""
        data = self.data
        N = data.cells.N
        normals = np.zeros((len(data.contact), N, N), dtype=bool)
        normals[data.contact, :, 0] = True
        dragged = np.zeros_like(normals)
        dragged[:, :, 1:] = (data.contact[:, None] & (data.friction > 0))[:, :, None]
        return normals.ravel(), dragged.ravel()

    def _boundary_rows(
        self, excepted: np.ndarray
    ) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
        """Equations of continuous and of given tractions."""
        data = self.data
        N = data.cells.N
        known = np.arange(N) >= data.held[:, None]
        known = np.repeat(known[:, None], N, axis=1).ravel() & ~excepted
        growing, staying = self._given
        return self.traction[known], growing[known], staying[known]

    def _equilibrium_rows(self) -> tuple[csr_matrix, np.ndarray, np.ndarray]:
        """Minus the divergence of the stress times the size of the cell, and body forces."""
        cells = self.data.cells
        N = cells.N
        size = cells.volume ** (1 / N)
        slopes = np.einsum("t,crq,tiq->tric", -size, self.shape.basis, cells.gradients)
        columns = np.arange(self.count).reshape(len(size), 1, N + 1, -1)
        rows = np.arange(N * len(size)).reshape(-1, N, 1, 1)
        matrix = sparse_rows(slopes, rows, columns, (N * len(size), self.count))
        growing, staying = (
            (size[:, None] * force).ravel() for force in self.data.force
        )
        return matrix, growing, staying

    def _drag_rows(self, dragged: np.ndarray) -> None:
        """Friction: |T| is at most F at the vertices."""
        data = self.data
        N = data.cells.N
        rubbing = dragged.reshape(-1, N, N)[:, :, 1]
        bound = data.friction[rubbing]
        growing, staying = (given[dragged] for given in self._given)
        rows = self._with_factor(self.traction[dragged], -growing).tocoo()
        place = N * (rows.row // (N - 1)) + 1 + rows.row % (N - 1)
        shape = (N * len(bound), self.count + 1)
        self.drag = csr_matrix((rows.data, (place, rows.col)), shape=shape)
        self.drag_offset = np.zeros((len(bound), N))
        self.drag_offset[:, 0] = bound
        self.drag_offset[:, 1:] = -staying.reshape(-1, N - 1)

    def yield_rows(self) -> csr_matrix:
        """Zero and the capped coordinates of the stress at each vertex of each cell."""
        shape = self.shape
        vertices = self.count // shape.size
        place = np.arange(vertices)[:, None]
        capped = np.arange(shape.free, shape.size)
        rows = (shape.capped + 1) * place + 1 + np.arange(shape.capped)
        columns = shape.size * place + capped
        size = ((shape.capped + 1) * vertices, self.count + 1)
        ones = np.ones(rows.size)
        return csr_matrix((ones, (rows.ravel(), columns.ravel())), shape=size)

    def strengths(self) -> np.ndarray:
        """The yield bound at each vertex of each cell."""
        return self.at_vertices(self.data.bound)

    def at_vertices(self, values: np.ndarray) -> np.ndarray:
        """Values of cells at each of their vertices."""
        return np.repeat(values, self.data.cells.N + 1)

    def gain(self) -> np.ndarray:
        """The objective of the lower bound, as a vector for x.

        It is the load factor, or the power of the reactions if supports move.
        """
        result = np.zeros(self.count + 1)
        if not self.data.moves:
            result[-1] = 1.0
            return result
        data = self.data
        N = data.cells.N
        mass = (np.ones((N, N)) + np.eye(N)) / (N * (N + 1))
        moments = np.einsum(
            "f,ij,fjp,frp->fir", data.cells.measure, mass, data.motion, data.frame
        )
        result[:-1] = self.traction.T @ moments.ravel()
        return result

    def capped(self, x: np.ndarray) -> np.ndarray:
        """|dev sigma| at each vertex of each cell."""
        coordinates = x[:-1].reshape(-1, self.shape.size)
        return np.linalg.norm(coordinates[:, self.shape.free :], axis=1)

    def dragging(self, x: np.ndarray) -> np.ndarray:
        """The size of the friction where it has a bound."""
        values = (self.drag @ x).reshape(self.drag_offset.shape) + self.drag_offset
        return np.linalg.norm(values[:, 1:], axis=1)

    def price(self, multipliers: np.ndarray) -> np.ndarray:
        """The strength of each cell times the multipliers of its yield condition, (nc,)."""
        first = multipliers.reshape(-1, self.shape.capped + 1)[:, 0]
        each = (first * self.strengths()).reshape(
            -1, len(self.data.bound), self.corners
        )
        return each.sum(axis=(0, 2))

    @property
    def corners(self) -> int:
        """Vertices of a cell."""
        return self.data.cells.N + 1

    def program(self, gain: np.ndarray) -> ConeProgram:
        """The conic program of the largest gain."""
        strengths = self.strengths()
        offset = np.zeros((len(strengths), self.shape.capped + 1))
        offset[:, 0] = strengths
        cones = [(self.yield_rows(), offset.ravel(), offset.shape[1])]
        if len(self.drag_offset):
            cones.append(
                (self.drag, self.drag_offset.ravel(), self.drag_offset.shape[1])
            )
        equations = self.equations
        values = self.values
        if self.data.moves:  # no load grows: the factor is fixed
            last = np.zeros((1, self.count + 1))
            last[0, -1] = 1.0
            equations = vstack([equations, csr_matrix(last)], format="csr")
            values = np.append(values, 0.0)
        return ConeProgram(-gain, equations, values, self.pressed, self.least, cones)

    def least_stressed(self) -> ConeProgram:
        """The conic program of the smallest fraction of the strength that some load needs.

        The fraction is the last unknown.
        """
        whole = self.program(self.gain())
        cones = []
        for rows, offset, size in whole.cones:
            bounds = np.where(np.arange(len(offset)) % size == 0, offset, 0.0)
            wider = csr_matrix(hstack([rows, bounds[:, None]]))
            cones.append((wider, offset - bounds, size))

        def widened(rows: csr_matrix) -> csr_matrix:
            """Rows with a zero column for the last unknown."""
            return csr_matrix(hstack([rows, csr_matrix((rows.shape[0], 1))]))

        cost = np.append(np.zeros(self.count + 1), 1.0)
        return ConeProgram(
            cost,
            widened(whole.equations),
            whole.values,
            widened(whole.above),
            whole.least,
            cones,
        )

    def balanced(self, x: np.ndarray) -> np.ndarray:
        """x after the smallest change of stress to equilibrium, up to rounding.

        Tiny contact pressures become zero.
        """
        scale = TOUCHES * self.data.bound.max()
        x = x.copy()
        while True:
            active = self.pressed @ x - self.least < scale
            rows = vstack([self.equations, self.pressed[active]], format="csc")
            values = np.concatenate([self.values, self.least[active]])
            load = values - x[-1] * rows[:, -1].toarray()[:, 0]
            x[:-1] = Projection(csr_matrix(rows[:, :-1]), load)(x[:-1])
            pull = (self.least - self.pressed @ x)[~active]
            if not (pull > 0).any():
                return x

    def admissible(self, x: np.ndarray, centre: np.ndarray) -> np.ndarray | None:
        """The point on the way from an admissible ``centre`` to x that is balanced and safe.

        Its stress is within the yield bound by the defect of its equilibrium; None where no such
        point is found.
        """
        x = self.balanced(x)
        defect = np.zeros(len(self.data.bound))
        for _ in range(ATTEMPTS):
            x = self._towards(x, centre, SAFE * self.at_vertices(defect))
            defect = self.defect(x).stress
            if (self.used(x) + self.at_vertices(defect) <= self.strengths()).all():
                return x
        return None

    def used(self, x: np.ndarray) -> np.ndarray:
        """|dev sigma| at the places of ``strengths``, with its rounding error."""
        whole = np.linalg.norm(self.coordinates(x), axis=2).max(axis=1)
        return self.capped(x) + ROUNDED * self.at_vertices(whole)

    def _towards(
        self, x: np.ndarray, centre: np.ndarray, margin: np.ndarray
    ) -> np.ndarray:
        """The point nearest to x, on its way from the centre, that has a margin to the strength.

        The centre where it has none itself.
        """
        part = 1.0
        strengths = self.strengths()
        # where friction has the bound zero the defect answers for what rounding leaves
        drags = self.drag_offset[:, 0]
        drags = np.where(drags > 0, drags, ROUNDED)
        sides = (
            (self.used(centre), self.used(x), strengths - margin),
            (self.dragging(centre), self.dragging(x), drags),
        )
        for inside, outside, bound in sides:
            room = bound * (1 - ROUNDED) - inside
            need = outside - inside
            beyond = need > room
            share = np.divide(room, need, out=np.zeros_like(need), where=need > 0)
            part = min(part, share[beyond].min(initial=1.0))
        return centre + max(part, 0.0) * (x - centre)

    def coordinates(self, x: np.ndarray) -> np.ndarray:
        """Of the stress at the vertices of the cells, (nc, N + 1, s)."""
        return x[:-1].reshape(len(self.data.cells.nodes), self.data.cells.N + 1, -1)

    def defect(self, x: np.ndarray) -> Defect:
        """What the stress of x needs to be in equilibrium with the loads of x."""
        tensors = np.einsum("tic,cpq->tipq", self.coordinates(x), self.shape.basis)
        return self.equilibrium.defect(tensors, float(x[-1]))

    def stress(self, x: np.ndarray) -> AdmissibleStress:
        """The stress and the factor of x; for supports that move no more than their power."""
        gain = self.gain()
        factor = float(gain @ x)
        if self.data.moves:
            factor -= ROUNDED * float(np.abs(gain) @ np.abs(x)) + self.defect(x).power
        return AdmissibleStress(self.coordinates(x), factor)


def traction_rows(data: LimitData, shape: YieldShape) -> csr_matrix:
    """Tractions in the frames of facets at their vertices, jumps inside, (nf N N, nc (N+1) s)."""
    cells = data.cells
    N = cells.N
    of_basis = np.einsum("frp,cpq,fq->frc", data.frame, shape.basis, cells.normal)
    signed = cells.sign[..., None, None] * of_basis[cells.facet_of]
    values = np.broadcast_to(signed[:, :, None], (*cells.place.shape, N, shape.size))

    row = N * cells.slot[..., None] + np.arange(N)
    first_vertex = (N + 1) * np.arange(len(cells.nodes))
    vertex = first_vertex[:, None, None] + np.array(FACETS[N])
    column = shape.size * vertex[..., None] + np.arange(shape.size)

    rows = cells.facets.size * N
    columns = len(cells.nodes) * (N + 1) * shape.size
    places = row[..., None], column[:, :, :, None, :]
    return sparse_rows(values, *places, (rows, columns))


def sparse_rows(
    values: np.ndarray, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]
) -> csr_matrix:
    """A sparse matrix; rows and columns are broadcast to the values, duplicates are summed."""
    where = tuple(np.broadcast_to(a, values.shape).ravel() for a in (rows, columns))
    result = csr_matrix(coo_matrix((values.ravel(), where), shape=shape))
    result.eliminate_zeros()
    return result
