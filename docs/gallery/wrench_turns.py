"""The wrench of the paper's Example (b), turned, turned back, turned again, and let go.

Its handle is loaded by 1.1 times the paper's pressure.  Unloading is elastic: the handle springs
back by just the displacement that the same load causes without plasticity.
"""

from pathlib import Path

import numpy as np
from shared import check, plain, run, save

from ngepc import semismooth_newton, wrench_problem
from ngepc.evolution.load_path import load_cycle
from ngepc.evolution.solver import cold_start, evolve
from ngepc.geometries import wrench
from ngepc.pictures import beside, plot_field
from ngepc.primal.solver import primal_newton

LOAD, CORNERS, END = 1.1, (1, -1, 1, 0), (8.0, 1.5)


def main(out: Path, coarse: bool = False) -> str:
    """Compare the spring-back with the elastic displacement, and both methods."""
    problem = wrench_problem(wrench.paper_mesh(437 if coarse else 1641))
    steps = 3 if coarse else 6
    path = load_cycle(problem, [LOAD * c for c in CORNERS], steps)
    dual = cold_start(semismooth_newton)
    histories = {
        "primal": evolve(problem, path, primal_newton).raise_for_status(),
        "dual": evolve(problem, path, dual).raise_for_status(),
    }
    moved = {
        name: np.array(history.values(lambda f: f.displacement(problem.mesh(*END))[1]))
        for name, history in histories.items()
    }
    u = moved["primal"]
    elastic = steps * u[0]
    line = check("spring-back", u[3 * steps - 1] - u[-1], elastic, 1e-8)
    difference = np.abs(moved["dual"] - u).max() / np.abs(u).max()
    assert difference < (0.06 if coarse else 0.03), f"the methods differ by {difference:.1%}"
    factors = np.interp(histories["primal"].times, range(5), (0, *CORNERS))

    def curves(axes):
        plain(axes, "displacement of the handle's end (length)", "load factor")
        for style, (name, end) in zip(("k-", "C1--"), moved.items(), strict=True):
            axes.plot([0, *end], [0, *(LOAD * factors)], style, linewidth=1, label=f"{name} method")
        axes.legend(fontsize=8, frameon=False)

    def body(axes):
        turned = histories["primal"].steps[steps - 1].fields
        plot_field(turned, axes=axes, vmin=0, vmax=0.01, title="after the first turn")

    save(beside(curves, body, width=5.0, height=3.2), out, "wrench_turns")
    return f"wrench: {line}, primal and dual differ by {difference:.2%}"


if __name__ == "__main__":
    run(main)
