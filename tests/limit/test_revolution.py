"""Why limit loads refuse bodies of revolution: how many velocities keep the volume, counted."""

import numpy as np
import pytest
from netgen.occ import MoveTo, OCCGeometry, X, Y
from ngsolve import L2, BilinearForm, Mesh, VectorH1, div, dx, x

from ngepc import Material, Problem, limit_load
from ngepc.geometries import block

COUNTS = {2: (64, 10), 3: (177, 74)}
"""Degree -> velocities without change of volume, in the plane and of a body of revolution."""


def meridian():
    """A unit square of 54 triangles beside the axis, held at the bottom."""
    square = MoveTo(0, 0).Rectangle(1, 1).Face()
    square.edges.name = "free"
    square.edges.Min(X).name = "axis"
    square.edges.Min(Y).name = "bottom"
    return Mesh(OCCGeometry(square, dim=2).GenerateMesh(maxh=0.2))


def kernel(mesh, degree, turns):
    """Dimension of the velocities with div v = 0, or with r div v + v_r = 0."""
    held = {"dirichletx": "bottom|axis", "dirichlety": "bottom"}
    space = VectorH1(mesh, order=degree, **held)
    test = L2(mesh, order=degree if turns else degree - 1)
    v = space.TrialFunction()
    q = test.TestFunction()
    change = x * div(v) + v[0] if turns else div(v)
    form = BilinearForm(trialspace=space, testspace=test)
    form += change * q * dx(bonus_intorder=2)
    form.Assemble()
    rows, columns, values = form.mat.COO()
    matrix = np.zeros((test.ndof, space.ndof))
    matrix[np.array(rows), np.array(columns)] = np.array(values)
    free = np.array(list(space.FreeDofs()), dtype=bool)
    sizes = np.linalg.svd(matrix[:, free], compute_uv=False)
    return int(free.sum() - (sizes > 1e-10 * sizes[0]).sum())


@pytest.mark.parametrize("degree", [2, 3])
def test_few_continuous_velocities_keep_the_volume_of_a_body_of_revolution(degree):
    """The numbers of docs/limit_loads.md; degree two has one for each fifth triangle."""
    mesh = meridian()
    found = kernel(mesh, degree, turns=False), kernel(mesh, degree, turns=True)
    assert mesh.ne == 54
    assert found == COUNTS[degree]


def test_bodies_of_revolution_are_refused_by_name():
    mesh = block.structured_mesh(2, 2, simplices=True)
    steel = Material.kinematic(
        lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=1.0
    )
    loads = {"traction": {"contact": (0.0, 1.0)}}
    body = Problem(mesh, steel, "clamped", kinematics="axisymmetric", **loads)
    with pytest.raises(ValueError, match="kinematics='axisymmetric': a limit load"):
        limit_load(body)
