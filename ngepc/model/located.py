"""The elements that contain points.

NGSolve's search in quadrilaterals has absolute tolerances, 1e-12 for lengths and areas.  In a body
of a millimetre, in metres, places were wrong by up to 1e-3 of its size, in one of a micrometre by
whole elements.  So they are sought in a copy whose elements have the size one.
"""

from __future__ import annotations

import math

import numpy as np
from ngsolve import Mesh

from ngepc.model.elements import has_more_corners, is_straight


def located(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """The places of points (n, N) in a mesh, to evaluate functions of NGSolve there, (n,).

    The field ``nr`` is the number of the element, -1 outside the mesh, and ``x``, ``y``, ``z`` are
    the coordinates in the reference element.
    """
    if mesh.dim == 3 or not has_more_corners(mesh) or not is_straight(mesh):
        return mesh(*points.T)
    copied = mesh.ngmesh.Copy()
    vertices = np.asarray(copied.Coordinates())
    size = np.ptp(vertices, axis=0).max() / math.sqrt(mesh.ne)
    vertices /= size
    found = Mesh(copied)(*points.T / size)
    found["meshptr"] = mesh(*points[:1].T)["meshptr"]
    return found
