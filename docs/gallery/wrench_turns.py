"""The wrench of the paper's Example (b), turned, turned back, turned again, and let go.

Its handle is loaded by 1.1 times the paper's pressure.  Unloading is elastic: the handle springs
back by just the displacement that the same load causes without plasticity.
"""

from pathlib import Path

import numpy as np
from shared import check, plain, run, save

from ngepc import wrench_problem
from ngepc.evolution.load_path import load_cycle
from ngepc.evolution.solver import evolve
from ngepc.geometries import wrench
from ngepc.pictures import beside, plot_field
from ngepc.primal.solver import primal_newton

LOAD, CORNERS, END = 1.1, (1, -1, 1, 0), (8.0, 1.5)


def main(out: Path, coarse: bool = False) -> str:
    """Compare the spring-back with the elastic displacement, and both methods."""
    problem = wrench_problem(wrench.paper_mesh(245 if coarse else 1641))
    steps = 3 if coarse else 12
    path = load_cycle(problem, [LOAD * c for c in CORNERS], steps)
    history = evolve(problem, path).raise_for_status()
    witness = evolve(problem, path, primal_newton).raise_for_status()
    u, other = (
        np.array(h.values(lambda f: f.displacement(problem.mesh(*END))[1]))
        for h in (history, witness)
    )
    elastic = steps * u[0]
    line = check("spring-back", u[3 * steps - 1] - u[-1], elastic, 1e-8)
    difference = np.abs(other - u).max() / np.abs(u).max()
    assert difference < 1e-8, f"the methods differ by {difference:.1%}"
    factors = np.interp(history.times, range(5), (0, *CORNERS))

    def curves(axes):
        plain(
            axes, "plastic part of the displacement of the handle's end", "load factor"
        )
        axes.plot(
            [0, *(u - elastic * factors)], [0, *(LOAD * factors)], ".-", markersize=5
        )

    def body(axes):
        turned = history.steps[steps - 1].fields
        plot_field(turned, axes=axes, vmin=0, vmax=0.01, title="after the first turn")

    save(beside(curves, body, width=5.0, height=3.2), out, "wrench_turns")
    return f"wrench: {line}, exact and primal differ by {difference:.1g}"


if __name__ == "__main__":
    run(main)
