"""The linear solver that is taken when none is given."""

from dataclasses import replace

import numpy as np
import pytest
from netgen.occ import Box, Compound, OCCGeometry
from ngsolve import Mesh, x, y
from ngsolve.meshes import MakeStructured3DMesh

from ngepc import Coulomb, Material, NewtonOptions, Problem, PyAMG, semismooth_newton
from ngepc.discretisation.points import Points
from ngepc.geometries import block
from ngepc.linalg.direct import FactorisationError
from ngepc.local import choice
from ngepc.local.choice import fastest_solver
from ngepc.local.cuts import cut_sizes, unknowns_of_cube
from ngepc.local.iterative import IterativeTangent
from ngepc.local.system import DiscreteProblem
from ngepc.studies.large import pressed


def cube(n, **data):
    mesh = block.structured_mesh(n, n, n, simplices=True)
    return replace(pressed(mesh, 100.0), **data)


def test_plane_and_small_bodies_take_factors():
    square = block.structured_mesh(60, 60, simplices=True)
    plane = pressed(block.structured_mesh(3, 3, 3, simplices=True), 100.0)
    flat = replace(plane, mesh=square, gap=-1e-3, kinematics="plane strain")
    assert semismooth_newton(flat).linear_solver == "sparsecholesky"
    assert semismooth_newton(plane).linear_solver == "sparsecholesky"


@pytest.mark.parametrize("friction", [None, 5.0, Coulomb(0.3)])
def test_large_solids_take_multigrid(friction, monkeypatch):
    """The same solution, whatever was chosen, and the result says what."""
    monkeypatch.setattr(choice, "MOST_BY_FACTORS", 500)
    monkeypatch.setattr(choice, "MOST_BY_FACTORS_TRESCA", 500)
    monkeypatch.setattr(choice, "MOST_BY_FACTORS_LARGER", 500)
    problem = cube(6, friction=friction)
    chosen = semismooth_newton(problem)
    assert chosen.linear_solver == "PyAMG"
    assert sum(chosen.history.column("linear_iterations")) > 0
    direct = semismooth_newton(problem, options=NewtonOptions(inverse="sparsecholesky"))
    assert direct.linear_solver == "sparsecholesky"
    size = np.abs(direct.state.u).max()
    assert np.abs(chosen.state.u - direct.state.u).max() < 1e-8 * size


def test_factors_take_the_place_of_multigrid_that_gives_up(monkeypatch):
    def fails(*args):
        raise FactorisationError("no")

    monkeypatch.setattr(choice, "MOST_BY_FACTORS_LARGER", 500)
    monkeypatch.setattr(IterativeTangent, "minimise", fails)
    result = semismooth_newton(cube(6))
    assert result.status.label == "converged"
    assert result.linear_solver == "sparsecholesky"


STEEL = Material.metal(
    young=1000.0, poisson=0.3, yield_stress=2.0, plastic_modulus=40.0, kind="kinematic"
)


def bar(length, cells, turn=0.0, order=2):
    """Hexahedra, cells x cells over the cross section of a bar that is turned."""

    def place(s, t, u):
        along = length * s
        return (
            along * np.cos(turn) - t * np.sin(turn),
            along * np.sin(turn) + t * np.cos(turn),
            u,
        )

    mesh = MakeStructured3DMesh(nx=length * cells, ny=cells, nz=cells, mapping=place)
    problem = Problem(mesh, STEEL, "back", {"front": (0, 0, -0.1)}, order=order)
    return DiscreteProblem(problem)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_cuts_of_a_bar_are_its_cross_sections(turn):
    """Halves and quarters of 2 x 2 x 32 cells have cuts of 5 x 5 nodes, whatever the direction."""
    body = bar(16, 2, turn)
    sizes = cut_sizes(body.points, np.full(len(body.free), 3))
    assert sizes == [75] * 7
    assert unknowns_of_cube(body) == pytest.approx(3 * 25**1.5)


def test_a_cube_is_as_large_as_itself():
    """Its cut has 3 (n + 1)^2 unknowns of 3 (n + 1)^3, where n is even."""
    body = bar(1, 6, order=1)
    every = np.full(len(body.free), 3)
    assert max(cut_sizes(body.points, every)) == 3 * 7**2
    assert unknowns_of_cube(body) == pytest.approx(body.free.sum(), rel=0.1)


def test_slender_solids_take_factors_and_cubes_of_as_many_unknowns_do_not():
    slender = bar(40, 2)
    compact = bar(1, 7)
    assert compact.free.sum() < slender.free.sum()
    assert fastest_solver(slender) == "sparsecholesky"
    assert isinstance(fastest_solver(compact), PyAMG)


def test_two_cubes_are_not_slender():
    """The first cut passes between the bodies, the others do not."""
    mesh = MakeStructured3DMesh(nx=2, ny=2, nz=2)
    both = DiscreteProblem(Problem(mesh, STEEL, "back", {"front": (0, 0, -0.1)}))
    alone = max(cut_sizes(both.points, np.full(len(both.free), 3)))
    boxes = Compound([Box((k, 0, 0), (k + 1, 1, 1)) for k in (0, 3)])
    apart = Mesh(OCCGeometry(boxes).GenerateMesh(maxh=0.5))
    points = Points(apart, both.problem.kinematics, 2)
    sizes = cut_sizes(points, np.full(points.scalar.ndof, 3))
    assert sizes[0] == 0
    assert max(sizes) > alone / 2


@pytest.mark.parametrize("forcing", [None, 0.1])
def test_thin_plates_by_multigrid(forcing):
    """Rough first solves may not lower the energy of a plate: then closer ones do."""
    mesh = MakeStructured3DMesh(
        nx=6, ny=6, nz=1, mapping=lambda s, t, u: (10 * s, 10 * t, 0.2 * u)
    )
    gap = 0.02 * ((x - 5) ** 2 + (y - 5) ** 2) - 0.05
    sides = "back|front|left|right"
    plate = Problem(mesh, STEEL, sides, contact="top", gap=gap)
    exact = semismooth_newton(plate, options=NewtonOptions(inverse="sparsecholesky"))
    found = semismooth_newton(
        plate, options=NewtonOptions(inverse=PyAMG(forcing=forcing))
    )
    assert found.status.label == "converged"
    assert found.primal_energy == pytest.approx(exact.primal_energy, rel=1e-10)
