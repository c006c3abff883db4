"""Small problems, one for each feature: the plain one with that feature and no more than needed."""

from dataclasses import replace

from bodies import STEEL, pressed_body
from netgen.occ import Compound, MoveTo, OCCGeometry, Rectangle, X, Y
from ngsolve import CF, Mesh

from ngepc import (
    Contact,
    Coulomb,
    Hill,
    Kinematics,
    Material,
    Norton,
    Overlay,
    Point,
    Problem,
    Roller,
    Voce,
)
from ngepc.geometries import block
from ngepc.model.kinematics import KINEMATICS
from ngepc.model.processes import Team

SQUARE = block.structured_mesh(3, 3, simplices=True)
LOAD = {"right": (2.0, 1.5)}
PLAIN = Problem(SQUARE, STEEL, traction=LOAD, order=1)
"""A clamped square that is pulled until a part of it yields."""

LAW = Material.with_law(
    lame_lambda=1e3, lame_mu=1e3, law=Voce(1.5, 0.5, 100.0), hardening=50.0
)
MIXED = replace(STEEL, hardening_modulus=0.1, hardening_stiffness=1e3)
VISCOUS = replace(STEEL, rate=Norton(1.0, 3.0))
LAYERS = Overlay([0.5, 0.3], [STEEL.yield_stress, 2 * STEEL.yield_stress])
CYCLIC = replace(STEEL, hardening=0.0, overlay=LAYERS)
STRETCHED = CF((1e-3, 0, 0, 0, -1e-3, 0, 0, 0, 0), dims=(3, 3))
OWN = Kinematics("my own", 2, KINEMATICS[0].basis)
CONTACT = {"contact": "contact", "gap": 3e-4}
PRESSED = {"contact": "contact", "gap": -1e-3}
CLAMPED_ASIDE = {"clamped": "left", "traction": {"clamped": (0.5, 2.0)}}

CHANGES = {
    "plane strain": {},
    "two-dimensional": {"kinematics": "two-dimensional"},
    "plane stress": {"kinematics": "plane stress"},
    "thickness": {"thickness": 2.0},
    "axisymmetric": {"kinematics": "axisymmetric"},
    "other kinematics": {"kinematics": OWN},
    "order 2": {"order": 2},
    "quadrilaterals": {"mesh": block.structured_mesh(3, 3)},
    "kinematic hardening": {},
    "isotropic hardening": {"material": MIXED},
    "hardening law": {"material": LAW},
    "rate": {"material": VISCOUS, "duration": 0.1},
    "anisotropic yield": {
        "material": replace(STEEL, hill=Hill.r_values(1.8, 1.2, 2.3, angle=0.2))
    },
    "cyclic hardening": {"material": CYCLIC},
    "initial plastic strain": {"initial_plastic_strain": STRETCHED},
    "initial hardening": {"material": MIXED, "initial_hardening": 0.5},
    "initial strain": {"initial_strain": 5e-4},
    "obstacle": CONTACT,
    "held by contact": {
        **{"clamped": None, "prescribed": {"left": (0, None)}, "body_force": (0, -3.0)},
        **{"contact": "clamped", "gap": 1e-3},
    },
    "friction": {**PRESSED, "friction": 0.1},
    "Coulomb friction": {**PRESSED, "friction": Coulomb(0.3)},
    "contact at a clamp": {**CLAMPED_ASIDE, **CONTACT},
    "rollers": {"prescribed": {"contact": Roller()}},
    "edges and points": {"traction": LOAD | {Point((1.0, 1.0)): (0.2, 0.1)}},
    "springs": {"springs": {"contact": 200.0}},
}
"""Feature -> what gives it to the plain problem."""


def two_squares():
    """A unit square above another one, each with its own nodes between them."""
    lower = Rectangle(1, 1).Face()
    upper = MoveTo(0, 1).Rectangle(1, 1).Face()
    for body, maxh in ((lower, 0.6), (upper, 0.4)):
        body.edges.name = "side"
        body.faces.maxh = maxh
    upper.edges.Max(X).name = "right"
    lower.edges.Max(Y).name = "below"
    lower.edges.Min(Y).name = "clamped"
    upper.edges.Min(Y).name = "above"
    upper.edges.Max(Y).name = "top"
    return Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=1))


def share(mesh):
    """Let a mesh say from now on that two processes have a part of it each."""
    team = Team()
    team.size = 2
    mesh.processes = team


def problem_with(feature):
    """A problem with this feature; a mesh is to be shared when a solution is there."""
    if feature == "solid":
        return pressed_body("tetrahedra")
    if feature in ("hexahedra", "prisms"):
        return pressed_body(feature)
    if feature == "curved elements":
        return pressed_body("curved triangles")
    if feature == "shared mesh":
        return replace(PLAIN, mesh=block.structured_mesh(3, 3, simplices=True))
    if feature == "two bodies":
        held = {"top": (0.002, -0.005)}
        pair = Contact("above", "below")
        return Problem(two_squares(), STEEL, prescribed=held, contact=pair, order=1)
    return replace(PLAIN, **CHANGES[feature])
