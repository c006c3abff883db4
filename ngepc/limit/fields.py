"""The mesh, the stress and the mechanism of a limit load as functions to draw and to evaluate."""

from __future__ import annotations

import math

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
    VectorL2,
)

from ngepc.geometries.outlines import netgen_mesh
from ngepc.limit.data import LimitData
from ngepc.limit.mechanism import Mechanism
from ngepc.limit.static import AdmissibleStress
from ngepc.limit.yielding import YieldShape
from ngepc.linalg.bernstein import bernstein_values, multi_indices

ROUNDED = 1e-14
"""Coefficients of velocities below this fraction of the largest are set to zero."""


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
    """The velocity of a mechanism, with a largest speed of one.

    It is continuous in the plane and discontinuous between elements in three dimensions.
    """
    N = data.cells.N
    degree = mechanism.degree
    values = mechanism.values[cell_order(data)]
    speed = np.linalg.norm(corner_values(values, degree), axis=2).max()
    values = values / speed
    space = VectorL2 if N == 3 else VectorH1
    result = GridFunction(space(mesh, order=degree))
    result.Set(polynomial(mesh, values, degree))
    numbers = result.vec.FV().NumPy()
    numbers[np.abs(numbers) < ROUNDED * np.abs(numbers).max()] = 0.0
    return result


def corner_values(coefficients: np.ndarray, degree: int) -> np.ndarray:
    """Values at the vertices of each cell from Bernstein coefficients, (nc, N + 1, ...)."""
    N = coefficients.shape[2]
    return bernstein_values(degree, np.eye(N + 1)) @ coefficients


def polynomial(mesh: Mesh, values: np.ndarray, degree: int) -> CoefficientFunction:
    """The vector with these Bernstein coefficients (elements, n, N) on each element."""
    hats = discontinuous_hats(mesh)
    components = [CF(0.0)] * mesh.dim
    for place, powers in enumerate(multi_indices(mesh.dim, degree)):
        factor = math.factorial(degree)
        term = CF(1.0)
        for hat, power in zip(hats, powers, strict=True):
            factor /= math.factorial(power)
            for _ in range(power):
                term = term * hat
        for p in range(mesh.dim):
            own = on_elements(mesh, factor * values[:, place, p])
            components[p] = components[p] + own * term
    return CF(tuple(components))


def discontinuous_hats(mesh: Mesh) -> list[GridFunction]:
    """The barycentric coordinates of the elements."""
    space = Discontinuous(H1(mesh, order=1))
    result = []
    for vertex in np.eye(mesh.dim + 1):
        hat = GridFunction(space)
        hat.vec.FV().NumPy()[:] = np.tile(vertex, mesh.ne)
        result.append(hat)
    return result
