"""Gaps of obstacles: distances along the outer normal in closed form, motions, what never hits."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from ngsolve import CF, IfPos, InnerProduct, Integrate, Parameter, ds, sqrt, x, y, z

from ngepc import Material, Problem, outward_normal
from ngepc.checks.arguments import sample
from ngepc.geometries import block, lshape, plate, ring, wrench
from ngepc.model.obstacles import (
    Cylinder,
    Disc,
    Obstacle,
    Plane,
    SignedDistance,
    Sphere,
)

SQUARE = block.structured_mesh(8, 8)
CUBE = block.structured_mesh(4, 4, 4)
RING = ring.mesh(0.2, 1.0, 2.0)
SIDES = ("left", "right", "clamped")


@dataclass(frozen=True)
class Hollow(Obstacle):
    """All that is outside a disc or cylinder: an obstacle of one's own with a < 0."""

    inside: Disc | Cylinder

    def level(self, X, n):
        return tuple(-part for part in self.inside.level(X, n))


HIT = {
    "plane": (Plane((0.0, 1.2), (0.1, -1.0)), SQUARE),
    "disc": (Disc((0.4, 2.5), 1.4), SQUARE),
    "sphere": (Sphere((0.4, 0.5, 2.5), 1.5), CUBE),
    "cylinder": (Cylinder((0.5, 0.5, 2.5), (1.0, 0.2, 0.0), 1.5), CUBE),
    "signed distance": (SignedDistance(1.2 + 0.1 * x - y), SQUARE),
}
"""An obstacle of each kind above a body whose top it can touch everywhere."""


def samples(cf, mesh, *names):
    return sample(cf, mesh, names).ravel()


def difference(a, b, mesh, *names):
    return np.abs(samples(a - b, mesh, *names)).max()


BODIES = {
    "L-shape": (lambda: lshape.mesh(0.1), 0.75),
    "L-shape of the paper": (lambda: lshape.paper_mesh(113), 0.75),
    "wrench": (lambda: wrench.mesh(0.4), 12.0),
    "plate": (lambda: plate.quarter_mesh(0.2), None),
    "ring": (lambda: ring.mesh(0.3), None),
    "curved ring": (lambda: curved(ring.quarter_mesh(0.3)), None),
    "shell": (lambda: ring.shell_octant_mesh(0.5), None),
    "block with a hole": (lambda: block.with_hole(0.25), None),
    "hexahedra": (lambda: block.structured_mesh(2, 3, 4), 1.0),
    "tetrahedra": (lambda: block.structured_mesh(2, 3, 4, simplices=True), 1.0),
}


def curved(mesh):
    mesh.Curve(3)
    return mesh


@pytest.mark.parametrize("name", BODIES)
def test_normal_is_outward(name):
    """Divergence theorem: int n . x = N |Omega| on any mesh, part by part of the boundary."""
    build, volume = BODIES[name]
    mesh = build()
    n, X = outward_normal(mesh), CF((x, y, z)[: mesh.dim])
    measured = Integrate(CF(1.0), mesh)
    flux = Integrate(InnerProduct(n, X) * ds, mesh) / mesh.dim
    assert flux == pytest.approx(measured, rel=1e-11)
    closed = [Integrate(n[i] * ds, mesh) for i in range(mesh.dim)]
    assert closed == pytest.approx([0.0] * mesh.dim, abs=1e-10 * measured)
    if volume is not None:
        assert measured == pytest.approx(volume, rel=1e-11)


def test_normal_survives_refinement():
    mesh = lshape.mesh(0.4)
    n = outward_normal(mesh)
    for _ in range(2):
        mesh.Refine()
        assert Integrate(InnerProduct(n, CF((x, y))) * ds, mesh) == pytest.approx(
            1.5, rel=1e-12
        )


@pytest.mark.parametrize(
    ("name", "normal"), [("left", (-1, 0)), ("right", (1, 0)), ("contact", (0, 1))]
)
def test_normals_are_those_of_the_sides(name, normal):
    mesh = block.mesh(0.3, (2, 1))
    found = sample(outward_normal(mesh), mesh, [name])
    assert np.abs(found - np.array(normal)).max() < 1e-14


def test_every_obstacle_of_the_package_is_hit():
    package = {
        c for c in Obstacle.__subclasses__() if c.__module__.startswith("ngepc.")
    }
    missing = package - {type(obstacle) for obstacle, _ in HIT.values()}
    assert not missing, "add one to HIT"


