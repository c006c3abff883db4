"""Obstacles that slide, roll and wear the body: histories with a given motion."""

import numpy as np
import pytest
from ngsolve import H1, GridFunction, x

from ngepc import Coulomb, Material, Problem, Schedule, evolve
from ngepc.geometries import block
from ngepc.model.obstacles import Disc

STEEL = Material.metal(
    young=1000.0, poisson=0.3, yield_stress=2.0, plastic_modulus=20.0, kind="kinematic"
)
MU = 0.3
TIMES = (0.25, 0.5, 0.75, 1.0)
PUSH = (0.002, -0.004)
"""What the obstacle moves along the body until time 1, and how far it is pushed in."""


def pressed(material=STEEL, **data):
    mesh = block.structured_mesh(4, 4, simplices=True)
    given = {"contact": "contact", "gap": 0.0, "friction": Coulomb(MU)}
    return Problem(mesh, material, **given | data)


def test_an_obstacle_that_moves_is_a_base_that_moves_the_other_way():
    """The same forces and strains; the displacements differ by the motion."""
    along, deep = PUSH

    def with_base(t):
        return {"gap": deep * t, "prescribed": {"clamped": (-along * t, 0.0)}}

    base = evolve(pressed(clamped=None), Schedule(TIMES, with_base)).raise_for_status()

    def motion(t):
        return (along * t, 0.0)

    schedule = Schedule(TIMES, lambda t: {"gap": deep * t}, obstacle_motion=motion)
    moved = evolve(pressed(), schedule).raise_for_status()
    for one, other, t in zip(moved.steps, base.steps, TIMES, strict=True):
        u, v = (
            s.fields.displacement.vec.FV()
            .NumPy()
            .reshape(2, -1)[:, : s.problem.mesh.nv]
            for s in (one, other)
        )  # at the vertices
        shifted = v + np.array([[along * t], [0.0]])
        assert np.abs(u - shifted).max() < 1e-9 * np.abs(u).max()
        slips = (s.solution.nodal_slip for s in (one, other))
        assert np.subtract(*slips) == pytest.approx(0, abs=1e-11)
        assert one.record.contact_resultant == pytest.approx(
            other.record.contact_resultant, rel=1e-8, abs=1e-9
        )
    assert max(moved.column("max_slip")) > 0
    across, down = moved.steps[-1].record.contact_resultant
    assert 0 < across <= MU * abs(down) * (1 + 1e-9)  # it drags the body along


def disc(t):
    """Where a disc above the block is at a time, pushed in at first."""
    start, way = 0.35, 0.3
    return start + way * max(t - 0.5, 0.0) / 0.5


def over_the_block(surface):
    problem = pressed(friction=Coulomb(MU))
    height = 1.0 + 2.0 - 0.01

    def changes(t):
        depth = min(t, 0.5) / 0.5
        place = (disc(t), height + 0.01 * (1 - depth))
        return {"gap": Disc(centre=place, radius=2.0).gap(problem.mesh)}

    times = tuple(np.linspace(0.1, 1.0, 10))
    run = evolve(problem, Schedule(times, changes, obstacle_motion=surface))
    run.raise_for_status()
    across, down = np.transpose(run.column("contact_resultant"))
    return across / np.abs(down)


def test_a_disc_that_slides_drags_the_body_and_one_that_rolls_does_not():
    """Sliding, all rows slip the same way; rolling, the surface rests on the body."""
    slides = over_the_block(lambda t: (disc(t) - disc(0.0), 0.0))
    rolls = over_the_block(None)
    assert slides[-1] == pytest.approx(MU, rel=0.02)
    assert rolls[-1] < 0.5 * MU
    assert abs(rolls[-1]) < 0.9 * MU


def test_a_motion_may_be_a_field():
    """Turning about a point: a vector coefficient; the same as its value where it is constant."""
    deep = PUSH[1]
    changes = {"gap": deep}

    def run(motion):
        schedule = Schedule((1.0,), lambda t: changes, obstacle_motion=motion)
        return evolve(pressed(), schedule).steps[-1].record.contact_resultant

    plain = run(lambda t: (1e-3 * t, 0.0))
    assert run(lambda t: (1e-3 * t + 0.0 * x, 0.0)) == pytest.approx(plain, rel=1e-9)


def test_wear_by_archard_on_a_uniform_pressure():
    """The gap grows by k p times the way in each step; p follows the gap that is left."""
    mu = 100.0
    soft = Material.kinematic(
        lame_lambda=0.0, lame_mu=mu, yield_stress=1e6, hardening=1.0
    )
    deep, k, way = -0.02, 2e-3, 1.0
    problem = pressed(soft, friction=None, gap=deep, order=1)
    worn = GridFunction(H1(problem.mesh, order=1))

    def wear(step):
        pressure = step.contact_pressure.vec.FV().NumPy()
        worn.vec.FV().NumPy()[:] += k * way * pressure

    schedule = Schedule((1.0, 2.0, 3.0), lambda t: {"gap": deep + worn})
    run = evolve(problem, schedule, monitor=wear).raise_for_status()
    depth, forces = 0.0, []
    for _ in range(3):
        pressure = 2 * mu * (-deep - depth)
        forces.append(pressure)
        depth += k * way * pressure
    assert run.column("contact_force") == pytest.approx(forces, rel=1e-9)


def test_what_is_refused():
    with pytest.raises(TypeError, match="obstacle_motion=3: a function of time"):
        Schedule((1.0,), lambda t: {}, obstacle_motion=3)
    schedule = Schedule((1.0,), lambda t: {}, obstacle_motion=lambda t: (0.0,))
    with pytest.raises(ValueError, match=r"obstacle_motion at time 0=\(0.0,\)"):
        evolve(pressed(), schedule)
    unknown = Schedule((1.0,), lambda t: {}, None, lambda t: (0.0, 0.0))
    with pytest.raises(ValueError, match="begin=None"):
        evolve(pressed(), unknown)
