"""Random problems of two blocks, one above the other, whose meshes do not match.

And of one block that contact alone holds.
"""

import math
from dataclasses import replace

import numpy as np
from campaigns.random_problems import _material
from netgen.occ import Compound, MoveTo, OCCGeometry, X, Y
from ngsolve import Mesh, x

from ngepc import Contact, Problem

LONGEST = 0.02
"""Largest gap or overlap, over the width of the lower block."""


def two_blocks(draw, order):
    """The problem that a draw stands for.

    The upper block may reach beyond the lower one, and be stiffer or softer.  Its top is moved, or
    it is pressed and nothing else holds it in the vertical direction, or it is clamped at a side
    and loaded.
    """
    random = np.random.default_rng(int(1e9 * draw.maxh))
    size = 10**draw.length_unit
    one = _material(draw)
    strain = one.yield_stress / (2 * one.lame_mu)
    gap = gap_of(draw, strain) * 2 * size
    mesh = mesh_of(draw, random, size, gap)
    material = with_other(one, mesh, 10 ** random.uniform(-1, 1))
    names = ("above", "below") if random.uniform() < 0.7 else ("below", "above")
    contact = Contact(*names)
    stress = draw.load * one.yield_stress
    top = held = None
    clamped = "bottom"
    if draw.kind == "kinematic":
        pushed = 0.7 * size * draw.load * strain
        held = {"top": (pushed * math.cos(draw.angle), -gap - pushed)}
    elif draw.kind == "isotropic":
        top = (0.0, -stress)
        held = {"left": (0, None)}
    else:
        top = (stress * math.cos(draw.angle), stress * math.sin(draw.angle))
        clamped = "bottom|left"
    load = None if top is None else {"top": top}
    return Problem(
        mesh, material, clamped, load, prescribed=held, contact=contact, order=order
    )


def held_block(draw, order):
    """A block that is pressed onto a flat or curved obstacle; contact alone holds it vertically.

    It may turn and slide, or a support on the left keeps it from that.
    """
    random = np.random.default_rng(int(1e9 * draw.maxh))
    size = 10**draw.length_unit
    material = _material(draw)
    strain = material.yield_stress / (2 * material.lame_mu)
    width = random.uniform(0.5, 2.0)
    block = MoveTo(0, 0).Rectangle(width * size, size).Face()
    block.edges.name = "side"
    block.edges.Min(X).name = "left"
    block.edges.Min(Y).name = "below"
    block.edges.Max(Y).name = "top"
    geometry = OCCGeometry(block, dim=2)
    mesh = Mesh(geometry.GenerateMesh(maxh=2 * size * draw.maxh))
    middle = random.uniform(0.3, 0.7) * width * size
    bent = {"near": 1.0, "pushed": 5.0}.get(draw.gap, 0.0)
    gap = bent * strain * (x - middle) ** 2 / size
    pressure = draw.load * material.yield_stress
    slope = 0.5 * math.cos(draw.angle) / size
    load = {"top": (0, -pressure * (1 + slope * (x - middle)))}
    held = {"left": (0, None)} if draw.kind == "isotropic" else None
    contact = {"contact": "below", "gap": gap}
    return Problem(mesh, material, None, load, prescribed=held, order=order, **contact)


def gap_of(draw, strain):
    """The gap over the width of the lower block, negative for blocks that overlap."""
    least = min(draw.gap_size * strain, LONGEST)
    signed = {"open": 3 * least, "near": least, "pushed": -least}
    return signed.get(draw.gap, 0.0)


def mesh_of(draw, random, size, gap):
    """The mesh of both blocks."""
    start = random.uniform(-0.1, 1.6)
    width = random.uniform(0.5, 1.2)
    lower = MoveTo(0, 0).Rectangle(2 * size, size).Face()
    upper = MoveTo(start * size, size + gap).Rectangle(width * size, 0.7 * size).Face()
    maxh = 2 * size * draw.maxh
    widths = maxh, maxh * 10 ** random.uniform(-0.4, 0.4)
    sides = (("bottom", "below"), ("above", "top"))
    bodies = (lower, upper)
    names = ("lower", "upper")
    for body, name, h, (low, high) in zip(bodies, names, widths, sides, strict=True):
        body.edges.name = "side"
        body.faces.name = name
        body.faces.maxh = h
        body.edges.Min(Y).name = low
        body.edges.Max(Y).name = high
    upper.edges.Min(X).name = "left"
    geometry = OCCGeometry(Compound([lower, upper]), dim=2)
    return Mesh(geometry.GenerateMesh(maxh=size))


def with_other(one, mesh, factor):
    """The material, and in the upper block one that is stiffer by a factor."""

    def scaled(value):
        """A modulus or a stress in both blocks."""
        return mesh.MaterialCF({"lower": value, "upper": factor * value})

    names = ("lame_lambda", "lame_mu", "yield_stress")
    changes = {name: scaled(getattr(one, name)) for name in names}
    return replace(one, **changes)
