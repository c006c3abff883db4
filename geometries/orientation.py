"""Boundary edges that run counterclockwise, so that NGSolve's normal points outward.

Netgen's CSG2d turns some edges the other way, and ``specialcf.normal`` follows them inward.
"""

import numpy as np
from netgen.meshing import Mesh as NetgenMesh


def outward(netgen_mesh: NetgenMesh) -> NetgenMesh:
    """Turn the boundary edges of a polygon's mesh so that the body lies to their left.

    The mesh forgets its geometry, which for straight edges says nothing more.

    Parameters
    ----------
    netgen_mesh
        A Netgen mesh of triangles; it is changed and returned.
    """
    triangles = netgen_mesh.Elements2D().NumPy()["nodes"][:, :3]
    left_of = {(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)}
    ends = netgen_mesh.Elements1D().NumPy()["nodes"]
    wrong = np.array([tuple(edge) not in left_of for edge in ends[:, :2].tolist()], dtype=bool)
    ends[wrong, :2] = ends[wrong, 1::-1]
    netgen_mesh.SetGeometry(None)
    netgen_mesh.Update()
    return netgen_mesh