@pytest.mark.parametrize("name", HIT)
def test_the_ray_ends_where_it_enters(name):
    """phi(x + psi n) = 0, and phi > 0 before; the level of a point is that with t = 0."""
    obstacle, mesh = HIT[name]
    X = CF((x, y, z)[: mesh.dim])
    n = outward_normal(mesh)
    psi = obstacle.gap(mesh)
    entered = obstacle.level(X + psi * n, n)[2]
    before = obstacle.level(X + (psi - 1e-3) * n, n)[2]
    assert np.abs(samples(entered, mesh, "contact")).max() < 1e-13
    assert samples(before, mesh, "contact").min() > 1e-4


@pytest.mark.parametrize("height", [1.3, 1.0, 0.9])
def test_plane_above_a_block(height):
    """Apart, touching and pushed in: psi is the height over the top."""
    psi = Plane((0.0, height), (0, -2)).gap(SQUARE)
    assert samples(psi, SQUARE, "contact") == pytest.approx(height - 1, abs=1e-14)


def test_inclined_plane():
    """A plane at the angle a over the top: the vertical distance, not the perpendicular one."""
    a = 0.2
    psi = Plane((0.0, 1.1), (math.sin(a), -math.cos(a))).gap(SQUARE)
    assert difference(psi, 0.1 + math.tan(a) * x, SQUARE, "contact") < 1e-14


def test_plane_behind_or_beside_is_far():
    psi = Plane((0.0, 1.3), (0, -1)).gap(SQUARE)
    for name in SIDES:
        assert samples(psi, SQUARE, name) == pytest.approx(10.0)
    assert samples(
        Plane((0, 1.3), (0, 1)).gap(SQUARE), SQUARE, "contact"
    ) == pytest.approx(10.0)


def test_far_is_ten_times_the_body_or_as_given():
    long = block.structured_mesh(2, 2, size=(3, 1))
    disc = Disc((0, -9), 1.0)
    assert samples(disc.gap(long), long, "contact") == pytest.approx(30.0)
    assert samples(disc.gap(long, far=4.5), long, "contact") == pytest.approx(4.5)


def test_far_bounds_every_gap():
    grazing = Plane((0.0, 1.1), (-1, -1e-6)).gap(SQUARE)
    values = samples(grazing, SQUARE, "contact", *SIDES)
    assert np.abs(values).max() <= 10.0
    assert np.isfinite(values).all()


def test_ball_of_the_tutorial_step_42():
    """deal.II step-42: u_z <= 0.59 - sqrt(0.36 - r^2) inside r < 0.6."""
    psi = Sphere((0.5, 0.5, 1.59), 0.6).gap(CUBE)
    r2 = (x - 0.5) ** 2 + (y - 0.5) ** 2
    under = 0.36 - r2
    formula = IfPos(under, 0.59 - sqrt(IfPos(under, under, 0.0)), 10.0)
    assert difference(psi, formula, CUBE, "contact") < 1e-14
    assert samples(psi, CUBE, "contact").min() < 0 < samples(psi, CUBE, "contact").max()


def test_disc_and_its_motion():
    """Moving the disc down by d lowers the gap by d; a Parameter moves it later."""
    down = Parameter(0.0)
    psi = Disc((0.5, 1.5), 0.5).gap(SQUARE, (0, -1 * down))
    inside = 0.25 - (x - 0.5) ** 2
    formula = 0.5 - sqrt(IfPos(inside, inside, 0.0))
    for d in (0.0, 0.1, 0.25):
        down.Set(d)
        assert difference(psi, formula - d, SQUARE, "contact") < 1e-14


def test_disc_moved_sideways():
    moved = Disc((0.5, 1.6), 0.5).gap(SQUARE, (0.1, 0.05))
    built = Disc((0.6, 1.65), 0.5).gap(SQUARE)
    assert difference(moved, built, SQUARE, "contact", *SIDES) < 1e-13


def test_ball_behind_the_surface_is_far():
    """A ball below the bottom is met by the bottom, and by no other side."""
    psi = Disc((0.5, -1.0), 0.7).gap(SQUARE)
    assert samples(psi, SQUARE, "contact", "left", "right") == pytest.approx(10.0)
    assert samples(psi, SQUARE, "clamped").min() == pytest.approx(0.3, abs=2e-2)


