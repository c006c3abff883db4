"""Pyramids: their five plastic points, and histories that carry the plastic strain exactly."""

import itertools

import numpy as np
import pytest
from netgen.meshing import Element2D, Element3D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import ET, VOL, IntegrationRule, Mesh

from ngepc import Material, Problem, evolve, load_cycle, primal_newton, semismooth_newton
from ngepc.model.rules import plastic_points, pyramid_rule
from ngepc.primal.return_mapping import ReturnMapping

FACES = {
    "bottom": [(0, 0, 0), (0, 1, 0), (1, 1, 0), (1, 0, 0)],
    "top": [(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)],
    "front": [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)],
    "back": [(0, 1, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0)],
    "left": [(0, 0, 0), (0, 0, 1), (0, 1, 1), (0, 1, 0)],
    "right": [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)],
}


@pytest.fixture(scope="module")
def problem():
    """A cube of six pyramids with a common apex, pulled at a side under an obstacle."""
    mesh = NetgenMesh(dim=3)
    corners = {
        c: mesh.Add(MeshPoint(Pnt(*map(float, c)))) for c in itertools.product((0, 1), repeat=3)
    }
    apex = mesh.Add(MeshPoint(Pnt(0.55, 0.45, 0.5)))
    for number, name in enumerate(FACES):
        mesh.Add(FaceDescriptor(surfnr=number + 1, domin=1, bc=number + 1))
        mesh.SetBCName(number, name)
    mesh.SetMaterial(1, "body")
    for number, face in enumerate(FACES.values()):
        base = [corners[c] for c in face]
        mesh.Add(Element2D(number + 1, base))
        mesh.Add(Element3D(1, [base[0], *reversed(base[1:]), apex]))
    steel = Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0)
    pull = {"right": (2.0, 0.5, 1.0)}
    return Problem(Mesh(mesh), steel, "bottom", pull, contact="top", gap=2e-4)


@pytest.mark.parametrize(
    "powers", [p for p in itertools.product(range(3), repeat=3) if sum(p) <= 2]
)
def test_five_points_integrate_quadratic_polynomials(powers):
    def integral(rule):
        return sum(q.weight * np.prod(np.power(q.point, powers)) for q in rule)

    exact = integral(IntegrationRule(ET.PYRAMID, 8))
    assert integral(pyramid_rule()) == pytest.approx(exact, rel=1e-11)


def test_points_lie_inside_with_positive_weights():
    for q in pyramid_rule():
        x, y, z = q.point
        assert 0 < z < 1
        assert min(x, y) > 0
        assert max(x, y) < 1 - z
        assert q.weight > 0


def test_plastic_strain_has_the_values_at_the_points(problem):
    result = primal_newton(problem).raise_for_status()
    points = problem.mesh.MapToAllElements(plastic_points(problem.mesh, 1), VOL)
    exact = ReturnMapping(problem, result.displacement).plastic_increment
    kept, wanted = (np.asarray(p(points)) for p in (result.plastic_increment, exact))
    assert np.abs(wanted).max() > 1e-4
    assert np.abs(kept - wanted).max() < 1e-14 * np.abs(wanted).max() * 10


def test_a_step_that_changes_nothing_dissipates_nothing(problem):
    history = evolve(problem, load_cycle(problem, [1, 1 + 1e-9])).raise_for_status()
    first, second = history.column("dissipation")
    assert second < 1e-7 * first


def test_dual_method_takes_pyramids(problem):
    dual, primal = (
        solve(problem).raise_for_status() for solve in (semismooth_newton, primal_newton)
    )
    assert dual.dual_energy == pytest.approx(-primal.primal_energy, rel=0.15)
    total = dual.applied_force + dual.contact_resultant + dual.reaction
    assert np.abs(total).max() < 1e-10
