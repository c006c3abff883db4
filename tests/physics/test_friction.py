"""Tresca friction: closed form of a sheared block, limits in the bound, duality."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import FLAT
from ngepc.geometries import block, ring
from ngsolve import BND, CF, Integrate, Norm, ds, x

from ngepc import (
    Balanced,
    Coupled,
    FullProduct,
    Material,
    NewtonOptions,
    Problem,
    Status,
    semismooth_newton,
)
from ngepc.dual.friction import friction_energy, pressed_block_problem, slip
from ngepc.evolution.solver import cold_start, evolve
from ngepc.model.tensors import tensor
from ngepc.primal.solver import primal_newton
from ngepc.theory.duality import duality_report

MU, HARDENING, LOAD = 100.0, 10.0, 3.0
QUICK = NewtonOptions(quadrature_points=49)


def shear(F, gamma):
    """(s, t, u_t) of a unit block under the tangential load g on its top, all constant.

    s = g + t is the shear stress; elastic with p = dev sigma / (gamma + h) by the Tichonov term,
    so u_t = c s with c = 1/mu + 2/(gamma + h); u_t + [gamma (|t| - F)]^+ sgn t + t/gamma = 0.
    """
    c, g = 1 / MU + 2 / (gamma + HARDENING), LOAD
    t = -c * g / (c + 1 / gamma)
    if abs(t) > F:
        t = -(c * g + gamma * F) / (c + gamma + 1 / gamma)
    return g + t, t, c * (g + t)


def sheared_block(N, F, gamma, angle):
    """The block of ``shear``: fixed below, loaded on top, the exact shear stress on its sides."""
    cells = (3, 3) if N == 2 else (2, 2, 2)
    material = Material.kinematic(
        lame_lambda=100.0, lame_mu=MU, yield_stress=50.0, hardening=HARDENING
    )
    s = shear(F, gamma)[0]
    if N == 2:
        loads = {"contact": (LOAD, 0), "right": (0, s), "left": (0, -s)}
    else:
        a, b = np.cos(angle), np.sin(angle)
        loads = {
            **{"contact": (LOAD * a, LOAD * b, 0)},
            **{"right": (0, 0, s * a), "left": (0, 0, -s * a)},
            **{"back": (0, 0, s * b), "front": (0, 0, -s * b)},
        }
    mesh = block.structured_mesh(*cells, simplices=True)
    return Problem(
        mesh,
        material,
        traction=loads,
        contact="contact",
        gap=0.0,
        friction=F,
        kinematics=FLAT[mesh.dim],
    )


@pytest.mark.parametrize(("N", "angle"), [(2, 0.0), (3, 0.0), (3, 0.6435)])
@pytest.mark.parametrize("gamma", [10.0, 300.0])
@pytest.mark.parametrize("F", [0.0, 1.0, 2.0, 5.0])
def test_sheared_block(N, angle, gamma, F):
    """Slipping (F = 0, 1, 2) and sticking (F = 5), with the exact regularised t and u_t."""
    problem = sheared_block(N, F, gamma, angle)
    regularisation = Coupled(gamma, tichonov=FullProduct())
    result = semismooth_newton(problem, options=QUICK, regularisation=regularisation)
    assert result.status is Status.CONVERGED
    _, t, u_t = shear(F, gamma)
    direction = np.array([np.cos(angle), np.sin(angle), 0.0][:N])
    assert np.array(result.friction_force) == pytest.approx(t * direction, abs=1e-8)
    means = [Integrate(c * ds("contact"), problem.mesh) for c in result.displacement]
    assert np.array(means) == pytest.approx(u_t * direction, abs=1e-8)
    sliding = Integrate(result.sliding * ds("contact"), problem.mesh)
    assert sliding == pytest.approx(1.0 if abs(t) > F else 0.0)
    assert result.history.records[-1].friction_active == pytest.approx(sliding)


def block_mesh(n=8):
    return block.structured_mesh(2 * n, n, size=(2, 1), simplices=True)


def solved(problem, gamma=1e3, **choices):
    regularisation = Coupled(gamma, tichonov=FullProduct(**choices))
    result = semismooth_newton(problem, options=QUICK, regularisation=regularisation)
    assert result.status is Status.CONVERGED
    return result


def test_zero_bound_gives_the_frictionless_solution():
    """F = 0 leaves M^3 = gamma/2 |t|^2, so that V falls by |u_t|^2 / (2 gamma), and no more."""
    problem = pressed_block_problem(block_mesh(), None)
    differences = []
    for gamma in (1e2, 1e3):
        smooth, rough = (solved(replace(problem, friction=F), gamma) for F in (None, 0.0))
        square = Integrate(slip(problem, smooth.displacement) ** 2 * ds("contact"), problem.mesh)
        assert smooth.dual_energy - rough.dual_energy == pytest.approx(
            square / (2 * gamma), rel=1e-2
        )
        difference = rough.displacement.vec - smooth.displacement.vec
        differences.append(difference.Evaluate().Norm() / smooth.displacement.vec.Norm())
    assert differences[1] < 0.2 * differences[0]
    assert differences[1] < 1e-4


def test_large_bound_does_not_matter_beyond_the_stress():
    """Where |t| < F everywhere a larger F changes nothing."""
    problem = pressed_block_problem(block_mesh(), 100.0)
    results = [solved(replace(problem, friction=F)) for F in (100.0, 1e4)]
    assert all(r.history.records[-1].friction_active == 0.0 for r in results)
    assert results[0].dual_energy == pytest.approx(results[1].dual_energy, rel=1e-12)


def test_large_bound_sticks():
    """As gamma grows u_t -> 0 and V tends to that with u_t = 0 prescribed, both as 1/gamma."""
    rough = pressed_block_problem(block_mesh(4), 1e3)
    held = replace(rough, friction=None, prescribed={"contact": (0, None)})
    gaps, slips = [], []
    for gamma in (1e8, 1e10):
        regularisation = Balanced(gamma, tichonov=FullProduct())
        V, W = (semismooth_newton(p, regularisation=regularisation) for p in (rough, held))
        assert V.status is W.status is Status.CONVERGED
        gaps.append(abs(V.dual_energy / W.dual_energy - 1))
        u_t = slip(rough, V.displacement)
        slips.append(np.sqrt(Integrate(u_t**2 * ds("contact"), rough.mesh)))
    assert gaps[1] == pytest.approx(gaps[0] / 100, rel=0.1)
    assert slips[1] == pytest.approx(slips[0] / 100, rel=0.1)
    assert gaps[1] < 1e-5


def test_energies_are_monotone_in_the_bound():
    """A larger bound leaves more t to minimise over: V falls, J rises."""
    problem = pressed_block_problem(block_mesh())
    results = [
        semismooth_newton(
            replace(problem, friction=F),
            options=QUICK,
            regularisation=Balanced(1e9, tichonov=FullProduct()),
        )
        for F in (0.0, 1.0, 4.0, 16.0)
    ]
    assert all(r.status is Status.CONVERGED for r in results)
    assert all(b.dual_energy < a.dual_energy for a, b in pairwise(results))
    assert all(b.primal_energy > a.primal_energy for a, b in pairwise(results))
    assert all(b.contact_force > a.contact_force for a, b in pairwise(results))


def test_pressed_block_sticks_in_the_middle_and_slips_outside():
    problem = pressed_block_problem(block_mesh(), 5.0)
    result = semismooth_newton(
        problem, options=QUICK, regularisation=Balanced(1e9, tichonov=FullProduct())
    )
    assert result.status is Status.CONVERGED
    at = {s: problem.mesh(s, 1.0, VOL_or_BND=BND) for s in (0.1, 0.97, 1.03, 1.9)}
    assert [result.sliding(at[s]) for s in at] == [1.0, 0.0, 0.0, 1.0]
    u_t, t = slip(problem, result.displacement), result.friction_stress
    assert u_t(at[0.1]) * u_t(at[1.9]) < 0  # it bulges to both sides
    against = Integrate(t * result.displacement * ds("contact"), problem.mesh)
    assert -against == pytest.approx(friction_energy(problem, result.displacement), rel=2e-2)
    assert max(Norm(t)(at[s]) for s in at) < 5.0 + 0.05


def test_duality_gap_closes():
    """J(u, p) + V -> 0 with h, with the friction term of 5 percent in J."""
    gaps = []
    for n in (4, 8):
        problem = pressed_block_problem(block_mesh(n), 5.0)
        result = semismooth_newton(
            problem, options=QUICK, regularisation=Balanced(1e9, tichonov=FullProduct())
        )
        gaps.append(abs(result.primal_energy + result.dual_energy) / result.primal_energy)
    assert gaps[1] < 0.004
    assert np.log2(gaps[0] / gaps[1]) > 0.9
    assert friction_energy(problem, result.displacement) > 10 * gaps[1] * result.primal_energy


def test_friction_energy_of_a_given_displacement():
    """int F |u_t| of u = (x - 1, y) on the top of (0, 2) x (0, 1), F = 1 + x: 1 + 1 = 2."""
    problem = pressed_block_problem(block_mesh(), 1.0 + x)
    assert friction_energy(problem, CF((x - 1, 7.0))) == pytest.approx(2.0, rel=1e-6)
    assert friction_energy(replace(problem, friction=None), CF((x, 0.0))) == 0.0


def test_slip_has_no_normal_part():
    mesh = ring.shell_octant_mesh(0.6)
    material = Material.kinematic(lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=1.0)
    problem = Problem(
        mesh,
        material,
        clamped="inner",
        contact="outer",
        gap=0.0,
        friction=1.0,
        kinematics=FLAT[mesh.dim],
    )
    n, u = problem.normal, CF((1.0 + x, 2.0, -x))
    u_t = slip(problem, u)
    normal_part = Integrate((u_t * n) ** 2 * ds("outer"), mesh)
    whole = Integrate((u * u - (u * n) ** 2 - u_t * u_t) * ds("outer"), mesh)
    assert normal_part == pytest.approx(0.0, abs=1e-20)
    assert whole == pytest.approx(0.0, abs=1e-12)


def test_bound_that_varies():
    """A bound that grows from 0 at the left: the left end slips, the right one sticks."""
    problem = pressed_block_problem(block_mesh(), 40 * x**2)
    result = semismooth_newton(
        problem, options=QUICK, regularisation=Balanced(1e9, tichonov=FullProduct())
    )
    assert result.status is Status.CONVERGED
    assert result.sliding(problem.mesh(0.03, 1.0, VOL_or_BND=BND)) == 1.0
    assert result.sliding(problem.mesh(1.9, 1.0, VOL_or_BND=BND)) == 0.0


@pytest.mark.parametrize("N", [2, 3])
def test_start_on_another_mesh(N):
    """t is carried over with z and q: from the coarse solution fewer steps are needed."""

    def problem(n):
        cells = (2 * n, 2 * n) if N == 2 else (n, n, n)
        mesh = block.structured_mesh(*cells, simplices=True)
        return pressed_block_problem(mesh, 4.0)

    coarse = solved(problem(2), 1e2)
    cold = solved(problem(4), 1e2)
    regularisation = Coupled(1e2, tichonov=FullProduct())
    warm = semismooth_newton(problem(4), start=coarse, options=QUICK, regularisation=regularisation)
    assert warm.status is Status.CONVERGED
    assert warm.dual_energy == pytest.approx(cold.dual_energy, rel=1e-9)
    assert warm.history.residual_norms[0] < 0.5 * cold.history.residual_norms[0]


NAN = float("nan")
BAD = {
    "negative": ({"friction": -1.0}, ValueError, "friction falls to -1: values >= 0"),
    "negative somewhere": ({"friction": x - 1}, ValueError, "friction falls to"),
    "NaN": ({"friction": NAN}, ValueError, "friction=nan: a finite number"),
    "a vector": ({"friction": CF((1.0, 1.0))}, ValueError, "friction has shape (2,): a scalar"),
    "a string": ({"friction": "1"}, TypeError, "friction='1': a number or a CoefficientFunction"),
    "no contact": (
        {"friction": 1.0, "contact": None, "gap": None},
        ValueError,
        "friction=1.0: name the contact boundary too",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_bounds_are_refused(name):
    changes, error, message = BAD[name]
    with pytest.raises(error) as caught:
        replace(pressed_block_problem(block_mesh(1), None), **changes)
    assert message in str(caught.value)


def test_primal_solver_refuses_friction():
    with pytest.raises(ValueError, match=r"friction=5.0.*semismooth_newton"):
        primal_newton(pressed_block_problem(block_mesh(1)))


def test_without_friction_there_is_no_tangential_stress():
    result = solved(pressed_block_problem(block_mesh(2), None), 1.0)
    assert result.friction_force == (0.0, 0.0)
    assert result.sliding(result.problem.mesh(0.5, 1.0, VOL_or_BND=BND)) == 1.0


def test_slip_counts_from_the_initial_displacement():
    """A press at rest slips no further; lifted a little, friction keeps the bulge."""
    problem = pressed_block_problem(block_mesh(4), 5.0)
    problem = replace(problem, material=replace(problem.material, yield_stress=1e3))
    regularisation = Balanced(1e9, tichonov=FullProduct())

    def done(**changes):
        changed = replace(problem, **changes)
        result = semismooth_newton(changed, options=QUICK, regularisation=regularisation)
        assert result.status is Status.CONVERGED
        return result

    pressed = done()
    u_0 = pressed.displacement
    again = done(initial_displacement=u_0)
    assert friction_energy(again.problem, u_0) == 0.0
    assert (again.displacement.vec - u_0.vec).Evaluate().Norm() < 1e-3 * u_0.vec.Norm()
    kept, fresh = done(initial_displacement=u_0, gap=-0.019), done(gap=-0.019)
    bulges = [
        Integrate(slip(problem, r.displacement) ** 2 * ds("contact"), problem.mesh)
        for r in (pressed, kept, fresh)
    ]
    assert bulges[1] == pytest.approx(bulges[0], rel=1e-2)  # it sticks
    assert bulges[2] < 0.95 * bulges[0]


def test_histories_remember_where_the_body_stuck():
    """Two steps of evolve are the step and then the step with u_0, p_0 and alpha_0."""
    problem = pressed_block_problem(block_mesh(3), 5.0)
    regularisation = Balanced(1e9, tichonov=FullProduct())
    solver = cold_start(semismooth_newton, options=QUICK, regularisation=regularisation)
    history = evolve(problem, [(1.0, {}), (2.0, {"gap": -0.018})], solver)
    assert history.status is Status.CONVERGED
    first, second = (step.fields for step in history.steps)
    assert second.problem.initial_displacement is first.displacement
    k, p = problem.material.hardening, tensor(first.plastic_increment, 2)
    by_hand = replace(
        problem,
        gap=-0.018,
        initial_displacement=first.displacement,
        initial_plastic_strain=p,
        initial_hardening=k * p,
    )
    result = semismooth_newton(by_hand, options=QUICK, regularisation=regularisation)
    difference = (result.displacement.vec - second.displacement.vec).Evaluate().Norm()
    assert difference < 1e-8 * second.displacement.vec.Norm()


def test_terms_of_the_duality_gap():
    """J + J* is the sum of its terms, friction included."""
    problem = pressed_block_problem(block_mesh(3), 5.0)
    for case in (problem, replace(problem, initial_displacement=CF((1e-3 * x, 0.0)))):
        report = duality_report(solved(case, 1e3))
        assert sum(report.parts.values()) == pytest.approx(report.gap, rel=1e-6)
        assert report.friction_term > 0


def test_initial_displacement_without_friction_is_refused():
    with pytest.raises(ValueError, match="matters for friction alone"):
        replace(pressed_block_problem(block_mesh(1), None), initial_displacement=(0.0, 0.0))