def test_cylinder_is_a_disc_in_every_section():
    psi = Cylinder((0.5, -7.0, 1.5), (0, 3, 0), 0.5).gap(CUBE)
    inside = 0.25 - (x - 0.5) ** 2
    formula = 0.5 - sqrt(IfPos(inside, inside, 0.0))
    assert difference(psi, formula, CUBE, "contact") < 1e-14
    assert samples(psi, CUBE, "front", "back") == pytest.approx(10.0)  # along the axis


def test_rotation_by_a_quarter_turn():
    """The gap on the right from an obstacle on the right is that on the top, turned."""
    top = Disc((0.4, 1.55), 0.6).gap(SQUARE)
    right = Disc((1.55, 0.4), 0.6).gap(SQUARE)
    assert np.sort(samples(top, SQUARE, "contact")) == pytest.approx(
        np.sort(samples(right, SQUARE, "right")), abs=1e-14
    )


@pytest.mark.parametrize("wall", [2.3, 2.0, 1.9])
def test_ring_in_a_rigid_ring(wall):
    """On the exact circle psi = R - r; on a polygon the chord lies inside by O(h^2)."""
    psi = Hollow(Disc((0, 0), wall)).gap(RING)
    chord = 2.0 - np.sqrt(samples(x * x + y * y, RING, "outer"))
    n_error = samples(psi, RING, "outer") - (wall - 2.0) - chord
    assert np.abs(n_error).max() < 2e-3
    bent = curved(ring.mesh(0.2, 1.0, 2.0))
    assert samples(
        Hollow(Disc((0, 0), wall)).gap(bent), bent, "outer"
    ) == pytest.approx(wall - 2.0, abs=1e-4)


def test_hollow_seen_from_the_inner_boundary():
    """From the hole the normal looks at the centre: the far wall is met across the hole."""
    bent = curved(ring.mesh(0.2, 1.0, 2.0))
    psi = Hollow(Disc((0, 0), 2.3)).gap(bent)
    assert samples(psi, bent, "inner") == pytest.approx(3.3, abs=1e-3)


def test_bore_around_a_block():
    psi = Hollow(Cylinder((0.5, 0.0, 0.5), (0, 1, 0), 0.8)).gap(CUBE)
    formula = sqrt(0.64 - (x - 0.5) ** 2) - 0.5
    assert difference(psi, formula, CUBE, "contact") < 1e-14


def test_signed_distance_of_a_plane_is_exact():
    normal = np.array([0.3, -1.0]) / math.hypot(0.3, 1.0)
    phi = float(normal[0]) * x + float(normal[1]) * (y - 1.2)
    psi = SignedDistance(phi).gap(SQUARE, (0.05, -0.1))
    plane = Plane((0.0, 1.2), normal).gap(SQUARE, (0.05, -0.1))
    assert difference(psi, plane, SQUARE, "contact", *SIDES) < 1e-13


def test_signed_distance_is_of_first_order():
    """The exact ray t to a disc is longer by sin(a)^2 t^2 / (2 rho cos(a)) (1 + O(t / rho)).

    Here rho is the distance to the centre and a the angle between ray and radius.
    """
    for gap in (0.1, 0.05):
        centre = (0.5, 3.0 + gap)
        dx, dy = x - centre[0], y - centre[1]
        rho = sqrt(dx * dx + dy * dy)
        first = SignedDistance(rho - 2.0).gap(SQUARE)
        t = Disc(centre, 2.0).gap(SQUARE)
        sin2, cos = dx * dx / rho**2, -dy / rho
        predicted = samples(sin2 * t * t / (2 * rho * cos), SQUARE, "contact")
        error = samples(t - first, SQUARE, "contact")
        bound = 1.5 * samples(t / rho, SQUARE, "contact")
        assert (np.abs(error - predicted) <= bound * predicted + 1e-14).all()
        assert predicted.max() > 1e-5


@pytest.mark.parametrize(
    "obstacle",
    [Disc((0.5, 1.6), 0.5), Plane((0, 1.1), (0, -1)), Hollow(Disc((0.5, 0.5), 0.9))],
)
def test_gap_serves_a_problem(obstacle):
    steel = Material(lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=1.0)
    psi = obstacle.gap(SQUARE)
    problem = Problem(SQUARE, steel, contact="contact", gap=psi)
    assert difference(problem.psi, psi, SQUARE, "contact") == 0.0


def test_obstacles_are_values():
    assert Disc((0, 0), 1) == Sphere((0.0, 0.0), 1.0)
    assert Plane((0, 0), (0, 2)).normal == (0.0, 1.0)
    assert hash(Sphere((0, 0, 0), 1)) == hash(Sphere(np.zeros(3), 1))
