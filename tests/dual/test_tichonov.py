"""The Tichonov choices: units, limits, closed contact boundaries."""

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import BND, CF, Integrate, ds

from ngepc import (
    Coupled,
    DualSpaces,
    Material,
    NewtonOptions,
    Status,
    Units,
    lshape_problem,
    semismooth_newton,
)
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.spaces import FullProduct, SurfaceGradient
from ngepc.geometries import block, lshape, ring

QUICK = NewtonOptions(quadrature_points=49)

CHOICES = {"R2": SurfaceGradient(), "full": FullProduct()}


def scaled_problem(stress, length):
    """A pressed square in units where the stress and length units are so many of the plain ones."""
    mesh = block.structured_mesh(6, 6, size=(length, length), simplices=True)
    material = Material.kinematic(
        lame_lambda=1e3 * stress,
        lame_mu=1e3 * stress,
        yield_stress=1.25 * stress,
        hardening=100 * stress,
    )
    push = {"left": (6.0 * stress, 4.0 * stress)}
    return flat_problem(
        mesh, material, traction=push, contact="contact", gap=-0.002 * length
    )


@pytest.mark.parametrize("name", CHOICES)
def test_units_of_the_products(name):
    """The same body in other units: V scales as stress length^2, and so do all iterates."""
    plain, scaled = (
        semismooth_newton(
            scaled_problem(stress, length),
            regularisation=Coupled(
                1e3, tichonov=CHOICES[name], units=Units(stress=stress, length=length)
            ),
        )
        for stress, length in ((1.0, 1.0), (1e6, 1e-2))
    )
    assert plain.status is scaled.status is Status.CONVERGED
    assert plain.history.records[-1].plastic_active > 0.01
    assert plain.contact_force > 0.1
    energies = np.array(scaled.history.energies) / (1e6 * 1e-4)
    assert energies == pytest.approx(np.array(plain.history.energies), rel=1e-9)


@pytest.mark.parametrize("name", CHOICES)
def test_lshape_converges_to_one_limit(name):
    """V falls to the limit -J of about 0.375 as gamma grows, whatever the product."""
    problem = lshape_problem(lshape.paper_mesh(225))
    values = []
    result = None
    for gamma in (1e3, 1e4):
        choice = Coupled(gamma, tichonov=CHOICES[name])
        result = semismooth_newton(
            problem, start=result, options=QUICK, regularisation=choice
        )
        assert result.status is Status.CONVERGED
        values.append(result.dual_energy)
    assert values[0] > values[1] > 0.37
    at_end = result.normal_stress(problem.mesh(1e-6, 1.0, VOL_or_BND=BND))
    if CHOICES[name].fixed:
        assert at_end == pytest.approx(0.0, abs=1e-3)
    else:
        assert at_end < -1.0  # the pressure peaks at this end of Gamma_c


def pressed_ring(maxh):
    """A ring held inside whose outer circle, of radius 2, is pushed in by 0.01; elastic."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1e3, hardening=100.0
    )
    mesh = ring.mesh(maxh)
    return flat_problem(mesh, material, clamped="inner", contact="outer", gap=-0.01)


LAME_PRESSURE = -0.01 * 4500 / 1.5
"""u_r = A (r - 1/r) has sigma_rr(2) = (2 (lambda + mu) + 2 mu / 4) A = 4500 A, u_r(2) = 1.5 A."""


def test_closed_contact_boundary():
    """The constant pressure of Lamé's ring."""
    errors = []
    for maxh in (0.4, 0.2):
        problem = pressed_ring(maxh)
        result = semismooth_newton(
            problem, regularisation=Coupled(1e7, tichonov=FullProduct())
        )
        assert result.status is Status.CONVERGED
        force, length = (
            Integrate(f * ds("outer"), problem.mesh)
            for f in (result.normal_stress, CF(1.0))
        )
        errors.append(abs(force / length / LAME_PRESSURE - 1))
    assert errors[1] < 0.003
    assert np.log2(errors[0] / errors[1]) > 1.5


def test_constants_have_the_length_term_alone():
    """<B_z 1, 1> = |Gamma_c| / L on a closed boundary."""
    problem = pressed_ring(0.5)
    units = Units(length=3.0)
    spaces = DualSpaces(tichonov=FullProduct(), units=units)
    blocks = LinearBlocks(problem, spaces, "sparsecholesky")
    B, one = blocks.B, blocks.H_vector()
    blocks.parts(one)[0][:] = 1.0
    length = Integrate(CF(1.0) * ds("outer"), problem.mesh)
    assert one.InnerProduct((B * one).Evaluate()) == pytest.approx(
        length / 3.0, rel=1e-12
    )


def test_closed_contact_boundary_is_refused_by_the_gradients():
    with pytest.raises(ValueError, match=r"closed piece without ends.*FullProduct"):
        semismooth_newton(pressed_ring(0.5), 100.0)


def test_one_closed_piece_is_enough_to_be_refused():
    mesh = block.with_hole(0.3, size=(1.0, 1.0))
    problem = flat_problem(
        mesh, pressed_ring(0.5).material, contact="contact|hole", gap=0.0
    )
    with pytest.raises(ValueError, match="closed piece without ends"):
        semismooth_newton(problem, 100.0)


def test_products_are_positive_definite():
    blocks = LinearBlocks(
        pressed_ring(0.6), DualSpaces(tichonov=FullProduct()), "sparsecholesky"
    )
    v, w = blocks.H_vector(), blocks.H_vector()
    free = np.array(blocks.H.FreeDofs())
    v.FV().NumPy()[:] = np.random.default_rng(1).standard_normal(len(v)) * free
    Bv = (blocks.B * v).Evaluate()
    w.data = blocks.B_inverse * Bv - v
    assert w.Norm() < 1e-9 * v.Norm()
    for part, image in zip(blocks.parts(v), blocks.parts(Bv), strict=True):
        assert part.InnerProduct(image) > 0
