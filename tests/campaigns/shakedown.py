"""Factors of loads that vary, beside closed forms and published values."""

import math
from dataclasses import dataclass

from ngsolve import y

from ngepc import Problem, shakedown_load
from ngepc.geometries import block
from ngepc.studies.shakedown_problems import (
    YOUNG,
    bree_problem,
    bree_vertices,
    holed_plate,
    steel,
)
from ngepc.studies.work import Work

BREE = ((0.0, 1.0), (0.3, 2.0), (0.5, 0.5), (0.6, 1.2), (0.8, 0.8))
"""Tension X and thermal stress Y over the yield stress."""

PRESSURES = (0.0, 0.5, 0.9)
"""Tractions on the free side of a sheet between walls, over the yield stress."""

WIDTHS = (0.6, 0.3, 0.2)
"""Mesh widths of the plate with a hole of radius one."""

HOLES = {
    "hole, one load": ({"right": (0, 1), "top": (0, 0)}, "0.571 to 0.654"),
    "hole, two loads": ({"right": (0, 1), "top": (0, 1)}, "0.431 to 0.504"),
}
"""Ranges of the loads, and what tables have: Belytschko 1972, Corradi and Zavelani 1974,
Gross-Weege 1997, quoted from memory."""


def heated_sheet():
    """A square sheet between two walls, warmer at the top than at the bottom, pulled there."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    return Problem(
        mesh,
        steel(0.3),
        None,
        kinematics="plane stress",
        prescribed={"clamped": (None, 0), "left": (0, None), "right": (0, None)},
        traction={"contact": (0, 1.0)},
        initial_strain=2 * (y - 0.5) / YOUNG,
    )


@dataclass(eq=False)
class Shakedowns(Work):
    """Bree's plate, a sheet between walls and a plate with a hole."""

    width: float = 0.01

    name = "shakedown"
    title = "Factors of loads that vary"
    columns = """problem = {problem} | known = {known} | origin = {origin}
        | lower = {lower:.7g} | upper = {upper:.7g} | worth = {worth}
        | above the upper bound = {beyond} | elements = {elements}"""
    note = (
        "C: closed form. M: tables of Belytschko 1972, Corradi and Zavelani 1974 and Gross-Weege"
        " 1997, quoted from memory, not looked up."
    )

    def cells(self):
        bree = [{"kind": "bree", "X": X, "Y": Y} for X, Y in BREE]
        sheets = [{"kind": "sheet", "pressure": p} for p in PRESSURES]
        holes = [
            {"kind": "hole", "loads": loads, "maxh": maxh}
            for loads in HOLES
            for maxh in WIDTHS
        ]
        return bree + sheets + holes

    def solve(self, kind, **given):
        found, known, problem = getattr(self, kind)(**given)
        return {
            "problem": problem,
            "known": known if isinstance(known, str) else f"{known:.7g}",
            "exact": None if isinstance(known, str) else known,
            "origin": "M" if isinstance(known, str) else "C",
            "lower": found.lower,
            "upper": found.upper,
            "alternating": found.alternating,
            "worth": "guaranteed" if found.exact else "estimate",
            "beyond": "alternates" if found.alternates else "grows",
            "elements": found.records[-1].cells,
            "reached": found.status.is_success,
        }

    def bree(self, X, Y):
        """X + Y / 4 = 1 (ratchetting) and Y = 2 (alternation)."""
        found = shakedown_load(bree_problem(), bree_vertices(X, Y), self.width)
        exact = min(1 / (X + Y / 4), 2 / Y)
        return found, exact, f"Bree's plate, X = {X:g}, Y = {Y:g}"

    def sheet(self, pressure):
        """Stresses t and t + Y along it within the ellipse of yield: Y^2 + 3 P^2 = 4."""
        cold = {"contact": pressure}
        hot = {"contact": pressure, "initial_strain": 1.0}
        found = shakedown_load(heated_sheet(), [cold, hot], self.width)
        exact = 2 / math.sqrt(1 + 3 * pressure**2)
        return found, exact, f"sheet between walls, P = {pressure:g}"

    def hole(self, loads, maxh):
        """A fifth of the width of the plate; an estimate that improves with the mesh."""
        ranges, known = HOLES[loads]
        found = shakedown_load(holed_plate(maxh), ranges, self.width)
        return found, known, f"{loads}, mesh width {maxh:g}"

    def succeeded(self, records):
        closed = [record for record in records if record["exact"] is not None]
        return all(record["reached"] for record in records) and all(
            record["lower"] <= record["exact"] * (1 + 1e-12)
            and record["upper"] >= record["exact"]
            for record in closed
        )
