"""The quarter (1/2, 1) x (1/2, 1) x (0, 1) of a unit cube, graded to the middle of its top.

A problem that the planes x = 1/2 and y = 1/2 mirror onto itself is solved on it with a quarter of
the unknowns; its forces and energies are a quarter of the whole ones.  Boundaries: ``clamped`` is
the bottom, ``contact`` the top, ``side_x`` and ``side_y`` are x = 1 and y = 1, ``mirror_x`` and
``mirror_y`` are x = 1/2 and y = 1/2.
"""

import math

from ngsolve import Mesh

from ngepc.checks.arguments import require_integer, require_number

from .block import structured_mesh

_NAMES = {"left": "mirror_x", "front": "mirror_y", "right": "side_x", "back": "side_y"}


def mesh(
    cells: int = 8,
    layers: int | None = None,
    *,
    grading: float = 3.0,
    simplices: bool = True,
) -> Mesh:
    """``cells`` x ``cells`` x ``layers`` cells: hexahedra, or each cut into six tetrahedra.

    Parameters
    ----------
    cells, layers
        Numbers of cells along x and y, and along z, >= 1; as many layers as cells by default.
    grading
        s >= 0 in the map t -> sinh(s t)/sinh(s) of equal cells, which makes those under (1/2, 1/2,
        1) smaller by the factor s/sinh(s); 0 for equal cells.
    simplices
        Whether the cells are cut into tetrahedra.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    layers = cells if layers is None else layers
    for name, n in {"cells": cells, "layers": layers}.items():
        require_integer(name, n, 1, 500)
    require_number("grading", grading, 0, most=20)
    netgen_mesh = structured_mesh(cells, cells, layers, simplices=simplices).ngmesh
    for point in netgen_mesh.Points():
        x, y, z = point.p
        for i, t in enumerate((x, y, 1 - z)):
            away = math.sinh(grading * t) / math.sinh(grading) if grading > 0 else t
            point[i] = (1 + away) / 2 if i < 2 else 1 - away
    for number, name in enumerate(Mesh(netgen_mesh).GetBoundaries()):
        netgen_mesh.SetBCName(number, _NAMES.get(name, name))
    return Mesh(netgen_mesh)
