"""Combined hardening: the reduction of (2.3) to (2.14), its limits, two steps in closed form."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
from bodies import FLAT
from coordinates import coordinates_count, deviator, strain, tensor
from ngsolve import (
    CF,
    H1,
    L2,
    GridFunction,
    Id,
    InnerProduct,
    Integrate,
    Norm,
    Trace,
    VectorH1,
    VectorValued,
    ds,
    x,
    y,
    z,
)

from ngepc import Material, Problem, Status, semismooth_newton
from ngepc.dual.blocks import primal_energy
from ngepc.geometries import block
from ngepc.primal.solver import primal_newton
from ngepc.results.fields import Fields, frobenius

DATA = {
    "lame_lambda": 900.0,
    "lame_mu": 800.0,
    "yield_stress": 1.25,
    "hardening": 60.0,
    "hardening_modulus": 0.4,
    "hardening_stiffness": 200.0,
}
FORCE = {2: (0.3, -0.7), 3: (0.3, -0.7, 0.2)}
TENSOR = {
    2: CF((0.2, 0.1, 0.1, -0.2), dims=(2, 2)),
    3: CF((0.2, 0.1, 0.0, 0.1, -0.3, 0.05, 0.0, 0.05, 0.1), dims=(3, 3)),
}


def general_problem(N, **material):
    """Every kind of datum that (2.15) and (2.16) know, none of them constant."""
    mesh = block.structured_mesh(*(3,) * N, simplices=True)
    return Problem(
        mesh,
        Material(**{**DATA, **material}),
        traction={"left": (2.0 * y, *(1.0,) * (N - 1))},
        body_force=FORCE[N],
        initial_plastic_strain=(1 + x) * 1e-3 * TENSOR[N],
        initial_hardening=(0.3 * (1 + y), (1 - x) * TENSOR[N]),
        contact="contact",
        gap=0.01,
        kinematics=FLAT[mesh.dim],
    )


def random_state(problem, seed=5):
    """A random u in V_h and p in Q_h."""
    u = GridFunction(VectorH1(problem.mesh, order=1))
    p = GridFunction(
        VectorValued(L2(problem.mesh, order=0), coordinates_count(problem.N))
    )
    random = np.random.default_rng(seed)
    for f, size in ((u, 1e-2), (p, 1e-2)):
        f.vec.FV().NumPy()[:] = size * random.standard_normal(len(f.vec))
    return u, p


def elastic_energy(problem, e):
    m, N = problem.material, problem.N
    stress = m.lame_lambda * Trace(e) * Id(N) + 2 * m.lame_mu * e
    return InnerProduct(stress, e) / 2


def unreduced_energy(problem, u, p, alpha_1, alpha_2):
    """J~(u, p_0 + p, alpha) of (2.3), with dt phi* = sigma_y |p| on its domain."""
    m, N, mesh = problem.material, problem.N, problem.mesh
    stored = elastic_energy(problem, strain(u) - problem.p_0 - tensor(p, N))
    stored += alpha_1**2 / (2 * m.hardening_stiffness)
    stored += InnerProduct(alpha_2, alpha_2) / (2 * m.hardening)
    loads = sum(
        Integrate(g * u * ds(name, bonus_intorder=4), mesh)
        for name, g in problem.tractions.items()
    )
    return (
        Integrate(stored + m.yield_stress * Norm(p) - problem.f * u, mesh, order=6)
        - loads
    )


def dropped_constant(problem):
    m = problem.material
    alpha_1, alpha_2 = problem.alpha_0
    density = elastic_energy(problem, problem.p_0) + alpha_1**2 / (
        2 * m.hardening_stiffness
    )
    density += InnerProduct(alpha_2, alpha_2) / (2 * m.hardening)
    return Integrate(density, problem.mesh, order=6)


@pytest.mark.parametrize("N", [2, 3])
def test_reduced_energy_is_the_unreduced_one(N):
    """J(u, p) + constant = J~(u, p_0 + p, alpha(p)) for any u and p, with all initial data."""
    problem = general_problem(N)
    for seed in range(3):
        u, p = random_state(problem, seed)
        fields = Fields(problem, u, p)
        whole = unreduced_energy(
            problem, u, p, fields.hardening_variable, fields.back_stress
        )
        reduced = primal_energy(problem, u, p) + dropped_constant(problem)
        assert reduced == pytest.approx(whole, rel=1e-10)


def test_eliminated_alpha_1_is_the_minimiser():
    """An alpha_1 that is larger by delta costs delta (alpha_1 + delta/2) / k_1 more."""
    problem = general_problem(2)
    u, p = random_state(problem)
    fields = Fields(problem, u, p)
    alpha_1, alpha_2 = fields.hardening_variable, fields.back_stress
    least = unreduced_energy(problem, u, p, alpha_1, alpha_2)
    for delta in (0.01, 0.1):
        more = unreduced_energy(problem, u, p, alpha_1 + delta, alpha_2)
        k_1 = problem.material.hardening_stiffness
        expected = Integrate(delta * (alpha_1 + delta / 2) / k_1, problem.mesh, order=6)
        assert more - least == pytest.approx(expected, rel=1e-6)
        assert more > least


def test_flow_law_at_the_solution():
    """Phi <= 0, phi = 0 and p along dev sigma - alpha_2 where p is not zero."""
    problem = replace(
        general_problem(2),
        traction={"left": (1.2, 0.6)},
        initial_plastic_strain=1e-4 * TENSOR[2],
        initial_hardening=(0.3, TENSOR[2]),
    )
    result = primal_newton(problem)
    assert result.status is Status.CONVERGED
    fields, mesh = result.fields, problem.mesh
    increment = Norm(fields.plastic_increment)
    rho = fields.deviatoric_stress - fields.back_stress
    aligned = InnerProduct(rho, tensor(fields.plastic_increment, 2))
    phi, size, work, product = (
        np.array(Integrate(f, mesh, element_wise=True))
        / np.array(Integrate(CF(1.0), mesh, element_wise=True))
        for f in (fields.yield_function, increment, aligned, frobenius(rho) * increment)
    )
    flowing = size > 0
    assert 0.1 < flowing.mean() < 0.9
    assert phi.max() < 1e-9
    assert np.abs(phi[flowing]).max() < 1e-9
    assert phi[~flowing].max() < -1e-4
    assert work == pytest.approx(product, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("solver", ["primal", "dual"])
@pytest.mark.parametrize("limit", ["kinematic", "isotropic"])
def test_limits_are_the_single_laws(solver, limit):
    """k_1 = 0 is (2.16), k = 0 is (2.15): energies and fields of the two constructors agree."""
    base = general_problem(2)
    elastic = {name: DATA[name] for name in ("lame_lambda", "lame_mu", "yield_stress")}
    if limit == "kinematic":
        combined = Material(
            **{**DATA, "hardening_stiffness": 0.0, "hardening_modulus": 0.0}
        )
        single = Material.kinematic(**elastic, hardening=DATA["hardening"])
        states = ((0.3, (1 - x) * TENSOR[2]), (1 - x) * TENSOR[2])
    else:
        combined = Material(**{**DATA, "hardening": 0.0})
        isotropic = {n: DATA[n] for n in ("hardening_modulus", "hardening_stiffness")}
        single = Material.isotropic(**elastic, **isotropic)
        states = ((0.3 * (1 + y), 0.0 * TENSOR[2]), 0.3 * (1 + y))
    results = []
    for material, state in zip((combined, single), states, strict=True):
        problem = replace(base, material=material, initial_hardening=state)
        if solver == "primal":
            results.append(primal_newton(problem))
        else:
            results.append(semismooth_newton(problem))
    a, b = results
    assert a.status is b.status is Status.CONVERGED
    assert a.primal_energy == pytest.approx(b.primal_energy, rel=1e-10)
    difference = Integrate(Norm(a.displacement - b.displacement), base.mesh)
    assert difference < 1e-9 * Integrate(Norm(a.displacement), base.mesh)


def test_one_virgin_step_sees_the_sum_only():
    """From a virgin state, k + (H sigma_y)^2 k_1 = h is all that one step can tell."""
    h, energies = 100.0, []
    for k in (100.0, 60.0, 0.0):
        isotropic = {
            "hardening_modulus": 0.4,
            "hardening_stiffness": (h - k) / (0.4 * 1.25) ** 2,
        }
        problem = replace(
            general_problem(2, hardening=k, **isotropic),
            initial_plastic_strain=None,
            initial_hardening=None,
        )
        energies.append(primal_newton(problem).primal_energy)
    assert energies == pytest.approx([energies[0]] * 3, rel=1e-10)


EPSILON = {"load": 2.5e-3, "reversal": -3.0e-3}
"""Prescribed strains diag(eps, -eps) = sqrt(2) eps D with D = diag(1, -1) / sqrt(2)."""


def uniform_problem(epsilon, **state):
    """A square whose whole boundary moves by (eps x, -eps y): uniform, trace-free strain."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    motion = (epsilon * x, -epsilon * y)
    return Problem(
        mesh,
        Material(**DATA),
        clamped=None,
        prescribed={"left|right|clamped|contact": motion},
        **state,
        kinematics=FLAT[mesh.dim],
    )


