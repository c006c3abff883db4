"""Bounds on cubes of hexahedra, regular and tapered, beside the error."""

import time
from dataclasses import dataclass
from functools import cache

from bodies import STEEL, tapered

from ngepc import Problem, error_bound, semismooth_newton, solve_to
from ngepc.geometries import block
from ngepc.studies.work import Work

CASES = {
    "elastic": {"traction": {"right": (0.2, 0.1, 0.15)}},
    "plastic": {"traction": {"right": (2.0, 0.5, 1.0)}},
    "contact": {
        "traction": {"right": (2.0, 0.5, 1.0)},
        "body_force": (0.0, 0.0, 1.0),
        "contact": "contact",
        "gap": 3e-4,
    },
}
"""Loads of a clamped cube with h/mu = 0.1."""

KNOWN = {"elastic": 0.0015, "plastic": 0.004, "contact": 0.004}
"""Guaranteed relative errors of the references."""

TAPERS = (0.0, 0.3)
"""By how much the top is narrower; vertices of the tapered cube are moved at random, too."""


def cube(n, taper):
    """A cube of n x n x n hexahedra."""
    if taper == 0:
        return block.structured_mesh(n, n, n)
    return tapered(n, taper=taper)


@cache
def reference(case, taper):
    """The middle of an interval of the least energy, by adaptive tetrahedra of order two."""
    problem = Problem(cube(2, taper), STEEL, **CASES[case])
    bound = solve_to(problem, KNOWN[case]).bound
    return (bound.energy + bound.least_energy) / 2, bound.total / 2


def timed(work, *arguments):
    """What ``work`` returns, and its processor time."""
    start = time.process_time()
    found = work(*arguments)
    return found, time.process_time() - start


@dataclass(eq=False)
class Cubes(Work):
    """The bounds of each case on meshes of three widths, both orders."""

    name = "cubes"
    title = "Bounds on hexahedra"
    columns = """case = {case} | taper = {taper:g} | elements = {elements} | order = {order}
        | bound / error = {effectivity:.2f} | known to = {known:.2f}
        | upper energy less energy / error = {excess:.4f} | Newton steps = {steps_ratio:.0f}"""
    note = (
        "A clamped cube that is pulled at one side.  Errors are energies less the middle of an"
        " interval from adaptive tetrahedra of order two, the half width of which is 'known to'"
        " times the error.  Newton steps: the processor time of the bound over that of a Newton"
        " step of the result, its set-up shared among the steps."
    )

    def cells(self):
        """Cases, tapers, widths and orders."""
        return [
            {"case": case, "taper": taper, "n": n, "order": order}
            for case in CASES
            for taper in TAPERS
            for n in (2, 4, 6)
            for order in (1, 2)
        ]

    def solve(self, case, taper, n, order):
        """The bound over the error."""
        mesh = cube(n, taper)
        problem = Problem(mesh, STEEL, order=order, **CASES[case])
        result, solving = timed(semismooth_newton, problem)
        bound, bounding = timed(error_bound, result)
        middle, half = reference(case, taper)
        error = bound.energy - middle
        steps = len(result.history.records)
        return {
            "case": case,
            "taper": taper,
            "order": order,
            "elements": mesh.ne,
            "effectivity": bound.total / error,
            "known": half / error,
            "excess": (bound.energy - result.primal_energy) / error,
            "crosses": bound.least_energy > middle + half or error < -half,
            "steps_ratio": bounding * steps / solving,
        }

    def succeeded(self, records):
        """No energy crosses a lower bound."""
        return not any(record["crosses"] for record in records)
