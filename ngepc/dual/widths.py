"""Mesh widths h and h_c, which the tolerances of Algorithm 7.2 refer to.

The paper does not define h.  Here it is the width in the geometric sense, the distance between the
two closest parallel planes with an element between them, of the narrowest element.  With it the
outer iterations of Table 3 come out as printed; with the longest edge, more than twice
that on the same meshes, paths end earlier (docs/reading.md).
"""

import numpy as np
from ngsolve import BND, VOL, Integrate, Mesh

from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.model.problem import Problem


def mesh_width(mesh: Mesh) -> float:
    """h, the smallest width of an element: of a triangle its smallest altitude (length).

    Other elements than triangles count as cubes, with width |T|^(1/N).
    """
    volumes = np.array(Integrate(1.0, mesh, VOL, element_wise=True))
    nodes = element_nodes(mesh)
    if mesh.dim != 2 or (nodes[:, 3] >= 0).any():
        return float(volumes.min() ** (1 / mesh.dim))
    x = vertex_coordinates(mesh)[nodes[:, :3]]
    longest = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    return float((2 * volumes / longest).min())


def contact_mesh_width(problem: Problem) -> float:
    """h_c, the largest |S|^(1/(N-1)) over the elements S of Gamma_c; 0 without contact (length)."""
    if not problem.contact_names:
        return 0.0
    mesh = problem.mesh
    region = mesh.Boundaries("|".join(problem.contact_names))
    measures = Integrate(1.0, mesh, BND, definedon=region, element_wise=True)
    return float(max(measures)) ** (1 / (mesh.dim - 1))
