"""Bounds for Hill's ellipsoid and sub-elements: no energy crosses them, and von Mises is met."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.crossings import finer
from ngsolve import CF, x
from pairs import in_turn

from ngepc import (
    Coulomb,
    Hill,
    Material,
    Overlay,
    Problem,
    error_bound,
    error_indicators,
    semismooth_newton,
    solve_to,
)
from ngepc.bounds.convex import ConvexConjugate
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.geometries import block

PLAIN = Material.kinematic(
    lame_lambda=1e3, lame_mu=800.0, yield_stress=1.0, hardening=60.0
)
SHARE = 1600.0 / 1660.0
SAME = {
    "ellipsoid": replace(PLAIN, hill=Hill()),
    "sub-element": replace(PLAIN, hardening=0.0, overlay=Overlay([SHARE], [1.0])),
}
"""Laws that are von Mises's with linear kinematic hardening in one step."""
STRETCHED = CF((4e-4, 1e-4, 0, 1e-4, -3e-4, 0, 0, 0, -1e-4), dims=(3, 3))


def square(n, material, order=1, **data):
    load = {"right": (1.4, 0.9)}
    mesh = block.structured_mesh(n, n, simplices=True)
    return Problem(mesh, material, traction=load, order=order, **data)


@pytest.mark.parametrize(
    ("law", "kinematics"), in_turn(SAME, ["plane strain", "plane stress"])
)
def test_the_bound_is_that_of_von_mises_where_the_law_is(law, kinematics):
    one, two = (
        error_bound(semismooth_newton(square(4, material, kinematics=kinematics)))
        for material in (PLAIN, SAME[law])
    )
    assert two.energy == pytest.approx(one.energy, rel=1e-10)
    assert two.total == pytest.approx(one.total, rel=0.02)
    assert two.strain_energy == pytest.approx(one.strain_energy, rel=1e-9)
    assert two.strain == pytest.approx(one.strain, rel=0.02)
    assert abs(two.algebraic) < 1e-9 * two.total


@pytest.mark.parametrize(
    ("kinematics", "law"),
    [
        ("plane strain", "ellipsoid"),
        ("plane stress", "sub-element"),
        ("solid", "ellipsoid"),
    ],
)
def test_order_two_is_that_of_von_mises_where_the_law_is(law, kinematics):
    """Integrals of convex functions are a little larger than those of von Mises's law."""
    problem = (
        square(4, PLAIN, 2, kinematics=kinematics) if kinematics != "solid" else cube()
    )
    one, two = (
        error_bound(semismooth_newton(replace(problem, material=material)))
        for material in (PLAIN, SAME[law])
    )
    assert one.state.at.yields.any()
    assert -0.01 < (two.energy - one.energy) / one.total < 0.05
    assert 0.98 * one.total < two.total < 1.25 * one.total
    assert abs(two.algebraic) < 1e-6 * two.total


def cube():
    """A cube that is pulled until a part of it yields, order two."""
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    return Problem(mesh, PLAIN, traction={"right": (0.6, 0.0, 0.3)}, order=2)


def random_material(rng, anisotropic):
    stiffness = {"lame_lambda": rng.uniform(200, 2e3), "lame_mu": rng.uniform(300, 1e3)}
    if anisotropic:
        r = rng.uniform(0.5, 2.5, 3)
        hardening = stiffness["lame_mu"] * 10 ** rng.uniform(-2, -0.3)
        return Material(
            **stiffness,
            yield_stress=1.0,
            hardening=hardening,
            hardening_modulus=rng.choice([0.0, 0.1]),
            hardening_stiffness=1e3,
            hill=Hill.r_values(*r, angle=rng.uniform(0, np.pi)),
        )
    parts = rng.integers(1, 4)
    shares = rng.dirichlet(np.ones(parts)) * rng.uniform(0.6, 0.97)
    bounds = np.cumsum(rng.uniform(0.3, 1.0, parts))
    overlay = Overlay(shares.tolist(), bounds.tolist())
    return Material(**stiffness, yield_stress=bounds[0], overlay=overlay)


def random_data(seed):
    """Material, mesh (a function of the number of cells) and other data of a problem."""
    rng = np.random.default_rng(seed)
    data = {"order": 1, "contact": "contact", "gap": rng.uniform(-1e-3, 3e-3)}
    material = random_material(rng, anisotropic=seed % 2 == 0)
    kind = ("plane strain", "plane stress", "solid")[seed % 3]
    load = rng.uniform(-1.5, 1.5, 3 if kind == "solid" else 2)
    data["traction"] = {"right": tuple(load)}
    if kind != "solid":
        data["kinematics"] = kind
    if rng.random() < 0.3:
        data["initial_strain"] = rng.uniform(-1e-3, 1e-3)
    if rng.random() < 0.3 and material.overlay is None:
        data["initial_plastic_strain"] = STRETCHED
    if rng.random() < 0.2:
        data["body_force"] = (*load[1:], 2.0 * x)
    size = (2, 1, 1) if kind == "solid" else (3, 3)
    return material, size, data


