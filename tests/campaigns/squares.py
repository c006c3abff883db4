"""Bounds on squares of quadrilaterals, regular and distorted, beside the error."""

from dataclasses import dataclass
from functools import cache

from bodies import STEEL, distorted
from campaigns.cubes import timed

from ngepc import Problem, error_bound, semismooth_newton
from ngepc.geometries import block
from ngepc.studies.work import Work

CASES = {
    "elastic": {"traction": {"right": (0.2, 0.15)}},
    "plastic": {"traction": {"right": (2.0, 1.5)}},
    "contact": {
        "traction": {"right": (2.0, 1.5)},
        "body_force": (0.0, -1.0),
        "contact": "contact",
        "gap": 3e-4,
    },
}
"""Loads of a clamped unit square with h/mu = 0.1."""

MOVED = (0.0, 0.3)
"""How far inner vertices are moved at most, over the mesh width."""


@cache
def least_energy(case, fine):
    """A lower bound of the least energy, from triangles of order two."""
    mesh = block.structured_mesh(fine, fine, simplices=True)
    problem = Problem(mesh, STEEL, order=2, **CASES[case])
    return error_bound(semismooth_newton(problem)).least_energy


@dataclass(eq=False)
class Squares(Work):
    """The bounds of each case on meshes of three widths, both orders.

    Parameters
    ----------
    fine
        Squares along each side of the reference, each of two triangles.
    """

    fine: int = 32

    name = "squares"
    title = "Bounds on quadrilaterals"
    columns = """case = {case} | moved = {moved:g} | elements = {elements}
        | order = {order} | bound / error = {effectivity:.2f}
        | upper energy less energy / error = {excess:.4f} | Newton steps = {steps_ratio:.0f}"""
    note = (
        "A clamped square that is pulled at one side; inner vertices moved at random. Errors are"
        " energies less the lower bound from triangles of order two. The last column is what the"
        " upper bound of the energy adds, in part quadrature errors of the discrete energy."
        "  Newton steps: the processor time of the bound over that of a Newton step of the result,"
        " its set-up shared among the steps."
    )

    def cells(self):
        """Cases, distortions, widths and orders."""
        return [
            {"case": case, "moved": moved, "n": n, "order": order}
            for case in CASES
            for moved in MOVED
            for n in (4, 8, 16)
            for order in (1, 2)
        ]

    def solve(self, case, moved, n, order):
        """The bound over the largest error that the reference allows."""
        mesh = distorted(n, moved)
        problem = Problem(mesh, STEEL, order=order, **CASES[case])
        result, solving = timed(semismooth_newton, problem)
        bound, bounding = timed(error_bound, result)
        lower = least_energy(case, self.fine)
        error = bound.energy - lower
        return {
            "case": case,
            "moved": moved,
            "order": order,
            "elements": mesh.ne,
            "effectivity": bound.total / error,
            "excess": (bound.energy - result.primal_energy) / error,
            "steps_ratio": bounding * len(result.history.records) / solving,
        }

    def succeeded(self, records):
        """No bound is below the error."""
        return all(record["effectivity"] >= 1 for record in records)
