"""Bounds of bodies on rollers in any direction: nothing depends on the axes."""

import math

import numpy as np
import pytest
from bodies import STEEL, curved, distorted, moved_by, tapered
from featured import two_squares
from netgen.meshing import Element1D, Element2D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as NetgenMesh
from ngsolve import Mesh, x, y

from ngepc import (
    Contact,
    NewtonOptions,
    Problem,
    Roller,
    error_bound,
    evolve,
    load_cycle,
    semismooth_newton,
)
from ngepc.bounds.rollers import by_nodes, in_components
from ngepc.geometries import block, ring

EXACT = NewtonOptions(tolerance=1e-12)
TURN = np.array([[math.sqrt(3), -1.0], [1.0, math.sqrt(3)]]) / 2
"""By 30 degrees."""
TILT = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
UPRIGHT = np.eye(2)
ROLLERS = {"left": Roller(value=1e-3), "clamped": Roller()}
HELD = {"left": (-1e-3, None), "clamped": (None, 0)}
"""The same as components of the displacement, of a body that is not turned."""


def quarter(turn=UPRIGHT, order=1, supports=ROLLERS, mesh=None, **changes):
    """A quarter of a plate with a hole on two rollers, which an obstacle presses."""
    across = turn[0, 0] * x + turn[1, 0] * y
    data = {
        "traction": {"right": tuple(turn @ [1.5, 0.3]), "left": tuple(turn @ [0, 0.2])},
        "contact": "contact",
        "gap": -2e-3 + 4e-3 * across,
        "body_force": tuple(turn @ [0.2, -0.1]),
        "kinematics": "plane strain",
        "order": order,
    }
    mesh = block.with_hole(0.2, (1.0, 1.0)) if mesh is None else mesh
    mesh = moved_by(turn, mesh)
    return Problem(mesh, STEEL, None, prescribed=supports, **{**data, **changes})


def solved(problem):
    return semismooth_newton(problem, options=EXACT).raise_for_status()


@pytest.mark.parametrize("order", [1, 2])
def test_rollers_along_axes_are_components(order):
    """Bound and stress are the same to rounding."""
    by_rollers = error_bound(solved(quarter(order=order)))
    by_components = error_bound(solved(quarter(order=order, supports=HELD)))
    assert by_rollers.total == pytest.approx(by_components.total, rel=1e-9)
    apart = np.abs(by_rollers.admissible - by_components.admissible).max()
    assert apart < 1e-7 * np.abs(by_components.admissible).max()


def test_directions_with_a_sign_are_components():
    """A direction of any length and sign, the normal, and a value that varies."""
    supports = {"left": Roller((-3.0, 0.0), 1e-3 * y), "clamped": Roller()}
    found = in_components(quarter(supports=supports)).prescribed
    assert found["clamped"] == (None, 0.0)
    given, free = found["left"]
    assert free is None
    mesh = quarter().mesh
    assert given(mesh(0.9, 0.8)) == pytest.approx(-0.8e-3)
    turned = quarter(TURN)
    assert in_components(turned) is turned


CHANGES = [
    (1, {}),
    (2, {}),
    (1, {"kinematics": "two-dimensional"}),
    (2, {"kinematics": "plane stress"}),
    (1, {"springs": {"right": 50.0}}),
    (2, {"friction": 0.05, "body_force": None}),
    (1, {"contact": None, "gap": None}),
]


@pytest.mark.parametrize(("order", "changes"), CHANGES, ids=str)
def test_a_turned_body_has_the_same_bound(order, changes):
    here = error_bound(solved(quarter(order=order, **changes)))
    there = error_bound(solved(quarter(TURN, order, **changes)))
    assert here.total > 1e-3 * here.strain_energy
    assert there.energy == pytest.approx(here.energy, rel=1e-9)
    assert there.total == pytest.approx(here.total, rel=1e-7)
    apart = np.abs(there.per_cell - here.per_cell).max()
    assert apart < 1e-6 * here.total


