"""Supports of a problem at the nodes: what they hold, the displacements they give, their springs.

Nodal arrays have shape (nodes, N): one row for each degree of freedom of a displacement component.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from ngsolve import BND, CF, H1, BilinearForm, FESpace, GridFunction
from scipy.sparse import csr_matrix, hstack

from ngepc.checks.arguments import Coefficient, boundary_names
from ngepc.discretisation.loads import region_measure
from ngepc.discretisation.slanted import SlantedNodes, unit_columns
from ngepc.discretisation.spaces import displacement_space, nodal, nodes_at
from ngepc.model.data import as_scalar, same_fields
from ngepc.model.elements import vertex_coordinates
from ngepc.model.places import Place, Point, values_at, vertices_at
from ngepc.model.problem import Problem


def shares_of_supports(problem: Problem) -> dict[Place, np.ndarray]:
    """Single place -> its share of the forces at held components, (N, nodes).

    A component that several supports hold at a node is shared equally among them.
    """
    scalar = H1(problem.mesh, order=problem.order)
    shape = (problem.N, scalar.ndof)
    supports = (*problem.clamped_names, *problem.single("prescribed"))
    here = {place: np.zeros(shape) for place in supports}
    for _, place, axis, _ in problem.held:
        here[place][axis, nodes_at(scalar, place)] = 1.0

    def on_all_processes(mask: np.ndarray) -> np.ndarray:
        """1 at components that the support holds here or on another process, else 0."""
        processes = problem.nodal_processes
        return np.minimum(processes.summed(mask.T).T, 1.0)

    held = {place: on_all_processes(mask) for place, mask in here.items()}
    count = sum(held.values(), np.zeros(shape))
    return {place: mask / np.maximum(count, 1.0) for place, mask in held.items()}


def support_motion(problem: Problem, support: str, component: int) -> np.ndarray:
    """The unit motion of a support along a component, (nodes, N): one at its vertices.

    Where other supports hold a vertex, too, it is the share of this one.  The work of all forces
    in this motion is the reaction.

    ValueError if the support does not hold the component.
    """
    names = boundary_names("support", support, problem.mesh)
    shares = shares_of_supports(problem)
    held = [shares[name][component] for name in names if name in shares]
    if len(held) < len(names) or not all(share.any() for share in held):
        hint = ""
        if set(names) & set(problem.single("springs")):
            hint = (
                "; the force of its springs is the integral of -k u: LoadWork with the traction "
                "-k has its interval, a function of u its derivative"
            )
        raise ValueError(
            f"support={support!r}: it does not hold component {component}{hint}"
        )
    motion = np.zeros((len(held[0]), problem.N))
    vertices = problem.mesh.nv
    motion[:vertices, component] = sum(held)[:vertices]
    return motion


def prescribed_displacement(problem: Problem, V: FESpace) -> GridFunction:
    """A function in ``V`` with the prescribed values, linear on edges, zero at all free nodes."""
    lift = GridFunction(V)
    for _, place, axis, component in problem.held:
        if place not in problem.clamped_names:
            nodes, values = given_at(V.components[axis], place, component)
            lift.vec.FV().NumPy()[V.Range(axis).start + nodes] = values
    return lift


def given_at(
    scalar: FESpace, place: Place, value: Coefficient
) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of a place, and a given function there, linear on edges."""
    if not isinstance(place, str):
        vertices, values = values_at(value, scalar.mesh, place)
        return vertices, values[:, 0]
    function = GridFunction(scalar)
    nodes = nodes_at(scalar, place)
    function.Set(as_scalar(value), definedon=scalar.mesh.Boundaries(place))
    return nodes, function.vec.FV().NumPy()[nodes]


def spring_matrix(
    problem: Problem, V: FESpace, place: Place, springs: list[tuple]
) -> csr_matrix:
    """Forces per displacement, flattened node by node, of one of ``Problem.spring_constants``."""
    if isinstance(place, Point):
        return _springs_at_point(problem, V, place, springs)
    u, v = V.TnT()
    density = 0
    for given, k in springs:
        direction = problem.normal if given is None else CF(tuple(given))
        density += as_scalar(k) * (direction * u) * (direction * v)
    form = BilinearForm(V)
    form += problem.kinematics.weight * density * region_measure(problem, place)
    entries = tuple(map(np.asarray, form.Assemble().mat.CSR()))
    matrix = csr_matrix(entries, shape=(V.ndof, V.ndof))
    by_node = nodal(np.arange(V.ndof), problem).ravel()
    matrix = matrix[by_node][:, by_node]
    matrix.eliminate_zeros()
    return matrix


def _springs_at_point(
    problem: Problem, V: FESpace, place: Point, springs: list[tuple]
) -> csr_matrix:
    """Springs along the axes at a point, on the diagonal."""
    vertices = vertices_at(place, problem.mesh)
    rows = (problem.N * vertices[:, None] + np.arange(problem.N)).ravel()
    stiffness = [values_at(k, problem.mesh, place)[1][:, 0] for _, k in springs]
    entries = np.stack(stiffness, axis=1).ravel()
    return csr_matrix((entries, (rows, rows)), shape=(V.ndof, V.ndof))


