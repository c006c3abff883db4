"""Yield stress and hardening of a block from its force-depth curve, with noise of two percent.

A parabola is pressed into the block in six steps and drawn back in two; the forces, with random
errors, are all that ``calibrate`` gets.  The landscape is the sum of squares over both constants.

The constants are data of ``Material``, to which derivatives refer: a bar yields at (3/2)^(1/2)
times the first, and its plastic modulus is 3/2 times the second.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from ngsolve import x
from scipy.interpolate import RectBivariateSpline
from shared import check, plain, run, save

from ngepc import Curve, Material, Problem, Schedule, calibrate, evolve
from ngepc.geometries import block

TRUTH = {"yield_stress": 2.0, "hardening": 60.0}
START = {"yield_stress": 5.0, "hardening": 200.0}
TIMES = (0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.05, 1.1)
DEPTH = 0.03
YIELDS, HARDENINGS = np.geomspace(1.2, 6, 60), np.geomspace(15, 250, 60)


def main(out: Path, coarse: bool = False) -> str:
    """Find the constants and draw the curve beside the landscape of the misfit."""
    mesh = block.mesh(0.25 if coarse else 0.12, (2.0, 1.0))
    times = TIMES[1::2] if coarse else TIMES
    depths = [DEPTH * min(t, 2 - t) for t in times]
    path = Schedule(times, lambda t: {"gap": (x - 1) ** 2 / 2 - DEPTH * min(t, 2 - t)})

    def body(**constants: float) -> Problem:
        metal = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, **constants)
        order = 1 if coarse else 2
        return Problem(mesh, metal, contact="contact", gap=1.0, order=order)

    def forces(**constants: float) -> np.ndarray:
        return np.array(evolve(body(**constants), path).column("contact_force"))

    exact = forces(**TRUTH)
    noise = 0.02 * exact.max()
    measured = exact + noise * np.random.default_rng(0).standard_normal(len(exact))
    found = calibrate(
        body(**START), Curve(path, "contact_force", measured, noise), START
    )
    assert found.evaluations <= 15
    for name, (low, high) in found.intervals.items():
        assert low < TRUTH[name] < high, f"{name}: {low} to {high} misses {TRUTH[name]}"
    line = check(
        "yield stress", found.values["yield_stress"], TRUTH["yield_stress"], 0.1
    )
    line += ", " + check(
        "hardening", found.values["hardening"], TRUTH["hardening"], 0.15
    )

    side = 2 if coarse else 5
    degree = 1 if coarse else 3
    ys, hs = np.geomspace(1.2, 6, side), np.geomspace(15, 250, side)
    table = np.array([[forces(yield_stress=y, hardening=h) for h in hs] for y in ys])
    values = [
        RectBivariateSpline(np.log(ys), np.log(hs), F, kx=degree, ky=degree)
        for F in np.moveaxis(table, 2, 0)
    ]
    between = np.array([s(np.log(YIELDS), np.log(HARDENINGS)) for s in values])
    misfit = 0.5 * (((between - measured[:, None, None]) / noise) ** 2).sum(axis=0)

    figure = Figure(figsize=(8.2, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    plain(left, "depth", "contact force")
    left.plot([0, *depths], [0, *forces(**START)], "--", color="#9aa3ad", label="start")
    left.plot([0, *depths], [0, *forces(**found.values)], color="#c1440e", label="fit")
    left.errorbar(depths, measured, 2 * noise, fmt="ko", markersize=4, label="measured")
    left.legend(frameon=False, fontsize=8)
    plain(right, "yield stress", "hardening")
    levels = np.geomspace(1, 10_000, 9)
    kind = {"norm": "log", "cmap": "Blues", "extend": "both"}
    right.contourf(YIELDS, HARDENINGS, misfit.T, levels, **kind)
    right.plot(*START.values(), "o", color="#59636e", label="start")
    (low, high), (least, most) = found.intervals.values()
    box = [low, high, high, low, low], [least, least, most, most, least]
    right.plot(*box, color="#c1440e", label="95 percent")
    right.plot(*TRUTH.values(), "k*", label="truth")
    right.set(xscale="log", yscale="log")
    right.set_title("sum of squares, large where it is dark", fontsize=9)
    right.set_xticks([1.5, 2, 3, 5], ["1.5", "2", "3", "5"])
    right.set_yticks([20, 50, 100, 200], ["20", "50", "100", "200"])
    right.minorticks_off()
    right.legend(fontsize=8, loc="lower left")
    save(figure, out, "calibration")
    return f"calibration: {line}, {found.evaluations} solutions, condition {found.condition:.1f}"


if __name__ == "__main__":
    run(main)
