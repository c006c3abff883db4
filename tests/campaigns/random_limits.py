"""Random bodies for limit loads, in the plane and in space."""

import numpy as np
from netgen.occ import Box, Glue, MoveTo, OCCGeometry, X, Y, Z
from ngsolve import CF, Mesh

from ngepc import Material, Problem, Roller


def body(random):
    """Two rectangles of random sizes side by side, of two materials."""
    a, b, h = random.uniform(0.5, 2.0, 3)
    left = MoveTo(0, 0).Rectangle(a, h).Face()
    right = MoveTo(a, 0).Rectangle(b, h * random.choice((1.0, 0.6))).Face()
    for part, name in ((left, "left"), (right, "right")):
        part.faces.name = name
        part.edges.Max(Y).name = "top"
        part.edges.Min(Y).name = "bottom"
    left.edges.Min(X).name = "west"
    right.edges.Max(X).name = "east"
    shape = Glue([left, right])
    for edge in shape.edges:
        edge.name = edge.name or "step"
    return Mesh(OCCGeometry(shape, dim=2).GenerateMesh(maxh=random.uniform(0.15, 0.4)))


def strength(mesh, random):
    """A yield stress, one value or one for each material."""
    strong, weak = random.uniform(0.5, 2.0, 2)
    if random.random() < 0.5:
        return float(strong)
    return mesh.MaterialCF({"left": strong, "right": weak})


def problem(seed):
    """The problem with a number, and the loads that grow."""
    random = np.random.default_rng(seed)
    mesh = body(random)
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=strength(mesh, random), hardening=1.0
    )
    given = {"body_force": (0.0, -float(random.uniform(0, 0.05)))}
    support = random.integers(4)
    if support == 0:
        given["clamped"] = "bottom"
    elif support == 1:
        given |= {"clamped": None, "prescribed": {"bottom": Roller(), "west": (0, 0)}}
    else:
        given |= {"clamped": "west", "contact": "bottom", "gap": 0.0}
        if support == 3:
            given["friction"] = float(random.uniform(0, 0.5))
    x, y = random.normal(size=2)
    some = random.random() < 0.5
    staying = 0.1 if some else 1.0
    top = (staying * float(x), staying * float(y))
    given["traction"] = {"top": top, "east": (0.0, CF(float(x)))}
    return Problem(mesh, metal, **given), ["east"] if some else None


def solid_body(random):
    """Two boxes of random sizes side by side, of two materials."""
    a, b, width, height = random.uniform(0.5, 1.5, 4)
    left = Box((0, 0, 0), (a, width, height))
    right = Box((a, 0, 0), (a + b, width, height * random.choice((1.0, 0.6))))
    for part, name in ((left, "left"), (right, "right")):
        part.solids.name = name
        part.faces.name = "side"
        part.faces.Max(Z).name = "top"
        part.faces.Min(Z).name = "bottom"
    left.faces.Min(X).name = "west"
    right.faces.Max(X).name = "east"
    shape = Glue([left, right])
    for face in shape.faces:
        face.name = face.name or "step"
    return Mesh(OCCGeometry(shape).GenerateMesh(maxh=random.uniform(0.6, 1.0)))


def solid_problem(seed):
    """The problem of a solid with a number, and the loads that grow."""
    random = np.random.default_rng(seed)
    mesh = solid_body(random)
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=strength(mesh, random), hardening=1.0
    )
    given = {"body_force": (0.0, 0.0, -float(random.uniform(0, 0.05)))}
    support = random.integers(4)
    if support == 0:
        given["clamped"] = "bottom"
    elif support == 1:
        given |= {"clamped": None}
        given["prescribed"] = {"bottom": Roller(), "west": (0, 0, 0)}
    else:
        given |= {"clamped": "west", "contact": "bottom", "gap": 0.0}
        if support == 3:
            given["friction"] = float(random.uniform(0, 0.5))
    pull = random.normal(size=3)
    some = random.random() < 0.5
    staying = 0.1 if some else 1.0
    given["traction"] = {
        "top": tuple(float(staying * p) for p in pull),
        "east": (0.0, 0.0, float(pull[0])),
    }
    return Problem(mesh, metal, **given), ["east"] if some else None
