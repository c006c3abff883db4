"""The integration points of a mesh, where strains, stresses and history variables are known.

Arrays over the points follow the elements, rule point by rule point; nodal arrays have shape
(nodes, N).  What an element computes is in ``element_strains``; here are sums over the mesh, and
the functions that are determined by their values at the points.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np
from ngsolve import (
    ET,
    H1,
    L2,
    VOL,
    CoefficientFunction,
    ElementId,
    FESpace,
    GridFunction,
    IntegrationRule,
    Mesh,
    VectorValued,
    specialcf,
    x,
    y,
    z,
)

from ngepc.discretisation.element_strains import Elements
from ngepc.linalg.cores import in_order
from ngepc.model.elements import (
    determinants,
    elements_by_shape,
    inverses,
    plastic_order,
    plastic_points,
)
from ngepc.model.kinematics import Kinematics
from ngepc.model.problem import Problem
from ngepc.model.processes import Team, nodal_processes_of


def unknowns_of(space: H1, elements: np.ndarray) -> np.ndarray:
    """The unknowns (elements, k) of all elements of one shape, without a call for each.

    The function that has its own numbers as coefficients is evaluated in all elements at once.
    """
    one = space.GetFE(ElementId(VOL, int(elements[0])))
    rule = IntegrationRule(one.type, 2 * space.globalorder)
    shapes = np.array([np.array(one.CalcShape(*point)) for point in rule.points])
    numbers = GridFunction(space)
    numbers.vec.FV().NumPy()[:] = np.arange(space.ndof)
    everywhere = space.mesh.Materials(".*")
    values = numbers(space.mesh.MapToAllElements({one.type: rule}, everywhere))
    found = np.reshape(values, (len(elements), -1)) @ np.linalg.pinv(shapes).T
    return np.rint(found).astype(int)


def slopes_to_strain(kinematics: Kinematics) -> np.ndarray:
    """The basis of ``Elements``: trace and deviator of a strain by slopes, (s, N, slopes)."""
    N = kinematics.N
    basis = np.concatenate([np.eye(N)[None], kinematics.basis[:, :N, :N]])
    if not kinematics.hoop:
        return basis
    hoop_entries = np.append(1.0, kinematics.basis[:, 2, 2])
    ring = hoop_entries[:, None, None] * np.eye(N)[:, :1]
    return np.concatenate([basis, ring], axis=2)


class Points:
    """The integration points of a mesh for displacements of one order.

    ``mean_volume`` averages tr eps over each element, which avoids volumetric locking of
    quadrilaterals and hexahedra of order one (docs/locking.md).
    """

    rules: dict[ET, IntegrationRule]
    """Integration rules for ``dx(intrules=...)`` and ``mesh.MapToAllElements``."""
    scalar: H1  # the space of one displacement component; its degrees of freedom are the nodes
    weights: np.ndarray  # volume that belongs to each point, shape (points,)
    blocks: list[Elements]  # one for each shape
    processes: Team  # that share the mesh; each has the points of its own elements
    seen: dict[
        int, object
    ]  # data of the material that the points miss, by ``finer.seen``

    def __init__(
        self,
        mesh: Mesh,
        kinematics: Kinematics,
        order: int,
        *,
        mean_volume: bool = False,
        scalar: H1 | None = None,
    ) -> None:
        self.mesh = mesh
        self.kinematics = kinematics
        self.order = order
        self.seen = {}
        self.processes = nodal_processes_of(mesh, order)
        self.rules = plastic_points(mesh, order)
        self.scalar = H1(mesh, order=order) if scalar is None else scalar
        self._mapped = mesh.MapToAllElements(self.rules, mesh.Materials(".*"))
        jacobians = specialcf.JacobianMatrix(mesh.dim)(self._mapped)
        jacobians = jacobians.reshape(-1, mesh.dim, mesh.dim)
        around = self.at(kinematics.weight) if kinematics.hoop else kinematics.thickness
        self.weights = np.abs(determinants(jacobians)) * around
        self.blocks = list(self._blocks(inverses(jacobians), mean_volume))

    def __getstate__(self) -> dict:
        """Everything except the mapped points, which refer to their mesh in memory."""
        left_out = ("_mapped", "functions", "seen")
        return {name: part for name, part in vars(self).items() if name not in left_out}

    def __setstate__(self, state: dict) -> None:
        vars(self).update(state, seen={})
        whole = self.mesh.Materials(".*")
        self._mapped = self.mesh.MapToAllElements(self.rules, whole)

    def __len__(self) -> int:
        return len(self.weights)

    def misses_like(self, other: Points) -> None:
        """Take from other points at the same places what they miss of data, now and later."""
        self.seen = other.seen

    @cached_property
    def functions(self) -> PointFunctions:
        """The polynomials through values at the points."""
        return PointFunctions(self)

    def at(self, value: CoefficientFunction | float) -> np.ndarray:
        """A coefficient at the points, shape (points,) or (points, components); to be read only."""
        if not isinstance(value, CoefficientFunction):
            return np.broadcast_to(float(value), len(self._mapped))
        values = np.asarray(value(self._mapped)).reshape(len(self._mapped), -1)
        return values[:, 0].copy() if not value.dims else values

    def coordinates(self, tensor: CoefficientFunction) -> np.ndarray:
        """The d coordinates of the deviator of a symmetric tensor at the points, (points, d)."""
        size = self.kinematics.size
        values = self.at(tensor).reshape(-1, size, size)
        return np.einsum("dij,pij->pd", self.kinematics.basis, values)

    def _blocks(self, to_reference: np.ndarray, averaged: bool) -> Iterator[Elements]:
        """The elements of each shape, from the inverse Jacobians at the points."""
        basis = slopes_to_strain(self.kinematics)
        alike = elements_by_shape(self.mesh)
        kinds = [
            self.scalar.GetFE(ElementId(VOL, int(of_shape[0]))) for of_shape, _ in alike
        ]
        sizes = np.zeros(self.mesh.ne, dtype=int)
        for (of_shape, _), element in zip(alike, kinds, strict=True):
            sizes[of_shape] = len(self.rules[element.type])
        firsts = np.cumsum(sizes) - sizes
        for (of_shape, nodes), fe in zip(alike, kinds, strict=True):
            rule = self.rules[fe.type]
            points = firsts[of_shape][:, None] + np.arange(len(rule))
            self.weights[points] *= np.array(rule.weights)
            if self.order == 2:
                nodes = unknowns_of(self.scalar, of_shape)
            shapes = np.array([np.array(fe.CalcShape(*point)) for point in rule.points])
            slopes = np.array([np.array(fe.CalcDShape(*p)) for p in rule.points])
            slopes = np.matmul(slopes, to_reference[points])
            if self.kinematics.hoop:
                hoop = shapes / self.at(x)[points][:, :, None]
                slopes = np.concatenate([slopes, hoop[..., None]], axis=3)
            yield Elements(
                basis,
                self.kinematics.size,
                averaged,
                shapes,
                nodes,
                points,
                self.weights[points],
                slopes,
            )

    def strain(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """tr eps(u) and the coordinates of dev eps(u), shapes (points,) and (points, d)."""
        strain = np.empty((len(self), 1 + self.kinematics.d))

        def enter(part: Elements) -> None:
            """Store the strains of some elements."""
            strain[part.points] = part.strain(u)

        for block in self.blocks:
            deque(in_order(enter, block.row_parts), maxlen=0)
        return strain[:, 0].copy(), strain[:, 1:].copy()

    def forces(self, pressure: np.ndarray, deviator: np.ndarray) -> np.ndarray:
        """Nodal forces of a stress with this mean part and these deviatoric coordinates.

        ``pressure`` is the factor of tr eps(v) in sigma : eps(v), tr(sigma)/size; the result has
        shape (nodes, N).
        """
        stress = np.column_stack([pressure, deviator])
        return self._gathered(lambda part: part.forces(stress))

    def diagonal(self, bulk: np.ndarray, shear: np.ndarray) -> np.ndarray:
        """Diagonal of B' C B for C = bulk I (x) I + shear Id, shape (nodes, N)."""
        return self._gathered(lambda part: part.diagonal(bulk, shear))

    def _gathered(self, local: Callable[[Elements], np.ndarray]) -> np.ndarray:
        """Sums over elements of the values at their nodes, shape (nodes, N)."""
        N = self.kinematics.N
        parts = [part for block in self.blocks for part in block.row_parts]
        values = [found.reshape(-1, N) for found in in_order(local, parts)]
        nodes = np.concatenate([block.nodes.ravel() for block in self.blocks])
        sums = [
            np.bincount(nodes, column, self.scalar.ndof)
            for column in np.concatenate(values).T
        ]
        return self.processes.summed(np.stack(sums, axis=1))

    def cell_means(self, values: np.ndarray) -> np.ndarray:
        """The mean over its element at each point, shape (points,)."""
        means = np.empty(len(self))
        for block in self.blocks:
            shares = block.weights / block.weights.sum(axis=1, keepdims=True)
            mean = (shares * values[block.points]).sum(axis=1)
            means[block.points] = mean[:, None]
        return means

    def integral(self, density: np.ndarray) -> float:
        """The integral of a density given at the points."""
        return self.processes.total(float(self.weights @ density))


