"""Strains at the integration points as rows on nodal displacements; forces and stiffnesses.

A strain is its trace and the d coordinates of its deviator, a stress what they are multiplied with:
s = 1 + d numbers.  The discrete problem needs only the rows B of these numbers at the points, and
the weights of the points: forces are B' times stresses, stiffnesses B' C B.  Slopes of the shape
functions are kept; rows would be five times as many numbers, and are computed when they are needed.
Arrays over the points follow the elements, rule point by rule point; nodal arrays have shape
(nodes, N).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil

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
from scipy.sparse import csr_matrix

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

CHUNK = 400_000
"""Numbers in the matrices of the elements that are held in memory at once.

With fewer threads wait for each other: each call of NumPy lets go of Python's lock and takes it
back.  A thread that has to wait for it is woken up some 50 microseconds later.
"""

SMALL = 200_000
"""Fewer numbers are not divided."""


@dataclass(frozen=True, eq=False)
class Elements:
    """The elements of one shape, k nodes and p points each.

    Slopes are the N derivatives, on bodies of revolution also that along the circumference, 1/r.
    """

    basis: np.ndarray
    """Numbers of a strain by the slopes of a displacement, shape (s, N, slopes)."""
    size: int  # tensors are size x size
    averaged: bool  # tr eps is the mean over each element
    shapes: np.ndarray  # shape functions at the points, shape (p, k)
    nodes: np.ndarray  # numbers, shape (elements, k)
    points: np.ndarray  # numbers among all points, shape (elements, p)
    weights: np.ndarray  # of the points, shape (elements, p)
    slopes: np.ndarray
    """Derivatives of the shape functions at the points, shape (elements, p, k, slopes)."""

    def chunks(self, numbers: int) -> list[slice]:
        """The elements in an even number of parts; of each element so many ``numbers``.

        There is one part if they are few.
        """
        elements = len(self.nodes)
        total = numbers * elements
        if total < SMALL:
            return [slice(0, elements)]
        count = 2 * ceil(total / (2 * CHUNK))
        size = max(1, ceil(elements / count))
        return [slice(first, first + size) for first in range(0, elements, size)]

    def of(self, chosen: np.ndarray | slice) -> Elements:
        """Some of the elements."""
        names = ("nodes", "points", "weights", "slopes")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    @property
    def matrix_chunks(self) -> list[slice]:
        """Parts for matrices of the elements."""
        return self.chunks(self.basis.shape[1] ** 2 * self.shapes.shape[1] ** 2)

    @property
    def row_parts(self) -> list[Elements]:
        """Parts for what has the size of the slopes, as views."""
        return [self.of(chosen) for chosen in self.chunks(self.slopes[0].size)]

    @property
    def _shares(self) -> np.ndarray:
        """Of the points in their elements, shape (elements, p)."""
        return self.weights / self.weights.sum(axis=1, keepdims=True)

    def rows(self) -> np.ndarray:
        """Rows of strains on the nodal displacements node by node, (elements, p, s, k N)."""
        # E : eps(phi_i e_c) = E[c, :] . grad phi_i for symmetric E
        rows = np.einsum("scj,epkj->epskc", self.basis, self.slopes, optimize=True)
        rows = rows.reshape(*rows.shape[:3], -1)
        if self.averaged:
            rows[:, :, 0] = np.einsum("ep,epk->ek", self._shares, rows[:, :, 0])[
                :, None
            ]
        return rows

    def strain(self, u: np.ndarray) -> np.ndarray:
        """Strains, shape (elements, p, s): the rows times u, without making them."""
        slopes = np.matmul(u[self.nodes].swapaxes(1, 2)[:, None], self.slopes)
        basis = self.basis.reshape(len(self.basis), -1)
        found = (slopes.reshape(-1, basis.shape[1]) @ basis.T).reshape(
            *slopes.shape[:2], -1
        )
        if self.averaged:
            found[:, :, 0] = (self._shares * found[:, :, 0]).sum(axis=1)[:, None]
        return found

    def forces(self, stress: np.ndarray) -> np.ndarray:
        """The transposed rows times weighted stresses (points, s), shape (elements, k, N)."""
        stress = self.weights[:, :, None] * stress[self.points]
        if self.averaged:
            stress[:, :, 0] = self._shares * stress[:, :, 0].sum(axis=1)[:, None]
        s, N, kinds = self.basis.shape
        turned = self.basis.swapaxes(1, 2).reshape(s, -1)
        tensors = stress.reshape(-1, s) @ turned
        at_points = np.matmul(
            self.slopes, tensors.reshape(*stress.shape[:2], kinds, N)
        ).swapaxes(0, 1)
        return sum(at_points[1:], at_points[0])

    def diagonal(self, bulk: np.ndarray, shear: np.ndarray) -> np.ndarray:
        """Diagonal of B' C B for C = bulk I (x) I + shear Id, shape (elements, k, N).

        A square of a row b . g is b b' : g g', so that products of slopes g are summed, without
        rows.
        """
        bulk, shear = (self.weights * modulus[self.points] for modulus in (bulk, shear))
        products = self.slopes[..., :, None] * self.slopes[..., None, :]
        volume, *shape = np.einsum("scj,sck->sjkc", self.basis, self.basis)
        found = self._product_sums(shear, products) @ _flat_products(sum(shape))
        if not self.averaged:
            return found + self._product_sums(bulk, products) @ _flat_products(volume)
        trace = self.slopes @ self.basis[0].T
        mean = np.einsum("ep,epkc->ekc", self._shares, trace)
        return found + bulk.sum(axis=1)[:, None, None] * mean**2

    def _product_sums(self, weights: np.ndarray, products: np.ndarray) -> np.ndarray:
        """Weighted sums over the points of products of slopes, (elements, k, slopes^2)."""
        count, points, k = products.shape[:3]
        sums = np.matmul(weights[:, None], products.reshape(count, points, -1))
        return sums.reshape(count, k, -1)

    def stiffness(self, moduli: Moduli) -> Iterator[np.ndarray]:
        """B' C B by two matrices of each element, L, then G, shapes (elements, k N, k N).

        Nodes i, j and components a, b have

            L[i a, j b] + G[i b, j a], and where a = b the sum of G[i c, j c] over c.

        With symmetric tensors dev a : dev b = a : b - tr a tr b / size.  The products G of the
        slopes of two nodes give sym(u grad) : sym(v grad) at once, so that only the trace and the
        direction of the moduli need rows.  L should be given up before G is asked for: a cache has
        room for one of them.
        """
        count, points = self.points.shape
        N = self.basis.shape[1]
        if moduli.coupling is None:
            yield _weighted_squares(*self._single_rows(moduli))
        else:
            rows = _weighted_squares(*self._single_rows(moduli))
            yield rows + self._coupled(moduli.coupling)
        slopes = self.slopes[..., :N].reshape(count, points, -1)
        yield _weighted_squares(slopes, 0.5 * self.weights * moduli.across[self.points])

    def _single_rows(self, moduli: Moduli) -> tuple[np.ndarray, np.ndarray]:
        """Rows whose squares with these factors are what remains of B' C B beside a : b.

        Shapes (elements, rows, k N) and (elements, rows).
        """
        count, points = self.points.shape
        bulk = moduli.bulk[self.points]
        across = moduli.across[self.points]
        s, N, kinds = self.basis.shape
        directions = moduli.direction[self.points].reshape(-1, s - 1)
        tensors = directions @ self.basis[1:].swapaxes(1, 2).reshape(s - 1, -1)
        along = np.matmul(self.slopes, tensors.reshape(count, points, kinds, N))
        trace = self.slopes[..., :N]
        if kinds > N:
            trace = trace.copy()
            trace[..., 0] += self.slopes[..., -1]  # the strain along the circumference
        rows = [trace, along]
        factors = [-across / self.size, moduli.extra[self.points]]
        if self.averaged:
            mean = np.einsum("ep,epic->eic", self._shares, trace)
            rows.append(np.broadcast_to(mean[:, None], trace.shape))
            factors.append(bulk)
        else:
            factors[0] = factors[0] + bulk
        if kinds > N:
            hoop = np.zeros(trace.shape)
            hoop[..., 0] = self.slopes[..., -1]
            rows.append(hoop)
            factors.append(across)
        weighted = [self.weights * factor for factor in factors]
        flat = [row.reshape(count, points, -1) for row in rows]
        return np.concatenate(flat, axis=1), np.concatenate(weighted, axis=1)

    def _coupled(self, coupling: np.ndarray) -> np.ndarray:
        """B' C B for symmetric matrices C on (tr, dev), node by node."""
        strains = self.rows()
        weighted = self.weights[:, :, None, None] * coupling[self.points]
        stresses = np.matmul(weighted, strains)
        flat = (len(strains), -1, strains.shape[-1])
        return np.matmul(strains.reshape(flat).swapaxes(1, 2), stresses.reshape(flat))


