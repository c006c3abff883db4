"""Both solvers against closed forms, patch tests, energy identities and each other."""

import dataclasses
import math

import numpy as np
import pytest
from bodies import FLAT
from closed_forms import Law, Ring
from coordinates import coordinates, tensor
from ngsolve import CF, Integrate, Norm, ds, dx, grad, sqrt, x, y, z
from scipy.optimize import brentq
from witness import distance_bound

from ngepc import (
    Coupled,
    FullProduct,
    Material,
    Problem,
    Status,
    Units,
    lshape_problem,
    semismooth_newton,
)
from ngepc.discretisation.quadrature import boundary_rules, fine_rules
from ngepc.geometries import block, lshape
from ngepc.primal.solver import primal_newton
from ngepc.results.fields import Fields

KINEMATIC = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
ISOTROPIC = Material.isotropic(
    lame_lambda=700.0,
    lame_mu=900.0,
    yield_stress=1.5,
    hardening_modulus=0.5,
    hardening_stiffness=300.0,
)
COMBINED = Material(
    lame_lambda=-300.0,
    lame_mu=800.0,
    yield_stress=1.0,
    hardening=60.0,
    hardening_modulus=2.0,
    hardening_stiffness=20.0,
)
MATERIALS = {"kinematic": KINEMATIC, "isotropic": ISOTROPIC, "combined": COMBINED}
UNITS = Units(stress=2.0, length=0.7)
REGULARISATIONS = {
    "exact": None,
    "coupled, gamma 0.1": Coupled(0.1, tichonov=FullProduct()),
    "coupled, gamma 30": Coupled(30.0, tichonov=FullProduct(), units=UNITS),
}


def solve(problem, regularisation):
    """By the primal method for None, by the dual one otherwise; the status must be CONVERGED."""
    if regularisation is None:
        result = primal_newton(problem)
    else:
        result = semismooth_newton(problem, regularisation=regularisation)
    assert result.status is Status.CONVERGED
    return result


def of_y(result):
    """The fields of y = (u, p) itself, which obeys the regularised law to rounding."""
    increment = result.plastic_increment
    return Fields(result.problem, result.displacement, increment)


def bar(material, load, **changes):
    """A square on rollers pulled at the right: sigma = diag(load, 0)."""
    rollers = {"left": (0, None), "clamped": (None, 0)}
    mesh = block.mesh(0.5, (1.0, 1.0))
    data = {
        "clamped": None,
        "prescribed": rollers,
        "traction": {"right": (load, 0)},
        **changes,
    }
    return Problem(mesh, material, **data, kinematics=FLAT[mesh.dim])


def fixed_everywhere(mesh, material, u, **changes):
    """Displacements given on the whole boundary."""
    names = "|".join(sorted(set(mesh.GetBoundaries())))
    return Problem(
        mesh,
        material,
        clamped=None,
        prescribed={names: u},
        **changes,
        kinematics=FLAT[mesh.dim],
    )


def largest(difference, mesh):
    """The L2 norm over the body of a coefficient, per square root of its volume."""
    return math.sqrt(Integrate(Norm(difference) ** 2, mesh) / Integrate(1.0, mesh))


@pytest.mark.parametrize("regularisation", REGULARISATIONS)
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("load", [1.0, -4.0])
def test_uniaxial_stress(material, regularisation, load):
    problem, R = bar(MATERIALS[material], load), REGULARISATIONS[regularisation]
    result, m = solve(problem, R), problem.material
    p = Law.of(problem, R).plastic_strain(abs(load) / math.sqrt(2)) * math.copysign(
        1, load
    )
    mean, shear = load / (4 * (m.lame_lambda + m.lame_mu)), load / (4 * m.lame_mu)
    along, across = mean + shear + p / math.sqrt(2), mean - shear - p / math.sqrt(2)
    exact = CF((along * x, across * y))
    assert largest(result.displacement - exact, problem.mesh) < 1e-10 * abs(along)
    strain = CF((p, 0, 0, -p), dims=(2, 2)) / math.sqrt(2)
    assert largest(of_y(result).plastic_strain - strain, problem.mesh) < 1e-10 * abs(
        along
    )
    stress = CF((load, 0, 0, 0), dims=(2, 2))
    assert largest(result.stress - stress, problem.mesh) < 1e-9 * abs(load)


