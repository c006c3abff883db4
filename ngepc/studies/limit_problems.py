"""Limit loads with published values or closed forms."""

import math
from collections.abc import Callable
from functools import partial

from ngepc.geometries import block
from ngepc.geometries.published import (
    eighth_under_punch,
    ground_under_strip,
    quarter_sheet,
    vertical_cut,
)
from ngepc.limit.load import limit_load
from ngepc.limit.outcome import LimitLoad
from ngepc.model.material import Material
from ngepc.model.places import Roller
from ngepc.model.problem import Problem
from ngepc.studies.solid_problems import Quantity, Solved

CUT = (3.7752, 3.7776)
"""Kammoun, Pastor, Smaoui, Pastor 2010, doi 10.1002/nag.887: gamma H / c."""

PUNCH = (1.5, 1.0, (3, 2))
"""Half the width and the depth of the block over half the width of the punch, of each box."""


def strong(bound: float) -> Material:
    """A material with this bound of |dev sigma|; limit loads need no other number."""
    elastic = {"lame_lambda": 1e3 * bound, "lame_mu": 1e3 * bound}
    return Material.kinematic(**elastic, yield_stress=bound, hardening=bound)


CLAY = strong(math.sqrt(2))
"""Shear yield stress one."""


def cut_problem() -> Problem:
    """The vertical cut under its own weight."""
    return Problem(vertical_cut(0.5), CLAY, "held", body_force=(0, -1))


def strip_problem() -> Problem:
    """Prandtl's strip: a pressure on the ground, half of it."""
    supports = {"axis": (0, None)}
    loads = {"load": 1}
    mesh = ground_under_strip(0.6)
    return Problem(mesh, CLAY, "held", prescribed=supports, pressure=loads)


def square_problem(side: float = 0.0, top: float = 1.0) -> Problem:
    """SSNV124: a square in plane strain that yields at 10, with a traction that stays on a side.

    ``top`` is the traction that grows.
    """
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None)}
    loads = {"contact": (0, top), "right": (side, 0.0)}
    steel = strong(10 * math.sqrt(2 / 3))
    return Problem(mesh, steel, None, prescribed=supports, traction=loads)


def sheet_problem() -> Problem:
    """A square sheet in plane stress with a hole, a quarter of it, pulled on two sides.

    The hole has a fifth of its width; the yield stress is one.
    """
    steel = strong(math.sqrt(2 / 3))
    supports = {"bottom": (None, 0), "left": (0, None)}
    given = {"prescribed": supports, "traction": {"right": (1, 0)}}
    mesh = quarter_sheet(5.0, 1.0, 0.7)
    return Problem(mesh, steel, None, kinematics="plane stress", **given)


def punch_problem(rough: bool = False) -> Problem:
    """A rigid square punch on a block of clay that lies on rough ground, an eighth of it."""
    half, depth, boxes = PUNCH
    mesh = eighth_under_punch(half, depth, 1.0, boxes)
    down = (0, 0, -1) if rough else (None, None, -1)
    supports = {"front": (None, 0, None), "diagonal": Roller(), "punch": down}
    return Problem(mesh, CLAY, "bottom", prescribed=supports)


LIMITS: dict[str, Callable[[], Problem]] = {
    "cut": cut_problem,
    "strip": strip_problem,
    "square": square_problem,
    "sheet": sheet_problem,
    "punch": punch_problem,
    "rough-punch": partial(punch_problem, rough=True),
}
"""Problems of ``ngepc limit``."""

GROWING = {"square": ["contact"]}
"""Their growing loads, if not all of them grow."""


def both_bounds(name: str, load: LimitLoad, exact: float, kind: str) -> list[Quantity]:
    """Both bounds beside a known value; the tolerance is the width that was asked for."""
    return [
        Quantity(f"{name}, lower bound", exact, kind, 0.01, load.lower),
        Quantity(f"{name}, upper bound", exact, kind, 0.01, load.upper),
    ]


def cut_height() -> Solved:
    """The height at which a vertical cut collapses, over shear strength and weight.

    The reference is the middle of the published bracket [3.7752, 3.7776].
    """
    return None, both_bounds("height", limit_load(cut_problem()), sum(CUT) / 2, "P")


def strip_pressure() -> Solved:
    """The pressure under a strip, 2 + pi."""
    load = limit_load(strip_problem())
    return None, both_bounds("pressure", load, 2 + math.pi, "C")


def square_traction() -> Solved:
    """A square in plane strain that is pulled, without a load that stays and with one.

    0.2 on the other side has -0.25 times the power of 0.8 on the first one: the published case.
    """
    found = []
    for side, top in ((0.0, 1.0), (0.2, 0.8)):
        load = limit_load(square_problem(side, top), 1e-3, ["contact"])
        exact = (20 / math.sqrt(3) + side) / top
        found += both_bounds(f"traction, {side:g} aside", load, exact, "P")
    return None, found


def sheet_traction() -> Solved:
    """A sheet in plane stress with a hole of a fifth of its width: 1 - R / L.

    Gaydon, McCrum, J. Mech. Phys. Solids 2 (1954).
    """
    load = limit_load(sheet_problem())
    return None, both_bounds("traction", load, 0.8, "P")
