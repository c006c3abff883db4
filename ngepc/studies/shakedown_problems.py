"""Loads that vary: Bree's plate, whose shakedown is known, and a plate with a hole."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from netgen.occ import Glue, MoveTo, OCCGeometry, X, Y
from ngsolve import CF, CoefficientFunction, Mesh, y

from ngepc.geometries.published import quarter_sheet
from ngepc.limit.shakedown import Ranges, Vertices, shakedown_load
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.studies.solid_problems import Quantity, Solved

YOUNG = 200.0
"""Young's modulus over the yield stress of a bar, which is one."""

STRONG = 100.0
"""Yield stress of the end of Bree's plate, which transfers the tension."""


def steel(poisson: float, strength: float | CoefficientFunction = 1.0) -> Material:
    """Steel with the yield stress ``strength`` of a bar; its hardening does not count."""
    mu = YOUNG / (2 * (1 + poisson))
    return Material.kinematic(
        lame_lambda=2 * mu * poisson / (1 - 2 * poisson),
        lame_mu=mu,
        yield_stress=math.sqrt(2 / 3) * strength,
        hardening=1.0,
    )


def bree_mesh() -> Mesh:
    """A plate and its end, cut along the middle; boundaries ``left``, ``right``, ``guide``."""
    parts = []
    for name, left in (("plate", 0), ("end", 1)):
        for bottom in (-1, 0):
            part = MoveTo(left, bottom).Rectangle(1, 1).Face()
            part.faces.name = name
            part.edges.name = "free"
            if name == "plate":
                part.edges.Min(X).name = "left"
            else:
                part.edges.Max(X).name = "right"
                outside = part.edges.Max(Y) if bottom == 0 else part.edges.Min(Y)
                outside.name = "guide"
            parts.append(part)
    return Mesh(OCCGeometry(Glue(parts), dim=2).GenerateMesh(maxh=1.0))


def bree_problem() -> Problem:
    """A plate under tension that is heated on one side and cannot bend.

    A strong end between guides transfers the tension, a body force, and keeps plane sections plane.
    Without Poisson's effect and with thermal strains along the plate alone the elastic stress is
    X + Y y, also in the end, on which a traction holds the thermal stress in balance.
    """
    mesh = bree_mesh()
    strength = mesh.MaterialCF({"plate": 1.0, "end": STRONG})
    thermal = CF((-y / YOUNG, 0, 0, 0, 0, 0, 0, 0, 0), dims=(3, 3))
    return Problem(
        mesh,
        steel(0.0, strength),
        None,
        kinematics="plane stress",
        prescribed={"left": (0, None), "guide": (None, 0)},
        traction={"right": (y, 0)},
        body_force=mesh.MaterialCF({"end": (1, 0)}, default=(0, 0)),
        initial_strain=thermal,
    )


def bree_vertices(tension: float, thermal: float) -> list[dict[str, float]]:
    """The tension stays in each vertex, the temperature comes and goes."""
    hot = {"body_force": tension, "initial_strain": thermal, "right": thermal}
    return [{"body_force": tension}, hot]


def holed_plate(maxh: float = 0.2) -> Problem:
    """A quarter of a square plate in plane stress, pulled on two sides; the hole has a fifth."""
    mesh = quarter_sheet(5.0, 1.0, maxh)
    supports = {"bottom": (None, 0), "left": (0, None)}
    given = {"prescribed": supports, "traction": {"right": (1, 0), "top": (0, 1)}}
    return Problem(mesh, steel(0.3), None, kinematics="plane stress", **given)


@dataclass(frozen=True)
class Varying:
    """A problem and the vertices of its loads.

    Parameters
    ----------
    problem
        Makes the problem.
    vertices
        Ranges of loads, or factors at each vertex.
    """

    problem: Callable[[], Problem]
    vertices: Ranges | Vertices


SHAKEDOWNS: Mapping[str, Varying] = {
    "bree": Varying(bree_problem, bree_vertices(0.8, 0.8)),
    "bree-hot": Varying(bree_problem, bree_vertices(0.3, 2.0)),
    "hole": Varying(holed_plate, {"right": (0, 1), "top": (0, 0)}),
    "hole-both": Varying(holed_plate, {"right": (0, 1), "top": (0, 1)}),
}
"""Problems of ``ngepc limit`` whose loads vary."""


def bree_shakedown() -> Solved:
    """Factors of tension and thermal stress below which Bree's plate shakes down.

    X + Y / 4 = 1 (ratchetting) and Y = 2 (alternating plasticity), bounds that are guaranteed.
    """
    found: list[Quantity] = []
    cases: Sequence[tuple[float, float]] = ((0.8, 0.8), (0.6, 1.2), (0.3, 2.0))
    for tension, thermal in cases:
        load = shakedown_load(bree_problem(), bree_vertices(tension, thermal))
        exact = min(1 / (tension + thermal / 4), 2 / thermal)
        quantity = partial(Quantity, reference=exact, kind="C", tolerance=0.01)
        where = f"X = {tension}, Y = {thermal}"
        found.append(quantity(f"{where}, lower bound", ours=load.lower))
        found.append(quantity(f"{where}, upper bound", ours=load.upper))
    return None, found
