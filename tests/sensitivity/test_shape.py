"""Derivatives with respect to the shape: closed forms, moved meshes, refusals."""

import numpy as np
import pytest
from campaigns.random_data import (
    four_times,
    functionals,
    last_state,
    once,
    random_problem,
)
from ngsolve import CF, sin, x, y, z

from ngepc import Direction, Material, Problem, gradient, semismooth_newton, tangent
from ngepc.geometries import block
from ngepc.sensitivity.equations import STENCIL
from ngepc.sensitivity.shape import moved_mesh, vertex_motion

STEP = 1e-5


@pytest.mark.parametrize(
    ("seed", "solve"), [(6, once), (19, once), (45, once), (1, four_times)]
)
def test_derivatives_agree_with_moved_meshes(seed, solve):
    """Axisymmetric of order two, Coulomb in 3D and between two bodies, a history on triangles."""
    problem = random_problem(seed)
    up = y / 2 + sin(2 * x) / 5
    V = (
        CF((x * y, up, 0.3 * z + x))
        if problem.N == 3
        else CF((x * (1.3 - x) * (1 + y), up))
    )
    result, chosen = solve(problem), functionals(problem)
    del chosen["displacement"]  # at a point in space that the body moves away from
    parameter = {"V": Direction("shape", V)}
    slopes = {key: gradient(result, F, parameter)["V"] for key, F in chosen.items()}
    along, differences = (
        tangent(result, {"V": (1.0, parameter["V"])}),
        dict.fromkeys(chosen, 0.0),
    )
    for k, weight in STENCIL.items():
        with moved_mesh(problem.mesh, k * STEP * vertex_motion(problem, V)):
            state = last_state(solve(problem, result))
            for key, F in chosen.items():
                differences[key] += weight / STEP * F.slope(state).value
    for key, slope in slopes.items():
        assert slope == pytest.approx(differences[key], rel=1e-6, abs=1e-8)
        assert along.of(chosen[key]) == pytest.approx(slope, rel=1e-9, abs=1e-12)


def squeezed() -> Problem:
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=1.0
    )
    mesh = block.structured_mesh(3, 2, size=(1.5, 1.0))
    rollers = {"clamped": (None, 0.0), "left": (0.0, None)}
    return Problem(
        mesh, material, None, prescribed=rollers, contact="contact", gap=-0.01
    )


def test_a_squeezed_block():
    """Its force is E/(1 - nu^2) gap width / height."""
    result = semismooth_newton(squeezed())
    force = result.contact_force
    fields = {
        "taller": (0.0, y),
        "wider": (x, 0.0),
        "moved": (1.0, 0.0),
        "sheared": (y, 0.0),
    }
    parameters = {name: Direction("shape", V) for name, V in fields.items()}
    slopes = gradient(result, "contact_force", parameters)
    assert force == pytest.approx(1e3 * 8 / 3 * 0.01 * 1.5, rel=1e-9)
    assert slopes["taller"] == pytest.approx(-force, rel=1e-8)
    assert slopes["wider"] == pytest.approx(force, rel=1e-8)
    assert slopes["moved"] == pytest.approx(0.0, abs=1e-8)
    assert gradient(result, "primal_energy", parameters)["taller"] == pytest.approx(
        -result.primal_energy, rel=1e-8
    )


def test_the_mesh_comes_back():
    result = semismooth_newton(squeezed())
    coordinates = np.asarray(result.problem.mesh.ngmesh.Coordinates())
    before = coordinates.copy()
    gradient(result, "contact_force", {"V": Direction("shape", (x, y))})
    assert (coordinates == before).all()


def test_what_is_refused():
    result = semismooth_newton(squeezed())
    with pytest.raises(ValueError, match="a vector V is needed"):
        gradient(result, "contact_force", "shape")
    with pytest.raises(ValueError, match="change"):
        gradient(result, "contact_force", {"V": Direction("shape", (x, y, x))})
    ring = once(random_problem(2))
    with pytest.raises(ValueError, match="keeps the axis"):
        gradient(ring, "contact_force", {"V": Direction("shape", (1.0, 0.0))})
    bent = squeezed()
    bent.mesh.Curve(2)
    curved = semismooth_newton(bent)
    with pytest.raises(ValueError, match="a straight one is needed"):
        gradient(curved, "contact_force", {"V": Direction("shape", (x, y))})
