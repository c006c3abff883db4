"""A ring under internal pressure inside a rigid ring: yielding, contact, and the closed form.

The gap closes while the ring yields from inside.  ``pressed_shell.py`` has the solution,
with equilibrium, the flow rule and the contact condition satisfied exactly.  It is that of the
paper's two-dimensional law, which has no tensile test with the factors of ``Material.metal``.
"""

import math
from pathlib import Path

import numpy as np
from ngsolve import CF, InnerProduct, Integrate, ds
from pressed_shell import PressedShell
from shared import check, plain, run, save

from ngepc import Material, Problem, semismooth_newton
from ngepc.geometries import ring
from ngepc.pictures import beside, plot_field

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
GAP, PRESSURES = 4e-4, (0.3, 0.6, 0.9, 1.2, 1.5)


def solved(mesh, pressure):
    """A quarter of the ring, with the law of the closed form: tensors are 2 x 2."""
    problem = Problem(
        mesh,
        MATERIAL,
        clamped=None,
        prescribed={"left": (0, None), "bottom": (None, 0)},
        pressure={"inner": pressure},
        contact="outer",
        gap=GAP,
        kinematics="two-dimensional",
    )
    return semismooth_newton(problem).raise_for_status()


def main(out: Path, coarse: bool = False) -> str:
    """Compare displacement, contact pressure and plastic zone with the closed form."""
    mesh = ring.quarter_mesh(0.1 if coarse else 0.05)
    wall = Integrate(CF(1) * ds("outer"), mesh)
    results = [solved(mesh, pressure) for pressure in PRESSURES]
    shells = [
        PressedShell(material=MATERIAL, N=2, pressure=P, gap=GAP) for P in PRESSURES
    ]
    last, exact = results[-1], shells[-1]

    error = last.displacement - exact.displacement_vector
    size = Integrate(
        InnerProduct(exact.displacement_vector, exact.displacement_vector), mesh
    )
    error = math.sqrt(Integrate(InnerProduct(error, error), mesh) / size)
    assert error < (0.01 if coarse else 0.002)
    tolerance = 0.05 if coarse else 0.02
    line = check(
        "contact", last.contact_force / wall, exact.contact_pressure, tolerance
    )
    r = np.linspace(1, 2, 2001)
    yielded = float(np.mean(exact.plastic_strain(r) * r) * math.pi / 2)
    strain = Integrate(last.equivalent_plastic_strain, mesh)
    line += ", " + check("integral of |p|", strain, yielded, tolerance)

    def curves(axes):
        plain(axes, "internal pressure", "contact pressure")
        P = np.linspace(0, PRESSURES[-1], 100)
        closed = [
            PressedShell(material=MATERIAL, N=2, pressure=p, gap=GAP).contact_pressure
            for p in P
        ]
        axes.plot(P, closed, "k-", linewidth=1, label="closed form")
        axes.plot(
            PRESSURES,
            [r.contact_force / wall for r in results],
            "o",
            label="exact method",
        )
        axes.legend(fontsize=8, frameon=False)

    def body(axes):
        plot_field(last, axes=axes, deformation_scale=200)

    save(beside(curves, body), out, "pressed_ring")
    return f"pressed ring: {line}, relative error of u {error:.2g}"


if __name__ == "__main__":
    run(main)
