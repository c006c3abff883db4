"""What the bound bounds, for results of every kind, and what it refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from ngsolve import CF, L2, GridFunction, Integrate, Mesh, VectorH1, x, y

from ngepc import (
    Coulomb,
    Coupled,
    Material,
    NewtonOptions,
    Problem,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.bounds.bound import error_bound
from ngepc.bounds.data import Effort
from ngepc.bounds.of_state import bound_data_of, bound_of_state
from ngepc.discretisation.factors import Factors
from ngepc.geometries import block, lshape
from ngepc.geometries.bisection import triangulated
from ngepc.studies.bounds import LIMITS
from ngepc.studies.examples import example

NUMBERS = re.compile(r"\d+\.?\d*(?:e[-+]\d+)?")


@pytest.mark.parametrize(
    ("name", "nodes"), [("lshape", 417), ("lshape", 1601), ("wrench", 873)]
)
def test_effectivity_on_uniform_meshes(name, nodes):
    result = semismooth_newton(example(name, nodes))
    bound = error_bound(result)
    true = result.primal_energy - LIMITS[name]
    assert true <= bound.total <= 1.35 * true


@pytest.mark.parametrize("steps", [1, 3, 5])
def test_unconverged_results_have_bounds(steps):
    """Both parts hold for iterates; the algebraic one against the discrete solution."""
    problem = example("lshape", 417)
    solved = semismooth_newton(problem)
    iterate = semismooth_newton(problem, options=NewtonOptions(max_iterations=steps))
    bound = error_bound(iterate)
    assert bound.algebraic >= bound.energy - solved.primal_energy > 0
    assert bound.total >= bound.energy - LIMITS["lshape"]
    assert bound.discretisation == pytest.approx(bound.total - bound.algebraic)


def test_converged_results_have_no_algebraic_part():
    bound = error_bound(semismooth_newton(example("lshape", 417)))
    assert abs(bound.algebraic) <= 1e-12 * bound.total
    assert bound.moved == 0


def test_a_printed_bound_is_rounded_up_and_says_whether_it_is_proved():
    bound = error_bound(semismooth_newton(example("lshape", 113)))
    total, percent = map(float, NUMBERS.findall(str(bound)))
    assert bound.total <= total <= 1.01 * bound.total
    assert 100 * bound.relative <= percent <= 101 * bound.relative
    assert str(bound).endswith("(guaranteed)")


def test_primal_and_exact_results_have_the_same_bound():
    problem = example("lshape", 417)
    one, other = (
        error_bound(semismooth_newton(problem)),
        error_bound(primal_newton(problem)),
    )
    assert other.total == pytest.approx(one.total, rel=1e-6)


def test_regularised_results_are_made_feasible():
    problem = example("lshape", 113)
    bound = error_bound(semismooth_newton(problem, regularisation=Coupled(1e4)))
    assert bound.moved > 0
    assert bound.state.penetration <= bound.state.touching_distance
    assert bound.total >= bound.energy - LIMITS["lshape"]
    assert bound.algebraic > 1e-3 * bound.total


def test_less_effort_gives_a_bound_too():
    result = semismooth_newton(example("wrench", 873))
    efforts = [
        Effort(newton=0, steps=1),
        Effort(newton=0),
        Effort(),
        Effort(newton=2, gain=1e-3),
    ]
    bound_data, totals = bound_data_of(result.discrete), []
    for bound_data.effort in efforts:
        tangent = Factors(result.discrete, "sparsecholesky")
        totals.append(bound_of_state(bound_data, result.state, tangent).total)
    assert sorted(totals, reverse=True) == totals
    assert totals[-1] >= result.primal_energy - LIMITS["wrench"]


def test_errors_of_stress_and_strain_are_within_their_bounds():
    """||sigma_h - sigma||^2 + h ||p_h - p||^2 <= 2 total, seen from a much finer solution."""
    problem = lshape_problem(lshape.paper_mesh(113))
    coarse = semismooth_newton(problem)
    fine = semismooth_newton(lshape_problem(lshape.paper_mesh(6273)))
    bound, law, points = error_bound(coarse), fine.discrete.law, fine.discrete.points
    centres = [points.at(c) for c in (x, y)]
    parent = element_at(problem.mesh, centres)
    _, stress = law.stress(fine.state.at)
    other = coarse.discrete.law.stress(coarse.state.at)[1][parent]
    mean = law.bulk * (fine.state.volume - coarse.state.volume[parent])
    p = fine.state.at.plastic_strain - coarse.state.at.plastic_strain[parent]
    elastic = mean**2 / law.bulk + ((stress - other) ** 2).sum(axis=1) / law.two_mu
    plastic = law.hardening * (p**2).sum(axis=1)
    assert 0 < points.integral(elastic + plastic) <= bound.stress**2
    e = fine.state.deviator - coarse.state.deviator[parent]
    volume = fine.state.volume - coarse.state.volume[parent]
    strain = points.integral(volume**2 / 2 + (e**2).sum(axis=1))
    assert 0 < strain <= bound.strain**2


def element_at(mesh, places):
    """Numbers of the elements that hold these places."""
    number = GridFunction(L2(mesh, order=0))
    number.vec.FV().NumPy()[:] = np.arange(mesh.ne)
    return np.ravel(number(mesh(*places))).round().astype(int)


def test_elastic_and_unloaded_bodies():
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
    )
    problem = Problem(block.mesh(0.5, (1.0, 1.0)), material)
    bound = error_bound(semismooth_newton(problem))
    assert bound.total == bound.relative == 0
    stretched = replace(problem, prescribed={"contact": (1e-4 * x, None)})
    assert error_bound(semismooth_newton(stretched)).total > 0


def test_a_solution_in_the_space_has_no_error():
    """Uniaxial stretch beyond yield: eps and sigma are constant."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
    )
    rollers = {"left": (0, None), "clamped": (None, 0), "right": (5e-3, None)}
    problem = Problem(
        block.mesh(0.3, (1.0, 1.0)), material, clamped=None, prescribed=rollers
    )
    result = semismooth_newton(problem)
    assert result.state.at.yields.all()
    bound = error_bound(result)
    assert abs(bound.total) <= 1e-10 * bound.strain_energy