def closed_form(epsilon, p_0=0.0, alpha_1=0.0, alpha_2=0.0):
    """(p, alpha_1, alpha_2) after a step: coordinates along D; p is the increment."""
    mu2, k = 2 * DATA["lame_mu"], DATA["hardening"]
    H_sigma = DATA["hardening_modulus"] * DATA["yield_stress"]
    k_1 = DATA["hardening_stiffness"]
    trial = mu2 * (sqrt(2) * epsilon - p_0) - alpha_2
    beta = DATA["yield_stress"] + H_sigma * alpha_1
    size = max(0.0, abs(trial) - beta) / (mu2 + k + H_sigma**2 * k_1)
    p = np.sign(trial) * size
    return p, alpha_1 + k_1 * H_sigma * size, alpha_2 + k * p


def solve(problem, solver):
    if solver == "primal":
        return primal_newton(problem)
    return semismooth_newton(problem)


@pytest.mark.parametrize("solver", ["primal", "dual"])
def test_load_and_reversal_by_hand(solver):
    """Two steps, p_0 and alpha_0 of the second by hand from the first: the scalar closed form."""
    D = CF((1, 0, 0, -1), dims=(2, 2)) / sqrt(2)
    first = solve(uniform_problem(EPSILON["load"]), solver)
    assert first.status is Status.CONVERGED
    p_1, a_1, b_1 = closed_form(EPSILON["load"])
    state = {"initial_plastic_strain": p_1 * D, "initial_hardening": (a_1, b_1 * D)}
    second = solve(uniform_problem(EPSILON["reversal"], **state), solver)
    assert second.status is Status.CONVERGED
    p_2, a_2, b_2 = closed_form(EPSILON["reversal"], p_1, a_1, b_1)
    assert p_1 > 5e-4
    assert p_2 < -1e-3
    point = second.problem.mesh(0.3, 0.4)
    for result, expected in ((first, (p_1, a_1, b_1)), (second, (p_2, a_2, b_2))):
        fields = result.fields
        found = (
            fields.plastic_increment(point)[0],
            fields.hardening_variable(point),
            InnerProduct(fields.back_stress, D)(point),
        )
        assert found == pytest.approx(expected, rel=1e-8)
        assert abs(fields.plastic_increment(point)[1]) < 1e-10
        assert fields.yield_function(point) == pytest.approx(0.0, abs=1e-8)
    total = InnerProduct(second.fields.plastic_strain, D)(point)
    assert total == pytest.approx(p_1 + p_2, rel=1e-8)
    assert -second.primal_energy == pytest.approx(second.dual_energy, rel=1e-8) or (
        solver == "primal"
    )


