"""Input -> message: every illegal input is refused before any work, none is accepted silently."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from netgen.csg import CSGeometry, OrthoBrick
from netgen.csg import Pnt as Corner
from netgen.geom2d import CSG2d, EdgeInfo, Solid2d
from netgen.meshing import (
    Element1D,
    Element2D,
    Element3D,
    FaceDescriptor,
    MeshPoint,
    Pnt,
)
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import CF, H1, GridFunction, IfPos, Mesh, Parameter, log, sqrt, x, y
from ngsolve.meshes import Make1DMesh

from ngepc import Contact, Edge, Material, Point, Problem, Roller, lame_parameters
from ngepc.geometries import block, cook, lshape, plate, punch, ring, wrench
from ngepc.model.obstacles import Cylinder, Disc, Plane, SignedDistance, Sphere

NAN, INF = math.nan, math.inf
STEEL = {
    "lame_lambda": 1000.0,
    "lame_mu": 800.0,
    "yield_stress": 5.0,
    "hardening": 100.0,
}
SQUARE = block.structured_mesh(4, 4, simplices=True)
CUBE = block.structured_mesh(2, 2, 2)


def material(**changes):
    return Material(**(STEEL | changes))


def problem(**changes):
    """A problem that is legal but for the changes, in two dimensions with 2 x 2 tensors."""
    usual = {"mesh": SQUARE, "material": material(), "contact": "contact", "gap": 0.1}
    if getattr(changes.get("mesh", SQUARE), "dim", 0) == 2:
        usual["kinematics"] = "two-dimensional"
    return Problem(**(usual | changes))


def by_hand(points, elements, edges=()):
    """A plane mesh of the given elements; edges are (a, b, name)."""
    netgen_mesh = NetgenMesh(dim=2)
    numbers = [netgen_mesh.Add(MeshPoint(Pnt(*p, 0))) for p in points]
    body = netgen_mesh.AddRegion("body", dim=2)
    for e in elements:
        netgen_mesh.Add(Element2D(body, [numbers[i] for i in e]))
    for a, b, name in edges:
        index = netgen_mesh.AddRegion(name, dim=1)
        netgen_mesh.Add(Element1D([numbers[a], numbers[b]], index=index))
    return Mesh(netgen_mesh)


def two_squares(shift, held=False):
    """Two unit squares, the second moved by ``shift``; its left side is named if it is held."""
    dx, dy = shift
    first = [(0, 0), (1, 0), (1, 1), (0, 1)]
    points = list(dict.fromkeys(first + [(a + dx, b + dy) for a, b in first]))
    at = {p: i for i, p in enumerate(points)}
    second = [at[a + dx, b + dy] for a, b in first]
    names = [(0, 1, "clamped"), (2, 3, "contact")] + held * [
        (second[3], second[0], "second")
    ]
    return by_hand(points, [(0, 1, 2, 3), second], names)


def two_cubes_on_an_edge():
    """Two unit cubes that touch along the edge x = y = 1; the bottom of the first is clamped."""
    netgen_mesh = NetgenMesh(dim=3)
    add = {}

    def point(p):
        if p not in add:
            add[p] = netgen_mesh.Add(MeshPoint(Pnt(*p)))
        return add[p]

    netgen_mesh.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    netgen_mesh.SetBCName(0, "clamped")
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    for s in (0, 1):
        corners = [(a + s, b + s, c) for c in (0, 1) for a, b in square]
        netgen_mesh.Add(Element3D(1, [point(p) for p in corners]))
    netgen_mesh.Add(Element2D(1, [point((a, b, 0)) for a, b in square]))
    return Mesh(netgen_mesh)


def pyramid():
    """One pyramid over the unit square."""
    netgen_mesh = NetgenMesh(dim=3)
    places = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
    corners = [netgen_mesh.Add(MeshPoint(Pnt(*place))) for place in places]
    netgen_mesh.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    netgen_mesh.Add(Element3D(1, corners))
    return Mesh(netgen_mesh)


def layered():
    """A unit square with an interface in the middle that has a name of its own."""

    def layer(low, high, bottom, top):
        corners = [(0, low), (1, low), (1, high), (0, high)]
        names = [bottom, "right", top, "left"]
        return Solid2d(
            [
                i
                for c, n in zip(corners, names, strict=True)
                for i in (c, EdgeInfo(bc=n))
            ]
        )

    geometry = CSG2d()
    geometry.Add(layer(0, 0.5, "clamped", "interface").Mat("soft"))
    geometry.Add(layer(0.5, 1, "interface", "contact").Mat("hard"))
    return Mesh(geometry.GenerateMesh(maxh=0.3))


LAYERED = layered()
ONLY_SOFT = LAYERED.MaterialCF({"soft": 800.0})
HARD_WITHOUT_END = LAYERED.MaterialCF({"soft": 800.0, "hard": CF(1.0) / 0.0})


def named(name):
    """The block with its top called ``name``."""
    mesh = block.structured_mesh(2, 2)
    mesh.ngmesh.SetBCName(mesh.GetBoundaries().index("contact"), name)
    return mesh


def second_order():
    netgen_mesh = block.mesh(0.3, (1, 1)).ngmesh
    netgen_mesh.SecondOrder()
    return Mesh(netgen_mesh)


def surface_only():
    geometry = CSGeometry()
    geometry.Add(OrthoBrick(Corner(0, 0, 0), Corner(1, 1, 1)))
    return Mesh(geometry.GenerateMesh(maxh=0.5, perfstepsend=4))


TRIANGLE = [(0, 0), (1, 0), (0, 1)]
ALONE = {"contact": None, "gap": None}
"""No contact, which might hold a body."""

UNIT = [*TRIANGLE, (1, 1)]
BOTTOM = [(0, 1, "clamped")]
TRACED = CF((1.0, 0.0, 0.0, 1.0), dims=(2, 2))
LOPSIDED = CF((0.0, 1.0, 0.0, 0.0), dims=(2, 2))
NOT_NUMBER = IfPos(x - 0.5, NAN, 1.0)
POLE = 1 / IfPos(x - 0.5, 0.0, 1.0)

MATERIALS = {
    "yield stress zero": ({"yield_stress": 0}, "yield_stress=0: a finite number > 0"),
    "yield stress negative": (
        {"yield_stress": -5.0},
        "yield_stress=-5.0: a finite number > 0",
    ),
    "yield stress NaN": (
        {"yield_stress": NAN},
        "yield_stress=nan: a finite number > 0",
    ),
    "yield stress infinite": (
        {"yield_stress": INF},
        "yield_stress=inf: a finite number",
    ),
    "hardening negative": ({"hardening": -1}, "hardening=-1: a finite number >= 0"),
    "hardening NaN": ({"hardening": NAN}, "hardening=nan: a finite number"),
    "modulus negative": (
        {"hardening_modulus": -1.0},
        "hardening_modulus=-1.0: a finite number >=",
    ),
    "stiffness NaN": (
        {"hardening_stiffness": NAN},
        "hardening_stiffness=nan: a finite",
    ),
    "shear modulus zero": ({"lame_mu": 0.0}, "lame_mu=0.0: a finite number > 0"),
    "first parameter infinite": (
        {"lame_lambda": -INF},
        "lame_lambda=-inf: a finite number",
    ),
    "an integer too large": ({"lame_mu": 10**400}, "a finite number > 0 is needed"),
    "a vector": ({"lame_mu": CF((1, 2))}, "lame_mu has shape (2,): a scalar is needed"),
}
MATERIAL_TYPES = {
    "boolean": (
        {"hardening": True},
        "hardening=True: a number or a CoefficientFunction",
    ),
    "string": ({"lame_mu": "800"}, "lame_mu='800': a number or a CoefficientFunction"),
    "complex": ({"lame_mu": 1j}, "lame_mu=1j: a number or a CoefficientFunction"),
    "complex coefficient": (
        {"lame_mu": CF(1j)},
        "lame_mu is complex: a real coefficient",
    ),
    "None": (
        {"yield_stress": None},
        "yield_stress=None: a number or a CoefficientFunction",
    ),
    "list": (
        {"yield_stress": [5.0]},
        "yield_stress=[5.0]: a number or a CoefficientFunction",
    ),
    "numpy boolean": ({"lame_mu": np.True_}, "a number or a CoefficientFunction"),
}

SAMPLED_MATERIALS = {
    "2D not elliptic": (
        {"lame_lambda": -800.0},
        "2 lambda + 2 mu falls to 0, > 0 is needed",
    ),
    "2D not elliptic inside": (
        {"lame_lambda": -2000 * x},
        "the elasticity is not elliptic",
    ),
    "yield stress falls": ({"yield_stress": x - 0.5}, "yield_stress falls to -"),
    "shear modulus falls": ({"lame_mu": 1 - 2 * y}, "lame_mu falls to -"),
    "hardening falls": ({"hardening": x - 0.5}, "hardening falls to -"),
    "modulus falls": ({"hardening_modulus": x - 0.5}, "hardening_modulus falls to -"),
    "perfect plasticity": ({"hardening": 0}, "falls to 0: > 0 is needed"),
    "isotropic without stiffness": (
        {"hardening": 0, "hardening_modulus": 2.0},
        "h = k + (H sigma_y)^2 k_1 falls to 0",
    ),
    "yield stress NaN inside": (
        {"yield_stress": NOT_NUMBER},
        "yield_stress is NaN or infinite at",
    ),
    "pole": ({"hardening": POLE}, "hardening is NaN or infinite at"),
    "logarithm": ({"lame_lambda": log(x - 0.5)}, "lame_lambda is NaN or infinite at"),
    "overflow": (
        {"lame_lambda": 1.7e308},
        "2 lame_lambda + 2 lame_mu is NaN or infinite",
    ),
    "overflow of h": (
        {"hardening_modulus": 1e200, "hardening_stiffness": 1.0},
        "(H sigma_y)^2 k_1 is NaN or infinite",
    ),
}

PROBLEMS = {
    # boundary names
    "unknown clamped": (
        {"clamped": "clampd"},
        "clamped='clampd': there is no boundary 'clampd'",
    ),
    "the known ones are listed": (
        {"contact": "top"},
        "this mesh has 'clamped', 'contact', 'left'",
    ),
    "empty name": ({"clamped": ""}, "clamped='': there is no boundary ''"),
    "white space": ({"clamped": " clamped"}, "there is no boundary ' clamped'"),
    "capital": ({"contact": "Contact"}, "there is no boundary 'Contact'"),
    "pattern": ({"clamped": ".*"}, "clamped='.*': there is no boundary '.*'"),
    "bar at the end": ({"clamped": "clamped|"}, "there is no boundary ''"),
    "no name in a list": ({"contact": []}, "contact=[]: at least one boundary name"),
    "unknown load": ({"traction": {"lod": (0, 1)}}, "there is no boundary 'lod'"),
    "unknown prescribed": (
        {"prescribed": {"lft": (0, None)}},
        "there is no boundary 'lft'",
    ),
    "gap between bodies": (
        {"contact": Contact("left", "right"), "gap": 0.0, "clamped": "clamped"},
        "gap=0.0: leave it out, that of two bodies is the distance between them",
    ),
    "contact is clamped": (
        {"contact": "clamped"},
        "contact and clamped overlap in clamped",
    ),
    "load is clamped": (
        {"traction": {"clamped": (0, 1)}},
        "traction and clamped overlap in",
    ),
    "prescribed is clamped": (
        {"prescribed": {"clamped": (0, 1)}},
        "prescribed and clamped overlap",
    ),
    "loaded twice": (
        {"traction": {"left": (0, 1), "left|right": (1, 0)}},
        "traction names left more than once",
    ),
    "prescribed twice": (
        {"prescribed": {"left|right": (0, None), "right": (1, None)}},
        "prescribed names right more than once",
    ),
    "pressed into the clamped": (
        {"contact": "left", "gap": -0.1},
        "gap=-0.1: the given displacement must not exceed the gap there, a larger gap is needed",
    ),
    # supports
    "nothing held": ({**ALONE, "clamped": None}, "leave 3 rigid motions"),
    "one roller": (
        {**ALONE, "clamped": None, "prescribed": {"clamped": (None, 0)}},
        "leave 1 rigid motion of the part around [0.5, 0.5]",
    ),
    "parallel rollers": (
        {**ALONE, "clamped": None, "prescribed": {"left|right": (0, None)}},
        "leave 1 rigid motion",
    ),
    "held in its normal": (
        {"prescribed": {"contact": (None, 0.1)}},
        "hold the normal displacement of contact='contact'",
    ),
    "held beside beyond the gap": (
        {"prescribed": {"left": (None, 2 * y)}, "clamped": "right"},
        "hold the normal displacement of contact='contact' at [0.0, 1.0], gap=0.1",
    ),
    "roller along the normal of contact": (
        {"prescribed": {"contact": Roller()}},
        "prescribed['contact'] holds the normal displacement of contact='contact'",
    ),
    "no vertex there": (
        {"traction": {Point((0.5, 0.6)): (0, 1)}},
        "traction: Point(where=(0.5, 0.6)): a vertex of the mesh is needed there, the nearest",
    ),
    "point in space": (
        {"springs": {Point((0, 0, 0)): (1, 1)}},
        "2 coordinates are needed",
    ),
    "unknown point": ({"springs": {Point("tip"): (1, 1)}}, "there is no such point"),
    "edges in the plane": ({"traction": {Edge("rim"): (0, 1)}}, "edges are needed"),
    "roller at a point": (
        {"prescribed": {Point((0.0, 1.0)): Roller()}},
        "a direction is needed, only boundaries",
    ),
    "roller in space": (
        {"prescribed": {"left": Roller((0, 0, 1))}},
        "direction=(0.0, 0.0, 1.0): 2 numbers are needed",
    ),
    "roller against a value": (
        {"prescribed": {"left": Roller(), "left|right": (1, None)}},
        "prescribed names left more than once",
    ),
    "springs that push": (
        {"springs": {"left": -1.0}},
        "falls to -1: values >= 0 are needed",
    ),
    "one spring at a point": (
        {"springs": {Point((0.0, 1.0)): 1.0}},
        "2 numbers are needed",
    ),
    "springs of three": ({"springs": {"left": (1, 1, 1)}}, "2 numbers are needed"),
    "a hole on the axis": (
        {"kinematics": "axisymmetric", "prescribed": {Point((0.0, 0.5)): (0.1, None)}},
        "gives u_x = 0.1 at a vertex where the axis of revolution gives 0: the values must agree",
    ),
    "springs where clamped": (
        {"springs": {"clamped": 1.0}},
        "springs and clamped overlap",
    ),
    "NaN pressure": (
        {"pressure": {"left": NAN}},
        "pressure['left']=nan: a finite number",
    ),
    "load on a held boundary": (
        {
            "prescribed": {"left": (0, 0)},
            "traction": {"left": (1, 0)},
            "contact": None,
            "gap": None,
        },
        "traction and prescribed overlap in left",
    ),
    "clamped and moved corner": (
        {"prescribed": {"left": (0.1, None)}},
        "prescribed['left'] gives u_x = 0.1 at a vertex where clamped='clamped' gives 0",
    ),
    "corner moved twice": (
        {
            "clamped": "contact",
            "contact": None,
            "gap": None,
            "prescribed": {
                "clamped": (x, 0),
                "right": (1 + y * (1 - y) * 0 + 0.5 * (1 - y), None),
            },
        },
        "prescribed['right'] gives u_x = 1.5 at a vertex where prescribed['clamped'] gives 1",
    ),
    # loads
    "NaN load": (
        {"traction": {"left": (0, NAN)}},
        "traction['left'][1]=nan: a finite number",
    ),
    "infinite load": (
        {"traction": {"left": (INF, 0)}},
        "traction['left'][0]=inf: a finite number",
    ),
    "NaN load inside": (
        {"traction": {"contact": (0, NOT_NUMBER)}},
        "traction['contact'] is NaN or infinite at",
    ),
    "three components": ({"traction": {"left": (0, 1, 2)}}, "2 components are needed"),
    "scalar coefficient": (
        {"traction": {"left": x}},
        "traction['left'] has shape scalar: shape (2,)",
    ),
    "matrix": (
        {"body_force": TRACED},
        "body_force has shape (2, 2): shape (2,) is needed",
    ),
    "body force of one": (
        {"body_force": (1.0,)},
        "body_force=(1.0,): 2 components are needed",
    ),
    "NaN body force": (
        {"body_force": CF((0, NOT_NUMBER))},
        "body_force is NaN or infinite at",
    ),
    "infinite body force": (
        {"body_force": (0, -INF)},
        "body_force[1]=-inf: a finite number",
    ),
    "prescribed too long": (
        {"prescribed": {"left": (0, 0, 0)}},
        "2 components are needed, None for",
    ),
    "prescribed scalar": (
        {"prescribed": {"left": 0}},
        "prescribed['left']=0: 2 components",
    ),
    "prescribed NaN": (
        {"prescribed": {"left": (NAN, None)}},
        "prescribed['left']=nan: a finite",
    ),
    "prescribed pole at a vertex": (
        {"prescribed": {"left": (1 / y, None)}},
        "prescribed['left'] is NaN or infinite at",
    ),
    "prescribed vector": (
        {"prescribed": {"left": (CF((1, 2)), None)}},
        "prescribed['left'] has shape (2,): a scalar is needed",
    ),
    # gaps
    "no gap": ({"gap": None}, "contact='contact' needs a gap to rigid obstacles"),
    "no contact": ({"contact": None}, "gap=0.1: name the contact boundary too"),
    "NaN gap": ({"gap": NAN}, "gap=nan: a finite number is needed"),
    "infinite gap": ({"gap": INF}, "gap=inf: a finite number is needed"),
    "gap NaN on a part": ({"gap": NOT_NUMBER}, "gap is NaN or infinite at"),
    "gap with a pole at one node": ({"gap": 1 / x}, "gap is NaN or infinite at 1 of"),
    "gap a vector": ({"gap": CF((0, 1))}, "gap has shape (2,): a scalar is needed"),
    "gap of a wrong boundary": (
        {"gap": {"left": 0.1}},
        "gap names ['left']: the contact boundaries",
    ),
    "gap of too many": (
        {"gap": {"contact": 0.1, "left": 0}},
        "gap names ['contact', 'left']",
    ),
    "gap of a boundary twice": (
        {"gap": {"contact|left": 0.1, "contact": 0}, "contact": "contact|left"},
        "gap names ['contact', 'contact|left']",
    ),
    "gap of a misspelt boundary": (
        {"gap": {"contact|contcat": 0.1}},
        "gap='contact|contcat': there is no boundary 'contcat'; this mesh has",
    ),
    "gap NaN in a mapping": (
        {"gap": {"contact": NAN}},
        "gap['contact']=nan: a finite number",
    ),
    # history
    "plastic strain with trace": (
        {"initial_plastic_strain": TRACED},
        "initial_plastic_strain has trace up to 2: plastic strains are trace-free",
    ),
    "plastic strain not symmetric": (
        {"initial_plastic_strain": LOPSIDED},
        "is not symmetric",
    ),
    "plastic strain NaN": (
        {"initial_plastic_strain": CF((NOT_NUMBER, 0, 0, -NOT_NUMBER), dims=(2, 2))},
        "initial_plastic_strain is NaN or infinite",
    ),
    "plastic strain a number": (
        {"initial_plastic_strain": 0.0},
        "shape (2, 2) is needed",
    ),
    "plastic strain of 3D": (
        {"initial_plastic_strain": CF((0,) * 9, dims=(3, 3))},
        "initial_plastic_strain has shape (3, 3): shape (2, 2) is needed",
    ),
    "plastic coordinates": (
        {"initial_plastic_strain": CF((0, 0))},
        "has shape (2,): shape (2, 2)",
    ),
    "hardening variable negative": (
        {"initial_hardening": -0.1},
        "initial_hardening falls to -0.1: values >= 0 are needed",
    ),
    "hardening variable NaN": (
        {"initial_hardening": NAN},
        "initial_hardening=nan: a finite number",
    ),
    "back stress not symmetric": (
        {"initial_hardening": LOPSIDED},
        "initial_hardening is not symm",
    ),
    "three hardening variables": (
        {"initial_hardening": (0, TRACED, 0)},
        "or the pair of both",
    ),
    "pair the wrong way round": (
        {"initial_hardening": (TRACED, 0.0)},
        "a scalar is needed",
    ),
    # the mesh
    "empty mesh": ({"mesh": by_hand(TRIANGLE, [])}, "mesh has no elements"),
    "one dimension": (
        {"mesh": Make1DMesh(4)},
        "mesh has dimension 1: 2 or 3 is needed",
    ),
    "surface without a body": ({"mesh": surface_only()}, "mesh has no elements"),
    "no area": (
        {"mesh": by_hand([(0, 0), (1, 0), (2, 0)], [(0, 1, 2)], BOTTOM)},
        "mesh has degenerate elements",
    ),
    "sliver beside a triangle": (
        {
            "mesh": by_hand(
                [*TRIANGLE, (2, 0)], [(0, 1, 2), (1, 0, 3)], [(0, 2, "clamped")]
            )
        },
        "mesh has degenerate elements",
    ),
    "a corner twice": (
        {"mesh": by_hand(UNIT, [(0, 1, 2), (1, 1, 2)], BOTTOM)},
        "mesh has degenerate elements",
    ),
    "inverted": (
        {"mesh": by_hand(UNIT, [(0, 1, 2), (1, 2, 3)], BOTTOM)},
        "mesh has inverted elements",
    ),
    "re-entrant quadrilateral": (
        {
            "mesh": by_hand(
                [(0, 0), (1, 0), (0.1, 0.1), (0, 1)],
                [(0, 1, 2, 3)],
                [(0, 1, "clamped")],
            )
        },
        "mesh has inverted elements",
    ),
    "slightly re-entrant": (
        {
            "mesh": by_hand(
                [(0, 0), (1, 0), (0.45, 0.45), (0, 1)], [(0, 1, 2, 3)], BOTTOM
            )
        },
        "mesh has inverted elements",
    ),
    "a corner at no number": (
        {"mesh": by_hand([(0, 0), (1, 0), (0, NAN)], [(0, 1, 2)], BOTTOM)},
        "mesh has degenerate elements",
    ),
    "the same element twice": (
        {
            "mesh": by_hand(
                UNIT, [(0, 1, 2), (0, 1, 2), (1, 3, 2)], [(0, 1, "clamped")]
            ),
            "contact": None,
            "gap": None,
        },
        "mesh has elements that overlap",
    ),
    "two elements with two common facets": (
        {
            "mesh": by_hand([*UNIT, (0.2, 0.4)], [(0, 1, 3, 2), (1, 3, 4, 0)], BOTTOM),
            "contact": None,
            "gap": None,
        },
        "mesh has elements that overlap: two of them share several facets",
    ),
    "a pyramid": ({"mesh": pyramid()}, "mesh has elements with 5 corners: triangles"),
    "second order": ({"mesh": second_order()}, "mesh has elements of second order"),
    "a loose part": (
        {**ALONE, "mesh": two_squares((3, 0))},
        "rigid motions of the part around [3.5, 0.5]",
    ),
    "a hinge": (
        {**ALONE, "mesh": two_squares((1, 1))},
        "leave 3 rigid motions of the part around [1.5, 1.5]",
    ),
    "a hinge along an edge": (
        {"mesh": two_cubes_on_an_edge(), "contact": None, "gap": None},
        "leave 3 rigid motions of the part around [1.5, 1.5, 0.5]",
    ),
    "contact inside the body": (
        {"mesh": layered(), "contact": "interface"},
        "contact='interface' lies inside the body",
    ),
    "pressure inside the body": (
        {"mesh": layered(), "pressure": {"interface": 1.0}},
        "pressure['interface'] lies inside the body: an outer boundary is needed",
    ),
    "a material without a value": (
        {"mesh": LAYERED, "material": material(lame_mu=ONLY_SOFT)},
        "lame_mu falls to 0: values > 0 are needed (in material 'hard')",
    ),
    "an infinite value in one material": (
        {"mesh": LAYERED, "material": material(lame_mu=HARD_WITHOUT_END)},
        "finite values are needed (in material 'hard')",
    ),
    "a name that is a pattern": (
        {"mesh": named("cont.*"), "contact": "cont.*"},
        "the name 'cont.*' has one of the characters",
    ),
    "3D not elliptic": (
        {"mesh": CUBE, "material": material(lame_lambda=-600.0)},
        "3 lambda + 2 mu falls to -200, > 0 is needed for 3 x 3 tensors",
    ),
    "2D load in 3D": (
        {"mesh": CUBE, "traction": {"left": (0, 1)}},
        "traction['left']=(0, 1): 3 components are needed",
    ),
    "one roller in 3D": (
        {
            **ALONE,
            "mesh": CUBE,
            "clamped": None,
            "prescribed": {"clamped": (None, None, 0)},
        },
        "leave 3 rigid motions",
    ),
    "prescribed conflict in 3D": (
        {"mesh": CUBE, "prescribed": {"left": (0, 0, None), "front": (0.2, 0, None)}},
        "gives u_x = 0.2 at a vertex where",
    ),
}
PROBLEM_TYPES = {
    "gap with a key of another type": (
        {"gap": {1: 0.1, "contact": 0}},
        "gap=1: a boundary name or several ('left|right') are needed",
    ),
    "displacements for clamped": (
        {"clamped": {"clamped": (0, None)}},
        "prescribed={'left': (0, None)} takes displacements",
    ),
    "pressure at a point": (
        {"pressure": {Point((0.0, 1.0)): 1.0}},
        "a boundary name or several",
    ),
    "pressure by components": (
        {"pressure": {"left": (0, 1)}},
        "a number or a CoefficientFunction",
    ),
    "mesh of Netgen": ({"mesh": SQUARE.ngmesh}, "an ngsolve.Mesh is needed"),
    "no mesh": ({"mesh": None}, "mesh=None: an ngsolve.Mesh is needed"),
    "material a dictionary": ({"material": STEEL}, "a Material is needed"),
    "name a number": ({"clamped": 1}, "clamped=1: a boundary name or several"),
    "names in bytes": (
        {"clamped": b"clamped"},
        "clamped=b'clamped': a boundary name or several",
    ),
    "names in a set": ({"contact": {"contact"}}, "a boundary name or several"),
    "list of numbers": ({"clamped": [1, 2]}, "a boundary name or several"),
    "traction no mapping": (
        {"traction": (0, 1)},
        "traction=(0, 1): a mapping of boundary name",
    ),
    "traction a list": (
        {"traction": [("left", (0, 1))]},
        "a mapping of boundary name -> value",
    ),
    "prescribed no mapping": ({"prescribed": "left"}, "prescribed='left': a mapping"),
    "traction key a number": ({"traction": {0: (0, 1)}}, "traction=0: a boundary name"),
    "load a number": (
        {"traction": {"left": 1.0}},
        "a vector of 2 components is needed",
    ),
    "load a string": (
        {"traction": {"left": "01"}},
        "a vector of 2 components is needed",
    ),
    "load None": ({"traction": {"left": None}}, "a vector of 2 components is needed"),
    "load of booleans": (
        {"traction": {"left": (True, False)}},
        "traction['left'][0]=True",
    ),
    "load of strings": (
        {"traction": {"left": ("0", "1")}},
        "traction['left'][0]='0': a number",
    ),
    "complex load": (
        {"traction": {"left": (0, 1j)}},
        "traction['left'][1]=1j: a number",
    ),
    "complex coefficient": (
        {"body_force": CF((0, 1j))},
        "body_force is complex: a real",
    ),
    "body force a mapping": (
        {"body_force": {"body": (0, 1)}},
        "a vector of 2 components",
    ),
    "body force a number": (
        {"body_force": 1.0},
        "body_force=1.0: a vector of 2 components",
    ),
    "gap a string": ({"gap": "0.1"}, "gap='0.1': a number or a CoefficientFunction"),
    "gap a boolean": ({"gap": True}, "gap=True: a number or a CoefficientFunction"),
    "gap complex": ({"gap": 0.1j}, "gap=0.1j: a number or a CoefficientFunction"),
    "gap None in a mapping": (
        {"gap": {"contact": None}},
        "gap['contact']=None: a number or a",
    ),
    "gap a function": (
        {"gap": lambda x: x},
        "a number or a CoefficientFunction is needed",
    ),
    "gap an obstacle": (
        {"gap": Disc((0, 3), 1.0)},
        "the gap to this obstacle is needed, obstacle.gap(mesh)",
    ),
    "prescribed a boolean": (
        {"prescribed": {"left": (True, None)}},
        "=True: a number or a",
    ),
    "prescribed a string": (
        {"prescribed": {"left": ("free", 0)}},
        "='free': a number or a",
    ),
    "plastic strain a list": (
        {"initial_plastic_strain": [[0, 0], [0, 0]]},
        "a CoefficientFunction",
    ),
    "hardening a list": (
        {"initial_hardening": [0.1]},
        "initial_hardening=[0.1]: a number or a",
    ),
    "hardening a string": (
        {"initial_hardening": "soft"},
        "initial_hardening='soft': a number",
    ),
}

FUNCTIONS = {
    "Young zero": (lambda: lame_parameters(0, 0.3), "young=0: a finite number > 0"),
    "Young negative": (
        lambda: lame_parameters(-1.0, 0.3),
        "young=-1.0: a finite number > 0",
    ),
    "Young NaN": (lambda: lame_parameters(NAN, 0.3), "young=nan: a finite number > 0"),
    "Poisson one half": (
        lambda: lame_parameters(1, 0.5),
        "poisson=0.5: a finite number > -1",
    ),
    "Poisson minus one": (
        lambda: lame_parameters(1, -1),
        "poisson=-1: a finite number > -1",
    ),
    "Poisson NaN": (lambda: lame_parameters(1, NAN), "poisson=nan: a finite number"),
    "mesh width zero": (lambda: lshape.mesh(0), "maxh=0: a finite number > 0"),
    "mesh width negative": (
        lambda: wrench.mesh(-0.1),
        "maxh=-0.1: a finite number > 0",
    ),
    "mesh width NaN": (lambda: ring.mesh(NAN), "maxh=nan: a finite number > 0"),
    "mesh width infinite": (
        lambda: plate.quarter_mesh(INF),
        "maxh=inf: a finite number > 0",
    ),
    "mesh width too small": (
        lambda: block.mesh(1e-6),
        "maxh=1e-06: a finite number >= 0.01",
    ),
    "wrench too fine": (
        lambda: wrench.mesh(1e-3),
        "maxh=0.001: a finite number >= 0.008",
    ),
    "no member": (
        lambda: lshape.paper_mesh(1000),
        "it has 8, 11, 21, 33, 65, 113, 225, 417, 833",
    ),
    "no member of the wrench": (
        lambda: wrench.paper_mesh(24927),
        "it has 26, 38, 75, 123, 245, 437",
    ),
    "no member of cook": (
        lambda: cook.bisected_mesh(100),
        "no mesh of this family has so many",
    ),
    "too few nodes": (
        lambda: lshape.paper_mesh(4),
        "nodes=4: an integer >= 8 and <= 5000000",
    ),
    "negative nodes": (lambda: wrench.paper_mesh(-873), "nodes=-873: an integer >= 26"),
    "too many nodes": (
        lambda: lshape.paper_mesh(10**9),
        "an integer >= 8 and <= 5000000",
    ),
    "NaN nodes": (lambda: lshape.paper_mesh(NAN), "nodes=nan: a finite number"),
    "no cells": (
        lambda: block.structured_mesh(0, 2),
        "nx=0: an integer >= 1 and <= 10000",
    ),
    "too many cells": (
        lambda: block.structured_mesh(2, 2, 501),
        "nz=501: an integer >= 1 and <= 500",
    ),
    "size of a point": (
        lambda: block.mesh(0.2, (1,)),
        "size=(1,): 2 or 3 numbers are needed",
    ),
    "size zero": (lambda: block.mesh(0.2, (1, 0)), "size=0.0: a finite number > 0"),
    "size NaN": (lambda: block.mesh(0.2, (1, NAN)), "size[1]=nan: a finite number"),
    "sizes and counts": (
        lambda: block.structured_mesh(2, 2, size=(1, 1, 1)),
        "2 sides are needed",
    ),
    "hole too large": (
        lambda: block.with_hole(0.2, (1, 1), 0.5),
        "radius=0.5: a finite number > 0 and < 0.5",
    ),
    "hole of the plate": (
        lambda: plate.quarter_mesh(0.1, (2, 1), 0.6),
        "a finite number > 0 and < 0.5 is",
    ),
    "plate of 3D": (
        lambda: plate.quarter_mesh(0.1, (1, 1, 1)),
        "size=(1, 1, 1): 2 numbers are needed",
    ),
    "hole zero": (
        lambda: block.with_hole(0.2, (1, 1), 0),
        "radius=0: a finite number > 0",
    ),
    "ring inside out": (lambda: ring.mesh(0.2, 2, 1), "outer=1: a finite number > 2"),
    "ring without a hole": (
        lambda: ring.quarter_mesh(0.2, 0, 1),
        "inner=0: a finite number > 0",
    ),
    "patch too wide": (
        lambda: punch.mesh(0.5, 0.1, (2, 1), 2.0),
        "patch=2.0: a finite number > 0 and < 2",
    ),
    "fine coarser than coarse": (
        lambda: punch.mesh(0.1, 0.2),
        "fine=0.2: a finite number >= 0.008",
    ),
    "shell too fine": (
        lambda: ring.shell_octant_mesh(0.01),
        "maxh=0.01: a finite number >= 0.04",
    ),
    "plane without normal": (
        lambda: Plane((0, 0), (0, 0)),
        "a vector other than zero is needed",
    ),
    "plane in mixed dimensions": (
        lambda: Plane((0, 0), (0, 0, 1)),
        "2 numbers are needed",
    ),
    "plane NaN": (lambda: Plane((0, NAN), (0, 1)), "point[1]=nan: a finite number"),
    "sphere radius zero": (
        lambda: Sphere((0, 0, 0), 0),
        "radius=0: a finite number > 0",
    ),
    "sphere in one dimension": (lambda: Sphere((0,), 1), "centre=(0,): 2 or 3 numbers"),
    "cylinder in a plane": (
        lambda: Cylinder((0, 0), (0, 1), 1),
        "point=(0, 0): 3 numbers",
    ),
    "cylinder without axis": (
        lambda: Cylinder((0, 0, 0), (0, 0, 0), 1),
        "other than zero",
    ),
    "disc for a cube": (
        lambda: Disc((0, 3), 1.0).gap(CUBE),
        "needs a mesh of dimension 2, this one has 3",
    ),
    "motion too long": (
        lambda: Disc((0, 3), 1).gap(SQUARE, (0, 0, 1)),
        "2 components are needed",
    ),
    "motion NaN": (
        lambda: Disc((0, 3), 1).gap(SQUARE, (0, NAN)),
        "motion[1]=nan: a finite number",
    ),
    "motion NaN inside": (
        lambda: Disc((0, 3), 1).gap(SQUARE, (0, NOT_NUMBER)),
        "motion is NaN or infinite",
    ),
    "far negative": (
        lambda: Disc((0, 3), 1).gap(SQUARE, far=-1),
        "far=-1: a finite number > 0",
    ),
    "distance a vector": (
        lambda: SignedDistance(CF((x, y))),
        "distance has shape (2,): a scalar",
    ),
    "distance constant": (
        lambda: SignedDistance(CF(0.3)).gap(SQUARE),
        "distance has no gradient on the boundary",
    ),
    "distance of unknown gradient": (
        lambda: SignedDistance(1 + GridFunction(H1(SQUARE))),
        "distance contains a GridFunction: a formula in x, y, z is needed",
    ),
    "distance not smooth": (
        lambda: SignedDistance(sqrt(y - 0.5)).gap(SQUARE),
        "distance is NaN or infinite at",
    ),
}
FUNCTION_TYPES = {
    "Young a string": (lambda: lame_parameters("1", 0.3), "young='1': a real number"),
    "Young a boolean": (
        lambda: lame_parameters(True, 0.3),
        "young=True: a real number",
    ),
    "Poisson complex": (
        lambda: lame_parameters(1, 0.3j),
        "poisson=0.3j: a real number",
    ),
    "mesh width a string": (lambda: lshape.mesh("fine"), "maxh='fine': a real number"),
    "mesh width None": (
        lambda: wrench.mesh(None),
        "maxh=None: a real number is needed",
    ),
    "mesh width a boolean": (
        lambda: plate.quarter_mesh(True),
        "maxh=True: a real number is needed",
    ),
    "mesh width a list": (
        lambda: block.mesh([0.1]),
        "maxh=[0.1]: a real number is needed",
    ),
    "nodes a string": (lambda: lshape.paper_mesh("417"), "nodes='417': a real number"),
    "nodes a fraction": (
        lambda: lshape.paper_mesh(417.5),
        "nodes=417.5: an integer is needed",
    ),
    "nodes a boolean": (lambda: wrench.paper_mesh(True), "nodes=True: a real number"),
    "cells a fraction": (
        lambda: block.structured_mesh(2.5, 2),
        "nx=2.5: an integer is needed",
    ),
    "size a number": (
        lambda: block.mesh(0.2, 1.0),
        "size=1.0: a sequence of 2 or 3 numbers",
    ),
    "size a string": (
        lambda: block.mesh(0.2, "11"),
        "size='11': a sequence of 2 or 3 numbers",
    ),
    "size of strings": (
        lambda: block.mesh(0.2, ("1", "1")),
        "size[0]='1': a real number",
    ),
    "centre a number": (lambda: Sphere(0, 1), "centre=0: a sequence of 2 or 3 numbers"),
    "radius a string": (lambda: Sphere((0, 0), "1"), "radius='1': a real number"),
    "distance a number": (
        lambda: SignedDistance(1.0),
        "distance=1.0: a CoefficientFunction",
    ),
    "distance a function": (
        lambda: SignedDistance(min),
        "a CoefficientFunction is needed",
    ),
    "motion a number": (
        lambda: Disc((0, 3), 1).gap(SQUARE, 1.0),
        "a vector of 2 components",
    ),
    "motion a string": (
        lambda: Disc((0, 3), 1).gap(SQUARE, ("a", 0)),
        "motion[0]='a': a number",
    ),
    "gap on a number": (
        lambda: Disc((0, 3), 1).gap(3),
        "mesh=3: an ngsolve.Mesh is needed",
    ),
    "an unknown argument": (lambda: Problem(SQUARE, material(), gab=1), "gab"),
    "a missing argument": (lambda: Material(lame_mu=1.0), "lame_lambda"),
}

TABLES = {
    "Material": [
        (lambda c=c: material(**c), ValueError, m) for c, m in MATERIALS.values()
    ]
    + [(lambda c=c: material(**c), TypeError, m) for c, m in MATERIAL_TYPES.values()],
    "Material on a mesh": [
        (lambda c=c: problem(material=material(**c)), ValueError, m)
        for c, m in SAMPLED_MATERIALS.values()
    ],
    "Problem": [
        (lambda c=c: problem(**c), ValueError, m) for c, m in PROBLEMS.values()
    ],
    "Problem, types": [
        (lambda c=c: problem(**c), TypeError, m) for c, m in PROBLEM_TYPES.values()
    ],
    "functions": [(call, ValueError, m) for call, m in FUNCTIONS.values()],
    "functions, types": [(call, TypeError, m) for call, m in FUNCTION_TYPES.values()],
}


def answer(call):
    """Type and text of the exception that a call raises."""
    try:
        call()
    except Exception as error:  # the test judges its type
        return type(error), str(error)
    return None, "accepted"


@pytest.mark.parametrize("table", TABLES)
def test_refused_with_the_message(table):
    wrong = []
    for call, kind, message in TABLES[table]:
        raised, text = answer(call)
        if raised is not kind or message not in text:
            wrong.append(f"{message!r}: {raised}, {text}")
    assert wrong == []


def test_the_tables_are_whole():
    assert sum(map(len, TABLES.values())) >= 220


LEGAL = {
    "numpy scalars": lambda: problem(
        material=material(lame_mu=np.float32(800), hardening=np.int64(100)),
        gap=np.float64(0.1),
        traction={"left": (np.float64(0), np.int32(1))},
    ),
    "numpy vectors": lambda: problem(
        body_force=np.array([0, -1]), traction={"left": np.zeros(2)}
    ),
    "integers and fractions": lambda: problem(
        material=Material.kinematic(
            lame_lambda=0, lame_mu=1, yield_stress=Fraction(1, 2), hardening=1
        ),
        gap=0,
    ),
    "negative gap": lambda: problem(gap=-0.1),
    "negative lambda": lambda: problem(material=material(lame_lambda=-700.0)),
    "parameters": lambda: problem(
        material=material(yield_stress=Parameter(5.0)),
        gap=Parameter(0.1),
        traction={"left": (Parameter(1.0), 0)},
    ),
    "gap for each boundary": lambda: problem(
        contact=("contact",), gap={"contact": 0.1}
    ),
    "a name twice": lambda: problem(clamped="clamped|clamped"),
    "contact that slides beside rollers": lambda: problem(
        prescribed={"left|right": (0, None)}
    ),
    "contact on a roller across its normal": lambda: problem(
        prescribed={"contact": (0, None)}
    ),
    "load on a contact boundary": lambda: problem(traction={"contact": (1, 0)}),
    "prescribed values that agree": lambda: problem(
        prescribed={"left|right": (0.1 * y, None)}
    ),
    "gap infinite nowhere": lambda: problem(gap=1 / (x + 1)),
    "load with a pole between the samples": lambda: problem(
        traction={"left": (1 / sqrt(y), 0)}
    ),
    "two parts, both held": lambda: problem(
        mesh=two_squares((1, 1), held=True), prescribed={"second": (0, 0)}
    ),
    "back stress and scalar": lambda: problem(
        initial_hardening=(0.1, CF((1, 2, 2, -1), dims=(2, 2)))
    ),
    "back stress alone": lambda: problem(
        initial_hardening=CF((1, 2, 2, -1), dims=(2, 2))
    ),
    "interface not in contact": lambda: problem(mesh=layered()),
    "unused points": lambda: problem(
        mesh=by_hand(
            [*UNIT, (5, 5)], [(0, 1, 3, 2)], [(0, 1, "clamped"), (2, 3, "contact")]
        )
    ),
    "all elements clockwise": lambda: problem(
        mesh=by_hand(UNIT, [(0, 2, 3, 1)], [(0, 1, "clamped"), (2, 3, "contact")])
    ),
    "another mesh's function": lambda: problem(
        gap=GridFunction(H1(block.structured_mesh(3, 3)))
    ),
    "a changed problem": lambda: replace(problem(), gap=0.2),
}


def test_what_is_legal_is_accepted():
    assert {name: make().N for name, make in LEGAL.items()} == dict.fromkeys(LEGAL, 2)


def test_numbers_become_floats():
    m = material(lame_mu=np.float32(800), hardening=np.int64(100))
    assert type(m.lame_mu) is float
    assert type(m.hardening) is float
    assert m.effective_hardening == 100.0
