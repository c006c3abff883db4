"""The problems of the study ``accuracy``: one number of interest each, on a family of meshes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from netgen.geom2d import Circle, CSG2d, EdgeInfo, Solid2d
from netgen.occ import OCCGeometry
from ngsolve import CoefficientFunction, Mesh, sqrt, x, y
from ngsolve.meshes import MakeStructured2DMesh, MakeStructured3DMesh

from ngepc.geometries.published import half_block, polygon
from ngepc.model.problem import Problem
from ngepc.results.result import Result
from ngepc.studies.locking import tip
from ngepc.studies.overlap import graded_quarter
from ngepc.studies.solid_problems import metal

SMALL = 1e-5
"""Hardening over shear modulus, used instead of zero."""


Number = Callable[[Result], float]


@dataclass(frozen=True)
class Metal:
    """Uniaxial data of a metal with isotropic hardening, for both programs."""

    young: float
    poisson: float
    yield_stress: float
    modulus: float

    @property
    def material(self) -> object:
        """The material of ngepc."""
        data = self.young, self.poisson, self.yield_stress
        return metal(*data, isotropic=self.modulus)


SOFT = Metal(1e3, 0.3, math.sqrt(3), 1.5 * SMALL * 1e3 / 2.6)


ALUMINIUM = Metal(70.0, 1 / 3, 0.243, 0.135)


HINGE = Metal(1e3, 0.3, 2.0, 1.5e-3 * 385)


SPHERE = Metal(2.5e3, 0.25, 0.5 * math.sqrt(1.5), 150.0)


STEEL = Metal(210e3, 0.3, 200.0, 12e3)


@dataclass(frozen=True)
class Rigid:
    """A rigid disc or sphere above a flat boundary, as a layer of stiff elements for CalculiX.

    ``axis`` and ``top`` are the coordinates of the point of first contact, ``depth`` is the
    indentation.  The layer has ``cells`` cells over the ``span`` of each horizontal coordinate;
    facets within ``reach`` may touch it.  ``stiffness`` is CalculiX's contact stiffness over
    Young's modulus.
    """

    radius: float
    depth: float
    axis: float
    top: float
    span: tuple[float, float]
    reach: float
    cells: int
    stiffness: float

    @property
    def gap(self) -> CoefficientFunction:
        """The vertical gap, for ngepc."""
        away = x - self.axis
        square = away * away if self.axis else x * x + y * y
        return self.radius - sqrt(self.radius**2 - square) - self.depth

    def height(self, square: np.ndarray) -> np.ndarray:
        """Height of the undeformed surface at squared distances from the axis."""
        return self.top + self.radius - np.sqrt(self.radius**2 - square)


HINGE_FORCE = 0.0938
"""Force on the hinge by order 2 on bricks that are graded to all edges and to the clamped end.

With 6, 8, 10, 12 and 16 of them over the height it is 0.09430, 0.09411, 0.09400, 0.09395, 0.09389,
from above at a rate of h^1.6 to h^2, so that it is known to 0.1 percent.
"""

SPHERICAL = Rigid(10.0, 3e-3, 0.0, 1.0, (-0.015, 0.36), 0.36, 24, 500.0)


SPHERE_FORCE = 0.40875
"""Force on the sphere by order 2 on bricks with 12 equal cells over the width 0.24 of the contact.

With 4, 6 and 8 of them it is 0.41027, 0.40877 and 0.40848, so that it is known to 0.1 percent.
"""


PUNCH = Rigid(25.0, 0.2, 30.0, 40.0, (19.5, 40.5), 41.0, 160, 50.0)
"""The rigid bodies of the block and of the first lecture.

With the stiffness 50 the sphere on six bricks along an edge meets 0.8 percent less resistance than
with 500, nearly the accuracy that is asked for, with 2000 0.16 percent more.  The punch changes by
0.03 percent with 500, and takes 31 in place of 18 iterations on the second mesh.
"""


@dataclass(frozen=True)
class Case:
    """A problem with one number of interest, on a family of meshes.

    ``mesh(level, simplices)`` generates a mesh; ``loads`` are fields of ``Problem``; ``printed`` is
    the number that CalculiX prints: ("force", boundary, component, factor) or ("displacement",
    point, component, factor); ``levels`` are the numbers of meshes of simplices, and of
    quadrilaterals or hexahedra.  Without a ``reference`` it is computed on the mesh ``finest``.
    """

    mesh: Callable[[int, bool], Mesh]
    metal: Metal
    loads: dict
    number: Number
    printed: tuple[str, object, int, float]
    levels: tuple[int, int]
    reference: float | None = None
    rigid: Rigid | None = None
    finest: int = 5

    def problem(self, level: int, simplices: bool = True) -> Problem:
        """The problem of ngepc, with all defaults."""
        mesh = self.mesh(level, simplices)
        return Problem(mesh, self.metal.material, **self.loads)


def half_block_mesh(level: int, simplices: bool) -> Mesh:
    """Half a block below a rough punch."""
    fine = 0.24 / 2**level
    return half_block(6, 4, 1.0, fine, min(8 * fine, 1.5))


def membrane(level: int, simplices: bool) -> Mesh:
    """Cook's membrane."""
    n = 4 * 2**level
    return MakeStructured2DMesh(
        nx=n,
        ny=n,
        quads=not simplices,
        mapping=lambda s, t: (48 * s, 44 * s + t * (44 - 28 * s)),
    )


