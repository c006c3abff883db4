"""Bounds of bodies of revolution beside the error."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from campaigns.cubes import timed
from netgen.geom2d import SplineGeometry
from ngsolve import Mesh, x

from ngepc import Material, Problem, error_bound, semismooth_newton
from ngepc.studies.work import Work

ELASTIC = Material.kinematic(
    lame_lambda=3.0, lame_mu=2.0, yield_stress=1e6, hardening=0.2
)
"""h/mu = 0.1"""
PRESSURE = 0.4
HEIGHT = 0.6
FINE = 0.02
"""Mesh width of the references without a closed form."""


def rectangle(maxh, inner, outer, height):
    """A mesh of a rectangle of the half plane."""
    geometry = SplineGeometry()
    names = ["bottom", "right", "top", "left"]
    geometry.AddRectangle((inner, 0), (outer, height), bcs=names)
    return Mesh(geometry.GenerateMesh(maxh=maxh))


def tube(maxh, order, material=ELASTIC, **data):
    """A tube 1 <= r <= 2 between smooth plates, under a pressure inside."""
    mesh = rectangle(maxh, 1.0, 2.0, HEIGHT)
    flat = {"bottom|top": (None, 0)}
    inside = {"left": PRESSURE}
    given = {"kinematics": "axisymmetric", "order": order}
    return Problem(
        mesh, material, None, pressure=inside, prescribed=flat, **given, **data
    )


def indented(maxh, order, yield_stress):
    """A clamped cylinder that a paraboloid is pressed into."""
    material = replace(ELASTIC, yield_stress=yield_stress)
    return Problem(
        rectangle(maxh, 0.0, 1.0, 0.8),
        material,
        "bottom",
        contact="top",
        gap=x**2 / 2 - 0.05,
        kinematics="axisymmetric",
        order=order,
    )


CASES = {
    "tube, elastic": tube,
    "tube, yielding": lambda h, k: tube(h, k, replace(ELASTIC, yield_stress=0.4)),
    "tube in a bore": lambda h, k: tube(h, k, contact="right", gap=0.05),
    "paraboloid, elastic": lambda h, k: indented(h, k, 1e6),
    "paraboloid, yielding": lambda h, k: indented(h, k, 0.1),
}
"""Mesh width and order -> a problem."""


def energy_of_lame():
    """The least energy of the elastic tube: half of minus the work of the pressure."""
    inner = 1.0
    outer = 2.0
    bulk = 2 * (ELASTIC.lame_lambda + ELASTIC.lame_mu)
    shear = 2 * ELASTIC.lame_mu
    # u = A r + B / r, sigma_rr = bulk A - shear B / r^2
    matrix = [[bulk, -shear / inner**2], [bulk, -shear / outer**2]]
    A, B = np.linalg.solve(matrix, [-PRESSURE, 0.0])
    return -math.pi * inner * HEIGHT * PRESSURE * (A * inner + B / inner)


@cache
def least_energy(case):
    """The least energy of the elastic tube, a lower bound of that of others."""
    if case == "tube, elastic":
        return energy_of_lame()
    return error_bound(semismooth_newton(CASES[case](FINE, 2))).least_energy


@dataclass(eq=False)
class Rings(Work):
    """The bounds of each case on meshes of three widths, both orders."""

    name = "rings"
    title = "Bounds of bodies of revolution"
    columns = """case = {case} | elements = {elements} | order = {order}
        | bound / strain energy = {relative:.2g} | bound / error = {effectivity:.3f}
        | Newton steps = {steps_ratio:.0f}"""
    note = (
        "Errors are energies less the closed form for the elastic tube, for the others less the"
        " lower bound from a fine mesh of order two.  Newton steps: the processor time of the bound"
        " over that of a Newton step of the result, its set-up shared among the steps."
    )

    def cells(self):
        """Cases, widths and orders."""
        return [
            {"case": case, "maxh": maxh, "order": order}
            for case in CASES
            for maxh in (0.3, 0.15, 0.075)
            for order in (1, 2)
        ]

    def solve(self, case, maxh, order):
        """The bound over the largest error that the reference allows."""
        problem = CASES[case](maxh, order)
        result, solving = timed(semismooth_newton, problem)
        bound, bounding = timed(error_bound, result)
        return {
            "case": case,
            "order": order,
            "elements": problem.mesh.ne,
            "relative": bound.relative,
            "effectivity": bound.total / (bound.energy - least_energy(case)),
            "steps_ratio": bounding * len(result.history.records) / solving,
        }

    def succeeded(self, records):
        """No bound is below the error."""
        return all(record["effectivity"] >= 1 for record in records)
