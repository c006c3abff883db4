"""Polygons with named edges, and the meshes that Netgen makes of CSG bodies."""

from collections.abc import Iterable, Sequence

import numpy as np
from netgen.csg import CSGeometry, Solid
from netgen.geom2d import CSG2d, EdgeInfo, Solid2d
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh

from ngepc.checks.arguments import require_number, require_vector


def polygon(corners: Iterable[tuple[tuple[float, float], str]]) -> Solid2d:
    """The polygon with these corners, counterclockwise, each with the name of the edge after it."""
    return Solid2d([item for x, name in corners for item in (x, EdgeInfo(bc=name))])


def meshed(body: Solid | Solid2d, maxh: float) -> Mesh:
    """Triangles or tetrahedra of width at most ``maxh``; the mesh knows its geometry.

    Netgen's threads wait for each other most of the time: one makes the same mesh earlier.
    """
    if isinstance(body, Solid2d):
        geometry = CSG2d()
        geometry.Add(body.Mat("body"))
        return Mesh(geometry.GenerateMesh(maxh=maxh))
    geometry = CSGeometry()
    geometry.Add(body.mat("body"))
    return Mesh(geometry.GenerateMesh(maxh=maxh, parallel_meshing=False))


def netgen_mesh(
    dim: int, points: np.ndarray, groups: Iterable[tuple[int, str, np.ndarray]]
) -> NetgenMesh:
    """A mesh of Netgen of groups (dimension, name, corners of cells by number of the point)."""
    mesh = NetgenMesh(dim=dim)
    regions = {}
    mesh.AddPoints(np.ascontiguousarray(points))
    for d, name, cells in groups:
        if (d, name) not in regions:
            regions[d, name] = mesh.AddRegion(name, dim=d)
        data = np.ascontiguousarray(cells, dtype=np.int32)
        mesh.AddElements(dim=d, index=regions[d, name], data=data, base=0)
    mesh.Update()
    return mesh


def outward(mesh: Mesh) -> Mesh:
    """The mesh with the boundary edges of a polygon turned so that the body lies to their left.

    Netgen's CSG2d turns some the other way, and ``specialcf.normal`` follows them inward.  The mesh
    forgets its geometry, which for straight edges says nothing more.
    """
    netgen_mesh = mesh.ngmesh
    triangles = netgen_mesh.Elements2D().NumPy()["nodes"][:, :3]
    left_of = {(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)}
    ends = netgen_mesh.Elements1D().NumPy()["nodes"]
    wrong = np.array(
        [tuple(edge) not in left_of for edge in ends[:, :2].tolist()], dtype=bool
    )
    ends[wrong, :2] = ends[wrong, 1::-1]
    netgen_mesh.SetGeometry(None)
    netgen_mesh.Update()
    return Mesh(netgen_mesh)


def require_mesh_width(maxh: object, extent: float, dim: int) -> float:
    """``maxh`` as a float when it is a mesh width > 0 that leaves the mesh of a bearable size.

    The least width is ``extent`` / 1000 for a body of that extent, in three dimensions / 100.
    """
    require_number("maxh", maxh, 0, strict=True)
    return require_number("maxh", maxh, extent / (1000 if dim == 2 else 100))


def require_sides(size: object, dimensions: Sequence[int] = (2,)) -> tuple[float, ...]:
    """``size`` as the sides > 0 of a box in one of the dimensions."""
    sides = require_vector("size", size, dimensions)
    return tuple(require_number("size", side, 0, strict=True) for side in sides)
