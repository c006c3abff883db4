"""What a problem prints: the arguments that were given, on one line."""

from ngsolve import sin, x

from ngepc import Material, Problem
from ngepc.geometries import block

STEEL = Material.metal(
    young=210e3, poisson=0.3, yield_stress=235.0, plastic_modulus=1e3
)


def test_a_problem_prints_what_was_given():
    mesh = block.structured_mesh(2, 2, simplices=True)
    problem = Problem(mesh, STEEL, traction={"right": (1.0, sin(x))}, gap=None)
    said = repr(problem)
    assert "\n" not in said
    assert said.startswith(
        "Problem(mesh=<mesh, 2D, 8 elements>, material=Material.metal("
    )
    assert "traction={'right': (1.0, <coefficient>)}" in said
    assert "kinematics='plane strain'" in said
    assert "None" not in said
