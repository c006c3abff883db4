"""What plastic strain adds to the compliance at a point."""

from types import SimpleNamespace

import numpy as np

from ngepc import Material, Problem, Voce
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.geometries import block
from ngepc.local.indicators import plastic_compliance


def test_plastic_compliance_is_one_over_the_hardening():
    """dp/ds along the flow: 1 / (h + beta'(g)) where it yields, else 0."""
    metal = Material.with_law(
        lame_lambda=900.0, lame_mu=700.0, law=Voce(1.5, 2.0, 40.0), hardening=30.0
    )
    problem = Problem(block.structured_mesh(3, 3, simplices=True), metal)
    law = law_of(problem, Points(problem.mesh, problem.kinematics, 1))
    random = np.random.default_rng(1)
    e = 6e-4 * random.normal(size=law.back.shape)
    at = law.returned(np.zeros(len(e)), e)
    found = plastic_compliance(
        SimpleNamespace(at=at, discrete=SimpleNamespace(law=law))
    )
    assert 0 < at.yields.sum() < len(e)
    expected = at.yields / (law.hardening + law.resistance.slope(at.gained))
    np.testing.assert_allclose(found, expected, rtol=1e-10)
