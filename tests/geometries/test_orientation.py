"""NGSolve's normals point outward on the bodies of the paper, CSG or bisected."""

import pytest
from ngsolve import BND, CF, Integrate, specialcf, x, y

from ngepc.geometries import lshape, wrench

BODIES = {
    "lshape": lambda: lshape.mesh(0.2),
    "lshape paper": lambda: lshape.paper_mesh(113),
    "wrench": lambda: wrench.mesh(0.5),
    "wrench paper": lambda: wrench.paper_mesh(123),
}


@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("name", BODIES)
def test_divergence_theorem_holds_with_the_normal_of_ngsolve(name, order):

    mesh = BODIES[name]()
    if order > 1:
        mesh.Curve(order)
    n = specialcf.normal(2)
    flux = Integrate(CF((x, y)) * n, mesh, BND)
    assert flux == pytest.approx(2 * Integrate(1, mesh), rel=1e-10)
