"""Error bounds on meshes of hexahedra."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import STEEL, prisms, tapered
from ngsolve import (
    CF,
    H1,
    Grad,
    GridFunction,
    InnerProduct,
    Integrate,
    Mesh,
    Trace,
    x,
    y,
    z,
)

from ngepc import (
    Hill,
    Material,
    MeanDisplacement,
    Problem,
    Voce,
    confidence,
    contact_force_bracket,
    error_bound,
    goal_bound,
    semismooth_newton,
    solve_to,
    write_receipt,
)
from ngepc.bounds import corners
from ngepc.bounds.counterpart import on_simplices
from ngepc.bounds.hexahedra import (
    check_hexahedra,
    cut_into_tetrahedra,
    local_tetrahedra,
    of_corners,
)
from ngepc.bounds.least_flow import halves
from ngepc.bounds.mapped import MappedElements, are_parallel
from ngepc.bounds.mapping import (
    CORNERS,
    bernstein_functions,
    corner_functions,
    places_of,
)
from ngepc.bounds.simplices import FACETS
from ngepc.bounds.upper_energy import elastic_energies, upper_energies
from ngepc.geometries import block

LOAD = {"right": (2.0, 0.5, 1.0)}
BOTH = pytest.mark.parametrize("order", [1, 2])


def plastic(mesh, order, **changes):
    """A clamped cube that is pulled until a large part of it yields."""
    given = {"material": STEEL, "traction": LOAD} | changes
    return Problem(mesh, order=order, **given)


def cubes(n):
    """The unit cube in n x n x n equal ones."""
    return block.structured_mesh(n, n, n)


def volumes(mesh):
    """The volumes of the elements."""
    return np.array(Integrate(CF(1), mesh, element_wise=True))


def moved(mesh, change):
    """A mesh of hexahedra with its vertices moved by a function of position."""
    for point in mesh.ngmesh.Points():
        place = np.array([point[0], point[1], point[2]])
        for axis, value in enumerate(change(place)):
            point[axis] = value
    for element in (*mesh.ngmesh.Elements3D(), *mesh.ngmesh.Elements2D()):
        element.curved = True
    mesh.ngmesh.Update()
    return Mesh(mesh.ngmesh)


def test_a_cut_mesh_is_the_same_body():
    mesh = tapered(2)
    made = cut_into_tetrahedra(mesh)
    parts = np.bincount(made.parents, volumes(made.mesh))
    assert parts == pytest.approx(volumes(mesh))
    assert made.mesh.GetMaterials() == mesh.GetMaterials()
    for name in mesh.GetBoundaries():
        sizes = [
            Integrate(CF(1), m, definedon=m.Boundaries(name)) for m in (mesh, made.mesh)
        ]
        assert sizes[0] == pytest.approx(sizes[1])


def test_neighbours_agree_however_vertices_are_numbered():
    n = 3
    grid = np.arange((n + 1) ** 3).reshape(3 * (n + 1,))
    corners = [tuple(slice(c, n + c) for c in corner) for corner in CORNERS[3].tolist()]
    nodes = np.stack([grid[corner].ravel() for corner in corners], axis=1)
    for seed in range(5):
        numbers = np.random.default_rng(seed).permutation(grid.size)[nodes]
        local = local_tetrahedra(numbers)
        own = CORNERS[3][local]
        sixth = np.abs(np.linalg.det(own[:, :, 1:] - own[:, :, :1]))
        assert sixth == pytest.approx(1.0)  # all six volumes are a sixth
        tetrahedra = of_corners(numbers, local).reshape(-1, 4)
        faces = np.sort(tetrahedra[:, np.array(FACETS[3])], axis=2).reshape(-1, 3)
        count = np.unique(faces, axis=0, return_counts=True)[1]
        assert count.max() == 2
        assert (count == 1).sum() == 2 * 6 * n**2


def test_reference_coordinates_are_found():
    random = np.random.default_rng(4)
    corners = CORNERS[3] + random.uniform(-0.15, 0.15, (40, 8, 3))
    places = random.uniform(0, 1, (40, 3))
    points = np.einsum("nk,nki->ni", corner_functions(places), corners)
    assert places_of(points, corners) == pytest.approx(places, abs=1e-12)


@pytest.mark.parametrize(("N", "degree"), [(2, 1), (2, 2), (3, 1), (3, 3)])
def test_halves_of_a_part_have_the_same_polynomial(N, degree):
    random = np.random.default_rng(5)
    whole = random.normal(size=(1, (degree + 1) ** N, 2))
    parts = halves(whole, N, degree)
    places = random.uniform(0, 1, (6, N))
    own = bernstein_functions(places, degree)
    for k, origin in enumerate(np.ndindex(*N * (2,))):
        there = bernstein_functions((np.array(origin) + places) / 2, degree)
        assert own @ parts[k] == pytest.approx(there @ whole[0])


def test_order_one_is_the_same_function_on_faces_of_parallelepipeds():
    result = semismooth_newton(plastic(block.structured_mesh(2, 3, 2), 1))
    made = on_simplices(result)
    differences = []
    for place in np.random.default_rng(3).uniform(0.05, 0.95, (20, 3)):
        face = place.copy()
        face[1] = round(3 * place[1]) / 3
        for point in (face, place):
            values = [r.displacement(r.problem.mesh(*point)) for r in (result, made)]
            differences.append(np.abs(np.subtract(*values)).max())
    assert max(differences[0::2]) < 1e-9
    assert max(differences[1::2]) > 1e-7


def test_order_two_is_the_same_function_on_edges():
    result = semismooth_newton(plastic(tapered(2), 2))
    made = on_simplices(result)
    mesh = result.problem.mesh
    for edge in mesh.edges:
        a, b = (np.array(mesh[v].point) for v in edge.vertices)
        place = 0.3 * a + 0.7 * b
        place[:2] *= 1 - 1e-9
        values = [r.displacement(r.problem.mesh(*place)) for r in (result, made)]
        assert values[0] == pytest.approx(values[1], abs=1e-8)


def test_parallelepipeds_are_found():
    sheared = CORNERS[3] @ np.array([(1, 0, 0), (0.2, 1, 0), (0.5, 0.3, 2)]) + 7
    other = sheared.copy()
    other[6, 0] += 1e-6
    assert are_parallel(np.stack([sheared, other])).tolist() == [True, False]


def strain_of(result):
    """The strain of the displacement."""
    gradient = Grad(result.displacement)
    return (gradient + gradient.trans) / 2


@BOTH
def test_the_elastic_energy_is_bounded_from_above_and_sharply(order):
    traction = {"right": (0.2, 0.1, 0.15)}
    result = semismooth_newton(plastic(tapered(2), order, traction=traction))
    strain = strain_of(result)
    density = 500 * Trace(strain) ** 2 + 1000 * InnerProduct(strain, strain)
    mesh = result.problem.mesh
    exact = np.array(Integrate(density, mesh, order=24, element_wise=True))
    for those in MappedElements.of(result.state):
        found, volume = elastic_energies(those)
        assert (those.degree, those.bend) == (order + 1, 2)
        assert volume == pytest.approx(volumes(mesh)[those.numbers])
        assert (found >= exact[those.numbers] * (1 - 1e-12)).all()
        assert (found <= exact[those.numbers] * (1 + 1e-6)).all()


@pytest.mark.parametrize(("make", "order"), [(tapered, 2), (cubes, 1)])
def test_the_energy_is_bounded_from_above(order, make):
    result = semismooth_newton(plastic(make(2), order))
    assert result.state.plastic_measure > 0.2
    strain = strain_of(result)
    deviator = strain - Trace(strain) / 3 * CF((1, 0, 0, 0, 1, 0, 0, 0, 1), dims=(3, 3))
    size = 2e3 * InnerProduct(deviator, deviator) ** 0.5
    over = 0.5 * (size - 1.25 + ((size - 1.25) ** 2) ** 0.5)
    density = (1e3 + 2e3 / 3) * Trace(strain) ** 2 / 2
    density = density + size**2 / (2 * 2e3) - over**2 / (2 * 2.1e3)
    mesh = result.problem.mesh
    near = np.array(Integrate(density, mesh, order=24, element_wise=True))
    bound = error_bound(result).total
    found, numbers = upper_energies(result.state, bound)
    assert (found >= near[numbers] - 1e-5 * near.sum()).all()
    assert 0 <= found.sum() - near.sum() <= 0.05 * bound


@pytest.mark.parametrize(("make", "order"), [(tapered, 1), (cubes, 2), (tapered, 2)])
def test_an_affine_solution_has_no_error(order, make):
    """Tension of a block whose side 'right' is slanted: its traction is sigma n."""
    mesh = make(2)
    slope = 0.3 if make is tapered else 0.0
    sides = {
        "left": (0, None, None),
        "front": (None, 0, None),
        "clamped": (None, None, 0),
    }
    normal = np.array([1.0, 0.0, slope]) / np.hypot(1.0, slope)
    problem = Problem(
        mesh,
        STEEL,
        clamped=None,
        prescribed=sides,
        traction={"right": (2.0 * normal[0], 0.0, 0.0)},
        order=order,
    )
    result = semismooth_newton(problem)
    bound = error_bound(result)
    assert abs(bound.total) < 1e-6 * bound.strain_energy
    assert bound.energy == pytest.approx(result.primal_energy, rel=1e-6)
    assert result.state.plastic_measure == pytest.approx(volumes(mesh).sum())


CASES = {
    "plain": {},
    "elastic": {"traction": {"right": (0.2, 0.1, 0.15)}},
    "contact": {"contact": "contact", "gap": 3e-4},
    "pressed": {"contact": "contact", "gap": -1e-3 + 1e-3 * x},
    "varying weight": {"body_force": (x * y, 3 * x - y**3, z)},
    "initial strain": {"initial_strain": 5e-4},
    "law": {
        "material": Material.with_law(
            lame_lambda=1e3, lame_mu=1e3, law=Voce(1.2, 0.5, 300.0), hardening=50.0
        )
    },
    "springs along axes": {
        "springs": {"contact": (100.0, 200.0, 50.0)},
        "traction": {"right": (2 + y * z, 0.5 * y**2, 1 - z**2)},
    },
}


@cache
def fine_result(case):
    """The cube in tetrahedra of order two."""
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    return semismooth_newton(plastic(mesh, 2, **CASES[case]))


def fine_interval(case):
    """An interval of the least energy of the cube, by tetrahedra of order two."""
    bound = error_bound(fine_result(case))
    return bound.least_energy, bound.energy


@pytest.mark.parametrize(
    ("case", "order"), [(case, 1 + k % 2) for k, case in enumerate(CASES)]
)
def test_the_least_energy_is_enclosed(case, order):
    lower, upper = fine_interval(case)
    result = semismooth_newton(
        plastic(block.structured_mesh(2, 2, 2), order, **CASES[case])
    )
    bound = error_bound(result)
    assert bound.least_energy <= upper
    assert lower <= bound.energy
    assert abs(bound.energy - result.primal_energy) < 0.05 * bound.total
    assert bound.moved == 0
    assert bound.problem is result.problem
    assert bound.per_cell.sum() == pytest.approx(bound.total)
    assert len(bound.per_cell) == result.problem.mesh.ne
    assert bound.per_cell.min() >= 0
    assert bound.total < {1: 1.5, 2: 3.0}[order] * (bound.energy - lower)


@pytest.mark.parametrize("simplices", [True, False])
def test_stresses_on_eighths_of_the_tetrahedra_are_sharper(simplices, monkeypatch):
    """Half of the bound of the same displacement."""
    mesh = block.structured_mesh(2, 1, 1, simplices=simplices)
    stiff = replace(STEEL, yield_stress=1e3)
    result = semismooth_newton(plastic(mesh, 2, material=stiff))
    sharp = error_bound(result)
    monkeypatch.setattr(corners, "LARGEST", 0)
    plain = error_bound(result)
    assert sharp.energy == pytest.approx(plain.energy, rel=1e-4)
    assert sharp.total < 0.55 * plain.total
    assert sharp.least_energy > plain.least_energy
    assert len(sharp.per_cell) == mesh.ne
    assert sharp.per_cell.sum() == pytest.approx(sharp.total)


@cache
def distorted_in_tetrahedra():
    """The bound of the distorted body by tetrahedra of order two."""
    mesh = cut_into_tetrahedra(tapered(2)).mesh
    problem = plastic(mesh, 2, contact="contact", gap=3e-4)
    return error_bound(semismooth_newton(problem))


@BOTH
def test_the_least_energy_of_a_distorted_body_is_enclosed(order):
    problem = plastic(tapered(2), order, contact="contact", gap=3e-4)
    result = semismooth_newton(problem)
    bound = error_bound(result)
    fine = distorted_in_tetrahedra()
    assert bound.least_energy <= fine.energy
    assert fine.least_energy <= bound.energy
    assert bound.energy == pytest.approx(result.primal_energy, rel=0.01)


def test_friction():
    changes = {"contact": "contact", "gap": -1e-3, "friction": 0.3}
    bounds = [
        error_bound(semismooth_newton(plastic(mesh, 1, **changes)))
        for mesh in (
            block.structured_mesh(2, 2, 2),
            block.structured_mesh(3, 3, 3, simplices=True),
        )
    ]
    assert bounds[0].least_energy <= bounds[1].energy
    assert bounds[1].least_energy <= bounds[0].energy
    assert bounds[0].total < 3 * (bounds[0].energy - bounds[1].least_energy)


@BOTH
def test_obstacles_that_are_not_known_between_the_rows(order):
    """The bound is one for v, moved clear; for order two a parabola is known."""
    gap = 2e-3 * (x - 0.4) ** 2 - 5e-4
    result = semismooth_newton(
        plastic(block.structured_mesh(2, 2, 2), order, contact="contact", gap=gap)
    )
    bound = error_bound(result)
    if order == 2:
        assert bound.moved == 0
        assert bound.energy == pytest.approx(result.primal_energy, rel=0.01)
        return
    assert result.penetration > 1e-5
    assert bound.moved > 1e-5
    fine = block.structured_mesh(2, 2, 2, simplices=True)
    other = error_bound(semismooth_newton(replace(result.problem, mesh=fine, order=2)))
    assert other.least_energy <= bound.energy
    assert bound.least_energy <= other.energy


def test_goals_and_refinement(tmp_path):
    problem = plastic(block.structured_mesh(2, 2, 2), 1, **CASES["contact"])
    fine = fine_result("contact")
    u, finer = fine.displacement, fine.problem.mesh
    mean = Integrate(u[0], finer, definedon=finer.Boundaries("right"))

    result = semismooth_newton(problem)
    found = goal_bound(result, MeanDisplacement("right", 0))
    assert found.lower <= mean <= found.upper
    bracket = contact_force_bracket(result)
    assert bracket.lower <= fine.contact_force <= bracket.upper
    assert confidence(result).startswith("Guaranteed")

    solved = solve_to(problem, 0.3)
    assert solved.reached
    assert solved.bound.least_energy <= fine.primal_energy
    assert solved.result.problem.order == 2
    with pytest.raises(ValueError, match=r"mesh has hexahedra: a receipt needs tetra"):
        write_receipt(result, tmp_path / "receipt.npz")


def bent(p):
    """Faces between the vertices of this cube are not flat."""
    inside = ((p > 1e-9) & (p < 1 - 1e-9)).all()
    return p + inside * np.array([0.05, 0.02, -0.04])


def folded(p):
    """Faces stay flat, but the edge at (1, 0) is moved beyond the diagonal."""
    there = p[0] > 0.9 and p[1] < 0.1
    return np.array([0.3, 0.6, p[2]]) if there else p


def test_what_is_not_covered_is_refused_by_name():
    def refused(match, mesh, order=1, **changes):
        result = semismooth_newton(plastic(mesh, order, **changes))
        with pytest.raises(ValueError, match=match):
            error_bound(result)

    whole = cubes(2)
    refused("faces that are not flat", moved(block.structured_mesh(2, 2, 2), bent))
    with pytest.raises(ValueError, match="not convex"):
        check_hexahedra(moved(block.structured_mesh(1, 1, 1), folded))
    refused("mesh has prisms: a bound needs tetrahedra", prisms(1))
    rubbed = {"contact": "contact", "gap": -1e-3, "friction": 0.3}
    refused("friction=0.3: a bound on hexahedra of order 2", whole, 2, **rubbed)
    hill = replace(STEEL, hill=Hill.r_values(1.8, 1.2, 2.3))
    refused("hexahedra: a bound with Hill's", whole, material=hill)
    pull = GridFunction(H1(whole, order=1))
    pull.Set(1.0)
    refused("traction is made of a Grid", whole, traction={"right": (pull, 0.0, 0.0)})
    first = semismooth_newton(plastic(whole, 1))
    changes = {"initial_plastic_strain": first.plastic_strain}
    refused("initial_plastic_strain varies inside", whole, **changes)
