"""A rigid disc pressed into a block: Hertz's contact pressure, and how yielding flattens it.

In plane strain the modulus is E* = E / (1 - nu^2). Under a rigid disc of radius R the line force
P belongs to the half width a = sqrt(4 P R / (pi E*)) and to the pressure 2 P / (pi a) sqrt(1 -
x^2/a^2).
"""

import math
from pathlib import Path

import numpy as np
from matplotlib.patches import Circle
from ngsolve import Integrate, ds, x
from shared import check, plain, run, save

from ngepc import Material, Problem, semismooth_newton
from ngepc.geometries import punch
from ngepc.model.obstacles import Disc
from ngepc.pictures import beside, plot_field
from ngepc.pictures.curves import pressure_curves

YOUNG = 2.5e3
POISSON = 0.25
RADIUS = 5.0
DEPTH = 0.02
PLANE_MODULUS = YOUNG / (1 - POISSON**2)


def pressed(mesh, yield_stress):
    """The block under the disc, which has come down by DEPTH."""
    material = Material.metal(
        young=YOUNG, poisson=POISSON, yield_stress=yield_stress, plastic_modulus=150.0
    )
    gap = Disc((0.0, RADIUS), RADIUS).gap(mesh, motion=(0.0, -DEPTH))
    problem = Problem(mesh, material, contact="contact", gap=gap, order=2)
    return semismooth_newton(problem).raise_for_status()


def half_width(result):
    """a from the second moment of the pressure, P a^2 / 4 for Hertz's."""
    moment = Integrate(
        result.contact_pressure * x * x * ds("contact"), result.problem.mesh
    )
    return math.sqrt(4 * moment / result.contact_force)


def main(out: Path, coarse: bool = False) -> str:
    """Compare half width and peak with Hertz's formulas and draw the pressures."""
    mesh = punch.mesh(fine=0.04)
    for _ in range(1 if coarse else 2):
        mesh.Refine()
    elastic, plastic = pressed(mesh, 1e6), pressed(mesh, 12.25)
    force = elastic.contact_force
    a = math.sqrt(4 * force * RADIUS / (math.pi * PLANE_MODULUS))
    peak = 2 * force / (math.pi * a)
    highest = max(pressure.max() for _, pressure in pressure_curves(elastic))
    tolerance = 0.02 if coarse else 0.005
    line = check("half width", half_width(elastic), a, tolerance)
    line += ", " + check("peak pressure", highest, peak, tolerance)
    assert plastic.contact_force < force

    def curves(axes):
        plain(axes, "x", "contact pressure")
        s = np.linspace(-a, a, 200)
        for result, label in ((elastic, "elastic"), (plastic, "elastoplastic")):
            (position, pressure) = pressure_curves(result)[0]
            axes.plot(
                position - 0.5, pressure, ".-", markersize=3, linewidth=1, label=label
            )
        axes.plot(
            s, peak * np.sqrt(1 - (s / a) ** 2), "k--", linewidth=1, label="Hertz"
        )
        axes.legend(fontsize=8, frameon=False)

    def body(axes):
        plot_field(plastic, axes=axes, vmin=0, vmax=0.025, title="elastoplastic")
        axes.add_patch(
            Circle((0, RADIUS - DEPTH), RADIUS, facecolor="#d5d9de", zorder=2)
        )
        axes.set(xlim=(-0.8, 0.8), ylim=(-1.0, 0.25))

    save(beside(curves, body, height=3.4), out, "hertz")
    return f"hertz: P {force:.4g}, {line}, elastoplastic P {plastic.contact_force:.4g}"


if __name__ == "__main__":
    run(main)
