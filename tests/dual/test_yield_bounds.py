"""Yield bounds that vary, and multipliers in balance with strains, against identities."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import CF, IfPos, Integrate, Norm, ds, dx, x, y

from ngepc import (
    Coupled,
    FullProduct,
    Material,
    NewtonOptions,
    Status,
    lshape_problem,
    semismooth_newton,
)
from ngepc.discretisation.quadrature import boundary_rules, fine_rules
from ngepc.geometries import block, lshape

QUICK = NewtonOptions(quadrature_points=49)


def full(gamma):
    """The paper's regularisation with the H^1 product: plastic zones on coarse meshes too."""
    return Coupled(gamma, tichonov=FullProduct())


def solved(problem, regularisation):
    result = semismooth_newton(problem, options=QUICK, regularisation=regularisation)
    assert result.status is Status.CONVERGED
    return result


def test_multipliers_balance_strain_and_overlap():
    """(OC1) tested by constants: int p + nu + q/gamma = 0, int u.n - psi + mu + z/gamma = 0."""
    problem, gamma = lshape_problem(lshape.paper_mesh(225)), 1e3
    result = solved(problem, full(gamma))
    z, q = result.normal_stress, result.plastic_dual
    mu = IfPos(z, gamma * z, 0.0)
    nu = gamma * IfPos(Norm(q) - 1.25, Norm(q) - 1.25, 0.0) / Norm(q) * q
    on_contact = ds("contact", intrules=boundary_rules(2, QUICK.quadrature_points))
    overlap = result.displacement * problem.normal - problem.psi
    terms = [Integrate(f * on_contact, problem.mesh) for f in (overlap, mu, z / gamma)]
    assert min(map(abs, terms)) > 1e-4
    assert sum(terms) == pytest.approx(0.0, abs=1e-10)
    for i in range(2):
        strain, multiplier, small = (
            Integrate(
                f[i] * dx(intrules=fine_rules(2, QUICK.quadrature_points)), problem.mesh
            )
            for f in (result.plastic_increment, nu, q / gamma)
        )
        assert abs(multiplier) > 1e-4
        assert strain + multiplier + small == pytest.approx(0.0, abs=1e-10)


def hardened(alpha, *, mesh=None, sigma=1.0, H=0.5):
    """A pressed square with isotropic hardening of the given alpha_0; h = 100 in any case."""
    mesh = block.structured_mesh(6, 6, simplices=True) if mesh is None else mesh
    material = Material.isotropic(
        lame_lambda=1e3,
        lame_mu=1e3,
        yield_stress=sigma,
        hardening_modulus=H,
        hardening_stiffness=100 / (H * sigma) ** 2,
    )
    loads = {"left": (6.0, 4.0)}
    return flat_problem(
        mesh,
        material,
        traction=loads,
        contact="contact",
        gap=0.0,
        initial_hardening=alpha,
    )


def test_initial_hardening_is_a_yield_bound():
    """Beta = sigma_y (1 + H alpha_0) with alpha_0 = x: kinematic hardening with sigma_y = beta."""
    isotropic = hardened(x)
    kinematic = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1 + 0.5 * x, hardening=100.0
    )
    other = replace(isotropic, material=kinematic, initial_hardening=None)
    a, b = (solved(p, Coupled(1e3)) for p in (isotropic, other))
    assert a.history.energies == pytest.approx(b.history.energies, rel=1e-10)
    assert a.primal_energy == pytest.approx(b.primal_energy, rel=1e-10)
    assert a.history.records[-1].plastic_active > 0.01


def test_constant_coefficient_is_a_number():
    """The same bound as a coefficient: other quadrature rules, the same value."""
    number = hardened(0.0)
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=CF(1.0), hardening=100.0
    )
    coefficient = replace(number, material=material, initial_hardening=None)
    a, b = (solved(p, Coupled(1e3)).dual_energy for p in (number, coefficient))
    assert a == pytest.approx(b, rel=1e-7)


def test_yield_stress_that_varies_scales_with_the_loads():
    """Bound, loads and gap times c: the iterates times c, V times c^2, for sigma_y = 1 + x y."""
    energies = []
    for c in (1.0, 3.0):
        material = Material.kinematic(
            lame_lambda=1e3, lame_mu=1e3, yield_stress=c * (1 + x * y), hardening=100.0
        )
        problem = replace(
            hardened(None),
            material=material,
            traction={"left": (8.0 * c, 4.0 * c)},
            gap=0.001 * c,
        )
        result = solved(problem, Coupled(1e3, tichonov=FullProduct()))
        energies.append(np.array(result.history.energies) / c**2)
    assert result.history.records[-1].plastic_active > 0.05
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)


def test_a_bound_that_is_not_reached_does_not_matter():
    """Yield stress 1 on the left, so large on the right that nothing yields there: any such one."""
    runs = []
    for large in (1e2, 1e5):
        material = Material.kinematic(
            lame_lambda=1e3,
            lame_mu=1e3,
            yield_stress=IfPos(x - 0.5, large, 1.0),
            hardening=100.0,
        )
        problem = replace(
            hardened(None), material=material, traction={"right": (6.0, 4.0)}
        )
        result = solved(problem, full(1e3))
        size = Norm(result.plastic_dual)
        assert (
            Integrate(IfPos(x - 0.5, IfPos(size - 1.0, 1.0, 0.0), 0.0), problem.mesh)
            > 0.1
        )
        runs.append(result)
    assert runs[0].history.energies == pytest.approx(
        runs[1].history.energies, rel=1e-10
    )
    assert runs[0].history.records[-1].plastic_active > 0.05
