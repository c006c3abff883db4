"""Error bounds on plane meshes with quadrilaterals."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import STEEL, distorted
from netgen.meshing import Element1D, Element2D, FaceDescriptor
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import (
    CF,
    ET,
    H1,
    L2,
    CoefficientFunction,
    Grad,
    GridFunction,
    InnerProduct,
    Integrate,
    IntegrationRule,
    Mesh,
    Trace,
    x,
    y,
)

from ngepc import (
    Hill,
    Material,
    MeanDisplacement,
    NewtonOptions,
    Overlay,
    Problem,
    Voce,
    confidence,
    contact_force_bracket,
    error_bound,
    evolve,
    goal_bound,
    load_cycle,
    primal_newton,
    semismooth_newton,
    solve_to,
    verdict,
    write_receipt,
)
from ngepc.bounds.counterpart import on_simplices
from ngepc.bounds.mapped import MappedElements
from ngepc.bounds.quadrilaterals import cut_into_triangles, diagonal_middles
from ngepc.bounds.upper_energy import elastic_energies, upper_energies
from ngepc.geometries import block
from ngepc.goals import check_receipt

LOAD = {"right": (2.0, 1.5)}
BOTH = pytest.mark.parametrize("order", [1, 2])


def plastic(mesh, order, **changes):
    """A clamped square that is pulled until a large part of it yields."""
    given = {"material": STEEL, "traction": LOAD} | changes
    return Problem(mesh, order=order, **given)


def fine_interval(problem, n=12):
    """An interval of the least energy, by triangles of order two."""
    finer = replace(problem, mesh=block.structured_mesh(n, n, simplices=True), order=2)
    bound = error_bound(semismooth_newton(finer))
    return bound.least_energy, bound.energy


def test_a_cut_mesh_is_the_same_body():
    mesh = distorted(3, mixed=True)
    made = cut_into_triangles(mesh)
    areas = np.array(Integrate(CoefficientFunction(1), mesh, element_wise=True))
    parts = np.array(Integrate(CoefficientFunction(1), made.mesh, element_wise=True))
    assert np.bincount(made.parents, parts) == pytest.approx(areas)
    assert made.mesh.GetBoundaries() == mesh.GetBoundaries()
    assert made.mesh.GetMaterials() == mesh.GetMaterials()
    for name in mesh.GetBoundaries():
        lengths = [
            Integrate(CoefficientFunction(1), m, definedon=m.Boundaries(name))
            for m in (mesh, made.mesh)
        ]
        assert lengths[0] == pytest.approx(lengths[1])


def test_the_middle_of_a_diagonal_is_found():
    random = np.random.default_rng(2)
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    corners = square + random.uniform(-0.24, 0.24, (50, 4, 2))
    turned = random.integers(0, 2, 50)
    X, Y = diagonal_middles(corners, turned).T
    shapes = np.stack([(1 - X) * (1 - Y), X * (1 - Y), X * Y, (1 - X) * Y], axis=1)
    found = np.einsum("qk,qkc->qc", shapes, corners)
    ends = [corners[i, [t, t + 2]].mean(axis=0) for i, t in enumerate(turned)]
    assert found == pytest.approx(np.array(ends), abs=1e-12)


def test_order_one_on_parallelograms_is_the_same_function_on_triangles():
    result = semismooth_newton(plastic(block.structured_mesh(3, 4), 1))
    made = on_simplices(result)
    for place in np.random.default_rng(3).uniform(0.01, 0.99, (30, 2)):
        values = [r.displacement(r.problem.mesh(*place)) for r in (result, made)]
        assert values[0] == pytest.approx(values[1], abs=1e-14)


@BOTH
def test_on_edges_the_function_is_the_same(order):
    result = semismooth_newton(plastic(distorted(3, mixed=True), order))
    made = on_simplices(result)
    edges = [e for e in result.problem.mesh.edges]
    for edge in edges:
        a, b = (np.array(result.problem.mesh[v].point) for v in edge.vertices)
        place = 0.3 * a + 0.7 * b
        values = [r.displacement(r.problem.mesh(*place)) for r in (result, made)]
        assert values[0] == pytest.approx(values[1], abs=1e-9)


@BOTH
def test_the_elastic_energy_is_bounded_from_above_and_sharply(order):
    traction = {"right": (0.2, 0.15)}
    result = semismooth_newton(plastic(distorted(4, 0.3), order, traction=traction))
    (those,) = MappedElements.of(result.state)
    found, area = elastic_energies(those)
    gradient = Grad(result.displacement)
    strain = (gradient + gradient.trans) / 2
    density = 500 * Trace(strain) ** 2 + 1000 * InnerProduct(strain, strain)
    mesh = result.problem.mesh
    exact = np.array(Integrate(density, mesh, order=40, element_wise=True))
    assert area.sum() == pytest.approx(1)
    assert (found >= exact * (1 - 1e-12)).all()
    assert (found <= exact * (1 + 1e-6)).all()


def energy_by_quadrature(result, degree):
    """The integral of phi over each element by a rule, from the formula of radial return."""
    mesh = result.problem.mesh
    rule = IntegrationRule(ET.QUAD, degree)
    gradient = Grad(result.displacement)
    places = mesh.MapToAllElements({ET.QUAD: rule, ET.TRIG: rule}, mesh.Materials(".*"))
    slopes = np.asarray(gradient(places)).reshape(mesh.ne, -1, 2, 2)
    strain = np.zeros((*slopes.shape[:2], 3, 3))
    strain[..., :2, :2] = (slopes + slopes.swapaxes(2, 3)) / 2
    trace = np.einsum("...ii", strain)
    deviator = strain - trace[..., None, None] * np.eye(3) / 3
    bulk = 1e3 + 2e3 / 3
    size = 2e3 * np.linalg.norm(deviator, axis=(2, 3))
    over = np.maximum(size - 1.25, 0.0)
    density = bulk * trace**2 / 2 + size**2 / (2 * 2e3) - over**2 / (2 * 2.1e3)
    corners = np.array([[mesh[v].point for v in e.vertices] for e in mesh.Elements()])
    X, Y = np.array(rule.points)[:, :2].T
    by_x = np.stack([Y - 1, 1 - Y, Y, -Y], axis=1)
    by_y = np.stack([X - 1, -X, X, 1 - X], axis=1)
    F = np.einsum("jpk,eki->epij", np.stack([by_x, by_y]), corners)
    return (density * np.linalg.det(F)) @ np.array(rule.weights)


@BOTH
def test_the_energy_is_bounded_from_above(order):
    result = semismooth_newton(plastic(distorted(4, 0.3), order))
    assert result.state.plastic_measure > 0.2
    bound = error_bound(result).total
    found, numbers = upper_energies(result.state, bound)
    near = energy_by_quadrature(result, 60)[numbers]
    assert (found >= near - 1e-6 * near.sum()).all()
    assert 0 <= found.sum() - near.sum() <= 0.02 * bound


@pytest.mark.parametrize(("order", "size"), [(1, 0.25), (2, 0.0), (2, 0.25)])
def test_an_affine_solution_has_no_error(order, size):
    sides = {"left": (0, None), "clamped": (None, 0)}
    problem = Problem(
        distorted(3, size),
        STEEL,
        clamped=None,
        prescribed=sides,
        traction={"right": (1.0, 0.0)},
        order=order,
    )
    result = semismooth_newton(problem)
    bound = error_bound(result)
    assert abs(bound.total) < 1e-6 * bound.strain_energy
    assert bound.energy == pytest.approx(result.primal_energy, rel=1e-6)


CASES = {
    "plain": {},
    "contact": {"contact": "contact", "gap": 3e-4},
    "pressed": {"contact": "contact", "gap": 2e-3 * (x - 0.4) ** 2 - 5e-4},
    "friction": {"contact": "contact", "gap": -1e-3, "friction": 0.3},
    "springs": {"springs": {"contact": 300.0}},
    "weight": {"body_force": (0.5, -2.0)},
    "varying weight": {"body_force": (x * y, 3 * x - y**3)},
    "initial strain": {"initial_strain": 5e-4},
    "law": {
        "material": Material.with_law(
            lame_lambda=1e3, lame_mu=1e3, law=Voce(1.2, 0.5, 300.0), hardening=50.0
        )
    },
    "two-dimensional": {"kinematics": "two-dimensional"},
}
ON_PARALLELOGRAMS = {
    "plane stress": {"kinematics": "plane stress"},
    "Hill": {"material": replace(STEEL, hill=Hill.r_values(1.8, 1.2, 2.3, angle=0.2))},
    "sub-elements": {
        "material": replace(
            STEEL, hardening=0.0, overlay=Overlay([0.5, 0.3], [1.25, 2.5])
        )
    },
}
"""Covered on parallelograms of order one only."""


@pytest.mark.parametrize(
    ("case", "order"), [(case, 1 + k % 2) for k, case in enumerate(CASES)]
)
def test_the_least_energy_is_enclosed(case, order):
    """On distorted meshes, order two with triangles between; no energy crosses a lower bound."""
    mesh = distorted(4, mixed=order == 2)
    problem = plastic(mesh, order, **CASES[case])
    lower, upper = fine_interval(problem)
    result = semismooth_newton(problem)
    bound = error_bound(result)
    assert bound.least_energy <= upper
    assert lower <= bound.energy
    assert bound.problem is result.problem
    assert bound.per_cell.sum() == pytest.approx(bound.total)
    assert len(bound.per_cell) == problem.mesh.ne
    assert bound.per_cell.min() > -2e-3 * bound.total
    assert bound.total < 2.5 * (bound.energy - lower)


@pytest.mark.parametrize("case", ON_PARALLELOGRAMS)
def test_other_laws_on_parallelograms(case):
    problem = plastic(block.structured_mesh(4, 5), 1, **ON_PARALLELOGRAMS[case])
    lower, upper = fine_interval(problem, 5)
    bound = error_bound(semismooth_newton(problem))
    assert bound.least_energy <= upper
    assert lower <= bound.energy
    assert bound.total < 1.6 * (bound.energy - lower)
    for changes in ({"order": 2}, {"mesh": distorted(3)}):
        result = semismooth_newton(replace(problem, **changes))
        with pytest.raises(ValueError, match=r"quadrilaterals: .* or parallelograms"):
            error_bound(result)


@pytest.mark.parametrize("case", ON_PARALLELOGRAMS)
def test_other_laws_are_refined_on_any_quadrilaterals(case):
    """Refinement is that of the triangles into which they are cut, of order two from the start."""
    problem = plastic(distorted(3), 2, **ON_PARALLELOGRAMS[case])
    cut = replace(problem, mesh=cut_into_triangles(problem.mesh).mesh)
    runs = [solve_to(one, 0.03) for one in (problem, cut)]
    assert all(run.reached and run.guaranteed for run in runs)
    assert runs[0].bound.energy == pytest.approx(runs[1].bound.energy, rel=1e-12)
    assert runs[0].bound.total == pytest.approx(runs[1].bound.total, rel=1e-9)


def test_histories_in_plane_stress_are_refined_on_any_quadrilaterals():
    problem = plastic(distorted(3), 2, kinematics="plane stress")
    history = evolve(problem, load_cycle(problem, [0.5, 1.0]), error=0.06)
    assert history.status.is_success
    assert max(step.record.error_bound for step in history.steps) <= 0.06
    assert all(step.record.guaranteed for step in history.steps)


@BOTH
def test_bounds_are_sharp(order):
    problem = plastic(block.structured_mesh(10, 10), order)
    lower, _ = fine_interval(problem, 20)
    bound = error_bound(semismooth_newton(problem))
    assert bound.total <= {1: 1.15, 2: 1.6}[order] * (bound.energy - lower)


def test_other_solvers_have_the_same_bound():
    problem = plastic(distorted(4), 1, contact="contact", gap=3e-4)
    bounds = [
        error_bound(solve(problem)) for solve in (semismooth_newton, primal_newton)
    ]
    assert bounds[0].total == pytest.approx(bounds[1].total, rel=1e-4)
    stopped = semismooth_newton(problem, options=NewtonOptions(max_iterations=2))
    assert not stopped.status.is_success
    assert error_bound(stopped).total > bounds[0].total
    assert error_bound(stopped).algebraic > 0


def test_goals_receipts_and_verdicts(tmp_path):
    problem = plastic(distorted(5), 2, contact="contact", gap=3e-4)
    finer = block.structured_mesh(10, 10, simplices=True)
    fine = semismooth_newton(replace(problem, mesh=finer, order=2))
    u = fine.displacement
    moved = Integrate(u[0], finer, definedon=finer.Boundaries("right"))

    result = semismooth_newton(problem)
    force = goal_bound(result, "contact_force")
    assert force.lower <= fine.contact_force <= force.upper
    mean = goal_bound(result, MeanDisplacement("right", 0))
    assert mean.lower <= moved <= mean.upper
    assert mean.percent < 12
    bracket = contact_force_bracket(result)
    assert bracket.lower <= fine.contact_force <= bracket.upper

    lower, upper = write_receipt(result, tmp_path / "receipt.npz")
    shown = check_receipt.check(tmp_path / "receipt.npz")
    assert f"({lower}, {upper})" in shown
    assert lower < fine.primal_energy < upper
    write_receipt(mean, tmp_path / "goal.npz")

    solved = solve_to(problem, 0.02)
    assert solved.reached
    assert solved.bound.least_energy <= fine.primal_energy
    assert solved.result.problem.order == 2
    limit = 1.05 * moved
    found = verdict(problem, MeanDisplacement("right", 0), at_most=limit)
    assert found.outcome == "PASS"
    assert confidence(result).startswith("Guaranteed")


def test_the_orientation_of_elements_does_not_matter():
    mesh = distorted(4)
    bounds = []
    for flip in (False, True):
        turned = NetgenMesh(dim=2)
        numbers = [turned.Add(point) for point in mesh.ngmesh.Points()]
        turned.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
        turned.SetMaterial(1, "body")
        for element in mesh.ngmesh.Elements2D():
            corners = [numbers[vertex.nr - 1] for vertex in element.vertices]
            turned.Add(Element2D(1, corners[::-1] if flip else corners))
        for element in mesh.ngmesh.Elements1D():
            ends = [numbers[vertex.nr - 1] for vertex in element.vertices]
            turned.Add(Element1D(ends, index=element.index))
        for number, name in enumerate(mesh.GetBoundaries()):
            turned.SetBCName(number, name)
        bounds.append(error_bound(semismooth_newton(plastic(Mesh(turned), 2))))
    assert bounds[0].total == pytest.approx(bounds[1].total, rel=0.01)
    assert bounds[0].energy == pytest.approx(bounds[1].energy, rel=1e-6)


def test_data_of_single_elements_are_carried():
    """A history and a stiffness with one value on each element, on both halves of it."""
    mesh = distorted(4)
    number = GridFunction(L2(mesh, order=0))
    number.vec.FV().NumPy()[:] = np.linspace(0.5, 1.5, mesh.ne)
    material = replace(STEEL, lame_mu=1e3 * number)
    strain = CF((1e-3 * number, 0, 0, 0, -1e-3 * number, 0, 0, 0, 0), dims=(3, 3))
    changes = {"material": material, "initial_plastic_strain": strain}
    result = semismooth_newton(plastic(mesh, 1, **changes))
    bound = error_bound(result)
    made = on_simplices(result)
    per_triangle = made.discrete.law.two_mu.reshape(-1, 3)
    assert per_triangle[:, 0].reshape(-1, 2) == pytest.approx(
        2e3 * np.repeat(np.linspace(0.5, 1.5, mesh.ne)[:, None], 2, axis=1)
    )
    finer = Mesh(mesh.ngmesh.Copy())
    finer.Refine()
    assert bound.energy == pytest.approx(result.primal_energy, rel=0.02)
    assert bound.least_energy < result.primal_energy


def test_what_is_not_covered_is_refused_by_name():
    mesh = distorted(3)
    pull = GridFunction(H1(mesh, order=1))
    pull.Set(1.0)
    result = semismooth_newton(plastic(mesh, 1, traction={"right": (pull, 0.0)}))
    with pytest.raises(ValueError, match="traction is made of a GridFunction"):
        error_bound(result)
    first = semismooth_newton(plastic(mesh, 1))
    second = first.problem.changed(initial_plastic_strain=first.plastic_strain)
    with pytest.raises(ValueError, match="initial_plastic_strain varies inside"):
        error_bound(semismooth_newton(second))
