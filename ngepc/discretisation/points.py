"""Strains at the integration points as rows on nodal displacements, and what is made of them.

All that the discrete problem needs of the elements are the rows of the volume strain tr eps(u) and
of the d coordinates of dev eps(u) at the points, and the weights of the points.  Forces are their
transposes, stiffnesses B' C B.  Arrays over the points follow the elements, rule point by rule
point; nodal arrays have shape (nodes, N).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import (
    ET,
    H1,
    VOL,
    CoefficientFunction,
    ElementId,
    IntegrationRule,
    Mesh,
    specialcf,
    x,
)

from ngepc.discretisation.elements import Elements
from ngepc.model.elements import element_numbers, element_vertices
from ngepc.model.kinematics import Kinematics
from ngepc.model.processes import Team, processes_of
from ngepc.model.rules import plastic_points


class Points:
    """The integration points of a mesh for displacements of one order.

    ``mean_volume`` averages tr eps over each element, which frees quadrilaterals and hexahedra of
    order one from volume locking (docs/locking.md).
    """

    rules: dict[ET, IntegrationRule]  # for ``dx(intrules=...)`` and ``mesh.MapToAllElements``
    scalar: H1  # the space of one displacement component; its degrees of freedom are the nodes
    weights: np.ndarray  # volume that belongs to each point, shape (points,)
    blocks: list[Elements]  # one for each shape
    processes: Team  # share the mesh; each has the points of its own elements

    def __init__(
        self, mesh: Mesh, kinematics: Kinematics, order: int, *, mean_volume: bool = False
    ) -> None:
        self.mesh, self.kinematics, self.order = mesh, kinematics, order
        self.processes = processes_of(mesh)
        self.rules = plastic_points(mesh, order)
        self.scalar = H1(mesh, order=order)
        self._mapped = mesh.MapToAllElements(self.rules, mesh.Materials(".*"))
        jacobians = specialcf.JacobianMatrix(mesh.dim)(self._mapped)
        jacobians = jacobians.reshape(-1, mesh.dim, mesh.dim)
        self.weights = np.abs(np.linalg.det(jacobians)) * self.at(kinematics.weight)
        radii = self.at(x) if kinematics.hoop else None
        self.blocks = list(self._blocks(np.linalg.inv(jacobians), radii))
        if mean_volume:
            self.blocks = [self._with_mean_volume(block) for block in self.blocks]

    def __len__(self) -> int:
        return len(self.weights)

    def at(self, value: CoefficientFunction | float) -> np.ndarray:
        """A coefficient at the points, shape (points,) or (points, components); to be read only."""
        if not isinstance(value, CoefficientFunction):
            return np.broadcast_to(float(value), len(self._mapped))
        values = np.asarray(value(self._mapped)).reshape(len(self._mapped), -1)
        return values[:, 0].copy() if not value.dims else values

    def _blocks(self, inverses: np.ndarray, radii: np.ndarray | None) -> Iterator[Elements]:
        """The elements of each shape, from the inverse Jacobians at the points."""
        sizes = np.zeros(self.mesh.ne, dtype=int)
        groups = []
        for numbers, vertices in zip(
            element_numbers(self.mesh), element_vertices(self.mesh), strict=True
        ):
            element = self.scalar.GetFE(_id(numbers[0]))
            rule = self.rules[element.type]
            sizes[numbers] = len(rule)
            groups.append((numbers, vertices, element, rule))
        firsts = np.concatenate([[0], np.cumsum(sizes)])
        weights = np.empty(len(self.weights))
        for numbers, vertices, element, rule in groups:
            points = firsts[numbers][:, None] + np.arange(len(rule))
            weights[points] = np.array(rule.weights)
            nodes = vertices
            if self.order == 2:
                nodes = np.array([self.scalar.GetDofNrs(_id(number)) for number in numbers])
            slopes = np.array([np.array(element.CalcDShape(*point)) for point in rule.points])
            values = np.array([np.array(element.CalcShape(*point)) for point in rule.points])
            gradients = np.einsum("pkj,epji->epki", slopes, inverses[points], optimize=True)
            here = None if radii is None else radii[points]
            yield Elements(self.kinematics, nodes, points, values, gradients, here)
        self.weights *= weights

    def _with_mean_volume(self, block: Elements) -> Elements:
        """The same elements with the mean of tr eps over each."""
        weights, volume = self.weights[block.points], block.rows()[:, :, 0]
        mean = np.einsum("ep,epk->ek", weights, volume) / weights.sum(axis=1)[:, None]
        return replace(block, mean=mean)

    def strain(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """tr eps(u) and the coordinates of dev eps(u), shapes (points,) and (points, d)."""
        strain = np.empty((len(self), 1 + self.kinematics.d))
        for block in self.blocks:
            for part in block.parts:
                strain[part.points] = part.strain(u)
        return strain[:, 0].copy(), strain[:, 1:].copy()

    def forces(self, pressure: np.ndarray, deviator: np.ndarray) -> np.ndarray:
        """Nodal forces of a stress with this mean part and these deviatoric coordinates.

        ``pressure`` is the factor of tr eps(v) in sigma : eps(v), tr(sigma)/size; the result has
        shape (nodes, N).
        """
        stress = np.column_stack([pressure, deviator])
        return self._gathered(lambda part, w: part.forces(w[:, :, None] * stress[part.points]))

    def diagonal(self, bulk: np.ndarray, shear: np.ndarray) -> np.ndarray:
        """Diagonal of B' C B for C = bulk I (x) I + shear Id, shape (nodes, N)."""
        C = np.column_stack([bulk, *[shear] * self.kinematics.d])
        return self._gathered(
            lambda p, w: np.einsum("eps,epsk->ek", w[:, :, None] * C[p.points], p.rows() ** 2)
        )

    def force_sizes(self, stress: np.ndarray) -> np.ndarray:
        """Nodal forces of a stress of this size if nothing cancelled, shape (nodes, N)."""
        return self._gathered(
            lambda p, w: np.einsum("ep,epdk->ek", w * stress[p.points], abs(p.rows()[:, :, 1:]))
        )

    def _gathered(self, local: Callable[[Elements, np.ndarray], np.ndarray]) -> np.ndarray:
        """The sum over elements of ``local(part, weights)``, shape (nodes, N)."""
        count, N = self.scalar.ndof, self.kinematics.N
        result = np.zeros((count, N))
        for block in self.blocks:
            values = np.concatenate([local(p, self.weights[p.points]) for p in block.parts])
            values = values.reshape(*block.nodes.shape, N)
            for corner, nodes in enumerate(block.nodes.T):
                for c in range(N):
                    result[:, c] += np.bincount(nodes, values[:, corner, c], minlength=count)
        return self.processes.summed(result)

    def integral(self, density: np.ndarray) -> float:
        """The integral of a density given at the points."""
        return self.processes.total(float(self.weights @ density))

    def element_stiffness(self, part: Elements, moduli: Moduli) -> np.ndarray:
        """B' C B of some elements, shape (elements, k N, k N)."""
        points, rows = part.points, part.rows()
        weights = self.weights[points]
        along = np.einsum("epd,epdk->epk", moduli.direction[points], rows[:, :, 1:])
        rows = np.concatenate([rows, along[:, :, None]], axis=2)
        factors = np.empty(rows.shape[:3])
        factors[:, :, 0] = weights * moduli.bulk[points]
        factors[:, :, 1:-1] = (weights * moduli.across[points])[:, :, None]
        factors[:, :, -1] = weights * moduli.extra[points]
        flat = rows.reshape(len(rows), -1, rows.shape[-1])
        return np.matmul(flat.transpose(0, 2, 1) * factors.reshape(len(rows), 1, -1), flat)


@dataclass(frozen=True, eq=False)
class Moduli:
    """Stress per strain at the points: C = bulk I (x) I + across Id + extra d (x) d."""

    bulk: np.ndarray  # (stress), shape (points,), as the next two
    across: np.ndarray
    extra: np.ndarray
    direction: np.ndarray  # unit vectors d in deviatoric coordinates, shape (points, d)

    def __call__(self, e: np.ndarray) -> np.ndarray:
        """The deviatoric stress of the deviatoric strain ``e``, both in coordinates."""
        along = self.extra * np.einsum("pd,pd->p", self.direction, e)
        return self.across[:, None] * e + along[:, None] * self.direction


def _id(number: int) -> ElementId:
    """An element of the body."""
    return ElementId(VOL, int(number))
