"""Spikes and ribs of a gap between nodes: no overlap, and smooth gaps are left alone."""

import numpy as np
import pytest
from ngsolve import (
    BND,
    ET,
    CoefficientFunction,
    ElementId,
    GridFunction,
    IfPos,
    InnerProduct,
    SurfaceL2,
    VectorH1,
    sin,
    sqrt,
    x,
    y,
)
from ngsolve.meshes import MakeStructured2DMesh
from teams import Jacobi, run

from ngepc import (
    Coulomb,
    Direction,
    Material,
    NewtonOptions,
    Problem,
    evolve,
    gradient,
    semismooth_newton,
)
from ngepc.discretisation.facets import facet_nodes
from ngepc.discretisation.gap_records import (
    gap_records,
    nearer_between_nodes,
    scanned_gap,
)
from ngepc.discretisation.lattices import Piece, lattice_rule
from ngepc.discretisation.narrow import cleared, lattice_of
from ngepc.discretisation.sampled import hidden_overlap, what_is_unseen
from ngepc.geometries import block
from ngepc.model.obstacles import Plane, Sphere
from ngepc.model.parts import distribute

MATERIAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=1e3
)
STRONG = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1e6, hardening=1e3
)
LEVEL = 0.01
HEIGHT = 0.03
OPTIONS = NewtonOptions(inverse=Jacobi(max_iterations=3000), tolerance=1e-9)


def hat(c: CoefficientFunction, middle: float, half: float) -> CoefficientFunction:
    """1 in the middle, affine to 0 at a distance ``half``."""
    away = sqrt((c - middle) ** 2)
    return IfPos(half - away, 1 - away / half, 0.0)


def rib(c: CoefficientFunction, middle: float, half: float) -> CoefficientFunction:
    """1 within a distance ``half``, else 0."""
    return IfPos(half - sqrt((c - middle) ** 2), 1.0, 0.0)


def under(gap, *, order=1, cells=(4, 4), simplices=True, mesh=None, **more) -> Problem:
    """A block under an obstacle."""
    mesh = block.structured_mesh(*cells, simplices=simplices) if mesh is None else mesh
    given = {"material": MATERIAL} | more
    return Problem(mesh, contact="contact", gap=gap, order=order, **given)


def spike(middle=0.6, half=0.02) -> CoefficientFunction:
    """A gap that is negative at the tip of a spike."""
    return LEVEL - HEIGHT * hat(x, middle, half)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("simplices", [True, False])
@pytest.mark.parametrize(
    ("middle", "half"), [(0.6, 0.005), (0.51, 0.02), (0.63, 0.06), (0.61, 0.12)]
)
def test_the_body_clears_a_spike(order, simplices, middle, half):
    """Where no node is near it, or one sees a part, and where it fills a facet."""
    given = {"order": order, "simplices": simplices}
    result = semismooth_newton(under(spike(middle, half), **given))
    assert result.status.is_success
    assert result.penetration <= 1e-12
    assert result.contact_force > 0


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("simplices", [True, False])
def test_in_space_too(order, simplices):
    gap = LEVEL - HEIGHT * hat(x, 0.4, 0.1) * hat(y, 0.45, 0.1)
    given = {"order": order, "cells": (3, 3, 1), "simplices": simplices}
    result = semismooth_newton(under(gap, **given))
    assert result.penetration <= 1e-12
    assert result.contact_force > 0


@pytest.mark.parametrize("order", [1, 2])
def test_energies_are_above_that_of_an_aligned_mesh_and_fall(order):
    """What clears the spike is admissible: J on coarse meshes is too large, never too small."""
    gap = spike(0.6, 0.04)
    aligned = semismooth_newton(under(gap, order=2, cells=(50, 16))).primal_energy
    energies = [
        semismooth_newton(under(gap, order=order, cells=(n, n))).primal_energy
        for n in (4, 8, 16)
    ]
    assert energies == sorted(energies, reverse=True)
    assert energies[-1] > aligned > 0.1 * energies[-1]


def disc(R: float) -> CoefficientFunction:
    """The gap below a disc or a ball."""
    height = R**2 - (x - 0.4) ** 2
    return R - sqrt(IfPos(height, height, 0.0))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "gap",
    [
        disc(0.3) - LEVEL,
        disc(3.0),
        disc(0.3) + 0.3 * y,
        sin(3 * x),
        IfPos(x - 0.6, 1.0, 0.0),
        IfPos(0.6 - x, 1.0, x - 0.6),
        IfPos(0.3**2 - (x - 0.4) ** 2, disc(0.3), 10.0),
        hat(x, 0.5, 0.25),
    ],
)
def test_smooth_gaps_and_steps_are_left_alone(order, gap):
    assert not gap_records(under(gap, order=order, cells=(8, 2))).lowered.any()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("cells", [(4, 4), (4, 4, 2)])
def test_a_body_that_nothing_touches_has_no_force(order, cells):
    """The gap is positive everywhere and jumps where facets meet."""
    mesh = block.structured_mesh(*cells, simplices=True)
    gap = GridFunction(SurfaceL2(mesh, order=0))
    gap.Set(IfPos(x - 0.5, 0.1, 0.001), definedon=mesh.Boundaries("contact"))
    result = semismooth_newton(under(gap, order=order, mesh=mesh))
    assert result.contact_force == 0
    assert result.rows.gaps.min() >= 0.001 * (1 - 1e-9)


