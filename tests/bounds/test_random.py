"""Random problems, and a body of two materials: the bound is never below the true error."""

import pytest
from campaigns.crossings import Crossings, finer, random_crossings
from netgen.geom2d import SplineGeometry
from ngsolve import Mesh

from ngepc import Material, Problem, semismooth_newton
from ngepc.bounds.bound import error_bound

CHOSEN = [
    (2, "order 1", 2),
    (7, "order 2", 1),
    (1, "friction", 1),
    (7, "friction, order 2", 1),
    (5, "varying loads", 1),
    (7, "solid", 1),
    (3, "springs", 1),
    (4, "springs, order 2", 1),
    (5, "springs, solid", 1),
    (8, "quadrilaterals, order 2", 1),
    (1, "hexahedra, order 2", 1),
    (2, "two bodies", 1),
    (3, "two bodies, order 2", 1),
    (2, "revolution", 1),
]
"""Seeds, kinds, and how many problems; the campaign of crossings has 200 of each kind."""


@pytest.mark.parametrize(("seed", "kind", "count"), CHOSEN)
def test_energies_of_random_problems_do_not_cross(seed, kind, count):
    for crossing in random_crossings(seed, count, 1, kind):
        assert list(crossing.failures) == [], crossing.draw
        moved = kind.endswith("order 2") or kind.startswith("two bodies")
        if (
            not moved
        ):  # parabolas and bodies that do not match are moved clear of contact
            assert abs(crossing.bound.algebraic) <= 1e-6 * crossing.bound.total


def test_the_campaign_counts_what_it_finds(tmp_path):
    work = Crossings(tmp_path, count=1, rows=("order 1", "friction"))
    work.write(work.run())
    rows = (tmp_path / "crossings.md").read_text().splitlines()[4:6]
    assert [row.split("|")[2].strip() for row in rows] == ["1", "1"]
    assert [row.split("|")[3].strip() for row in rows] == ["0", "0"]


def two_materials():
    """The square (0, 2) x (0, 1): soft on the left of x = 1, stiff on the right."""
    geometry = SplineGeometry()
    corners = [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)]
    points = [geometry.AddPoint(*corner) for corner in corners]
    sides = [
        (0, 1, 1, 0, "low"),
        (1, 2, 2, 0, "low"),
        (2, 3, 2, 0, "right"),
        (3, 4, 2, 0, "top"),
    ]
    sides += [(4, 5, 1, 0, "free"), (5, 0, 1, 0, "clamped"), (1, 4, 1, 2, "interface")]
    for a, b, left, right, name in sides:
        ends = ["line", points[a], points[b]]
        geometry.Append(ends, leftdomain=left, rightdomain=right, bc=name)
    geometry.SetMaterial(1, "soft")
    geometry.SetMaterial(2, "stiff")
    return Mesh(geometry.GenerateMesh(maxh=0.3))


def test_interfaces_inside_the_body():
    mesh = two_materials()
    moduli = mesh.MaterialCF({"soft": 1e3, "stiff": 5e3})
    material = Material.kinematic(
        lame_lambda=moduli, lame_mu=moduli, yield_stress=1.25, hardening=moduli / 10
    )
    problem = Problem(
        mesh,
        material,
        traction={"right": (0.5, 0.3)},
        contact="top",
        gap=1e-4,
        body_force=(0.0, 1.0),
        order=1,
    )
    bound = error_bound(semismooth_newton(problem))
    fine = error_bound(semismooth_newton(finer(problem, 3)))
    assert bound.state.at.yields.any()
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.total < 1.6 * (bound.energy - fine.energy + fine.total / 2)


def test_loads_inside_the_body_are_refused():
    mesh = two_materials()
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
    )
    problem = Problem(mesh, material, traction={"interface": (0.5, 0.3)})
    with pytest.raises(
        ValueError, match="traction: bounds need it on the outer boundary"
    ):
        error_bound(semismooth_newton(problem))
