"""Limit loads of random bodies in the plane: supports, obstacles, friction, loads, strengths."""

import numpy as np
from netgen.occ import Glue, MoveTo, OCCGeometry, X, Y
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