@pytest.mark.parametrize("regularisation", REGULARISATIONS)
@pytest.mark.parametrize("N", [2, 3])
@pytest.mark.parametrize("angle", [5e-4, 8e-3])
def test_simple_shear(N, regularisation, angle):
    """u = (angle times height, 0): the shear stress is mu angle until it yields."""
    R = REGULARISATIONS[regularisation]
    mesh = block.mesh(0.5 if N == 2 else 1.0, (1.0,) * N)
    height = y if N == 2 else z
    problem = fixed_everywhere(mesh, KINEMATIC, (angle * height, *(0.0,) * (N - 1)))
    result = solve(problem, R)
    s = math.sqrt(2) * 1e3 * angle
    p = Law.of(problem, R).plastic_strain(s, two_mu=2e3)
    shear = (s - 2e3 * p) / math.sqrt(2)
    assert largest(result.stress[0, N - 1] - shear, mesh) < 1e-9 * s
    assert largest(Norm(of_y(result).plastic_increment) - p, mesh) < 1e-10 * s / 1e3
    exact = CF((angle * height, *(0.0,) * (N - 1)))
    assert largest(result.displacement - exact, mesh) < 1e-12


@pytest.mark.parametrize("regularisation", REGULARISATIONS)
@pytest.mark.parametrize("push", [-0.002, 0.0004, 0.02])
def test_column_and_obstacle(regularisation, push):
    """A column of height 1/2 between smooth walls; the obstacle pushes, or hangs over a gap.

    u - psi + gamma_z [z]_+ + z / (gamma_T L) = 0 with the stress z; exactly, u <= psi.
    """
    R = REGULARISATIONS[regularisation]
    mesh = block.mesh(0.4, (1.0, 0.5))
    walls = {"left|right": (0, None)}
    problem = Problem(
        mesh,
        COMBINED,
        contact="contact",
        gap=-push,
        prescribed=walls,
        kinematics=FLAT[mesh.dim],
    )
    result, law = solve(problem, R), Law.of(problem, R)
    two_mu, bulk = 2 * COMBINED.lame_mu, COMBINED.lame_lambda + COMBINED.lame_mu

    def stress(e):
        s = two_mu * abs(e) / math.sqrt(2)
        s -= two_mu * law.plastic_strain(s, two_mu)
        return bulk * e + math.copysign(s, e) / math.sqrt(2)

    def imbalance(e):
        sigma = stress(e)
        weights = R.weights
        softness = 1 / (weights.tichonov * R.units.length)
        return e / 2 + push + weights.contact * max(sigma, 0.0) + softness * sigma

    exact = (
        -2 * max(push, 0.0)
        if R is None
        else brentq(imbalance, -1, 1, xtol=1e-17, rtol=1e-15)
    )
    error = largest(result.displacement - CF((0.0, exact * y)), mesh)
    assert error < 1e-11 + 1e-10 * abs(exact)
    assert result.contact_force == pytest.approx(-stress(exact), rel=1e-8, abs=1e-10)


@pytest.mark.parametrize("regularisation", ["exact", "coupled, gamma 30"])
@pytest.mark.parametrize("material", MATERIALS)
def test_loading_then_reversed(material, regularisation):
    """A second step starts from the state of the first: Bauschinger's effect or its absence."""
    R, m = REGULARISATIONS[regularisation], MATERIALS[material]
    first = solve(bar(m, 4.0), R)
    p_1 = Law.of(first.problem, R).plastic_strain(4.0 / math.sqrt(2))
    fields = of_y(first)
    state = (fields.hardening_variable, fields.back_stress)
    second = bar(
        m, -5.0, initial_plastic_strain=fields.plastic_strain, initial_hardening=state
    )
    result = solve(second, R)
    back = m.hardening * p_1
    bound = m.yield_stress * (
        1 + m.hardening_modulus**2 * m.hardening_stiffness * m.yield_stress * p_1
    )
    law = dataclasses.replace(Law.of(first.problem, R), beta=bound)
    p_2 = p_1 - law.plastic_strain(5.0 / math.sqrt(2) + back)
    strain = CF((p_2, 0, 0, -p_2), dims=(2, 2)) / math.sqrt(2)
    assert p_2 < p_1
    assert largest(of_y(result).plastic_strain - strain, second.mesh) < 1e-9 * p_1
    assert largest(result.stress - CF((-5.0, 0, 0, 0), dims=(2, 2)), second.mesh) < 1e-8


