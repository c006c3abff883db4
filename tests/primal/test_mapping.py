"""The return mapping in coefficients of NGSolve beside the law at the points, with all history."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, GridFunction, x, y

from ngepc import Material, Norton, Problem, Voce
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.discretisation.spaces import displacement_space
from ngepc.geometries import block
from ngepc.primal.return_mapping import ReturnMapping

SQUARE = block.structured_mesh(2, 2, simplices=True)
CUBE = block.structured_mesh(1, 1, 1, simplices=True)
ELASTIC = {"lame_lambda": 900.0, "lame_mu": 700.0}
LINEAR = Material.kinematic(**ELASTIC, yield_stress=1.2, hardening=90.0)
VOCE = Material.with_law(**ELASTIC, law=Voce(1.5, 2.0, 40.0), hardening=30.0)
METALS = {
    "kinematic": LINEAR,
    "law": VOCE,
    "rate": replace(LINEAR, rate=Norton(2.0, 3.0)),
    "law and rate": replace(VOCE, rate=Norton(2.0, 3.0)),
}
ROWS = {
    2: ((1.0, 0.4, 0.0), (0.4, -0.7, 0.0), (0.0, 0.0, -0.3)),
    3: ((1.0, 0.4, 0.2), (0.4, -0.7, 0.3), (0.2, 0.3, -0.3)),
}


def tensor(N, factor):
    """A symmetric deviator that varies in space, in the shape of the kinematics."""
    return factor * CF(tuple(np.ravel(ROWS[N]).tolist()), dims=(3, 3))


@pytest.fixture(
    scope="module", params=[(2, name) for name in METALS] + [(3, "law")], ids=str
)
def problem(request):
    """A problem whose step starts from plastic strain, back stress, PEEQ and initial strain."""
    N, name = request.param
    material = METALS[name]
    mesh = SQUARE if N == 2 else CUBE
    data = {"duration": 0.7} if material.rate else {}
    if material.law is not None:
        data["initial_accumulated"] = 0.01 * (1 + x)
    return Problem(
        mesh,
        material,
        "clamped",
        initial_plastic_strain=tensor(N, 4e-4 * (1 + y)),
        initial_hardening=(0.0, tensor(N, 0.3 * (1 + x))),
        initial_strain=tensor(N, 3e-4 * x)
        + 2e-4 * CF(tuple(np.eye(3).ravel()), dims=(3, 3)),
        **data,
    )


@pytest.fixture(scope="module")
def both(problem):
    """The mapping of some displacements, and the law at the same strains."""
    space = displacement_space(problem)
    u = GridFunction(space)
    u.vec.FV().NumPy()[:] = 2e-4 * np.random.default_rng(8).normal(size=space.ndof)
    mapping = ReturnMapping(problem, u)
    mapping.update()
    points = Points(problem.mesh, problem.kinematics, problem.order)
    law = law_of(problem, points)
    strain = problem.kinematics.strain(u)
    volume = points.at(sum(strain[i, i] for i in range(strain.dims[0])))
    deviator = points.coordinates(strain)
    return (mapping, points, law, law.returned(*law.beyond_initial(volume, deviator)))


def test_what_yields_and_flows(both):
    mapping, points, _, at = both
    assert 0 < at.yields.sum() < len(at.yields)
    assert ((points.at(mapping.plastic) > 0.5) == at.yields).all()
    found = points.at(mapping.plastic_increment)
    np.testing.assert_allclose(found, at.plastic_strain, atol=1e-12)


def test_stress_and_energy(both):
    mapping, points, law, at = both
    mean, deviator = law.stress(at)
    np.testing.assert_allclose(points.coordinates(mapping.stress), deviator, rtol=1e-8)
    size = mapping.stress.dims[0]
    trace = points.at(sum(mapping.stress[i, i] for i in range(size)))
    np.testing.assert_allclose(trace / size, mean, rtol=1e-10)
    energy = points.at(mapping.energy_density)
    np.testing.assert_allclose(energy, law.energy_density(at), rtol=1e-9)


def test_what_hardens_does_not_flow_freely(both):
    assert both[0].flowing() == 0.0
