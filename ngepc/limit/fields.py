"""The mesh, the stress and the mechanism of a limit load as functions to draw and to evaluate."""

from __future__ import annotations

import numpy as np
from ngsolve import (
    CF,
    H1,
    L2,
    CoefficientFunction,
    Discontinuous,
    GridFunction,
    Mesh,
    VectorH1,
)

from ngepc.bounds.contact import BUBBLE
from ngepc.geometries.outlines import netgen_mesh
from ngepc.limit.data import LimitData
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.static import AdmissibleStress
from ngepc.limit.yielding import YieldShape


def mesh_of(data: LimitData, original: Mesh, length: float) -> Mesh:
    """The cells as a mesh with the names of the original one; ``length`` is their unit."""
    cells = data.cells
    N = cells.N
    groups = []
    materials = original.GetMaterials()
    for number in np.unique(data.region):
        groups.append((N, materials[number], cells.nodes[data.region == number]))
    names = original.GetBoundaries()
    for number in np.unique(data.side[cells.outer]):
        groups.append((N - 1, names[number], cells.facets[data.side == number]))
    return Mesh(netgen_mesh(N, length * cells.points, groups))


def cell_order(data: LimitData) -> np.ndarray:
    """Numbers of the cells in the order of the elements of ``mesh_of``."""
    return np.argsort(data.region, kind="stable")


def on_elements(mesh: Mesh, values: np.ndarray) -> GridFunction:
    """A function with one value on each element."""
    result = GridFunction(L2(mesh, order=0))
    result.vec.FV().NumPy()[:] = values
    return result


def discontinuous(mesh: Mesh, values: np.ndarray) -> GridFunction:
    """A vector that is affine on each element, with values (elements, vertices, N)."""
    space = Discontinuous(H1(mesh, order=1))
    result = GridFunction(space**mesh.dim)
    components = values.reshape(-1, mesh.dim).T
    for component, numbers in zip(result.components, components, strict=True):
        component.vec.FV().NumPy()[:] = numbers
    return result


def stress_function(
    mesh: Mesh,
    data: LimitData,
    shape: YieldShape,
    stress: AdmissibleStress,
    unit: float,
) -> CoefficientFunction:
    """The tensor of an admissible stress."""
    order = cell_order(data)
    space = Discontinuous(H1(mesh, order=1))
    tensors = np.einsum("tic,cpq->tipq", stress.coordinates[order], shape.basis)
    entries = []
    for p in range(shape.N):
        for q in range(shape.N):
            entry = GridFunction(space)
            entry.vec.FV().NumPy()[:] = unit * tensors[:, :, p, q].ravel()
            entries.append(entry)
    return CF(tuple(entries), dims=(shape.N, shape.N))


def velocity_function(
    mesh: Mesh, data: LimitData, mechanism: Mechanism
) -> GridFunction:
    """The velocity of a mechanism, with a largest speed of one."""
    cells = data.cells
    values = mechanism.values
    speed = np.linalg.norm(values, axis=2).max()
    if cells.N == 3:
        return discontinuous(mesh, values[cell_order(data)] / speed)
    result = GridFunction(VectorH1(mesh, order=2))
    corners = np.empty(cells.points.shape)
    corners[cells.nodes] = values[:, : cells.N + 1]
    middles = np.empty((len(cells.facets), cells.N))
    middles[cells.facet_of] = values[:, cells.N + 1 :]
    ends = np.array([[v.nr for v in edge.vertices] for edge in mesh.edges])
    bubbles = middles[cells.facets_between(ends)] - corners[ends].mean(axis=1)
    whole = np.concatenate([corners, 4 * bubbles / BUBBLE])
    result.vec.FV().NumPy()[:] = (whole / speed).T.ravel()
    return result