@pytest.mark.parametrize("material", [KINEMATIC, COMBINED])
def test_unloading_is_elastic(material):
    first = solve(bar(material, 3.0), None)
    state = (first.fields.hardening_variable, first.fields.back_stress)
    data = {"initial_plastic_strain": first.plastic_strain, "initial_hardening": state}
    back = solve(bar(material, 0.0, **data), None)
    assert Integrate(Norm(back.plastic_increment), back.problem.mesh) == 0.0
    again = solve(bar(material, 3.0 * (1 - 1e-9), **data), None)
    assert largest(again.displacement - first.displacement, again.problem.mesh) < 1e-9


@pytest.mark.parametrize("material", MATERIALS)
def test_two_proportional_steps_equal_one(material):
    """Linear hardening: p depends on the end point of a proportional load path alone."""
    m = MATERIALS[material]
    whole = solve(bar(m, 6.0), None)
    half = solve(bar(m, 3.0), None)
    state = (half.fields.hardening_variable, half.fields.back_stress)
    rest = solve(
        bar(
            m, 6.0, initial_plastic_strain=half.plastic_strain, initial_hardening=state
        ),
        None,
    )
    difference = rest.plastic_strain - whole.plastic_strain
    assert largest(difference, whole.problem.mesh) < 1e-12


PATCHES = {
    "triangles": lambda: block.mesh(0.3, (1.0, 1.0)),
    "rectangles": lambda: block.structured_mesh(3, 4),
    "tetrahedra": lambda: block.mesh(1.0),
    "bricks": lambda: block.structured_mesh(2, 2, 2),
    "round hole": lambda: block.with_hole(0.3, (1.0, 1.0)),
}


@pytest.mark.parametrize("regularisation", ["exact", "coupled, gamma 30"])
@pytest.mark.parametrize("size", [1e-4, 5e-3])
@pytest.mark.parametrize("patch", PATCHES)
def test_patch(patch, size, regularisation):
    """A linear displacement on the whole boundary is taken inside, elastic or plastic."""
    mesh, R = PATCHES[patch](), REGULARISATIONS[regularisation]
    N = mesh.dim
    A = size * np.random.default_rng(7).standard_normal((N, N))
    u = tuple(sum(float(A[i, j]) * (x, y, z)[j] for j in range(N)) for i in range(N))
    problem = fixed_everywhere(mesh, COMBINED, u)
    result = solve(problem, R)
    assert largest(result.displacement - CF(u), mesh) < 1e-12
    e = (A + A.T) / 2
    s = 2 * COMBINED.lame_mu * (e - np.trace(e) / N * np.eye(N))
    p = Law.of(problem, R).plastic_strain(
        np.linalg.norm(s), two_mu=2 * COMBINED.lame_mu
    )
    strain = p * s / np.linalg.norm(s)
    exact = CF(tuple(strain.ravel().tolist()), dims=(N, N))
    assert largest(result.plastic_strain - exact, mesh) < 1e-10 * size
    assert (p > 1e-4) == (size == 5e-3)


RING = Ring(1e3, 1e3, 1.25, 100.0)