def with_a_history(shear, **data):
    """A square with plastic strain and back stress of earlier steps."""
    p = CF((4e-4, shear, 0, shear, -1e-4, 0, 0, 0, -3e-4), dims=(3, 3))
    history = {"initial_plastic_strain": p, "initial_hardening": -40.0 * p}
    return Problem(block.mesh(0.3, (1.0, 1.0)), MATERIAL, order=1, **history, **data)


def test_a_history_leaves_no_gap_at_the_solution():
    """Fenchel: phi + phi* - sigma : eps vanishes at the stress of the law, p_0 in it."""
    problem = with_a_history(2e-4, traction={"contact": (0.4, 1.0)})
    result = semismooth_newton(problem)
    assert result.state.at.yields.any()
    bound = error_bound(result)
    assert abs(bound.algebraic) <= 1e-9 * bound.strain_energy


def test_a_uniform_body_with_a_history_has_no_error():
    """On rollers all is constant: the bound is rounding, whatever was left before."""
    rollers = {"left": (0, None), "clamped": (None, 0), "right": (2e-3, None)}
    result = semismooth_newton(with_a_history(0.0, clamped=None, prescribed=rollers))
    assert result.state.at.yields.all()
    bound = error_bound(result)
    assert abs(bound.total) <= 1e-10 * bound.strain_energy


@pytest.mark.parametrize("solver", [semismooth_newton, primal_newton])
def test_sliding_in_the_space_has_no_error(solver):
    """Pressed and sheared alike everywhere: F = 2 mu_2 eps_xy, slip beyond it from u_0."""
    press, shear, moduli = 1e-3, 4e-4, (1e3, 1e3)
    xx, yy, xy = (
        -moduli[0] * press,
        -(moduli[0] + 2 * moduli[1]) * press,
        moduli[1] * shear,
    )
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1e3, hardening=1e2
    )
    problem = square(
        material,
        traction={"left": (-xx, -xy), "right": (xx, xy)},
        contact="contact",
        gap=-press,
        friction=xy,
        initial_displacement=(0.01, 0.0),
    )
    bound = error_bound(solver(problem))
    slip = 0.01 - shear
    assert bound.energy == pytest.approx((xy * shear - yy * press) / 2 + xy * slip)
    assert abs(bound.total) <= 1e-10 * bound.strain_energy


def test_friction_where_the_gap_is_open_is_bounded():
    """Tresca's law acts there, too: finer meshes end within the bounds of coarser ones."""
    gap = 0.2 * (x - 0.4) ** 2 - 4e-3
    problem = square(
        contact="contact", gap=gap, friction=0.1, traction={"right": (1, 0)}
    )
    lower = []
    upper = []
    for _ in range(3):
        result = semismooth_newton(problem)
        opens = result.nodal_contact_forces == 0
        assert (np.abs(result.nodal_friction_forces[opens]) > 1e-4).any()
        bound = error_bound(result)
        lower.append(bound.least_energy)
        upper.append(bound.energy)
        problem.mesh.Refine()
        problem = replace(problem, mesh=Mesh(problem.mesh.ngmesh.Copy()))
    assert max(lower) <= min(upper)
    assert upper[2] - lower[2] < 0.3 * (upper[0] - lower[0])


