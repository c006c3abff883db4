"""The quadrilaterals and hexahedra of a state: polynomials of strains, and the law.

See ``upper_energy`` for e and J.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from ngsolve import ET, VOL, ElementId

from ngepc.bounds.mapping import (
    CORNERS,
    bernstein_functions,
    bernstein_lattice,
    corner_slopes,
)
from ngepc.discretisation.element_strains import Elements
from ngepc.discretisation.law import Law, Return
from ngepc.local.system import State
from ngepc.model.elements import PARALLEL, elements_by_shape, vertex_coordinates

SHAPES = {2: ET.QUAD, 3: ET.HEX}
FLAT = 1e-6
"""Smallest ratio of the coefficients of J."""
NEEDED = {
    2: "mesh has quadrilaterals with an angle of 180 degrees: a bound needs less",
    3: "mesh has hexahedra that differ too much from parallelepipeds for a bound",
}


@dataclass(frozen=True, eq=False)
class MappedElements:
    """Quadrilaterals or hexahedra of a state, and the law there, which is constant on each.

    Parameters
    ----------
    state
        A state.
    block
        Its quadrilaterals or hexahedra.
    numbers, corners
        The numbers of some of them among the elements, and their corners (elements, 2^N, N).
    rows
        Their places in ``block``.
    degree, bend
        The degrees of e and J in each coordinate.
    """

    state: State
    block: Elements
    numbers: np.ndarray
    corners: np.ndarray
    rows: np.ndarray
    degree: int
    bend: int

    @classmethod
    def of(cls, state: State) -> Iterator[MappedElements]:
        """The quadrilaterals, or parallelepipeds and other hexahedra, of a state."""
        problem = state.discrete.problem
        mesh = problem.mesh
        blocks = state.discrete.points.blocks
        pairs = zip(elements_by_shape(mesh), blocks, strict=True)
        found = next(pair for pair in pairs if pair[0][1].shape[1] == 2**problem.N)
        (numbers, vertices), block = found
        corners = vertex_coordinates(mesh)[vertices]
        k = problem.order
        if problem.N == 2:
            yield cls(state, block, numbers, corners, np.arange(len(numbers)), k, 1)
            return
        straight = are_parallel(corners)
        for chosen, degree, bend in ((straight, k, 0), (~straight, k + 1, 2)):
            rows = np.flatnonzero(chosen)
            if len(rows):
                yield cls(
                    state, block, numbers[rows], corners[rows], rows, degree, bend
                )

    @property
    def common(self) -> int:
        """A degree of both e and J."""
        return max(self.degree, self.bend)

    @property
    def N(self) -> int:
        """The dimension."""
        return self.corners.shape[2]

    def slopes(self, places: np.ndarray) -> np.ndarray:
        """Derivatives of the shape functions of u by xi, (places, functions, N)."""
        scalar = self.state.discrete.points.scalar
        element = scalar.GetFE(ElementId(VOL, int(self.numbers[0])))
        order = self.state.discrete.problem.order
        lattice, to_coefficients = bernstein_lattice(self.N, order)
        known = np.array([np.array(element.CalcDShape(*place)) for place in lattice])
        functions = bernstein_functions(places, order) @ to_coefficients
        return np.einsum("pl,lkj->pkj", functions, known, optimize=True)

    def polynomials(
        self, places: np.ndarray, chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """e (chosen, p, 1 + d) and J (chosen, p) at places (p, N), both times the sign of J."""
        J, adjugate = self.adjugates(places, chosen)
        u = self.state.u[self.block.nodes[self.rows[chosen]]]
        D = np.einsum("pkj,qki->qpij", self.slopes(places), u, optimize=True)
        slopes = np.matmul(D, adjugate) * np.sign(J)[..., None, None]
        basis = self.block.basis
        flat = slopes.reshape(*J.shape, self.N**2)
        return flat @ basis.reshape(len(basis), -1).T, np.abs(J)

    def adjugates(
        self, places: np.ndarray, chosen: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """J (chosen, p) and adj F (chosen, p, N, N) at places (p, N)."""
        corners = self.corners[chosen]
        slopes = corner_slopes(places)
        F = np.einsum("pkj,qki->qpij", slopes, corners, optimize=True)
        if self.N == 2:
            trace = np.trace(F, axis1=2, axis2=3)[..., None, None]
            adjugate = trace * np.eye(2) - F
        else:
            a, b, c = np.moveaxis(F, 3, 0)
            rows = [np.cross(b, c), np.cross(c, a), np.cross(a, b)]
            adjugate = np.stack(rows, axis=2)
        J = np.einsum("qpi,qpi->qp", adjugate[:, :, 0], F[..., 0])
        return J, adjugate

    def returned(self, strain: np.ndarray, chosen: np.ndarray) -> tuple[Law, Return]:
        """The law at strains (chosen, p, 1 + d), trace and deviator, of points by element."""
        law = self.law(chosen, strain.shape[1])
        flat = strain.reshape(-1, strain.shape[2])
        beyond = law.beyond_initial(flat[:, 0], flat[:, 1:])
        return law, law.returned(*beyond)

    def law(self, chosen: np.ndarray, each: int) -> Law:
        """The law at so many points of each of some elements."""
        first = self.block.points[self.rows[chosen], 0]
        return self.state.discrete.law.of(np.repeat(first, each))

    def extremes(self) -> tuple[np.ndarray, np.ndarray]:
        """c and tau of each element, from the Bernstein coefficients of J.

        ValueError where one is not positive.
        """
        lattice, to_coefficients = bernstein_lattice(self.N, self.bend)
        J, _ = self.adjugates(lattice, np.arange(len(self.corners)))
        coefficients = (J * np.sign(J[:, :1])) @ to_coefficients.T
        least = coefficients.min(axis=1)
        most = coefficients.max(axis=1)
        if (least < FLAT * most).any():
            raise ValueError(NEEDED[self.N])
        return (most + least) / 2, (most - least) / (most + least)


def are_parallel(corners: np.ndarray) -> np.ndarray:
    """Which hexahedra with these corners (n, 8, 3) are parallelepipeds."""
    frame = [0, 1, 3, 4]
    shares = np.column_stack([1 - CORNERS[3].sum(axis=1), CORNERS[3]])
    off = np.abs(corners - shares @ corners[:, frame]).max(axis=(1, 2))
    return off <= PARALLEL * np.ptp(corners, axis=1).max(axis=1)