def _flat_products(matrices: np.ndarray) -> np.ndarray:
    """Matrices (slopes, slopes, N) as maps of flat products of slopes, (slopes^2, N)."""
    return matrices.reshape(-1, matrices.shape[2])


def _weighted_squares(rows: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """The sum over p of factor_p row_p row_p', shape (elements, n, n); rows (elements, p, n)."""
    weighted = rows * factors[:, :, None]
    return np.matmul(weighted.swapaxes(1, 2), rows)


@dataclass(frozen=True, eq=False)
class Moduli:
    """Stress per strain at the points: C = bulk I (x) I + across Id + extra d (x) d + coupling."""

    bulk: np.ndarray  # (stress), shape (points,), as the next two
    across: np.ndarray
    extra: np.ndarray
    direction: np.ndarray  # unit vectors d in deviatoric coordinates, shape (points, d)
    # a symmetric matrix on (tr, dev) to be added, or None, shape (points, 1 + d, 1 + d)
    coupling: np.ndarray | None = None

    def __call__(self, e: np.ndarray) -> np.ndarray:
        """The deviatoric stress of the deviatoric strain ``e``, both in coordinates."""
        along = self.extra * np.einsum("pd,pd->p", self.direction, e)
        stress = self.across[:, None] * e + along[:, None] * self.direction
        if self.coupling is None:
            return stress
        return stress + np.einsum("pij,pj->pi", self.coupling[:, 1:, 1:], e)

    def deviatoric(self) -> np.ndarray:
        """The matrix of deviatoric stress by deviatoric strain, shape (points, d, d)."""
        n = self.direction
        matrix = self.extra[:, None, None] * n[:, :, None] * n[:, None, :]
        matrix = matrix + self.across[:, None, None] * np.eye(n.shape[1])
        return matrix if self.coupling is None else matrix + self.coupling[:, 1:, 1:]

    def stress(
        self, volume: np.ndarray, e: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The stress of a strain: its mean part (points,), its deviator (points, d)."""
        mean = self.bulk * volume
        deviator = self(e)
        if self.coupling is not None:
            mean = mean + self.coupling[:, 0, 0] * volume
            mean = mean + np.einsum("pj,pj->p", self.coupling[:, 0, 1:], e)
            deviator = deviator + self.coupling[:, 1:, 0] * volume[:, None]
        return mean, deviator


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
        self.weights = np.abs(determinants(jacobians)) * self.at(kinematics.weight)
        self.blocks = list(self._blocks(inverses(jacobians), mean_volume))

    def __getstate__(self) -> dict:
        """Everything except the mapped points, which refer to their mesh in memory."""
        left_out = ("_mapped", "functions", "_incidence", "seen")
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
        mesh = self.mesh
        N = self.kinematics.N
        sizes = np.zeros(self.mesh.ne, dtype=int)
        basis = np.concatenate([np.eye(N)[None], self.kinematics.basis[:, :N, :N]])
        if self.kinematics.hoop:
            hoop_entries = np.append(1.0, self.kinematics.basis[:, 2, 2])
            ring = hoop_entries[:, None, None] * np.eye(N)[:, :1]
            basis = np.concatenate([basis, ring], axis=2)
            radii = self.at(x)
        alike = elements_by_shape(mesh)
        kinds = [
            self.scalar.GetFE(ElementId(VOL, int(of_shape[0]))) for of_shape, _ in alike
        ]
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
                hoop = shapes / radii[points][:, :, None]
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
        return self.processes.summed(self._incidence @ np.concatenate(values))

    @cached_property
    def _incidence(self) -> csr_matrix:
        """Ones where a node is one of an element, shape (nodes, nodes of all elements)."""
        nodes = np.concatenate([block.nodes.ravel() for block in self.blocks])
        places = nodes, np.arange(len(nodes))
        shape = (self.scalar.ndof, len(nodes))
        return csr_matrix((np.ones(len(nodes)), places), shape=shape)

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