class Supports:
    """The supports of the body: held components, given displacements and springs."""

    scalar: H1  # the space of one component of the displacement
    free: np.ndarray  # boolean, shape (nodes, N): components that no support holds
    values: np.ndarray  # prescribed displacements, zero elsewhere, shape (nodes, N)
    springs: dict[Place, csr_matrix]
    """Their forces per displacement, u flattened node by node."""
    stiffness: csr_matrix  # the sum of ``springs``
    slanted: SlantedNodes | None = None
    """Nodes that supports hold along other directions than axes; None where rows hold these."""

    def __init__(self, problem: Problem, like: Supports | None = None) -> None:
        """``like`` are supports of the same components of the same mesh, or None."""
        self.problem = problem
        if like is None:
            self.scalar = H1(problem.mesh, order=problem.order)
        else:
            self.scalar = like.scalar
            self._take_space(like)
        holding, lift = self._held()
        processes = problem.nodal_processes
        holding = processes.summed(holding)
        self.values = processes.summed(lift) / np.maximum(holding, 1)
        if like is not None and same_fields(problem, like.problem, "springs"):
            self.free = like.free
            self.springs = like.springs
            self.stiffness = like.stiffness
            return
        self.free = holding == 0
        if problem.kinematics.hoop:
            self._hold_axis()
        constants = problem.spring_constants.items()
        self.springs = {
            p: spring_matrix(problem, self.space, p, k) for p, k in constants
        }
        self.stiffness = sum(self.springs.values(), csr_matrix(2 * (holding.size,)))

    @cached_property
    def space(self) -> FESpace:
        """``displacement_space``: solvers do without it."""
        return displacement_space(self.problem)

    def _take_space(self, like: Supports) -> None:
        """Take over the space of the displacements if it was made."""
        if "space" in vars(like):
            vars(self)["space"] = like.space

    def _held(self) -> tuple[np.ndarray, np.ndarray]:
        """Ones where a component is held, and given displacements there, both (nodes, N)."""
        problem = self.problem
        holding = np.zeros((self.scalar.ndof, problem.N))
        lift = np.zeros_like(holding)
        for _, place, axis, component in problem.held:
            holding[nodes_at(self.scalar, place), axis] = 1.0
            if place not in problem.clamped_names:
                nodes, values = given_at(self.scalar, place, component)
                lift[nodes, axis] = values
        return holding, lift

    def _hold_axis(self) -> None:
        """On the axis of a body of revolution the radial displacement vanishes."""
        mesh = self.problem.mesh
        radii = np.abs(vertex_coordinates(mesh)[:, 0])
        scalar = self.scalar
        there = radii <= 1e-12 * radii.max()
        self.free[: len(there)][there, 0] = False
        for facet in mesh.Elements(BND):
            if all(there[vertex.nr] for vertex in facet.vertices):
                self.free[list(scalar.GetDofNrs(facet)), 0] = False

    def holds_like(self, other: Supports) -> bool:
        """Whether the same components are held, by the same springs."""
        same = self.free is other.free and self.stiffness is other.stiffness
        return self is other or (same and not self.problem.rollers)

    def kept(self, vectors: np.ndarray) -> np.ndarray:
        """The parts of vectors (nodes, N) along which no support holds the nodes."""
        result = np.where(self.free, vectors, 0.0)
        if self.slanted is not None:
            nodes = self.slanted.nodes
            result[nodes] = self.slanted.free_parts(vectors[nodes])
        return result

    def kept_at(self, nodes: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """The same for one vector at each of some nodes, (nodes, N)."""
        result = np.where(self.free[nodes], vectors, 0.0)
        if self.slanted is not None:
            self.slanted.keep_at(nodes, vectors, result)
        return result

    def admissible(self, u: np.ndarray) -> np.ndarray:
        """Displacements (nodes, N) with the prescribed values where supports hold them."""
        result = np.where(self.free, u, self.values)
        if self.slanted is not None:
            nodes = self.slanted.nodes
            result[nodes] = self.slanted.values + self.slanted.free_parts(u[nodes])
        return result

    def basis(self, there: np.ndarray) -> csr_matrix:
        """Orthonormal displacements that supports allow at the nodes ``there`` (booleans).

        Columns are displacements flattened node by node.
        """
        if self.slanted is None:
            return unit_columns(self.free & there[:, None])
        usual = there.copy()
        usual[self.slanted.nodes] = False
        columns = unit_columns(self.free & usual[:, None])
        return hstack([columns, self.slanted.columns(there)], format="csr")

    def pull(self, u: np.ndarray, place: Place | None = None) -> np.ndarray:
        """The forces on the springs, of one place or of all, at displacements, both (nodes, N)."""
        matrix = self.stiffness if place is None else self.springs[place]
        return self.problem.nodal_processes.summed(
            (matrix @ u.ravel()).reshape(u.shape)
        )

    def function(self, u: np.ndarray, name: str = "displacement") -> GridFunction:
        """The displacement with these nodal values."""
        result = GridFunction(self.space, name=name)
        result.vec.FV().NumPy()[:] = u.T.ravel()
        return result
