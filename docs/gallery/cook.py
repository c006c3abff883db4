"""Cook's membrane: the elastic tip displacement, then a membrane that yields.

The benchmark is plane stress with E = 1, nu = 1/3 and the shear load 1.  The tip (48, 52) then
rises by 23.96.
"""

from pathlib import Path

from shared import check, plain, run, save

from ngepc import Material, Problem, semismooth_newton
from ngepc.geometries import cook
from ngepc.pictures import beside, plot_field

TIP, REFERENCE = (48.0, 52.0), 23.96


def membrane(nodes, yield_stress, order=1):
    """Clamped on the left, sheared on the right."""
    material = Material.metal(
        young=1.0, poisson=1 / 3, yield_stress=yield_stress, plastic_modulus=0.1
    )
    mesh = cook.bisected_mesh(nodes)
    load = {"load": (0.0, 1 / 16)}
    return Problem(
        mesh, material, traction=load, kinematics="plane stress", order=order
    )


def tip(result):
    """The vertical displacement of the middle of the loaded edge."""
    return result.displacement(result.problem.mesh(*TIP))[1]


def main(out: Path, coarse: bool = False) -> str:
    """Compare the elastic tip with the benchmark; where it yields J + J* is the certificate."""
    family = (25, 81, 289) if coarse else (289, 1089, 4225)
    elastic = {
        order: [tip(semismooth_newton(membrane(nodes, 1e3, order))) for nodes in family]
        for order in (1, 2)
    }
    line = check("elastic tip", elastic[2][-1], REFERENCE, 0.003)

    problem = membrane(family[-1], 0.15, order=2)
    yielding = semismooth_newton(problem).raise_for_status()
    gap = (yielding.primal_energy + yielding.dual_energy) / abs(yielding.primal_energy)
    assert abs(gap) < 1e-9
    assert abs(yielding.reaction + yielding.applied_force).max() < 1e-9

    def curve(axes):
        plain(axes, "nodes", "elastic tip displacement")
        for order, tips in elastic.items():
            axes.semilogx(family, tips, "o-", label=f"order {order}")
        axes.axhline(
            REFERENCE, color="k", linestyle="--", linewidth=1, label="reference 23.96"
        )
        axes.set_xticks(family, [str(n) for n in family])
        axes.minorticks_off()
        axes.legend(fontsize=8, frameon=False)

    def body(axes):
        plot_field(yielding, axes=axes, deformation_scale=0.3)

    save(beside(curve, body), out, "cook")
    return f"cook: {line}, where it yields tip {tip(yielding):.5g} (J + J* = {gap:.0e} |J|)"


if __name__ == "__main__":
    run(main)
