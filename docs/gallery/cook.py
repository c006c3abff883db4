"""Cook's membrane: the elastic tip displacement, then a membrane that yields.

The benchmark is plane stress with E = 1, nu = 1/3 and the shear load 1: with 2 x 2 tensors that
is lambda = E nu / (1 - nu^2) and mu = E / (2 (1 + nu)), both 3/8.  The tip (48, 52) then rises by
23.96.
"""

from pathlib import Path

from shared import check, plain, run, save

from ngepc import Material, Problem, semismooth_newton
from ngepc.geometries import cook
from ngepc.pictures import beside, plot_field
from ngepc.primal.solver import primal_newton

TIP, REFERENCE = (48.0, 52.0), 23.96


def membrane(nodes, yield_stress):
    """Clamped on the left, sheared on the right."""
    material = Material.kinematic(
        lame_lambda=0.375, lame_mu=0.375, yield_stress=yield_stress, hardening=0.05
    )
    mesh = cook.bisected_mesh(nodes)
    return Problem(mesh, material, traction={"load": (0.0, 1 / 16)})


def tip(result):
    """The vertical displacement of the middle of the loaded edge."""
    return result.displacement(result.problem.mesh(*TIP))[1]


def main(out: Path, coarse: bool = False) -> str:
    """Extrapolate the elastic tip displacement; compare both methods where it yields."""
    family = (81, 289, 1089) if coarse else (289, 1089, 4225)
    elastic = [tip(primal_newton(membrane(nodes, 1e3))) for nodes in family]
    rate = (elastic[1] - elastic[0]) / (elastic[2] - elastic[1])
    limit = elastic[2] + (elastic[2] - elastic[1]) / (rate - 1)
    line = check("elastic tip", limit, REFERENCE, 0.01 if coarse else 0.003)

    problem = membrane(family[-1], 0.1)
    primal = primal_newton(problem).raise_for_status()
    dual = semismooth_newton(problem).raise_for_status()
    line += ", elastoplastic " + check("dual", tip(dual), tip(primal), 0.03 if coarse else 0.01)
    assert abs(dual.reaction + dual.applied_force).max() < 1e-9

    def curve(axes):
        plain(axes, "nodes", "elastic tip displacement (length)")
        axes.semilogx(family, elastic, "o-", label="P1 on nested meshes")
        axes.axhline(REFERENCE, color="k", linestyle="--", linewidth=1, label="reference 23.96")
        axes.set_xticks(family, [str(n) for n in family])
        axes.minorticks_off()
        axes.legend(fontsize=8, frameon=False)

    def body(axes):
        plot_field(dual, axes=axes, deformation_scale=0.3, title="displacement x 0.3")

    save(beside(curve, body), out, "cook")
    return f"cook: {line} (primal)"


if __name__ == "__main__":
    run(main)
