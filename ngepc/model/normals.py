"""The outer unit normal of a body.

NGSolve's ``specialcf.normal`` on a boundary follows the orientation of the boundary elements,
which need not be outward: in Netgen CSG meshes it points inward on some edges, on half of a hole
and on the surface of a subtracted sphere.
"""

from ngsolve import (
    CF,
    BoundaryFromVolumeCF,
    CoefficientFunction,
    IfPos,
    InnerProduct,
    Mesh,
    specialcf,
)

from ngepc.checks.kinds import require_mesh


def outward_normal(mesh: Mesh) -> CoefficientFunction:
    """The outer unit normal n of the body on its boundary, however its elements are oriented.

    The sign is settled by the neighbouring element: a vector from the boundary point to an
    interior point of the element, mapped from the reference element, has n . v < 0.

    Returns
    -------
    CoefficientFunction
        N components, to be evaluated on boundary elements (``ds``); NGSolve keeps it valid when
        the mesh is refined or curved.

    Raises
    ------
    TypeError, ValueError
        If ``mesh`` is no mesh in two or three dimensions.
    """
    require_mesh("mesh", mesh)
    N = mesh.dim
    n = specialcf.normal(N)
    interior = CF((1 / (N + 1),) * N)
    v = BoundaryFromVolumeCF(specialcf.JacobianMatrix(N) * (interior - specialcf.xref(N)))
    return IfPos(InnerProduct(n, v), -1.0, 1.0) * n