def test_indicators_are_drawn_where_they_belong():
    bound = error_bound(semismooth_newton(example("lshape", 113)))
    mesh = bound.problem.mesh
    areas = Integrate(CF(1.0), mesh, element_wise=True).NumPy()
    means = Integrate(bound.indicators, mesh, element_wise=True).NumPy() / areas
    assert np.allclose(means, bound.per_cell, rtol=1e-12)


MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
)


def square(material=MATERIAL, **data):
    return Problem(block.mesh(0.5, (1.0, 1.0)), material, **data)


@pytest.mark.parametrize(
    ("word", "make"),
    [
        ("springs", lambda: square(kinematics="axisymmetric", springs={"left": 1.0})),
        ("prescribed", lambda: square(prescribed={"contact": (None, 1e-3 * x**2)})),
        ("friction", lambda: square(contact="contact", gap=0.1, friction=Coulomb(0.3))),
        ("friction", lambda: square(contact="contact", gap=0.1, friction=x**2)),
        (
            "lame_mu",
            lambda: Problem(
                block.mesh(0.5, (1.0, 1.0)), replace(MATERIAL, lame_mu=1e3 + x)
            ),
        ),
    ],
)
def test_what_is_not_covered_is_refused_by_name(word, make):
    problem = make()

    class Result:
        displacement = contact_pressure = None

    result = Result()
    result.problem = problem
    with pytest.raises(ValueError, match=word):
        error_bound(result)


@pytest.mark.parametrize("order", [1, 2])
def test_hardening_that_varies_inside_elements_is_refused_with_what_helps(order):
    given = {"initial_hardening": x, "traction": {"contact": (0, -1.0)}}
    hard = replace(MATERIAL, hardening_modulus=1e2)
    result = semismooth_newton(square(hard, order=order, **given))
    with pytest.raises(ValueError, match=r"one value on each element, as histories"):
        error_bound(result)


def test_a_mesh_is_moved_by_its_points_and_not_by_a_deformation():
    """The refusal says so; both have the same area, and the moved mesh has a bound."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    push = {"traction": {"contact": (0, -1.0)}}
    moved = GridFunction(VectorH1(mesh))
    moved.Set((0.1 * y, 0.2 * y))
    mesh.SetDeformation(moved)
    area = Integrate(CF(1), mesh)
    deformed = semismooth_newton(Problem(mesh, MATERIAL, **push))
    with pytest.raises(ValueError, match=r"points of mesh.ngmesh .* mesh.SetDeform"):
        error_bound(deformed)
    mesh.UnsetDeformation()
    for point in mesh.ngmesh.Points():
        point[0] += 0.1 * point[1]
        point[1] += 0.2 * point[1]
    result = semismooth_newton(Problem(mesh, MATERIAL, **push))
    assert Integrate(CF(1), mesh) == pytest.approx(area, rel=1e-12)
    assert result.primal_energy == pytest.approx(deformed.primal_energy, rel=0.01)
    assert error_bound(result).guaranteed


def test_parts_that_hinge_at_a_vertex_are_refused():
    mesh = triangulated(
        [((0, 0), (1, 0), (1, 1), (0, 1)), ((1, 1), (2, 1), (2, 2), (1, 2))],
        lambda a, b: "clamped" if a[0] == b[0] in (0, 2) else "free",
    )
    with pytest.raises(ValueError, match="connected by edges"):
        error_bound(
            semismooth_newton(Problem(mesh, MATERIAL, traction={"free": (1.0, 0.0)}))
        )


def test_a_result_is_needed():
    with pytest.raises(TypeError, match="result=3"):
        error_bound(3)


@pytest.mark.parametrize("n", [3, 4])
def test_bounds_of_exact_solutions_are_not_negative(n):
    """A plate that is pulled evenly: rounding errors of the cells add up to either sign."""
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=100.0
    )
    plate = Problem(
        block.structured_mesh(n, n, simplices=True),
        steel,
        None,
        prescribed={"clamped": (None, 0), "left": (0, None)},
        traction={"right": (1.0, 0)},
        kinematics="plane stress",
        order=1,
    )
    bound = error_bound(semismooth_newton(plate))
    tiny = 1e-14 * bound.strain_energy
    for error in (bound.total, bound.algebraic, bound.discretisation):
        assert 0 <= error <= tiny
