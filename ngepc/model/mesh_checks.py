"""The check of a mesh: its elements, their orientation and their corners."""

from __future__ import annotations

import numpy as np
from ngsolve import CF, Det, Mesh, specialcf, x, y, z

from ngepc.checks.arguments import corner_rules, sample
from ngepc.checks.kinds import require_mesh
from ngepc.checks.sentences import counted
from ngepc.model.elements import (
    SHAPES,
    element_nodes,
    has_more_corners,
    is_straight,
    vertex_coordinates,
)


def check_mesh(mesh: Mesh) -> None:
    """A mesh in two or three dimensions with elements of positive size, all oriented alike."""
    require_mesh("mesh", mesh)
    if mesh.comm.size > 1:
        raise ValueError(
            f"mesh is on {mesh.comm.size} processes: "
            "a part made by ngepc.model.parts.distribute is needed"
        )
    nodes = element_nodes(mesh)
    if len(nodes) == 0:
        raise ValueError("mesh has no elements: a mesh of the body is needed")
    if (nodes[:, 2**mesh.dim :] >= 0).any():
        raise ValueError(
            "mesh has elements of second order: leave SecondOrder() out, take mesh.Curve()"
        )
    strange = set((nodes >= 0).sum(axis=1).tolist()) - {
        k for N, k in SHAPES if mesh.dim == N
    }
    if strange:
        legal = "triangles, quadrilaterals, tetrahedra, prisms or hexahedra are needed"
        raise ValueError(
            f"mesh has elements with {counted(min(strange), 'corner')}: {legal}"
        )
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    size = sample(determinant, mesh)
    if not np.isfinite(size).all() or np.abs(size).min() <= 1e-14 * np.abs(size).max():
        raise ValueError("mesh has degenerate elements (zero area or volume)")
    if (nodes[:, 2**mesh.dim - 1] >= 0).any():
        corner = sample(determinant, mesh, rules=corner_rules(mesh.dim))
        size = np.append(size, corner[np.abs(corner) > 1e-12 * np.abs(size).max()])
    if size.min() < 0 < size.max():
        raise ValueError(
            "mesh has inverted elements (Jacobian determinants of both signs)"
        )
    if is_straight(mesh) and has_more_corners(mesh):
        check_corners(mesh, nodes)


def check_corners(mesh: Mesh, nodes: np.ndarray) -> None:
    """Refuse elements that NGSolve maps by affine functions, but whose corners are elsewhere.

    ``nodes`` are those of ``element_nodes``.  Elements of structured meshes are marked as
    parallelograms, which they no longer are after vertices were moved.
    """
    mapped = sample(CF((x, y, z)[: mesh.dim]), mesh, rules=corner_rules(mesh.dim))
    places = vertex_coordinates(mesh)
    defect = np.abs(mapped - places[nodes[nodes >= 0]]).max()
    if defect > 1e-9 * np.ptp(places, axis=0).max():
        raise ValueError(
            "mesh has elements that are marked as parallelograms, but are none: set "
            "curved=True for its Netgen elements when their vertices were moved"
        )