def on_two_meshes(material, size, data):
    """The results on cells of this number along the axes, and on cells of half the size."""
    for factor in (1, 2):
        cells = [factor * n for n in size]
        mesh = block.structured_mesh(*cells, simplices=True)
        yield semismooth_newton(Problem(mesh, material, **data)).raise_for_status()


@pytest.mark.parametrize("seed", range(6, 10))
def test_no_energy_crosses_the_bound(seed):
    material, size, data = random_data(seed)
    coarse, fine = on_two_meshes(material, size, data)
    bound = error_bound(coarse)
    error = bound.energy - fine.primal_energy
    assert bound.guaranteed
    assert bound.least_energy <= fine.primal_energy
    assert error <= bound.total < 1e3 * max(error, 1e-6 * bound.strain_energy)
    assert abs(bound.algebraic) <= 1e-6 * bound.strain_energy


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_gradients_and_compliances_are_derivatives(seed):
    """phi* and its derivatives by differences, at stresses that yield."""
    material, size, data = random_data(seed)
    problem = Problem(block.structured_mesh(*size, simplices=True), material, **data)
    law = law_of(problem, Points(problem.mesh, problem.kinematics, 1))
    conjugate = ConvexConjugate(law)
    rng = np.random.default_rng(seed)
    z = 2.5 * rng.standard_normal((problem.mesh.ne, 1, 3))
    change = rng.standard_normal(z.shape)
    t = 1e-5
    at, after, before = (conjugate.completed(z + s * change) for s in (0, t, -t))
    slope = np.einsum("tqc,tqc->tq", conjugate.gradient(at), change)
    rise = (conjugate.value(after) - conjugate.value(before)) / (2 * t)
    assert at.over.mean() > 0.8
    assert rise == pytest.approx(slope, rel=1e-5, abs=1e-8)
    bent = np.einsum("tqcd,tqd->tqc", conjugate.compliance(at), change)
    turned = (conjugate.gradient(after) - conjugate.gradient(before)) / (2 * t)
    assert turned == pytest.approx(bent, rel=1e-3, abs=1e-5 * np.abs(bent).max())
    assert conjugate.sought(at) == pytest.approx(conjugate.value(at), rel=1e-9)


def test_an_error_is_reached_on_adaptive_meshes():
    material, _, _ = random_data(0)
    solved = solve_to(square(2, material), relative_error=0.1)
    assert solved.bound.relative <= 0.1


@pytest.mark.parametrize("seed", range(3))
def test_no_energy_of_order_two_crosses_the_bound(seed):
    material, size, data = random_data(seed)
    data["order"] = 2
    coarse, fine = on_two_meshes(material, size, data)
    bound = error_bound(coarse)
    assert bound.guaranteed
    assert bound.least_energy <= fine.primal_energy
    assert bound.per_cell.min() >= -1e-9 * bound.total
    error = bound.energy - fine.primal_energy
    assert error <= bound.total < 1e3 * max(error, 1e-6 * bound.strain_energy)


def test_histories_that_vary_inside_elements_are_refused():
    """Of sub-elements, too, whose plastic strains are a vector."""
    stretched = square(2, SAME["ellipsoid"], 2, initial_plastic_strain=x * STRETCHED)
    with pytest.raises(ValueError, match="initial_plastic_strain varies inside"):
        error_bound(semismooth_newton(stretched))
    strains = CF(tuple(1e-4 * x * k for k in (1, 2, 3, 0, 0, 0)))
    started = square(2, SAME["sub-element"], 1, initial_hardening=strains)
    with pytest.raises(ValueError, match="initial_hardening varies inside"):
        error_bound(semismooth_newton(started))


def test_an_angle_that_varies_inside_elements_is_refused():
    turning = replace(PLAIN, hill=Hill.r_values(1.8, 1.2, 2.3, angle=x))
    with pytest.raises(ValueError, match=r"hill.angle varies inside elements"):
        error_bound(semismooth_newton(square(2, turning)))


@pytest.mark.parametrize("law", SAME)
def test_no_estimate_is_advised_that_is_refused_as_well(law):
    """``error_indicators`` are for one smooth yield surface; others got the advice."""
    rubs = {"contact": "contact", "gap": 1e-4, "friction": Coulomb(0.3)}
    result = semismooth_newton(square(2, SAME[law], **rubs))
    with pytest.raises(ValueError, match="needs"):
        error_indicators(result)
    with pytest.raises(ValueError, match=r"a given bound F of friction$"):
        error_bound(result)


@pytest.mark.parametrize("number", [0, 1])
def test_a_constant_history_stays_constant_on_bisected_meshes(number):
    """Its values at the points of a cell differ by rounding errors there."""
    material = random_material(np.random.default_rng(5), anisotropic=number == 0)
    start = 1.1 * STRETCHED
    problem = square(2, material, order=2, initial_plastic_strain=start)
    fine = error_bound(semismooth_newton(finer(problem, 1)))
    bound = error_bound(semismooth_newton(problem))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
