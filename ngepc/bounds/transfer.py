"""The data of a problem, and its displacements, on a bisected copy of the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace

import numpy as np
from netgen.meshing import NetgenGeometry
from ngsolve import CF, L2, CoefficientFunction, GridFunction, Integrate, Mesh

from ngepc.bounds.coverage import varies_inside
from ngepc.bounds.simplices import marked
from ngepc.discretisation.points import PointFunctions, Points, on_children
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.model.kinematics import kinematics_of
from ngepc.model.material import Material
from ngepc.model.problem import Problem

# how near bisections come to what should be left, which mostly falls faster than expected
CLOSE = 1.03


def bisected(mesh: Mesh, chosen: np.ndarray) -> Mesh:
    """A copy of the mesh with the chosen elements bisected, and neighbours to conform."""
    finer = copied(mesh)
    finer.SetRefinementFlags(chosen.tolist())
    finer.Refine()
    return finer


def copied(mesh: Mesh) -> Mesh:
    """What can be bisected: spaces on meshes that Netgen has refined before transfer wrongly.

    The body stays what the mesh is: new vertices are not moved to curved boundaries.
    """
    netgen_mesh = mesh.ngmesh.Copy()
    netgen_mesh.SetGeometry(NetgenGeometry())
    return Mesh(netgen_mesh)


def bisected_to(mesh: Mesh, indicators: np.ndarray, share: float, left: float) -> Mesh:
    """A copy of the mesh, bisected until this part of the indicators should be left.

    The part v of an element's volume is expected to get the part v^(1 + 2/N) of its indicator, as
    for order one and smooth solutions: where edges are halved three quarters go.  Those with a
    share of what is left are bisected at a time (Doerfler), or fewer at the end.
    """
    finer, sums = copied(mesh), np.maximum(indicators, 0.0)
    density = GridFunction(L2(finer, order=0, autoupdate=True), autoupdate=True, nested=True)

    def scale() -> np.ndarray:
        return np.array(Integrate(CF(1), finer, element_wise=True)) ** (1 + 2 / mesh.dim)

    density.vec.FV().NumPy()[:] = sums / scale()
    wanted = left * sums.sum()
    while finer.ne == mesh.ne or sums.sum() > CLOSE * wanted:
        chosen = marked(sums, min(share, (1 - wanted / sums.sum()) / 0.75))
        finer.SetRefinementFlags(chosen.tolist())
        finer.Refine()
        sums = density.vec.FV().NumPy() * scale()
    return finer


def check_carried(problem: Problem) -> None:
    """Refuse, by name, boundary data made of finite element functions: they belong to one mesh."""
    data: dict[str, object] = {"gap": problem.gap, "traction": problem.traction}
    data |= {"prescribed": problem.prescribed, "pressure": problem.pressure}
    if problem.f is not None and varies_inside(problem, problem.f):
        data["body_force"] = problem.f
    data |= {"friction": problem.friction, "initial_displacement": problem.initial_displacement}
    for name, value in data.items():
        for one in values_in(value):
            if "gridfunction" in str(one).lower():
                raise ValueError(
                    f"{name} is made of a GridFunction, which belongs to one mesh: numbers or "
                    "functions of position are needed"
                )


def values_in(value: object) -> list[CoefficientFunction]:
    """The coefficient functions in a value, a mapping or a sequence."""
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [one for item in value for one in values_in(item)]
    return [value] if isinstance(value, CoefficientFunction) else []


def on_mesh(problem: Problem, mesh: Mesh) -> Problem:
    """The problem on a mesh that refines its own.

    Data that are constant on the elements of the problem's mesh stay what they are, with order two
    affine plastic strains and back stresses too.  What was checked holds on a finer mesh as well.
    """
    data = {f.name: getattr(problem, f.name) for f in fields(Problem)}
    carry = Carrier(problem.mesh, mesh)
    material = problem.material
    carried = {f.name: carry(getattr(material, f.name)) for f in fields(Material)}
    data["mesh"], data["material"] = mesh, replace(material, **carried)
    data["initial_accumulated"] = carry(data["initial_accumulated"])
    data["initial_plastic_strain"] = carry(data["initial_plastic_strain"], problem.order)
    if problem.f is not None and not varies_inside(problem, problem.f):
        data["body_force"] = carry(problem.f)
    hardening = data["initial_hardening"]
    if isinstance(hardening, tuple):
        data["initial_hardening"] = carry(hardening[0]), carry(hardening[1], problem.order)
    else:
        data["initial_hardening"] = carry(hardening, problem.order)
    finer = object.__new__(Problem)
    vars(finer).update(data)
    return finer


def parents(old: Mesh, new: Mesh) -> np.ndarray:
    """For each element of a mesh the number of the element of the coarser one that it lies in."""
    number = GridFunction(L2(old, order=0))
    number.vec.FV().NumPy()[:] = np.arange(old.ne)
    centres = vertex_coordinates(new)[element_nodes(new)[:, : new.dim + 1]].mean(axis=1)
    return np.ravel(number(old(*centres.T))).round().astype(int)


class Carrier:
    """Coefficients that are constant or affine on the cells of one mesh, on a finer one."""

    def __init__(self, old: Mesh, new: Mesh) -> None:
        self._meshes, self._parents = (old, new), parents(old, new)

    def __call__(self, value: object, order: int = 1) -> object:
        """A number or a coefficient; affine ones belong to problems of order two."""
        if not isinstance(value, CoefficientFunction):
            return value
        kinematics = kinematics_of(None, self._meshes[0].dim)
        before, after = (Points(m, kinematics, order) for m in self._meshes)
        values = on_children(before.at(value), before, after, self._parents)
        function = PointFunctions(after).function(values)
        if function.dim == 1:
            return function
        entries = tuple(function[i] for i in range(function.dim))
        return CF(entries, dims=tuple(value.dims)) if len(value.dims) == 2 else CF(entries)


def carried_parabolas(old: State, discrete: DiscreteProblem) -> np.ndarray:
    """Displacements of order two on a bisected mesh of triangles, shape (nodes, 2).

    An unknown of an edge is -8 times what the middle exceeds the mean of the ends by.
    """
    before, after = old.discrete.points.blocks[0].nodes, discrete.points.blocks[0].nodes
    parent = parents(old.discrete.problem.mesh, discrete.problem.mesh)
    corners = vertex_coordinates(old.discrete.problem.mesh)[before[parent, :3]]
    x = vertex_coordinates(discrete.problem.mesh)[after[:, :3]]
    ends = [(2, 0), (1, 2), (0, 1)]
    middles = np.stack([(x[:, a] + x[:, b]) / 2 for a, b in ends], axis=1)
    there = np.concatenate([x, middles], axis=1) - corners[:, :1]
    frame = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    share = np.matmul(there, np.linalg.inv(frame).transpose(0, 2, 1))
    share = np.concatenate([1 - share.sum(axis=2, keepdims=True), share], axis=2)
    bubbles = np.stack([-share[:, :, a] * share[:, :, b] / 2 for a, b in ends], axis=2)
    values = np.matmul(np.concatenate([share, bubbles], axis=2), old.u[before[parent]])
    for k, (a, b) in enumerate(ends):
        values[:, 3 + k] = 4 * (values[:, a] + values[:, b]) - 8 * values[:, 3 + k]
    u = np.empty_like(discrete.supports.values)
    u[after] = values
    return u


def carried_state(old: State, discrete: DiscreteProblem) -> State:
    """The state on a bisected mesh: the same displacements, contact forces as means of parents'."""
    mesh, before = discrete.problem.mesh, old.discrete
    count, N, rows = before.problem.mesh.nv, old.u.shape[1], before.rows
    nodal = np.zeros((mesh.nv, 2 * N + 1))
    nodal[:count, :N] = old.u[:count]
    forces = np.bincount(rows.vertices, old.multipliers, minlength=count)
    area = np.bincount(rows.vertices, rows.weights, minlength=count)
    dragged = rows.friction_forces(old.tangential_forces)
    stress = np.column_stack([forces, dragged[:count]]) / np.where(area > 0, area, 1.0)[:, None]
    nodal[:count, N:] = stress
    for vertex in range(count, mesh.nv):
        a, b = mesh.GetParentVertices(vertex)
        nodal[vertex] = (nodal[a] + nodal[b]) / 2
    supports, there = discrete.supports, discrete.rows
    u = nodal[:, :N] if discrete.problem.order == 1 else carried_parabolas(old, discrete)
    u = np.where(supports.free, u, supports.values)
    forces = nodal[there.vertices, N:] * there.weights[:, None]
    dragged = np.einsum("mdc,mc->md", there.tangents, forces[:, 1:])
    contact = np.concatenate([forces[:, 0], dragged.ravel()])
    return discrete.state(u, contact=contact[: len(discrete.contact)])
