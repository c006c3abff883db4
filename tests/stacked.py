"""A square that stands on a wider block; the nodes between them do not match."""

from dataclasses import replace
from functools import cache

from netgen.occ import Compound, MoveTo, OCCGeometry, Rectangle, X, Y
from ngsolve import Mesh

from ngepc import Contact, Material, Problem
from ngepc.geometries import block

ELASTIC = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=1e2
)
YIELDING = replace(ELASTIC, yield_stress=1.25)
PAIR = Contact("above", "below")
TURNED = Contact("below", "above")
LEFT = {"left": (0, None)}


def named(body, maxh, bottom, top):
    """A face with a mesh width and names of its lowest and highest edges."""
    body.edges.name = "side"
    body.faces.maxh = maxh
    body.edges.Min(X).name = "left"
    body.edges.Min(Y).name = bottom
    body.edges.Max(Y).name = top
    return body


@cache
def blocks(widths=(0.5, 0.3), start=0.5, gap=0.0):
    """A unit square on a wider block; the nodes between them do not match."""
    lower = named(Rectangle(2, 1).Face(), widths[0], "bottom", "below")
    upper = MoveTo(start, 1 + gap).Rectangle(1, 1).Face()
    upper = named(upper, widths[1], "above", "top")
    return Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=1))


@cache
def between(maxh, width):
    """A block between two wider ones; the nodes between them do not match."""
    lower = named(Rectangle(width, 1).Face(), maxh, "bottom", "below")
    middle = MoveTo(0.5, 1).Rectangle(width - 1, 1).Face()
    middle = named(middle, 0.9 * maxh, "above", "under")
    upper = MoveTo(0, 2).Rectangle(width, 1).Face()
    upper = named(upper, 1.1 * maxh, "over", "top")
    for wide in (lower, upper):
        wide.edges.Min(X).name = "side"
    bodies = Compound([lower, middle, upper])
    return Mesh(OCCGeometry(bodies, dim=2).GenerateMesh(maxh=1))


def pressed(order=1, pair=PAIR, material=YIELDING, mesh=None, **data):
    """The square pressed onto the block; in the vertical direction contact alone holds it."""
    mesh = mesh or blocks()
    load = {"top": (0, -1.0)}
    return Problem(
        mesh,
        material,
        "bottom",
        load,
        prescribed=LEFT,
        contact=pair,
        order=order,
        **data,
    )


def pushed(order=1, pair=PAIR, material=YIELDING):
    """The square pushed down and aside, after a small gap has closed."""
    moved = {"top": (1e-3, -1.5e-3)}
    mesh = blocks((0.35, 0.4), gap=5e-4)
    return Problem(
        mesh, material, "bottom", prescribed=moved, contact=pair, order=order
    )


def on_a_floor(order):
    """A column pressed onto a rigid floor after a gap has closed; contact alone holds it."""
    return Problem(
        block.mesh(0.3, (1.0, 1.0)),
        ELASTIC,
        None,
        {"contact": (0, -2)},
        prescribed=LEFT,
        contact="clamped",
        gap=1e-3,
        order=order,
    )
