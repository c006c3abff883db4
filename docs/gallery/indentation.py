"""A sphere pressed into a cube: the body of deal.II's tutorial step-42, and its contact force.

Box (0, 1)^3 fixed below, u_x = u_y = 0 on the sides, E = 2e5, nu = 0.3, beta = 400, isotropic
hardening 2 mu g / (1 - g) with g = 0.01; the sphere of radius 0.6 has come down by 0.01.  On
8 x 8 x 8 hexahedra the documentation of step-42 prints the contact force 37.3058.  A single node
touches there, so the two methods are compared under a larger sphere that comes down by 0.04.
"""

from pathlib import Path

from ngepc.geometries import block
from shared import check, run, save

from ngepc import Balanced, Material, Problem, lame_parameters, semismooth_newton
from ngepc.obstacles import Sphere
from ngepc.plotting import plot_field
from ngepc.plotting.picture import beside
from ngepc.primal.solver import primal_newton

DOCUMENTED, BOUND = 37.3058, 400.0


def cube(mesh, radius, depth):
    """The cube on any mesh, with a sphere that has come down by ``depth`` from the top."""
    lame_lambda, lame_mu = lame_parameters(2e5, 0.3)
    material = Material.isotropic(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=BOUND,
        hardening_modulus=1 / BOUND,
        hardening_stiffness=2 * lame_mu * 0.01 / 0.99,
    )
    sides = {"left|right|front|back": (0, 0, None)}
    gap = Sphere((0.5, 0.5, 1 + radius - depth), radius).gap(mesh)
    return Problem(mesh, material, contact="contact", gap=gap, prescribed=sides)


def main(out: Path, coarse: bool = False) -> str:
    """Compare the contact force with step-42, and the dual method with the primal one."""
    primal = primal_newton(cube(block.structured_mesh(8, 8, 8), 0.6, 0.01)).raise_for_status()
    line = check("contact force", primal.contact_force, DOCUMENTED, 2e-6)
    assert abs(primal.reaction + primal.contact_resultant).max() < 1e-9

    n = 6 if coarse else 10
    problem = cube(block.structured_mesh(n, n, n, simplices=True), 3.0, 0.04)
    dual = semismooth_newton(problem, regularisation=Balanced()).raise_for_status()
    reference = primal_newton(problem).contact_force
    tolerance = 0.12 if coarse else 0.03
    line += ", larger sphere, dual " + check("method", dual.contact_force, reference, tolerance)
    assert abs(dual.reaction + dual.contact_resultant).max() < 1e-9 * dual.contact_force

    def small(axes):
        plot_field(primal, axes=axes, title="step-42, hexahedra, primal method")

    def large(axes):
        plot_field(dual, axes=axes, title="larger sphere, tetrahedra, dual method")

    save(beside(small, large, three=True), out, "indentation")
    return f"indentation: {line} (primal)"


if __name__ == "__main__":
    run(main)
