"""A sphere pressed into a cube: the body of deal.II's tutorial step-42, and its contact force.

Box (0, 1)^3 fixed below, u_x = u_y = 0 on the sides, E = 2e5, nu = 0.3, beta = 400, isotropic
hardening 2 mu g / (1 - g) with g = 0.01; the sphere of radius 0.6 has come down by 0.01.  On
8 x 8 x 8 hexahedra the documentation of step-42 prints the contact force 37.3058.  A single node
touches there, so the two methods are compared on a quarter of the body, meshed finely under the
sphere; ``ngepc study step42`` does so on several meshes.
"""

from pathlib import Path

from shared import check, run, save

from ngepc import primal_newton, semismooth_newton
from ngepc.geometries import block, quarter_cube
from ngepc.pictures import plot_field
from ngepc.studies.step42 import WHOLE, step42_problem

DOCUMENTED = 37.3058


def main(out: Path, coarse: bool = False) -> str:
    """Compare the contact force with step-42, and the exact method with the primal one."""
    whole = semismooth_newton(step42_problem(block.structured_mesh(8, 8, 8), WHOLE))
    line = check("contact force", whole.contact_force, DOCUMENTED, 2e-6)
    assert abs(whole.reaction + whole.contact_resultant).max() < 1e-9

    problem = step42_problem(quarter_cube.mesh(4 if coarse else 10))
    graded_result = semismooth_newton(problem).raise_for_status()
    reference = 4 * primal_newton(problem).contact_force
    force = graded_result.contact_force
    line += ", graded " + check("force", 4 * force, reference, 1e-8)
    assert (
        abs(graded_result.reaction + graded_result.contact_resultant)[2] < 1e-9 * force
    )

    bodies = {
        "step-42, hexahedra": whole,
        "a quarter, graded tetrahedra": graded_result,
    }
    onto_the_planes_of_symmetry = (-135, 25)
    figure = plot_field(bodies, vmin=0, vmax=0.1, view=onto_the_planes_of_symmetry)
    save(figure, out, "indentation")
    return f"indentation: {line} (primal)"


if __name__ == "__main__":
    run(main)