def test_bauschinger_effect_separates_the_laws():
    """Reverse yielding starts at a stress range of twice the hardened bound sigma_y (1 + H a_1)."""
    p, a, b = closed_form(EPSILON["load"])
    peak = 2 * DATA["lame_mu"] * (sqrt(2) * EPSILON["load"] - p)
    H_sigma = DATA["hardening_modulus"] * DATA["yield_stress"]
    bound = DATA["yield_stress"] + H_sigma * a
    D = CF((1, 0, 0, -1), dims=(2, 2)) / sqrt(2)
    state = {"initial_plastic_strain": p * D, "initial_hardening": (a, b * D)}
    for factor, yields in ((0.999, False), (1.001, True)):
        stress = peak - factor * 2 * bound
        epsilon = (stress / (2 * DATA["lame_mu"]) + p) / sqrt(2)
        result = primal_newton(uniform_problem(epsilon, **state))
        increment = Norm(result.plastic_increment)(result.problem.mesh(0.3, 0.4))
        assert (increment > 1e-7) is yields
        assert increment < 1e-4


@pytest.mark.parametrize("solver", ["primal", "dual"])
def test_initial_plastic_strain_alone_is_stress_free(solver):
    """A compatible p_0 is a change of shape: u = p_0 x, no stress, on supports that allow it."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    p_0 = CF((1e-3, 0, 0, -1e-3), dims=(2, 2))
    rollers = {"left": (0, None), "clamped": (None, 0)}
    material = Material(**DATA)
    problem = Problem(
        mesh,
        material,
        clamped=None,
        prescribed=rollers,
        initial_plastic_strain=p_0,
        kinematics=FLAT[mesh.dim],
    )
    result = solve(problem, solver)
    assert result.status is Status.CONVERGED
    expected = CF((1e-3 * x, -1e-3 * y))
    assert Integrate(Norm(result.displacement - expected), mesh) < 1e-10
    assert Integrate(frobenius(result.stress), mesh) < 1e-7


def column_top(force, hardening, beta):
    """u_y at the top of a column under its weight with u_x = 0: sigma_yy = f (1 - y).

    With e = eps_yy: elastic e = sigma / (lambda + 2 mu) up to e_0 = beta / (sqrt(2) mu), then
    p = (sqrt(2) mu e - beta) / (2 mu + h) and sigma = (lambda + 2 mu) e - sqrt(2) mu p.
    """
    lam, mu = DATA["lame_lambda"], DATA["lame_mu"]
    stiff, e_0 = lam + 2 * mu, beta / (sqrt(2) * mu)
    soft = stiff - 2 * mu**2 / (2 * mu + hardening)
    s_0 = stiff * e_0
    if force <= s_0:
        return force / (2 * stiff)
    below = (s_0 / force) * e_0 / 2  # where sigma < s_0: e from 0 to e_0
    e_1 = e_0 + (force - s_0) / soft
    return below + (1 - s_0 / force) * (e_0 + e_1) / 2


@pytest.mark.parametrize("force", [2.0, 8.0])
def test_column_under_its_weight(force):
    """A body force against the closed form, elastic (2) and plastic near the base (8): order 2."""
    material = Material(**DATA)
    errors = []
    for n in (4, 8, 16):
        mesh = block.structured_mesh(2, n, simplices=True)
        problem = Problem(
            mesh,
            material,
            prescribed={"left|right": (0, None)},
            body_force=(0, force),
            kinematics=FLAT[mesh.dim],
        )
        result = primal_newton(problem)
        assert result.status is Status.CONVERGED
        top = Integrate(result.displacement[1] * ds("contact"), mesh)
        expected = column_top(
            force, material.effective_hardening, material.yield_bound()
        )
        errors.append(abs(top / expected - 1))
    assert errors[-1] < 1e-3
    assert errors[-1] < 0.4 * errors[0] or errors[0] < 1e-9


def test_body_force_enters_the_dual():
    """The dual solver with f: V -> -J of the primal one."""
    material = Material(**DATA)
    mesh = block.structured_mesh(4, 8, simplices=True)
    problem = Problem(
        mesh,
        material,
        prescribed={"left|right": (0, None)},
        body_force=(0, 8.0),
        kinematics=FLAT[mesh.dim],
    )
    primal = primal_newton(problem)
    dual = semismooth_newton(problem)
    assert dual.status is Status.CONVERGED
    assert -dual.dual_energy == pytest.approx(primal.primal_energy, rel=2e-2)


def test_deviator_of_the_back_stress_counts():
    """A hydrostatic part of alpha_2,0 does no work on trace-free strains."""
    problem = general_problem(2)
    alpha_1, alpha_2 = problem.initial_hardening
    shifted = replace(problem, initial_hardening=(alpha_1, alpha_2 + 0.7 * x * Id(2)))
    u, p = random_state(problem)
    assert primal_energy(problem, u, p) == pytest.approx(
        primal_energy(shifted, u, p), rel=1e-12
    )
    assert Integrate(
        Trace(deviator(alpha_2 + z * Id(2), 2)), H1(problem.mesh).mesh
    ) == (pytest.approx(0.0, abs=1e-14))