class PointFunctions:
    """Discontinuous polynomials that are determined by their values at the points."""

    def __init__(self, points: Points) -> None:
        self.points = points
        self._scalar = L2(points.mesh, order=plastic_order(points.mesh, points.order))
        self._spaces: dict[int, FESpace] = {}
        self._inverses = []
        shape = GridFunction(self._scalar)
        for numbers in (block.points for block in points.blocks):
            values = np.empty((*numbers.shape, numbers.shape[1]))
            for k, those in enumerate(numbers.T):
                shape.vec[:] = 0.0
                # unknowns are numbered in the order of the points
                shape.vec.FV().NumPy()[those] = 1.0
                values[:, :, k] = points.at(shape)[numbers]
            self._inverses.append(np.linalg.inv(values))

    def function(self, values: np.ndarray, name: str = "gfu") -> GridFunction:
        """The function with these values at the points, shape (points,) or (points, d)."""
        columns = values.reshape(len(values), -1)
        space = self._scalar if values.ndim == 1 else self._vectors(columns.shape[1])
        result = GridFunction(space, name=name)
        result.vec.FV().NumPy()[:] = self._applied(self._inverses, columns).T.ravel()
        return result

    def _vectors(self, components: int) -> FESpace:
        """The space of functions with this number of components, made once."""
        if components not in self._spaces:
            self._spaces[components] = VectorValued(self._scalar, components)
        return self._spaces[components]

    def transposed(self, slope: np.ndarray, components: int) -> np.ndarray:
        """Derivatives by the values at the points, (points, components), from those by ``vec``."""
        transposed = [inverse.swapaxes(1, 2) for inverse in self._inverses]
        return self._applied(transposed, slope.reshape(components, -1).T)

    def _applied(self, matrices: list[np.ndarray], columns: np.ndarray) -> np.ndarray:
        """Matrices of the elements of each shape times the values at their points."""
        result = np.empty_like(columns)
        for block, matrix in zip(self.points.blocks, matrices, strict=True):
            result[block.points] = matrix @ columns[block.points]
        return result


def on_children(
    values: np.ndarray, before: Points, after: Points, parents: np.ndarray
) -> np.ndarray:
    """Piecewise constant or affine functions at the points of a nested finer mesh, exactly.

    ``values`` are at the points of simplices, one or N + 1 of each; ``parents`` are the cells that
    those of the second mesh lie in.
    """
    known, wanted = (
        np.stack([points.at(v) for v in (1.0, x, y, z)], axis=1).reshape(
            points.mesh.ne, -1, 4
        )
        for points in (before, after)
    )
    q = known.shape[1]  # as many of 1, x, y, z
    shares = np.matmul(wanted[:, :, :q], np.linalg.inv(known[:, :, :q])[parents])
    carried = np.matmul(shares, values.reshape(len(known), q, -1)[parents])
    return carried.reshape(len(after), *values.shape[1:])


def interpolated(problem: Problem, value: CoefficientFunction) -> GridFunction:
    """The discontinuous polynomial with the values of a coefficient at the points of a problem."""
    points = Points(problem.mesh, problem.kinematics, problem.order)
    return points.functions.function(points.at(value))
