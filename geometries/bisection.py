"""Families of triangulations by newest-vertex bisection of a few quadrilaterals.

Each level bisects every triangle once, so that the number of triangles doubles; this is how the
node counts 417, 833, ... and 873, 1641, ... of the paper's Tables 1 to 3 arise.
"""

from collections import Counter
from collections.abc import Callable, Sequence

from netgen.meshing import Element1D, Element2D, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh

from ngepc.checks.arguments import require_integer

Point = tuple[float, float]
Quadrilateral = tuple[Point, Point, Point, Point]

MOST_NODES = 5_000_000


def triangulated(
    quadrilaterals: Sequence[Quadrilateral],
    boundary_name: Callable[[Point, Point], str],
) -> Mesh:
    """Two triangles for each quadrilateral (a, b, c, d), cut along its diagonal ac.

    Parameters
    ----------
    quadrilaterals
        Corners in counterclockwise order; neighbours share whole edges.
    boundary_name
        Maps the two end points of a boundary edge to the name of its boundary part.

    Returns
    -------
    Mesh
        A triangulation whose two-dimensional region is called ``body``.
    """
    triangles = [t for a, b, c, d in quadrilaterals for t in ((a, b, c), (a, c, d))]
    netgen_mesh = NetgenMesh(dim=2)
    corners = dict.fromkeys(x for t in triangles for x in t)
    point = {x: netgen_mesh.Add(MeshPoint(Pnt(*x, 0))) for x in corners}
    body = netgen_mesh.AddRegion("body", dim=2)
    for t in triangles:
        netgen_mesh.Add(Element2D(body, [point[x] for x in t]))

    edges = [(t[i], t[(i + 1) % 3]) for t in triangles for i in range(3)]
    shared = Counter(frozenset(e) for e in edges)
    outer = [(e, boundary_name(*e)) for e in edges if shared[frozenset(e)] == 1]
    region = {
        name: netgen_mesh.AddRegion(name, dim=1)
        for name in sorted({n for _, n in outer})
    }
    for (a, b), name in outer:
        netgen_mesh.Add(Element1D([point[a], point[b]], index=region[name]))
    netgen_mesh.Update()
    return Mesh(netgen_mesh)


def refined_to(mesh: Mesh, nodes: int, smallest: int) -> Mesh:
    """Bisect all triangles of ``mesh`` until it has exactly ``nodes`` vertices.

    Parameters
    ----------
    mesh
        The first mesh of the family; it is changed.
    nodes
        Number of vertices wanted, one of the family's from ``smallest`` on.
    smallest
        First member of the family that is offered.

    Raises
    ------
    TypeError, ValueError
        If the family has no such mesh; the message lists its members up to there.
    """
    nodes = require_integer("nodes", nodes, smallest, MOST_NODES)
    family = [mesh.nv]
    while mesh.nv < nodes:
        mesh.Refine(onlyonce=True)
        family.append(mesh.nv)
    if mesh.nv != nodes:
        members = ", ".join(str(n) for n in family if n >= smallest)
        raise ValueError(
            f"nodes={nodes}: no mesh of this family has so many; it has {members}, ..."
        )
    return mesh
