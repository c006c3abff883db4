"""Contact of order two is as fine as the displacement: overlaps, forces and pressures."""

from dataclasses import replace

import numpy as np
import pytest
from ngsolve import IfPos, Integrate, x, y
from pairs import in_turn

from ngepc import Material, Problem, primal_newton, semismooth_newton
from ngepc.geometries import block, ring
from ngepc.local.system import DiscreteProblem
from ngepc.model.obstacles import Disc
from ngepc.studies import overlap

STEEL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=2.0, hardening=100.0
)
BODIES = {
    "edges of triangles": lambda n: block.structured_mesh(n, n, simplices=True),
    "edges of rectangles": lambda n: block.structured_mesh(n, n),
    "triangles": lambda n: block.structured_mesh(n, n, n, simplices=True),
    "rectangles": lambda n: block.structured_mesh(n, n, n),
}


def pressed(mesh, gap, **more):
    """A block on its base, an obstacle above."""
    return Problem(mesh, STEEL, contact="contact", gap=gap, order=2, **more)


def solved(problem):
    result = semismooth_newton(problem).raise_for_status()
    certificate = result.primal_energy + result.dual_energy
    assert abs(certificate) <= 1e-11 * abs(result.primal_energy)
    return result


@pytest.mark.parametrize(("body", "friction"), in_turn(BODIES, [None, 0.3]))
def test_a_quadratic_gap_is_nowhere_violated(body, friction):
    mesh = BODIES[body](3)
    side = 0.3 * (y - 0.6) ** 2 if mesh.dim == 3 else 0.0
    gap = 0.4 * (x - 0.45) ** 2 + side - 0.01
    result = solved(pressed(mesh, gap, friction=friction))
    assert 0 < np.count_nonzero(result.pressing) < len(result.rows)
    assert result.penetration <= 1e-12


def test_order_one_overlaps_between_its_vertices():
    """The overlap is told as it is: the gap is up to h^2 / 8 gap'' below its chord."""
    mesh = block.structured_mesh(5, 5, simplices=True)
    gap = 0.4 * (x - 0.5) ** 2 - 0.02
    result = semismooth_newton(replace(pressed(mesh, gap), order=1))
    assert result.state.penetration <= 1e-13
    assert 0.1 * 0.2**2 * 0.9 < result.penetration <= 0.1 * 0.2**2 + 1e-12


@pytest.mark.parametrize(("hexahedra", "most"), [(True, 0.015), (False, 0.025)])
def test_a_sphere_on_four_by_four_cells(hexahedra, most):
    """The force on a quarter of a block; the one on the whole is known on fine meshes."""
    result = solved(overlap.sphere(4, 2, hexahedra=hexahedra))
    assert 4 * result.contact_force == pytest.approx(overlap.FORCE, rel=most)
    assert result.penetration <= 1e-4 * overlap.DEPTH


@pytest.mark.parametrize("hexahedra", [True, False])
def test_rows_are_independent_and_pressures_stable_on_all_meshes(hexahedra):
    """Each row has a node of its own: no force of the rows is without work."""
    least = [
        overlap.pressure_stability(
            DiscreteProblem(overlap.sphere(cells, 2, hexahedra=hexahedra)), 1e3
        )
        for cells in (2, 4)
    ]
    assert least[0] > 0.05
    assert least[1] == pytest.approx(least[0], rel=0.25)


def test_the_pressure_under_a_punch_has_one_hump():
    """Order one has a saw-tooth there that no refinement cures."""
    peaks = []
    for cells in (8, 16, 32):
        mesh = block.structured_mesh(cells, cells // 2, size=(4.0, 2.0), simplices=True)
        punch = Disc(centre=(2.0, 2.0 + 3.0 - 0.02), radius=3.0)
        result = solved(pressed(mesh, punch.gap(mesh)))
        place = mesh.ngmesh.Coordinates()
        on = np.unique(result.rows.corners)
        on = on[np.argsort(np.asarray(place)[on, 0])]
        pressure = result.contact_pressure.vec.FV().NumPy()[on]
        rises = np.abs(np.diff(pressure, prepend=0, append=0)).sum() / 2
        assert rises <= 1.05 * pressure.max()
        peaks.append(pressure.max())
    assert peaks[2] == pytest.approx(peaks[1], rel=0.03)


def test_a_gap_that_jumps_inside_a_facet_is_no_parabola():
    """A flat punch that ends inside a facet, far away beside it: unlimited rows press 1e3 times."""
    forces = []
    for cells in (9, 36):
        mesh = block.structured_mesh(cells, cells, simplices=True)
        gap = IfPos(x - 0.5, 1e3, -0.01)
        forces.append(solved(pressed(mesh, gap)).contact_force)
    assert forces[0] == pytest.approx(forces[1], rel=0.2)


@pytest.mark.parametrize("width", [0.4, 0.2])
def test_curved_facets_overlap_little(width):
    """A ring with curved elements, pressed from outside by 0.02 on all sides."""
    mesh = ring.mesh(width)
    mesh.Curve(2)
    result = solved(
        Problem(mesh, STEEL, clamped="inner", contact="outer", gap=-0.02, order=2)
    )
    length = Integrate(1.0, mesh, definedon=mesh.Boundaries("outer"))
    assert result.rows.weights.sum() == pytest.approx(length, rel=1e-3)
    assert result.penetration <= 0.01 * 0.02


@pytest.mark.parametrize("solver", [semismooth_newton, primal_newton])
def test_a_result_on_the_same_mesh_needs_no_step(solver):
    gap = 0.4 * (x - 0.45) ** 2 - 0.01
    problem = pressed(BODIES["edges of triangles"](4), gap)
    again = semismooth_newton(problem, start=solver(problem))
    assert again.iterations <= 1


def test_pressures_of_rows_make_the_resultant():
    gap = 0.4 * (x - 0.45) ** 2 - 0.01
    result = solved(pressed(BODIES["triangles"](3), gap))
    rows = result.rows
    assert rows.weights.sum() == pytest.approx(1.0)
    shared = rows.at_vertices(result.pressing, result.problem.mesh.nv)
    assert shared.sum() == pytest.approx(result.contact_force)
    assert result.contact_resultant[2] == pytest.approx(-result.contact_force)


@pytest.mark.parametrize(("body", "order"), in_turn(BODIES, [1, 2]))
def test_pressures_beside_clamps_integrate_to_the_force(body, order):
    """Rows at the edge of a clamp are held, but their area belongs to the boundary."""
    mesh = BODIES[body](3)
    push = (1.0,) + (0.0,) * (mesh.dim - 2) + (8.0,)
    beside = {"clamped": "clamped|left|right", "order": order, "friction": 0.2}
    result = semismooth_newton(
        replace(pressed(mesh, 0.0), body_force=push, **beside)
    ).raise_for_status()
    on_contact = {"definedon": mesh.Boundaries("contact")}
    assert Integrate(1.0, mesh, **on_contact) - result.rows.weights.sum() > 0.05
    assert result.contact_force > 0
    total = Integrate(result.contact_pressure, mesh, **on_contact)
    assert total == pytest.approx(result.contact_force, rel=1e-12)
    dragged = Integrate(result.friction_stress, mesh, **on_contact)
    size = 1e-12 * result.contact_force
    assert dragged == pytest.approx(result.friction_force, abs=size)
