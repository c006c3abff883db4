"""Random problems as a few numbers: the same numbers give the same problem again.

Materials over six orders of magnitude in stress, bodies over four in length, loads from elastic to
deeply plastic, gaps from none to full contact, CSG meshes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ngsolve import CF, Mesh

from ngepc.geometries import block, lshape, wrench
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.model.tensile import lame_parameters


@dataclass(frozen=True)
class DrawnBody:
    """A body of size ``length`` with the names of its parts; the contact boundary is flat."""

    mesh: Callable[[float], Mesh]
    length: float
    clamped: str
    load: str
    contact: str


BODIES = {
    "lshape": DrawnBody(lshape.mesh, 1.0, "clamped", "load", "contact"),
    "wrench": DrawnBody(
        lambda h: wrench.mesh(8 * h), 8.0, "clamped", "load", "contact"
    ),
    "block": DrawnBody(
        lambda h: block.mesh(h, (1.0, 0.7)), 1.0, "clamped", "right", "contact"
    ),
    "hole": DrawnBody(
        lambda h: block.with_hole(h, (1.0, 1.0)), 1.0, "clamped", "left", "contact"
    ),
    "strip": DrawnBody(
        lambda h: block.mesh(2 * h, (4.0, 0.5)), 4.0, "clamped", "left", "contact"
    ),
    "plate": DrawnBody(
        lambda h: block.with_hole(2 * h, (2.0, 2.0)),
        2.0,
        "clamped",
        "left|right",
        "contact",
    ),
    "cube": DrawnBody(lambda h: block.mesh(4 * h), 1.0, "clamped", "left", "contact"),
}

GAPS = ("none", "open", "touching", "near", "pushed")
HARDENINGS = ("kinematic", "isotropic", "combined")


@dataclass(frozen=True)
class Draw:
    """A random problem: all that ``build`` needs, as plain numbers.

    ``maxh`` is relative to the size of the body; ``stress_unit`` and ``length_unit`` are powers of
    ten that all stresses and lengths are multiplied with; ``yield_bound`` and ``hardening`` are
    log10 of them over lame_mu; ``load`` is in units of the yield bound, its ``angle`` in radians;
    ``gap_size`` (or the push) in units of length times yield strain; ``history`` is the size of
    the initial plastic strain over the yield strain.
    """

    body: str
    maxh: float
    stress_unit: float
    length_unit: float
    poisson: float
    yield_bound: float
    hardening: float
    kind: str
    load: float
    angle: float
    gap: str
    gap_size: float
    history: float


def draws(seed):
    """An endless sequence of random problems, the same for the same seed."""
    random = np.random.default_rng(seed)

    def one_of(values):
        return str(random.choice(list(values)))

    while True:
        yield Draw(
            body=one_of(BODIES),
            maxh=float(random.uniform(0.06, 0.2)),
            stress_unit=float(random.uniform(-3, 3)),
            length_unit=float(random.uniform(-2, 2)),
            poisson=float(random.choice([random.uniform(-0.4, 0.45), 0.3, 0.49])),
            yield_bound=float(random.uniform(-4, -1.5)),
            hardening=float(random.uniform(-3, 0.5)),
            kind=one_of(HARDENINGS),
            load=float(10 ** random.uniform(-1.5, 1.2)),
            angle=float(random.uniform(0, 2 * math.pi)),
            gap=one_of(GAPS),
            gap_size=float(10 ** random.uniform(-1, 1)),
            history=float(random.choice([0.0, 0.0, random.uniform(0, 2)])),
        )


def build(draw, plane="two-dimensional"):
    """The problem that a draw stands for, in the plane with this kinematics."""
    body = BODIES[draw.body]
    mesh = body.mesh(draw.maxh)
    kinematics = plane if mesh.dim == 2 else "solid"
    length = 10**draw.length_unit
    for point in mesh.ngmesh.Points():
        for i in range(mesh.dim):
            point[i] = length * point.p[i]
    mesh = Mesh(mesh.ngmesh)
    material = _material(draw)
    bound, strain = (
        material.yield_stress,
        material.yield_stress / (2 * material.lame_mu),
    )
    direction = [math.cos(draw.angle), math.sin(draw.angle)]
    if mesh.dim == 3:
        direction.insert(1, 0.3)
    contact = {}
    if draw.gap != "none":
        size = draw.gap_size * strain * body.length * length
        signed = {"open": 50 * size, "touching": 0.0, "near": size, "pushed": -size}[
            draw.gap
        ]
        contact = {"contact": body.contact, "gap": signed}
    return Problem(
        mesh,
        material,
        body.clamped,
        {body.load: tuple(draw.load * bound * c for c in direction)},
        **contact,
        **_history(draw, material, 2 if kinematics == "two-dimensional" else 3),
        kinematics=kinematics,
        order=1,
    )


def _material(draw):
    mu = 1e3 * 10**draw.stress_unit
    young = 2 * mu * (1 + draw.poisson)
    lame_lambda, lame_mu = lame_parameters(young, draw.poisson)
    bound, h = lame_mu * 10**draw.yield_bound, lame_mu * 10**draw.hardening
    share = {"kinematic": 1.0, "isotropic": 0.0, "combined": 0.4}[draw.kind]
    return Material(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=bound,
        hardening=share * h,
        hardening_modulus=2.0 if share < 1 else 0.0,
        hardening_stiffness=(1 - share) * h / (2.0 * bound) ** 2,
    )


def _history(draw, material, size):
    if draw.history == 0:
        return {}
    strain_size = draw.history * material.yield_stress / (2 * material.lame_mu)
    p = np.zeros((size, size))
    p[0, 0], p[1, 1], p[0, 1], p[1, 0] = (
        c * strain_size for c in (0.6, -0.6, 0.3, 0.3)
    )
    strain, back = (
        CF(tuple((c * p).ravel().tolist()), dims=p.shape)
        for c in (1, material.hardening)
    )
    norm = float(np.linalg.norm(p))
    scalar = (
        material.hardening_stiffness
        * material.hardening_modulus
        * material.yield_stress
    )
    return {
        "initial_plastic_strain": strain,
        "initial_hardening": (scalar * norm, back),
    }