@pytest.mark.parametrize("shape", [ET.SEGM, ET.TRIG, ET.QUAD])
@pytest.mark.parametrize("degree", [1, 2])
def test_lowered_polynomials_are_below_the_gap_and_no_lower_than_it(shape, degree):
    rng = np.random.default_rng(1)
    basis = facet_nodes(shape, degree).basis(lattice_of(shape, 12))
    for _ in range(20):
        given = rng.normal(size=basis.shape[1])
        gap = basis @ given - rng.exponential(size=len(basis)) ** 3
        found = cleared(given, basis, gap)
        assert (basis @ found <= gap + 1e-12 * np.abs(gap).max()).all()
        assert (found <= given).all()
        assert (found >= np.minimum(given, gap.min()) - 1e-12).all()


@pytest.mark.parametrize("friction", [0.5, Coulomb(0.3)])
def test_with_friction(friction):
    more = {"friction": friction, "traction": {"right": (0.0, 0.2)}}
    result = semismooth_newton(under(spike(), order=2, **more))
    assert result.status.is_success
    assert result.penetration <= 1e-12


def test_a_history_whose_gap_changes():
    """An elastic body remembers nothing: the last step is that gap alone."""
    problem = under(LEVEL, material=STRONG)
    history = evolve(problem, [(1.0, {"gap": 0.005}), (2.0, {"gap": spike()})])
    alone = semismooth_newton(under(spike(), material=STRONG, mesh=problem.mesh))
    force = history.steps[-1].record.contact_force
    assert force == pytest.approx(alone.contact_force, rel=1e-9)
    assert "An obstacle stands nearer between nodes by up to 0.0" in history.message


@pytest.mark.parametrize("away", [0.0, 1e3])
def test_a_plane_that_touches_an_oblique_side_hides_nothing(away):
    """Its gap is zero but for rounding errors, which no polynomial follows."""
    c, s = np.cos(0.3), np.sin(0.3)
    mesh = MakeStructured2DMesh(
        quads=False,
        nx=8,
        ny=4,
        mapping=lambda x, y: (away + c * x - s * y, c * y + s * x),
    )
    plane = Plane((away - s, c), (s, -c))
    touched = Problem(
        mesh, MATERIAL, clamped="bottom", contact="top", gap=plane.gap(mesh)
    )
    assert abs(gap_records(touched).gap).max() < 1e-12 * (1 + away)
    assert not len(scanned_gap(touched, "top").hidden)
    assert nearer_between_nodes(touched) == ""
    assert what_is_unseen(touched) == ""


@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_match_differences(order):
    gap = spike()
    result = semismooth_newton(under(gap, order=order))
    parameters = {"sum": Direction("gap"), "factor": Direction("gap", gap)}
    found = gradient(result, "contact_force", parameters)
    step = 1e-5
    for name, change in (("sum", 1.0), ("factor", gap)):
        forces = [
            semismooth_newton(under(gap + k * step * change, order=order)).contact_force
            for k in (1, -1)
        ]
        difference = (forces[0] - forces[1]) / (2 * step)
        assert found[name] == pytest.approx(difference, rel=1e-4)
    with pytest.raises(ValueError, match="nearer between nodes"):
        gradient(result, "contact_force", {"theta": Direction("gap", 1.0 + x)})


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("simplices", [True, False])
def test_values_and_overlaps_are_those_of_a_loop_over_facets(order, simplices):
    """To the last bit for the gap, whose common parts are evaluated once for all facets."""
    mesh = block.structured_mesh(3, 3, 1, simplices=simplices)
    sphere = Sphere((0.4, 0.5, 1.3), 0.3).gap(mesh)
    problem = under(sphere, order=order, mesh=mesh)
    scan = scanned_gap(problem, "contact")
    vector = VectorH1(mesh, order=order)
    moved = GridFunction(vector)
    moved.Set((0.1 * x, 0.2 * y, 0.03 * x * y))
    u = moved.vec.FV().NumPy().reshape(3, -1).T
    deepest = 0.0
    for number in scan.hidden.tolist():
        element = ElementId(BND, number)
        for piece in Piece.all(mesh[element].type):
            rule = lattice_rule(piece, scan.count)
            points = mesh.GetTrafo(element)(rule)
            gap = sphere(points)
            on_lattice = scan.on_lattice(np.array([number]), piece)[0]
            assert (on_lattice == gap).all()
            depth = InnerProduct(moved, problem.normal)(points) - gap
            deepest = max(deepest, depth.max())
    assert deepest > 0.0
    assert hidden_overlap(problem, u) == pytest.approx(deepest, rel=1e-12)


def test_two_processes_have_the_same_energy():
    problem = under(spike(), order=2)
    whole = semismooth_newton(problem, options=OPTIONS).primal_energy

    def energy(comm: object) -> float:
        mesh = distribute(problem.mesh if comm.rank == 0 else None, comm)
        own = under(spike(), order=2, mesh=mesh)
        return semismooth_newton(own, options=OPTIONS).primal_energy

    assert run(2, energy) == pytest.approx([whole, whole], rel=1e-8)
