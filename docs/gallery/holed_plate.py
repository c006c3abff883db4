"""A plate with a hole, pulled and pushed: hysteresis loops and their energy.

With linear kinematic hardening the cycles become periodic.  Then the work of a cycle, the area of
its loop, is what the plastic flow has dissipated: int beta |p| summed over the steps.
"""

from pathlib import Path

import numpy as np
from ngsolve import Integrate
from shared import check, plain, run, save

from ngepc import Material, Problem
from ngepc.evolution.load_path import load_cycle
from ngepc.evolution.solver import evolve
from ngepc.geometries import plate
from ngepc.pictures import beside, plot_field
from ngepc.primal.solver import primal_newton

STRETCH, CORNERS = 1.2e-3, (1, -1, 1, -1, 1)


def quarter(maxh):
    """A quarter of the plate, its top moved by STRETCH at factor 1."""
    material = Material.metal(
        young=2.5e3,
        poisson=0.25,
        yield_stress=np.sqrt(1.5) * 1.25,
        plastic_modulus=150.0,
        kind="kinematic",
    )
    supports = {"left": (0, None), "bottom": (None, 0), "top": (None, STRETCH)}
    return Problem(
        plate.quarter_mesh(maxh), material, clamped=None, prescribed=supports
    )


def loop(history):
    """Displacement and force of the top at the steps; the force by virtual work with (0, y)."""
    factors = np.interp(history.times, range(len(CORNERS) + 1), (0, *CORNERS))
    forces = history.values(
        lambda fields: Integrate(fields.stress[1, 1], history.problem.mesh)
    )
    return STRETCH * factors, np.array(forces)


def main(out: Path, coarse: bool = False) -> str:
    """Compare the area of the last loop with the dissipation, and with a second solver."""
    problem = quarter(0.3 if coarse else 0.08)
    steps = 4 if coarse else 12
    path = load_cycle(problem, CORNERS, steps)
    history = evolve(problem, path).raise_for_status()
    witness = evolve(problem, path, primal_newton).raise_for_status()
    moved, force = loop(history)
    _, other = loop(witness)
    first, last = (slice(k * steps - 1, (k + 2) * steps) for k in (1, 3))
    area = np.trapezoid(force[last], moved[last])
    lost = sum(history.column("dissipation")[-2 * steps :])
    line = check("area of the loop", area, lost, 0.15 if coarse else 0.03)
    assert np.abs(force[last] - force[first]).max() < 0.02 * force.max()
    line += ", largest force " + check("primal", other.max(), force.max(), 1e-8)

    def curves(axes):
        plain(axes, "displacement of the top", "force")
        axes.plot([0, *moved], [0, *force], ".-", linewidth=1, markersize=3)
        axes.ticklabel_format(axis="x", scilimits=(-2, 3))

    def body(axes):
        plot_field(history.steps[-1].fields, axes=axes, title="after two cycles")

    save(beside(curves, body), out, "holed_plate")
    return f"holed plate: {line} (exact)"


if __name__ == "__main__":
    run(main)
