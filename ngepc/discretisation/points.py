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
    H1,
    VOL,
    CoefficientFunction,
    ElementId,
    IntegrationRule,
    Mesh,
    specialcf,
    x,
)

from ngepc.model.elements import element_numbers, element_vertices
from ngepc.model.kinematics import Kinematics
from ngepc.model.processes import processes_of
from ngepc.model.rules import plastic_points

CHUNK = 20_000
"""Elements whose matrices are held in memory at once."""


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of one shape.

    Parameters
    ----------
    nodes
        Node numbers, shape (elements, k).
    points
        Numbers of their points among all points, shape (elements, p).
    volume, deviator
        Rows of tr eps and of the coordinates of dev eps at the points on the nodal displacements,
        node by node: shapes (elements, p, k N) and (elements, p, d, k N).
    shapes
        Shape functions at the points, shape (p, k).
    """

    nodes: np.ndarray
    points: np.ndarray
    volume: np.ndarray
    deviator: np.ndarray
    shapes: np.ndarray

    def __len__(self) -> int:
        return len(self.nodes)

    def local(self, u: np.ndarray) -> np.ndarray:
        """Displacements of the nodes of each element, shape (elements, k N)."""
        return u[self.nodes].reshape(len(self.nodes), -1)

    def part(self, chosen: slice) -> Elements:
        """Some of the elements, as views."""
        arrays = (self.nodes, self.points, self.volume, self.deviator)
        return Elements(*(array[chosen] for array in arrays), self.shapes)


def chunks(count: int) -> list[slice]:
    """The slices of ``CHUNK`` that cover ``count`` elements."""
    return [slice(first, first + CHUNK) for first in range(0, count, CHUNK)]


class Points:
    """The integration points of a mesh for displacements of one order.

    Parameters
    ----------
    mesh, kinematics, order
        The body, its kinematics, and the order of its displacements, 1 or 2.
    mean_volume
        Whether tr eps is averaged over each element, which frees quadrilaterals and hexahedra of
        order one from volume locking (docs/locking.md).

    Attributes
    ----------
    rules
        Shape -> rule, for ``dx(intrules=...)`` and ``mesh.MapToAllElements``.
    scalar
        The space of one displacement component; its degrees of freedom are the nodes.
    weights
        Volume that belongs to each point, shape (points,).
    blocks
        ``Elements`` of each shape.
    processes
        Those that share the mesh; each has the points of its own elements.
    """

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
        """A coefficient at the points, shape (points,) or (points, components)."""
        if not isinstance(value, CoefficientFunction):
            return np.full(len(self._mapped), float(value))
        values = np.asarray(value(self._mapped)).reshape(len(self._mapped), -1)
        return values[:, 0].copy() if not value.dims else values

    def _blocks(self, inverses: np.ndarray, radii: np.ndarray | None) -> Iterator[Elements]:
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
            nodes = vertices if self.order == 1 else self._nodes(numbers)
            slopes, values = _reference(element, rule)
            k, d = self.kinematics.N * nodes.shape[1], self.kinematics.d
            volume, deviator = np.empty((*points.shape, k)), np.empty((*points.shape, d, k))
            for part in chunks(len(points)):
                here = points[part]
                gradients = np.einsum("pkj,epji->epki", slopes, inverses[here], optimize=True)
                hoop = None if radii is None else values / radii[here][:, :, None]
                volume[part], deviator[part] = strain_rows(self.kinematics, gradients, hoop)
            yield Elements(nodes, points, volume, deviator, values)
        self.weights *= weights

    def _with_mean_volume(self, block: Elements) -> Elements:
        weights = self.weights[block.points]
        mean = np.einsum("ep,epk->ek", weights, block.volume) / weights.sum(axis=1)[:, None]
        repeated = np.repeat(mean[:, None, :], weights.shape[1], axis=1)
        return replace(block, volume=repeated)

    def _nodes(self, numbers: np.ndarray) -> np.ndarray:
        return np.array([self.scalar.GetDofNrs(_id(number)) for number in numbers.tolist()])

    def strain(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """tr eps(u) and the coordinates of dev eps(u), shapes (points,) and (points, d)."""
        volume = np.empty(len(self))
        deviator = np.empty((len(self), self.kinematics.d))
        for block in self.blocks:
            local = block.local(u)
            volume[block.points] = np.einsum("epk,ek->ep", block.volume, local)
            deviator[block.points] = np.einsum("epdk,ek->epd", block.deviator, local)
        return volume, deviator

    def forces(self, pressure: np.ndarray, deviator: np.ndarray) -> np.ndarray:
        """Nodal forces of a stress with this mean part and these deviatoric coordinates.

        ``pressure`` is the factor of tr eps(v) in sigma : eps(v), tr(sigma)/size; the result has
        shape (nodes, N).
        """
        return self._gathered(
            lambda b, w: (
                np.einsum("epk,ep->ek", b.volume, w * pressure[b.points])
                + np.einsum("epdk,epd->ek", b.deviator, w[:, :, None] * deviator[b.points])
            )
        )

    def diagonal(self, bulk: np.ndarray, shear: np.ndarray) -> np.ndarray:
        """Diagonal of B' C B for C = bulk I (x) I + shear Id, shape (nodes, N)."""
        return self._gathered(
            lambda b, w: (
                np.einsum("ep,epk->ek", w * bulk[b.points], b.volume**2)
                + np.einsum("ep,epdk->ek", w * shear[b.points], b.deviator**2)
            )
        )

    def force_sizes(self, stress: np.ndarray) -> np.ndarray:
        """Nodal forces of a stress of this size if nothing cancelled, shape (nodes, N)."""
        return self._gathered(
            lambda b, w: np.einsum("ep,epdk->ek", w * stress[b.points], np.abs(b.deviator))
        )

    def _gathered(self, local: Callable[[Elements, np.ndarray], np.ndarray]) -> np.ndarray:
        """The sum over elements of ``local(block, weights)``, shape (nodes, N)."""
        count, N = self.scalar.ndof, self.kinematics.N
        result = np.zeros(count * N)
        for block in self.blocks:
            dofs = (N * block.nodes[:, :, None] + np.arange(N)).ravel()
            values = np.empty((len(block), N * block.nodes.shape[1]))
            for part in chunks(len(block)):
                some = block.part(part)
                values[part] = local(some, self.weights[some.points])
            result += np.bincount(dofs, values.ravel(), minlength=count * N)
        return self.processes.summed(result.reshape(count, N))

    def integral(self, density: np.ndarray) -> float:
        """The integral of a density given at the points."""
        return self.processes.total(float(self.weights @ density))

    def element_stiffness(self, block: Elements, chosen: slice, moduli: Moduli) -> np.ndarray:
        """B' C B of some elements of a block, shape (elements, k N, k N)."""
        points = block.points[chosen]
        weights, d = self.weights[points], block.deviator[chosen]
        along = np.einsum("epd,epdk->epk", moduli.direction[points], d)
        rows = np.concatenate([block.volume[chosen][:, :, None], d, along[:, :, None]], axis=2)
        factors = np.empty(rows.shape[:3])
        factors[:, :, 0] = weights * moduli.bulk[points]
        factors[:, :, 1:-1] = (weights * moduli.across[points])[:, :, None]
        factors[:, :, -1] = weights * moduli.extra[points]
        flat = rows.reshape(len(rows), -1, rows.shape[-1])
        return np.matmul(flat.transpose(0, 2, 1) * factors.reshape(len(rows), 1, -1), flat)