def test_closed_form_of_the_ring_is_in_equilibrium():
    """The formulas themselves: sigma_r' + 2 tau / r = 0 and the boundary values, by differences."""
    pressure = 1.2
    rho = RING.radius(pressure)
    A, B, C = RING.plastic(rho)
    assert 1.2 < rho < 1.8

    def u(r):
        A_e, B_e = RING.elastic(rho)
        return A_e * r + B_e / r if r > rho else A * r + B / r + C * r * math.log(r)

    def stresses(r):
        slope = (u(r + 1e-5) - u(r - 1e-5)) / 2e-5
        D, S = slope - u(r) / r, slope + u(r) / r
        s = math.sqrt(2) * RING.mu * abs(D)
        p = max(s - RING.beta, 0.0) / (2 * RING.mu + RING.h)
        tau = math.copysign(s - 2 * RING.mu * p, D) / math.sqrt(2)
        return RING.bulk * S + tau, tau

    assert stresses(1.0)[0] == pytest.approx(-pressure, rel=1e-6)
    assert stresses(2.0)[0] == pytest.approx(0.0, abs=1e-6)
    for r in (1.05, 1.3, 0.5 * (rho + 2.0)):
        slope = (stresses(r + 1e-3)[0] - stresses(r - 1e-3)[0]) / 2e-3
        assert slope == pytest.approx(-2 * stresses(r)[1] / r, rel=1e-4)


@pytest.fixture(scope="module")
def small():
    return lshape_problem(lshape.paper_mesh(225))


def twice_tichonov(result):
    """b(v, v) of (R2) by plain integrals."""
    z_h, q_h = result.state.components[2:]
    gradients = Integrate(Norm(grad(q_h)) ** 2, result.problem.mesh)
    return gradients + Integrate(
        grad(z_h).Trace() ** 2 * ds("contact"), result.problem.mesh
    )  # L = 1


@pytest.mark.parametrize("gamma", [10.0, 1e3])
def test_energies_of_the_regularised_solution_add_up(small, gamma):
    """J(u, p) + J*_gamma = int beta |p| - int gamma s |q| + M^2 - M^1 - T with s = [|q| - beta]_+.

    It follows from D y = Lambda* v - l and Psi_gamma(v) = 0, tested with v.
    """
    result, mesh = semismooth_newton(small, gamma), small.mesh
    z_h, q_h = result.state.components[2:]
    fine = dx(intrules=fine_rules(2, 400))
    size, beta = Norm(q_h), small.beta
    s = 0.5 * (size - beta + sqrt((size - beta) ** 2))
    dissipation = Integrate(beta * Norm(result.plastic_increment), mesh)
    penalty = Integrate(gamma * (s * s / 2 - s * size) * fine, mesh)
    on_contact = ds("contact", intrules=boundary_rules(2, 400))
    contact = Integrate(gamma / 8 * (z_h + Norm(z_h)) ** 2 * on_contact, mesh)
    expected = dissipation + penalty - contact - twice_tichonov(result) / (2 * gamma)
    gap = result.primal_energy + result.dual_energy
    assert gap == pytest.approx(expected, abs=1e-7 * abs(result.dual_energy))


@pytest.mark.parametrize(
    "regularisation", [Coupled(1e3), Coupled(1e4, tichonov=FullProduct())]
)
def test_dual_solution_is_as_near_to_the_primal_one_as_the_energies_say(
    small, regularisation
):
    """1/2 |y - y_gamma|_D^2 <= J(y) + int |p|^2 / (2 gamma_q) + adhesion + J*_gamma."""
    dual = semismooth_newton(small, regularisation=regularisation)
    distance, bound = distance_bound(solve(small, None), dual)
    assert 0 < distance < bound
    assert bound < 2 * dual.dual_energy


def test_energy_falls_on_nested_meshes_with_contact_and_plasticity():
    """V_h grows under bisection, and a constant gap is the same condition on all meshes."""
    energies = []
    for n in (2, 4, 8, 16):
        mesh = block.structured_mesh(n, n, simplices=True)
        load = {"left": CF((0.0, 4.0))}
        problem = Problem(
            mesh,
            KINEMATIC,
            traction=load,
            contact="contact",
            gap=0.004,
            kinematics=FLAT[mesh.dim],
        )
        energies.append(solve(problem, None).primal_energy)
    assert (np.diff(energies) < 0).all()


def test_stress_and_strain_of_the_dual_solution_obey_the_elastic_law(small):
    """sigma = C (eps(u) - p): coordinates of the deviator are 2 mu (dev eps - p)."""
    result = semismooth_newton(small, 1e3)
    e = coordinates(result.fields.strain - tensor(result.plastic_increment, 2), 2)
    s = coordinates(result.stress, 2)
    assert largest(s - 2e3 * e, small.mesh) < 1e-12
