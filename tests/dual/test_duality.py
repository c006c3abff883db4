"""J(y_gamma) + J*_gamma and its parts; (3.8), (3.9); contact conditions (2.10) to (2.13)."""

import math
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, BoundaryFromVolumeCF, Integrate, ds

from ngepc import (
    Coupled,
    Material,
    PathOptions,
    Problem,
    duality_report,
    follow_path,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.geometries import block, lshape, wrench


@pytest.fixture(scope="module")
def contact_problem():
    return lshape_problem(lshape.paper_mesh(113))


@pytest.fixture(scope="module")
def contact_path(contact_problem):
    reports, options = (
        [],
        PathOptions(gamma_start=10, growth=10, gamma_end=1e5, inner_scale=1e-9),
    )
    path = follow_path(
        contact_problem, options, observer=lambda r: reports.append(duality_report(r))
    )
    path.raise_for_status()
    return path, reports


def assert_parts_add_up(report):
    size = max(abs(part) for part in report.parts.values())
    assert report.gap == pytest.approx(sum(report.parts.values()), abs=1e-9 * size)


def test_parts_add_up_to_the_gap_along_the_path(contact_path):
    _, reports = contact_path
    for report in reports:
        assert_parts_add_up(report)


def test_parts_add_up_with_initial_conditions_and_both_hardenings():
    combined = Material(
        lame_lambda=1e3,
        lame_mu=1e3,
        yield_stress=1.25,
        hardening=60.0,
        hardening_modulus=2.0,
        hardening_stiffness=8.0,
    )
    p_0 = CF((1e-3, 5e-4, 5e-4, -1e-3), dims=(2, 2))
    alpha_2 = CF((0.1, 0.05, 0.05, -0.1), dims=(2, 2))
    problem = replace(
        lshape_problem(lshape.paper_mesh(113)),
        material=combined,
        initial_plastic_strain=p_0,
        initial_hardening=(0.05, alpha_2),
        body_force=(0.2, 0.1),
        prescribed={"clamped": (0.0, 1e-3)},
        clamped=None,
    )
    result = semismooth_newton(problem, 1e3)
    result.raise_for_status()
    report = duality_report(result)
    assert_parts_add_up(report)
    assert report.mean_stress_deviation < 1e-9 * report.deviatoric_stress
    assert report.yield_deviation < report.deviatoric_stress


@pytest.mark.parametrize("N", [2, 3])
def test_parts_add_up_with_tensors_in_space(N):
    """Solids, and plane strain, where the normal has fewer components than the stress."""
    mesh = block.structured_mesh(3, 3, simplices=True) if N == 2 else block.mesh(0.5)
    force = (2.0, 1.0) if N == 2 else (0, 0, 4.0)
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
    )
    problem = Problem(
        mesh,
        material,
        "clamped",
        {"right": force},
        contact="contact",
        gap=0.0005,
        order=1,
    )
    result = semismooth_newton(problem, 1e2)
    report = duality_report(result)
    assert_parts_add_up(report)
    assert report.mean_stress_deviation < 1e-9 * report.deviatoric_stress

    # The contact boundary is the plane with the largest last coordinate.
    stress = BoundaryFromVolumeCF(result.stress)
    on_contact = ds("contact")
    normal = stress[N - 1, N - 1]
    shears = [stress[axis, N - 1] for axis in range(N - 1)]
    squares = {"normal_stress": normal**2, "shear": sum(shear**2 for shear in shears)}
    for name, square in squares.items():
        expected = math.sqrt(Integrate(square * on_contact, mesh))
        assert getattr(report, name) == pytest.approx(expected, rel=1e-12)


def test_regularised_energies_approach_each_other(contact_path):
    """The penalties and the Tichonov term vanish with 1/gamma, the gap with them."""
    _, reports = contact_path
    gaps = [abs(report.gap) / abs(report.dual_energy) for report in reports]
    assert gaps[-1] < 0.1
    for name in ("contact_penalty", "tichonov"):
        assert reports[-1].parts[name] < 0.25 * max(r.parts[name] for r in reports)


def test_penalties_are_the_infeasibility(contact_path):
    """M = gamma/2 |[.]^+|^2 without shifts."""
    path, reports = contact_path
    for gamma, report in zip(path.gammas, reports, strict=True):
        half = gamma / 2
        assert report.contact_penalty == pytest.approx(
            half * report.tension**2, rel=1e-3, abs=1e-15
        )
        expected = pytest.approx(half * report.overshoot**2, rel=1e-3, abs=1e-15)
        assert report.plastic_penalty == expected


def test_contact_conditions_hold_better_along_the_path(contact_path):
    _, reports = contact_path
    for name in ("tension", "penetration", "shear"):
        numbers = [getattr(report, name) for report in reports]
        assert numbers[-1] < 0.5 * max(numbers)


def test_contact_term_is_tested_optimality(contact_path):
    """(OC1_gamma) tested with z: (z, u.n - psi) = -2 M^1 - b(z, z)/gamma."""
    path, reports = contact_path
    blocks = path.last.functional.blocks
    v = path.last.v, (blocks.B * path.last.v).Evaluate()
    b = np.dot(*(blocks.parts(part)[0].FV().NumPy() for part in v))
    expected = (
        -2 * reports[-1].contact_penalty - b / path.last.functional.weights.tichonov
    )
    assert reports[-1].contact_term == pytest.approx(expected, rel=1e-6)


@pytest.fixture(scope="module")
def elastic_reports():
    """Example (b) at gamma = 10, where q is smooth, on meshes of widths 1, 1/2 and 1/4."""
    problems = [wrench_problem(wrench.paper_mesh(n)) for n in (75, 245, 873)]
    return [duality_report(semismooth_newton(problem, 10.0)) for problem in problems]


def test_3_8_holds_in_element_means_and_at_first_order(elastic_reports):
    """Element means of q are h p - dev sigma exactly; the rest is the oscillation of q."""
    for report in elastic_reports:
        assert report.mean_stress_deviation < 1e-10 * report.deviatoric_stress
    for name in ("stress_deviation", "yield_deviation"):
        _, coarse, fine = (getattr(report, name) for report in elastic_reports)
        assert 1.6 < coarse / fine < 2.4


def test_normal_stress_is_recovered_at_first_order(elastic_reports):
    """The dual variable z against (sigma n).n of the neighbouring elements."""
    _, coarse, fine = (
        r.normal_stress_deviation / r.normal_stress for r in elastic_reports
    )
    assert 1.6 < coarse / fine < 2.4


def test_report_without_contact(contact_problem):
    free = replace(
        contact_problem, contact=None, gap=None, traction={"load": (0.0, 1.0)}
    )
    report = duality_report(semismooth_newton(free, regularisation=Coupled(1e3)))
    assert_parts_add_up(report)
    assert report.contact_term == report.tension == report.shear == 0.0


def test_report_needs_a_result_of_the_dual_method(contact_problem):
    with pytest.raises(TypeError, match="result"):
        duality_report(contact_problem)