@dataclass(frozen=True, eq=False)
class Moduli:
    """Stress per strain at the points: C = bulk I (x) I + across Id + extra d (x) d.

    Parameters
    ----------
    bulk, across, extra
        Moduli (stress), shape (points,).
    direction
        Unit vectors d in deviatoric coordinates, shape (points, d).
    """

    bulk: np.ndarray
    across: np.ndarray
    extra: np.ndarray
    direction: np.ndarray

    def __call__(self, e: np.ndarray) -> np.ndarray:
        """The deviatoric stress of the deviatoric strain ``e``, both in coordinates."""
        along = self.extra * np.einsum("pd,pd->p", self.direction, e)
        return self.across[:, None] * e + along[:, None] * self.direction


def strain_rows(
    kinematics: Kinematics, gradients: np.ndarray, hoop: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of tr eps and dev eps from gradients (..., k, N) of shape functions, and N_i / r."""
    N, *_, k = kinematics.N, gradients.shape[-2]
    volume = gradients.copy()
    # E : eps(phi_i e_c) = E[c, :] . grad phi_i for symmetric E
    deviator = np.einsum("dcj,...kj->...dkc", kinematics.basis[:, :N, :N], gradients, optimize=True)
    if hoop is not None:
        volume[..., 0] += hoop
        deviator[..., 0] += kinematics.basis[:, 2, 2][:, None] * hoop[..., None, :]
    shape = gradients.shape[:-2]
    return volume.reshape(*shape, k * N), deviator.reshape(*shape, kinematics.d, k * N)


def _reference(element, rule: IntegrationRule) -> tuple[np.ndarray, np.ndarray]:
    """Gradients (p, k, N) and values (p, k) of the shape functions at the points of a rule."""
    slopes = [np.array(element.CalcDShape(*point)) for point in rule.points]
    values = [np.array(element.CalcShape(*point)) for point in rule.points]
    return np.array(slopes), np.array(values)


def _id(number: int) -> ElementId:
    return ElementId(VOL, int(number))
