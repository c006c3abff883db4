"""Shifts mu^ and nu^, beta_gamma and yield bounds that vary, against identities."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import CF, H1, GridFunction, IfPos, Integrate, Norm, ds, dx, exp, x, y

from ngepc import (
    Coupled,
    FullProduct,
    Material,
    NewtonOptions,
    Status,
    SurfaceGradient,
    lshape_problem,
    semismooth_newton,
)
from ngepc.discretisation.quadrature import boundary_rules, fine_rules
from ngepc.dual.newton import prepared
from ngepc.geometries import block, lshape
from ngepc.theory.shifts import augmented_lagrangian, positive_part, updated_shifts

QUICK = NewtonOptions(quadrature_points=49)


def lshape_225():
    return lshape_problem(lshape.paper_mesh(225))


def full(gamma, **shifts):
    """The paper's regularisation with the H^1 product: plastic zones on coarse meshes too."""
    return Coupled(gamma, tichonov=FullProduct(), **shifts)


def solved(problem, regularisation, start=None):
    result = semismooth_newton(problem, None, start, QUICK, regularisation=regularisation)
    assert result.status is Status.CONVERGED
    return result


def functional(problem, regularisation):
    return prepared(problem, regularisation, NewtonOptions(quadrature_points=100))


def random_dual(f, seed=1, size=2.0):
    v = f.blocks.H_vector()
    v.FV().NumPy()[:] = size * np.random.default_rng(seed).standard_normal(len(v))
    return v


def moved(f, v, part, amount):
    """V with ``amount`` added to all nodal values of a part."""
    w = v.CreateVector()
    w.data = v
    f.blocks.part_of(w, part).FV().NumPy()[:] += amount
    return w


@pytest.mark.parametrize("mu_hat", [0.5, 3.0])
def test_contact_shift_is_a_translation(mu_hat):
    """[mu^ + gamma z]^+ = [gamma (z + mu^/gamma)]^+: M^1 and both its derivatives are moved."""
    gamma, choice = 50.0, FullProduct()
    problem = lshape_225()
    shifted = functional(problem, Coupled(gamma, tichonov=choice, contact_shift=mu_hat))
    plain = functional(problem, Coupled(gamma, tichonov=choice))
    v = random_dual(plain)
    M, N = (
        f.terms(w).by_part["contact"]
        for f, w in ((shifted, v), (plain, moved(plain, v, "contact", mu_hat / gamma)))
    )
    assert M.energy == pytest.approx(N.energy, rel=1e-12)
    assert M.active == pytest.approx(N.active, rel=1e-12)
    assert (M.gradient - N.gradient).Evaluate().Norm() < 1e-12
    difference = M.hessian().AsVector() - N.hessian().AsVector()
    assert difference.Evaluate().Norm() < 1e-12 * gamma


def test_contact_shift_that_is_piecewise_linear_is_a_translation():
    """The same for mu^ = 2 x, the nodal values of z moved by 2 x / gamma."""
    gamma, problem = 50.0, lshape_225()
    shifted = functional(problem, Coupled(gamma, tichonov=FullProduct(), contact_shift=2 * x))
    plain = functional(problem, Coupled(gamma, tichonov=FullProduct()))
    v = random_dual(plain)
    w = v.CreateVector()
    w.data = v
    Z = plain.blocks.parts["contact"].space
    coordinate = GridFunction(Z)
    coordinate.Set(2 * x / gamma, definedon=problem.mesh.Boundaries("contact"))
    plain.blocks.part_of(w, "contact").data += coordinate.vec
    energies = (f.terms(s).by_part["contact"].energy for f, s in ((shifted, v), (plain, w)))
    assert next(energies) == pytest.approx(next(energies), rel=1e-12)


def test_plastic_shift_is_a_lower_yield_bound():
    """Nu^ + gamma (|q| - beta) = gamma (|q| - (beta - nu^/gamma)): the same run, digit by digit."""
    gamma, nu_hat = 1e3, 40.0
    problem = lshape_225()
    softer = replace(
        problem, material=replace(problem.material, yield_stress=1.25 - nu_hat / gamma)
    )
    shifted = solved(problem, full(gamma, plastic_shift=nu_hat))
    plain = solved(softer, full(gamma))
    assert shifted.history.energies == pytest.approx(plain.history.energies, rel=1e-11)
    assert shifted.iterations == plain.iterations > 3
    assert shifted.dual_energy != pytest.approx(solved(problem, full(gamma)).dual_energy)


