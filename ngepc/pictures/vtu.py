"""VTU files: cells with their own points, quadratic ones where elements or displacements are.

Every cell has points of its own, so that jumps between elements stay.  Curved and quadratic
elements are VTK's quadratic cells with nodes at the middle of each edge.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from ngsolve import CF, ET, CoefficientFunction, IntegrationRule, Mesh, x, y, z


@dataclass(frozen=True)
class Cell:
    """A kind of cell: reference corners and edges in VTK's order, and VTK's numbers."""

    corners: tuple[tuple[float, ...], ...]
    edges: tuple[tuple[int, int], ...]
    linear: int  # VTK's number of the cell without nodes on edges
    quadratic: int  # and with them
    mirror: tuple[int, ...]  # corners in the order of the mirrored cell

    def points(self, curved: bool) -> np.ndarray:
        """Reference points in VTK's order."""
        corners = np.array(self.corners, dtype=float)
        middles = [(corners[a] + corners[b]) / 2 for a, b in self.edges]
        return np.vstack([corners, *middles]) if curved else corners

    def mirrored(self, curved: bool) -> np.ndarray:
        """The numbers of the points in the order of the mirrored cell."""
        number = {frozenset(e): len(self.corners) + k for k, e in enumerate(self.edges)}
        turned = self.mirror
        middles = [number[frozenset((turned[a], turned[b]))] for a, b in self.edges]
        return np.array([*turned, *(middles if curved else [])])


RING = ((0, 1), (1, 2), (2, 3), (3, 0))
CELLS = {
    ET.TRIG: Cell(((0, 0), (1, 0), (0, 1)), ((0, 1), (1, 2), (2, 0)), 5, 22, (0, 2, 1)),
    ET.QUAD: Cell(((0, 0), (1, 0), (1, 1), (0, 1)), RING, 9, 23, (0, 3, 2, 1)),
    ET.TET: Cell(
        ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
        10,
        24,
        (0, 2, 1, 3),
    ),
    ET.PRISM: Cell(
        ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)),
        ((0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3), (0, 3), (1, 4), (2, 5)),
        13,
        26,
        (0, 2, 1, 3, 5, 4),
    ),
    ET.HEX: Cell(
        (
            *((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
            *((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
        ),
        (*RING, *((a + 4, b + 4) for a, b in RING), (0, 4), (1, 5), (2, 6), (3, 7)),
        12,
        25,
        (0, 3, 2, 1, 4, 7, 6, 5),
    ),
}
"""Shape of an element -> its cell."""


def vtu_text(
    mesh: Mesh, fields: Mapping[str, CoefficientFunction], curved: bool
) -> str:
    """The text of a VTU file: fields at the points, the number of the material of each cell."""
    region = mesh.Materials(".*")
    elements = list(region.Elements())
    types = [element.type for element in elements]
    rules = {
        shape: IntegrationRule(points.tolist(), [0.0] * len(points))
        for shape in set(types)
        for points in [CELLS[shape].points(curved)]
    }
    mapped = mesh.MapToAllElements(rules, region)
    place = np.asarray(CF((x, y, z)[: mesh.dim])(mapped)).reshape(len(mapped), -1)
    points = np.pad(place, ((0, 0), (0, 3 - mesh.dim)))
    sizes = np.array([len(CELLS[shape].points(curved)) for shape in types])
    ends = np.cumsum(sizes)
    cells = connectivity(points, types, ends - sizes, curved)
    kinds = [CELLS[t].quadratic if curved else CELLS[t].linear for t in types]
    numbers = {name: k for k, name in enumerate(dict.fromkeys(mesh.GetMaterials()))}
    bodies = [numbers[element.mat] for element in elements]
    data = {name: in_space(cf, mapped) for name, cf in fields.items()}
    parts = [
        tagged("PointData", [array(name, values) for name, values in data.items()]),
        tagged("CellData", [array("body", np.array(bodies, dtype=np.int64))]),
        tagged("Points", [array("points", points)]),
        tagged(
            "Cells",
            [
                array("connectivity", cells),
                array("offsets", ends),
                array("types", np.array(kinds, dtype=np.uint8)),
            ],
        ),
    ]
    piece = f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(types)}">'
    head = (
        '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="1.0" '
        'byte_order="LittleEndian" header_type="UInt64"><UnstructuredGrid>'
    )
    end = "</Piece></UnstructuredGrid></VTKFile>\n"
    return "\n".join([head, piece, *parts, end])


def connectivity(
    points: np.ndarray, types: list, first: np.ndarray, curved: bool
) -> np.ndarray:
    """The points of all cells, reordered in elements with a negative Jacobian determinant."""
    found = []
    for start, shape in zip(first.tolist(), types, strict=True):
        cell = CELLS[shape]
        count = len(cell.points(curved))
        order = np.arange(count)
        if is_turned(points[start : start + len(cell.corners)], cell):
            order = cell.mirrored(curved)
        found.append(start + order)
    return np.concatenate(found)


def is_turned(corners: np.ndarray, cell: Cell) -> bool:
    """Whether the orientation at the first corner of a cell is negative."""
    reference = np.array(cell.corners, dtype=float)
    nearest = np.flatnonzero(np.abs(reference - reference[0]).sum(axis=1) == 1)
    along = reference[nearest] - reference[0]
    edges = (corners[nearest] - corners[0])[np.argmax(along, axis=0)]
    if len(edges) == 2:
        return bool(edges[0, 0] * edges[1, 1] < edges[0, 1] * edges[1, 0])
    return bool(np.linalg.det(edges) < 0)


def in_space(value: CoefficientFunction, mapped: object) -> np.ndarray:
    """Scalars as they are, vectors with 3 and matrices with 9 components, filled with zeros."""
    values = np.asarray(value(mapped), dtype=float).reshape(len(mapped), -1)
    if value.dim == 1:
        return values[:, 0]
    missing = [(0, 3 - n) for n in value.dims]
    tensors = np.pad(values.reshape(-1, *value.dims), [(0, 0), *missing])
    return tensors.reshape(len(mapped), -1)


TYPES = {"f": "Float64", "i": "Int64", "u": "UInt8"}


def array(name: str, values: np.ndarray) -> str:
    """A named array in base64, after its length."""
    values = np.ascontiguousarray(values)
    raw = values.astype(values.dtype.newbyteorder("<")).tobytes()
    text = base64.b64encode(np.uint64(len(raw)).tobytes() + raw).decode()
    components = 1 if values.ndim == 1 else values.shape[1]
    kind = TYPES[values.dtype.kind]
    return (
        f'<DataArray type="{kind}" Name={quoteattr(name)} '
        f'NumberOfComponents="{components}" format="binary">{text}</DataArray>'
    )


def tagged(tag: str, parts: list[str]) -> str:
    """Parts of a file inside a tag."""
    return f"<{tag}>{''.join(parts)}</{tag}>"