def notched(level: int, simplices: bool) -> Mesh:
    """A quarter of a strip with two notches."""
    fine = 0.12 / 2**level
    face = polygon([(0, 0), (0.5, 0), (1, 0), (1, 2), (0, 2)])
    for edge in face.edges:
        c = edge.center
        edge.name = "free"
        if abs(c.y) < 1e-9 and c.x < 0.5:
            edge.name = "ligament"
            edge.maxh = fine
        elif abs(c.y - 2) < 1e-9:
            edge.name = "top"
        elif abs(c.x) < 1e-9:
            edge.name = "axis"
    geometry = OCCGeometry(face, dim=2)
    return Mesh(geometry.GenerateMesh(maxh=min(4 * fine, 0.5), grading=0.2))


def beam(level: int, simplices: bool) -> Mesh:
    """A beam 6 x 1 x 1, finer at the clamped end and at its edges."""
    n = level + 1

    def graded(t: float) -> float:
        """A coordinate of the section, finer at 0 and at 1."""
        return 0.5 * (2 * t) ** 1.5 if t <= 0.5 else 1 - graded(1 - t)

    return MakeStructured3DMesh(
        hexes=not simplices,
        nx=4 * n,
        ny=n,
        nz=n,
        mapping=lambda s, t, u: (6 * s**1.6, graded(t), graded(u)),
    )


def quarter_block(level: int, simplices: bool) -> Mesh:
    """A quarter of a block, fine below the point where the sphere touches."""
    return graded_quarter(level + 2, hexahedra=not simplices)


def first_block(level: int, simplices: bool) -> Mesh:
    """The block with a hole of the page on first steps (mm)."""
    coarse = 8.0 / 2**level
    corners = ((0, 0), (60, 0), (60, 40), (40, 40), (20, 40), (0, 40))
    sides = [EdgeInfo(bc="free") for _ in corners]
    sides[0] = EdgeInfo(bc="clamped")
    sides[3] = EdgeInfo(bc="contact", maxh=coarse / 4)
    outline = zip(corners, sides, strict=True)
    block = Solid2d([item for corner in outline for item in corner], mat="body")
    body = CSG2d()
    body.Add(block - Circle((30, 18), radius=8, bc="hole"))
    return Mesh(body.GenerateMesh(maxh=coarse))


def force_on(boundary: str, component: int, factor: float) -> Number:
    """The reaction of a boundary, times a factor."""
    return lambda result: (
        factor * float(result.equilibrium.reactions[boundary][component])
    )


CASES = {
    "Prandtl's punch": Case(
        half_block_mesh,
        SOFT,
        {
            "clamped": None,
            "prescribed": {
                "contact": (0, -0.1),
                "symmetry": (0, None),
                "bottom|right": (0, 0),
            },
        },
        force_on("contact", 1, -1.0),
        ("force", "contact", 1, -1.0),
        (4, 0),
        2 + math.pi,
    ),
    "Cook's membrane": Case(
        membrane,
        ALUMINIUM,
        {"clamped": "left", "traction": {"right": (0, 1.8 / 16)}},
        tip,
        ("displacement", (48, 60), 1, 1.0),
        (4, 4),
    ),
    "notched tension": Case(
        notched,
        SOFT,
        {
            "clamped": None,
            "prescribed": {
                "ligament": (None, 0),
                "axis": (0, None),
                "top": (None, 0.03),
            },
        },
        force_on("top", 1, 1.0),
        ("force", "top", 1, 1.0),
        (4, 0),
    ),
    "plastic hinge, 3D": Case(
        beam,
        HINGE,
        {"clamped": "back", "prescribed": {"front": (None, None, -0.3)}},
        force_on("front", 2, -1.0),
        ("force", "front", 2, -1.0),
        (6, 6),
        HINGE_FORCE,
    ),
    "sphere on a block, 3D": Case(
        quarter_block,
        SPHERE,
        {
            "clamped": "bottom",
            "prescribed": {"back": (0, None, None), "left": (None, 0, None)},
            "contact": "top",
            "gap": SPHERICAL.gap,
        },
        lambda result: 4 * result.contact_force,
        ("force", "bottom", 2, 4.0),
        (7, 7),
        SPHERE_FORCE,
        rigid=SPHERICAL,
    ),
    "first steps, punch": Case(
        first_block,
        STEEL,
        {"clamped": "clamped", "contact": "contact", "gap": PUNCH.gap},
        lambda result: result.contact_force,
        ("force", "clamped", 1, 1.0),
        (4, 0),
        rigid=PUNCH,
        finest=4,
    ),
}
"""Name -> case."""