def constrained_energy(result):
    """F* - (psi, z) + T, without the penalties: what the constrained problem minimises."""
    return result.functional.smooth_energy(result.y, result.v)


def constrained_limit(problem, gamma, tichonov):
    """Two penalty solutions extrapolated, as the error is proportional to 1/penalty."""
    result = None
    energies = []
    for factor in (10.0, 1e3, 1e4):
        regularisation = Coupled(factor * gamma, tichonov=tichonov, gamma_tichonov=gamma)
        result = solved(problem, regularisation, result)
        energies.append(constrained_energy(result))
    return energies[-1] + (energies[-1] - energies[-2]) / 9


def stiff_lshape():
    """Nothing yields: contact is the only constraint."""
    problem = lshape_225()
    return replace(problem, material=replace(problem.material, yield_stress=100.0))


@pytest.mark.parametrize("gamma", [1e2, 1e3])
def test_augmented_lagrangian_reaches_the_constrained_problem(gamma):
    """Shifts by the multipliers: z <= 0 and the limit energy, at a moderate gamma."""
    problem = stiff_lshape()
    limit = constrained_limit(problem, gamma, SurfaceGradient())
    results = augmented_lagrangian(problem, Coupled(gamma), 5, QUICK)
    assert [r.status for r in results] == [Status.CONVERGED] * 6
    errors = [abs(constrained_energy(r) / limit - 1) for r in results]
    assert errors[0] > 1e-8
    assert errors[-1] < 1e-3 * errors[0]
    assert all(b < 0.2 * a for a, b in pairwise(errors[:3]))
    z = [np.max(r.functional.blocks.part_of(r.v, "contact").FV().NumPy()) for r in results]
    assert z[0] > 0  # adhesion on the open gap
    assert all(b < 0.2 * a for a, b in pairwise(z[:4]))
    assert sum(r.iterations for r in results[1:]) <= 6


def test_augmented_lagrangian_with_plasticity():
    """The violation of |q| <= beta and the distance to the limit fall with every update."""
    problem, gamma = lshape_225(), 1e3
    limit = constrained_limit(problem, gamma, FullProduct())
    results = augmented_lagrangian(problem, full(gamma), 3, QUICK)
    assert [r.status for r in results] == [Status.CONVERGED] * 4
    errors = [1 - constrained_energy(r) / limit for r in results]
    finely = dx(bonus_intorder=20)
    excess = [Integrate(positive_part(r.yield_function) * finely, problem.mesh) for r in results]
    for falling in (errors, excess):
        assert all(b < a for a, b in pairwise(falling))
        assert falling[1] < 0.4 * falling[0]
    assert sum(r.iterations for r in results[1:]) < results[0].iterations


def test_multipliers_as_shifts_are_a_fixed_point():
    """With mu^ = the multiplier of the solution, the next multiplier is the same."""
    problem = stiff_lshape()
    last = augmented_lagrangian(problem, Coupled(1e3), 3, QUICK)[-1]
    following = updated_shifts(last)
    again = solved(problem, following, last)
    assert again.iterations == 0
    on_contact = ds("contact", bonus_intorder=10)
    old, new = following.contact_shift, updated_shifts(again).contact_shift
    change = Integrate((new - old) ** 2 * on_contact, problem.mesh)
    size = Integrate(new**2 * on_contact, problem.mesh)
    assert size > 0
    assert change < 1e-12 * size