def test_a_load_that_varies_has_the_same_oscillation():
    """Inside the body, and on a roller, where the part along it does no work."""
    along = TURN[0, 0] * x + TURN[1, 0] * y
    up = TURN[0, 1] * x + TURN[1, 1] * y
    bounds = []
    for turn, s, t in ((UPRIGHT, x, y), (TURN, along, up)):
        columns = [[float(c) for c in column] for column in turn.T]
        pull = [3 * (s * t * a + t**3 * b) for a, b in zip(*columns, strict=True)]
        shear = [40 * t**5 * a + t**4 * b for a, b in zip(*columns, strict=True)]
        data = {"contact": None, "gap": None, "body_force": tuple(pull)}
        bounds.append(
            error_bound(solved(quarter(turn, traction={"left": tuple(shear)}, **data)))
        )
    here, there = bounds
    assert here.oscillation > 0.01 * here.total
    assert there.oscillation == pytest.approx(here.oscillation, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_quadrilaterals(order):
    here = error_bound(solved(quarter(order=order, mesh=distorted(3))))
    there = error_bound(solved(quarter(TURN, order, mesh=distorted(3))))
    assert there.total == pytest.approx(here.total, rel=1e-6)


@pytest.mark.parametrize("order", [1, 2])
def test_two_bodies(order):
    """The upper one is pressed down by a roller that moves, the lower one slides."""
    bounds = []
    for turn in (UPRIGHT, TURN):
        problem = Problem(
            moved_by(turn, two_squares()),
            STEEL,
            None,
            {"right": tuple(turn @ [0.3, 0.0])},
            prescribed={"top": Roller(value=-3e-3), "clamped": Roller()},
            springs={"side": 100.0, "right": 100.0},
            contact=Contact("above", "below"),
            order=order,
        )
        bounds.append(error_bound(solved(problem)))
    here, there = bounds
    assert there.total == pytest.approx(here.total, rel=1e-6)


def octant(turn, supports, order=1):
    """A cube on three rollers."""
    mesh = moved_by(turn, block.mesh(0.6))
    load = {"right": tuple(turn @ [1.5, 0.3, 0.2])}
    return Problem(mesh, STEEL, None, load, prescribed=supports, order=order)


LYING = {"left": Roller(value=1e-3), "front": Roller(), "clamped": Roller()}
IN_SPACE = {"left": Roller(value=1e-3), "back": Roller(), "clamped": Roller()}
AXES = {
    "left": (-1e-3, None, None),
    "back": (None, 0, None),
    "clamped": (None, None, 0),
}


def turned_in_space():
    """A rotation about the third axis, and one about the first."""
    turn = np.eye(3)
    turn[:2, :2] = TURN
    return TILT @ turn


def test_a_turned_solid_has_the_same_bound():
    """The search computes in single precision."""
    turn = turned_in_space()
    upright = error_bound(solved(octant(np.eye(3), AXES)))
    on_rollers = error_bound(solved(octant(np.eye(3), IN_SPACE)))
    turned = error_bound(solved(octant(turn, IN_SPACE)))
    assert on_rollers.total == pytest.approx(upright.total, rel=1e-9)
    assert turned.total == pytest.approx(upright.total, rel=1e-4)


def test_a_turned_solid_of_order_two():
    """The bisected copy of the mesh differs, as edges of one length are bisected by rounding."""
    upright = error_bound(solved(octant(np.eye(3), IN_SPACE, 2)))
    turned = error_bound(solved(octant(TILT, IN_SPACE, 2)))
    assert turned.energy == pytest.approx(upright.energy, rel=1e-6)
    assert turned.total == pytest.approx(upright.total, rel=0.25)


def with_image(mesh):
    """A mesh beside x = 0 together with its image on the other side, which shares nodes there."""
    points = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    on_line = np.abs(points[:, 0]) < 1e-12
    whole = NetgenMesh()
    whole.dim = 2
    own = [whole.Add(MeshPoint(Pnt(*map(float, p), 0.0))) for p in points]
    image = [
        own[k] if on_line[k] else whole.Add(MeshPoint(Pnt(-float(a), float(b), 0.0)))
        for k, (a, b) in enumerate(points)
    ]
    names = mesh.GetBoundaries()
    whole.SetMaterial(1, "body")
    whole.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    for k, name in enumerate(names):
        whole.SetBCName(k, name)
        whole.SetBCName(len(names) + k, f"image of {name}")
    for numbers, first, step in ((own, 0, 1), (image, len(names), -1)):
        for element in mesh.ngmesh.Elements2D():
            corners = [numbers[p.nr - 1] for p in element.points][::step]
            whole.Add(Element2D(1, corners))
        for segment in mesh.ngmesh.Elements1D():
            if names[segment.index - 1] != "left":
                ends = [numbers[p.nr - 1] for p in segment.points[:2]][::step]
                whole.Add(Element1D(ends, index=first + segment.index))
    return Mesh(whole)


@pytest.mark.parametrize("order", [1, 2])
def test_a_half_on_a_roller_has_half_the_bound_of_the_whole(order):
    """The stress that the search finds for the whole is symmetric up to where it stops."""
    load = TURN @ [1.5, 0.3]
    image = TURN @ [-1.5, 0.3]
    half = block.with_hole(0.2, (1.0, 1.0))
    both = moved_by(TURN, with_image(half))
    data = {"kinematics": "plane strain", "order": order}
    sides = {"right": tuple(load), "image of right": tuple(image)}
    below = {name: Roller() for name in ("clamped", "image of clamped")}
    middle = {"springs": {name: 1e-3 for name in ("right", "image of right")}}
    whole = Problem(both, STEEL, None, sides, prescribed=below, **middle, **data)
    middle = {"springs": {"right": 1e-3}}
    part = quarter(
        TURN,
        supports={"left": Roller(), "clamped": Roller()},
        mesh=half,
        traction={"right": tuple(load)},
        **{"contact": None, "gap": None, "body_force": None, **middle, **data},
    )
    whole = error_bound(solved(whole))
    part = error_bound(solved(part))
    assert whole.energy == pytest.approx(2 * part.energy, rel=1e-6)
    assert whole.total == pytest.approx(2 * part.total, rel=0.02)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("direction", [None, (0.3, 0.8)])
def test_an_affine_displacement_has_no_error(order, direction):
    """The traction of its stress on all sides; on rollers only the part across d matters."""
    A = 1e-4 * np.array([[3.0, 1.0], [-2.0, 4.0]])
    strain = (A + A.T) / 2
    stress = STEEL.lame_lambda * np.trace(A) * np.eye(2)
    stress = stress + 2 * STEEL.lame_mu * strain
    normals = {"clamped": -TURN[:, 1], "left": -TURN[:, 0]}
    normals |= {"right": TURN[:, 0], "contact": TURN[:, 1]}
    u = [float(a) * x + float(b) * y for a, b in A]
    held = {}
    for name in ("clamped", "left"):
        d = normals[name] if direction is None else np.array(direction)
        if name == "left":
            d = normals[name]
        d = d / np.linalg.norm(d)
        value = float(d[0]) * u[0] + float(d[1]) * u[1]
        held[name] = Roller(None if name == "left" else direction, value)
    loads = {name: tuple(stress @ n) for name, n in normals.items()}
    problem = Problem(
        moved_by(TURN, block.mesh(0.4, (1.0, 0.7))),
        STEEL,
        None,
        loads,
        prescribed=held,
        kinematics="two-dimensional",
        order=order,
    )
    bound = error_bound(solved(problem))
    assert np.abs(bound.total) < 1e-12 * bound.strain_energy


def test_a_side_that_is_bent_is_refused_by_name():
    """At the corner between its parts the displacement is held along their mean only."""
    mesh = block.structured_mesh(4, 4, simplices=True)
    for point in mesh.ngmesh.Points():
        point[1] = point.p[1] + 0.2 * max(point.p[0] - 0.5, 0.0)
    supports = {"clamped": Roller(), "left": Roller()}
    bent = Mesh(mesh.ngmesh)
    result = semismooth_newton(Problem(bent, STEEL, None, prescribed=supports))
    with pytest.raises(ValueError, match=r"prescribed\['clamped'\].*straight sides"):
        error_bound(result)


def test_curved_sides_have_an_estimate_only():
    mesh = curved(ring.quarter_mesh(0.5))
    name = mesh.GetBoundaries()[0]
    problem = Problem(mesh, STEEL, prescribed={name: Roller()}, clamped=None)
    with pytest.raises(ValueError, match="straight edges"):
        error_bound(semismooth_newton(problem))


def test_supports_of_nodes_are_exact():
    """Displacements of the bound keep to the rollers, forces are those across them."""
    result = solved(quarter(TURN, order=2))
    supports = by_nodes(result.discrete).supports
    rng = np.random.default_rng(1)
    u = supports.admissible(rng.normal(size=supports.free.shape))
    v = supports.kept(rng.normal(size=supports.free.shape))
    rows = result.discrete.rows.chosen(
        np.arange(len(result.discrete.rows))[result.discrete.contact.roller_part]
    )
    assert rows.normal @ u.ravel() == pytest.approx(rows.gaps, abs=1e-14)
    assert np.abs(rows.normal @ v.ravel()).max() < 1e-15
    assert supports.kept(v) == pytest.approx(v, abs=1e-15)
    basis = supports.basis(np.ones(len(u), dtype=bool))
    assert basis @ (basis.T @ u.ravel()) == pytest.approx(supports.kept(u).ravel())
    assert (basis.T @ basis - np.eye(basis.shape[1])).max() < 1e-14


def test_hexahedra():
    bounds = []
    for turn in (np.eye(3), turned_in_space()):
        mesh = moved_by(turn, tapered(2))
        load = {"right": tuple(turn @ [1.5, 0.3, 0.2])}
        problem = Problem(mesh, STEEL, None, load, prescribed=LYING, order=1)
        bounds.append(error_bound(solved(problem)))
    here, there = bounds
    assert there.total == pytest.approx(here.total, rel=0.02)


@pytest.mark.parametrize("order", [1, 2])
def test_a_body_that_contact_and_a_roller_hold(order):
    bounds = []
    for turn in (UPRIGHT, TURN):
        problem = Problem(
            moved_by(turn, block.mesh(0.25, (1.0, 1.0))),
            STEEL,
            None,
            {"contact": tuple(turn @ [0.1, -1.0]), "right": tuple(turn @ [0.0, 0.3])},
            prescribed={"left": Roller()},
            contact="clamped",
            gap=1e-3,
            order=order,
        )
        bounds.append(error_bound(solved(problem)))
    here, there = bounds
    assert there.total == pytest.approx(here.total, rel=1e-6)


def test_a_history_on_meshes_that_follow_the_bound():
    """Each step of a turned body keeps its budget, and its history starts from its own mesh."""
    problem = quarter(TURN, contact=None, gap=None, body_force=None)
    cycle = load_cycle(problem, [1, -0.5], steps=2)
    run = evolve(problem, cycle, error=0.05).raise_for_status()
    assert max(run.column("error_bound")) <= 0.05
    assert run.column("nodes")[-1] > problem.mesh.nv
    last = error_bound(run.steps[-1].solution)
    assert last.relative == pytest.approx(run.column("error_bound")[-1], rel=1e-9)
