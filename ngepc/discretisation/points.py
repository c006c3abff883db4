"""Strains at the integration points as rows on nodal displacements, and what is made of them.

A strain is its trace and the d coordinates of its deviator, a stress what they are multiplied with:
s = 1 + d numbers.  All that the discrete problem needs of the elements are the rows B of these
numbers at the points and the weights of the points: forces are B' times stresses, stiffnesses
B' C B.  Gradients of the shape functions are kept; rows are five times as many numbers and are made
where they are needed.  Arrays over the points follow the elements, rule point by rule point; nodal
arrays have shape (nodes, N).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from ngsolve import ET, H1, VOL, CoefficientFunction, ElementId, IntegrationRule, Mesh, specialcf, x

from ngepc.model.elements import element_numbers, element_vertices, plastic_points
from ngepc.model.kinematics import Kinematics
from ngepc.model.processes import Team, processes_of

CHUNK = 20_000  # elements whose matrices are held in memory at once


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of one shape, k nodes and p points each."""

    kinematics: Kinematics
    nodes: np.ndarray  # numbers, shape (elements, k)
    points: np.ndarray  # numbers among all points, shape (elements, p)
    shapes: np.ndarray  # shape functions at the points, shape (p, k)
    gradients: np.ndarray  # of the shape functions at the points, shape (elements, p, k, N)
    radii: np.ndarray | None  # of the points of a body of revolution, shape (elements, p)
    mean: np.ndarray | None = None  # rows of the mean of tr eps over each, (elements, k N), or None

    def part(self, chosen: slice) -> Elements:
        """Some of the elements, as views."""
        arrays = {n: getattr(self, n) for n in ("nodes", "points", "gradients", "radii", "mean")}
        return replace(self, **{n: a[chosen] for n, a in arrays.items() if a is not None})

    @property
    def parts(self) -> Iterator[Elements]:
        """The elements in chunks."""
        firsts = range(0, len(self.nodes), CHUNK)
        return (self.part(slice(first, first + CHUNK)) for first in firsts)

    @property
    def _basis(self) -> np.ndarray:
        """The numbers of a strain by those of the displacement gradient, (s, N, N)."""
        N = self.kinematics.N
        return np.concatenate([np.eye(N)[None], self.kinematics.basis[:, :N, :N]])

    @property
    def _ring(self) -> np.ndarray:
        """The same by the hoop strain, shape (s,)."""
        return np.append(1.0, self.kinematics.basis[:, 2, 2])

    @property
    def _hoop(self) -> np.ndarray:
        """Rows of the hoop strain on the radial displacements, shape (elements, p, k)."""
        return self.shapes / self.radii[:, :, None]

    def rows(self) -> np.ndarray:
        """Rows of strains on the nodal displacements node by node, (elements, p, s, k N)."""
        # E : eps(phi_i e_c) = E[c, :] . grad phi_i for symmetric E
        rows = np.einsum("scj,epkj->epskc", self._basis, self.gradients, optimize=True)
        if self.radii is not None:
            rows[..., 0] += self._ring[:, None] * self._hoop[:, :, None]
        rows = rows.reshape(*rows.shape[:3], -1)
        if self.mean is not None:
            rows[:, :, 0] = self.mean[:, None]
        return rows

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Strains, shape (elements, p, s): the rows times u, without making them."""
        local = u[self.nodes]
        slopes = np.matmul(local.swapaxes(1, 2)[:, None], self.gradients)
        basis = self._basis
        found = slopes.reshape(*slopes.shape[:2], -1) @ basis.reshape(len(basis), -1).T
        if self.radii is not None:
            found += np.einsum("epk,ek->ep", self._hoop, local[:, :, 0])[:, :, None] * self._ring
        if self.mean is not None:
            found[:, :, 0] = np.einsum("ek,ek->e", self.mean, local.reshape(len(local), -1))[
                :, None
            ]
        return found

    def forces(self, stress: np.ndarray) -> np.ndarray:
        """The transposed rows times stresses (elements, p, s), shape (elements, k, N)."""
        basis, pressure = self._basis, stress[:, :, 0].sum(axis=1)
        if self.mean is not None:
            stress = np.where(np.arange(len(basis)) > 0, stress, 0.0)
        tensors = stress @ basis.reshape(len(basis), -1)
        tensors = tensors.reshape(*tensors.shape[:2], *basis.shape[1:])
        forces = np.matmul(self.gradients, tensors).sum(axis=1)
        if self.radii is not None:
            forces[:, :, 0] += np.einsum("ep,epk->ek", stress @ self._ring, self._hoop)
        if self.mean is not None:
            forces += (pressure[:, None] * self.mean).reshape(forces.shape)
        return forces


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
        mesh, sizes = self.mesh, np.zeros(self.mesh.ne, dtype=int)
        numbers, vertices = element_numbers(mesh), element_vertices(mesh)
        kinds = [self.scalar.GetFE(ElementId(VOL, int(of_shape[0]))) for of_shape in numbers]
        for of_shape, element in zip(numbers, kinds, strict=True):
            sizes[of_shape] = len(self.rules[element.type])
        firsts = np.cumsum(sizes) - sizes
        for of_shape, nodes, element in zip(numbers, vertices, kinds, strict=True):
            rule = self.rules[element.type]
            points = firsts[of_shape][:, None] + np.arange(len(rule))
            self.weights[points] *= np.array(rule.weights)
            if self.order == 2:
                ids = (ElementId(VOL, number) for number in of_shape.tolist())
                nodes = np.array([self.scalar.GetDofNrs(one) for one in ids])
            slopes = np.array([np.array(element.CalcDShape(*point)) for point in rule.points])
            values = np.array([np.array(element.CalcShape(*point)) for point in rule.points])
            gradients = np.einsum("pkj,epji->epki", slopes, inverses[points], optimize=True)
            here = None if radii is None else radii[points]
            yield Elements(self.kinematics, nodes, points, values, gradients, here)

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