def test_multipliers_balance_strain_and_overlap():
    """(OC1) tested by constants: int p + nu + q/gamma = 0, int u.n - psi + mu + z/gamma = 0."""
    problem, gamma, mu_hat, nu_hat = lshape_225(), 1e3, 0.02, 40.0
    regularisation = Coupled(
        gamma, tichonov=FullProduct(), contact_shift=mu_hat, plastic_shift=nu_hat * x
    )
    result = solved(problem, regularisation)
    z, q = result.normal_stress, result.plastic_dual
    mu = positive_part(mu_hat + gamma * z)
    nu = positive_part(nu_hat * x + gamma * (Norm(q) - 1.25)) / Norm(q) * q
    on_contact = ds("contact", intrules=boundary_rules(2, QUICK.quadrature_points))
    overlap = result.displacement * problem.normal - problem.psi
    terms = [Integrate(f * on_contact, problem.mesh) for f in (overlap, mu, z / gamma)]
    assert min(map(abs, terms)) > 1e-4
    assert sum(terms) == pytest.approx(0.0, abs=1e-10)
    for i in range(2):
        strain, multiplier, small = (
            Integrate(f[i] * dx(intrules=fine_rules(2, QUICK.quadrature_points)), problem.mesh)
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
        mesh, material, traction=loads, contact="contact", gap=0.0, initial_hardening=alpha
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


@pytest.mark.parametrize("gamma", [1e2, 1e3])
def test_beta_gamma_is_a_yield_bound(gamma):
    """J*_gamma sees beta_gamma only: the same run as with alpha_0 lowered accordingly."""
    shift = 0.9 / gamma * (1 - x)
    problem = hardened(0.2)  # beta = 1.1, sigma_y = 1
    relaxed = Coupled(gamma, beta_gamma=1.1 - shift)
    lowered = hardened(0.2 - shift / 0.5)
    a, b = solved(problem, relaxed), solved(lowered, Coupled(gamma))
    assert a.history.energies == pytest.approx(b.history.energies, rel=1e-10)


def test_beta_gamma_moves_V_by_the_penalties():
    """V differs by no more than M^2 differs at the one solution, no less than at the other."""
    problem, moves = hardened(0.2), []
    for gamma in (1e3, 1e4):
        exact = solved(problem, full(gamma))
        relaxed = solved(problem, full(gamma, beta_gamma=1.1 - 1 / gamma))
        least, most = (
            relaxed.functional.terms(r.v).energy - exact.functional.terms(r.v).energy
            for r in (relaxed, exact)
        )
        moves.append(relaxed.dual_energy - exact.dual_energy)
        assert 0 < least <= moves[-1] <= most
    assert moves[1] < 0.3 * moves[0]


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
        result = solved(problem, Coupled(1e3, tichonov=FullProduct(), contact_shift=0.002 * c))
        energies.append(np.array(result.history.energies) / c**2)
    assert result.history.records[-1].plastic_active > 0.05
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)


def test_a_bound_that_is_not_reached_does_not_matter():
    """Yield stress 1 on the left, so large on the right that nothing yields there: any such one."""
    runs = []
    for large in (1e2, 1e5):
        material = Material.kinematic(
            lame_lambda=1e3, lame_mu=1e3, yield_stress=IfPos(x - 0.5, large, 1.0), hardening=100.0
        )
        problem = replace(hardened(None), material=material, traction={"right": (6.0, 4.0)})
        result = solved(problem, full(1e3))
        size = Norm(result.plastic_dual)
        assert Integrate(IfPos(x - 0.5, IfPos(size - 1.0, 1.0, 0.0), 0.0), problem.mesh) > 0.1
        runs.append(result)
    assert runs[0].history.energies == pytest.approx(runs[1].history.energies, rel=1e-10)
    assert runs[0].history.records[-1].plastic_active > 0.05


def test_illegal_shifts_are_refused():
    problem = lshape_225()
    for bad, message in {
        "contact_shift": "contact_shift=-1",
        "plastic_shift": "plastic_shift=-1",
    }.items():
        with pytest.raises(ValueError, match=message):
            Coupled(1.0, **{bad: -1})
    with pytest.raises(ValueError, match="contact_shift falls to -"):
        semismooth_newton(problem, regularisation=Coupled(1.0, contact_shift=x - 0.5))
    with pytest.raises(ValueError, match="plastic_shift falls to -"):
        semismooth_newton(problem, regularisation=Coupled(1.0, plastic_shift=x - 0.5))
    with pytest.raises(ValueError, match="beta_gamma - plastic_shift / gamma falls to"):
        semismooth_newton(problem, regularisation=Coupled(10.0, plastic_shift=13.0))


def test_illegal_yield_bounds_are_refused():
    problem = hardened(0.2)
    for bound, message in ((1.2, "leaves"), (0.9, "leaves"), (1.05, "away from beta in L2")):
        with pytest.raises(ValueError, match=message):
            semismooth_newton(problem, regularisation=Coupled(1e3, beta_gamma=bound))


def test_shift_may_be_a_grid_function():
    """A P1 field as nu^, as an update stored on the mesh would be."""
    problem = lshape_225()
    field = GridFunction(H1(problem.mesh, order=1))
    field.Set(800 * exp(-10 * ((x - 0.5) ** 2 + (y - 0.5) ** 2)))
    a = solved(problem, Coupled(1e3, plastic_shift=field))
    b = solved(problem, Coupled(1e3, plastic_shift=1.0 * field + 0.0))
    assert a.dual_energy == pytest.approx(b.dual_energy, rel=1e-12)
    assert a.dual_energy > solved(problem, Coupled(1e3)).dual_energy
