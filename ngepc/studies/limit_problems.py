"""Limit loads with published values or closed forms."""

import math
from collections.abc import Callable

from ngepc.geometries import block
from ngepc.geometries.published import (
    ground_under_strip,
    quarter_under_punch,
    vertical_cut,
)
from ngepc.limit.load import LimitLoad, limit_load
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.studies.solid_problems import Quantity, Solved

CUT = (3.7752, 3.7776)
"""Kammoun, Pastor, Smaoui, Pastor 2010, doi 10.1002/nag.887: gamma H / c."""

PUNCH = (1.5, 1.0, (3, 2))
"""Half of the width of the block and its depth over half of the width of the punch; boxes."""


def strong(bound: float) -> Material:
    """A material with this bound of |dev sigma|; limit loads do not depend on its other numbers."""
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


def square_problem(side: float = 0.0) -> Problem:
    """SSNV124: a square in plane strain that yields at 10, with a traction that stays on a side."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"clamped": (None, 0), "left": (0, None)}
    loads = {"contact": (0, 1.0), "right": (side, 0.0)}
    steel = strong(10 * math.sqrt(2 / 3))
    return Problem(mesh, steel, None, prescribed=supports, traction=loads)


def punch_problem(rough: bool = False) -> Problem:
    """A rigid square punch on a block of clay that lies on rough ground, a quarter of it."""
    half, depth, boxes = PUNCH
    mesh = quarter_under_punch(half, depth, 1.0, boxes)
    down = (0, 0, -1) if rough else (None, None, -1)
    supports = {"left": (0, None, None), "front": (None, 0, None), "punch": down}
    return Problem(mesh, CLAY, "bottom", prescribed=supports)


LIMITS: dict[str, Callable[[], Problem]] = {
    "cut": cut_problem,
    "strip": strip_problem,
    "square": square_problem,
    "punch": punch_problem,
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

    The second row has a traction of 3 on the other side, which adds 3: one field of stress.
    """
    found = []
    for side in (0.0, 3.0):
        load = limit_load(square_problem(side), 1e-3, ["contact"])
        exact = 20 / math.sqrt(3) + side
        found += both_bounds(f"traction, {side:g} aside", load, exact, "C")
    return None, found
