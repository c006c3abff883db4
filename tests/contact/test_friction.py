"""Friction on contact rows: homogeneous bodies in closed form, balance, duality, limits."""

from dataclasses import replace

import numpy as np
import pytest
from netgen.geom2d import SplineGeometry
from netgen.meshing import Element1D, Element2D, FaceDescriptor, MeshPoint, Pnt
from netgen.meshing import Mesh as RawMesh
from ngsolve import CF, IfPos, Mesh, sin, x, y
from pairs import in_turn
from scipy.linalg import eigh

from ngepc import (
    Coulomb,
    Material,
    NewtonOptions,
    Point,
    Problem,
    Roller,
    Status,
    evolve,
    primal_newton,
    semismooth_newton,
)
from ngepc.discretisation import contact_step
from ngepc.discretisation.contact_step import is_unique
from ngepc.geometries import block
from ngepc.linalg.friction import FrictionCone
from ngepc.linalg.friction_equation import FrictionEquation
from ngepc.linalg.other_forces import other_forces
from ngepc.linalg.secants import Compliance
from ngepc.results import iteration

MU, PRESSURE = 100.0, 4.0
SPRINGY = Material.kinematic(
    lame_lambda=0.0, lame_mu=MU, yield_stress=1e6, hardening=1.0
)
"""Without lateral strain: compression and shear of a block do not mix."""


def solved(problem, **choices):
    result = semismooth_newton(problem, **choices)
    assert result.status is Status.CONVERGED, result.message
    size = np.abs(result.equilibrium.contact).max(initial=1.0)
    assert np.abs(result.equilibrium.free_residual).max() < 1e-9 * size
    return result


def sheared(mesh, g, s, law, u_0):
    """A unit block on its base, pressed by PRESSURE against a plane, with the load g on top.

    The shear stress s on its sides makes u = s/mu y along the plane.
    """
    if mesh.dim == 2:
        loads = {"contact": (g[0], 0), "right": (0, s[0]), "left": (0, -s[0])}
    else:
        loads = {
            **{"contact": (*g, 0), "right": (0, 0, s[0]), "left": (0, 0, -s[0])},
            **{"back": (0, 0, s[1]), "front": (0, 0, -s[1])},
        }
    gap = -PRESSURE / (2 * MU)
    return Problem(
        mesh,
        SPRINGY,
        "clamped",
        loads,
        "contact",
        gap,
        friction=law,
        initial_displacement=u_0,
    )


PATHS = {
    2: [(3.0,), (2.5,), (0.0,), (-4.0,), (-3.5,)],
    3: [(3.0, 0.0), (3.0, 3.0), (2.5, 2.5), (-1.0, 2.0), (0.0, 0.0)],
}


@pytest.mark.parametrize(("N", "law"), in_turn([2, 3], [1.0, Coulomb(0.25)]))
def test_slip_reversal(N, law):
    """t = -F (g - mu u_0)/|g - mu u_0| where it slips, g - mu u_0 + t = 0 where it sticks."""
    F, cells = 1.0, (3, 3) if N == 2 else (2, 2, 2)
    mesh = block.structured_mesh(*cells, simplices=True)
    slipped, u_0, seen = np.zeros(N - 1), None, set()
    for g in PATHS[N]:
        trial = np.array(g) - MU * slipped
        slides = np.linalg.norm(trial) > F
        t = -trial * min(1.0, F / np.linalg.norm(trial))
        s = np.array(g) + t
        result = solved(sheared(mesh, g, s, law, u_0))
        assert np.array(result.friction_force)[: N - 1] == pytest.approx(t, abs=1e-11)
        assert result.contact_force == pytest.approx(PRESSURE, rel=1e-11)
        u = result.displacement(mesh(*([0.5] * (N - 1)), 1.0))
        assert np.array(u)[: N - 1] == pytest.approx(s / MU, abs=1e-13)
        assert result.sliding.vec.FV().NumPy().any() == slides
        gap = result.primal_energy + result.dual_energy
        assert abs(gap) <= 1e-12 * abs(result.primal_energy)
        slipped, u_0 = s / MU, result.displacement
        seen.add(bool(slides))
    assert seen == {True, False}


def wedge_mesh(slope):
    """0 < x < 1, 0 < y < 1 + slope x, with the inclined top as contact boundary."""
    shape = SplineGeometry()
    corners = [(0, 0), (1, 0), (1, 1 + slope), (0, 1)]
    p = [shape.AppendPoint(*corner) for corner in corners]
    for i, name in enumerate(["clamped", "right", "contact", "left"]):
        shape.Append(
            ["line", p[i], p[(i + 1) % 4]], bc=name, leftdomain=1, rightdomain=0
        )
    return Mesh(shape.GenerateMesh(maxh=0.3))


@pytest.mark.parametrize(
    ("coefficient", "slides"), [(0.1, True), (0.2, True), (5.0, False)]
)
def test_loaded_wedge(coefficient, slides):
    """u = (a y, b y): n . u = -d y on the top, and Coulomb's law there for a and b."""
    slope, d, load = 0.3, 0.02, np.array([5.0, 0.0])
    n = np.array([-slope, 1.0]) / np.hypot(1, slope)
    tangent = np.array([n[1], -n[0]])
    traction = MU * np.array([[n[1], 0.0], [n[0], 2 * n[1]]])  # sigma n from (a, b)
    if slides:  # t = -mu p for slip > 0, p = -n . (sigma n - load)
        row = tangent @ traction - coefficient * (n @ traction)
        a, b = np.linalg.solve([n, row], [-d, (tangent - coefficient * n) @ load])
    else:
        a, b = np.linalg.solve([n, tangent], [-d, 0.0])
    on_body = traction @ (a, b) - load
    pressure, t = -n @ on_body, tangent @ on_body
    assert pressure > 0
    assert abs(t) <= coefficient * pressure * (1 + 1e-12)
    assert (tangent @ (a, b) > 1e-3) == slides
    mesh = wedge_mesh(slope)
    loads = {"contact": tuple(load), "right": (0, MU * a), "left": (0, -MU * a)}
    problem = Problem(
        mesh,
        SPRINGY,
        "clamped",
        loads,
        "contact",
        -d * y,
        friction=Coulomb(coefficient),
    )
    result = solved(problem)
    length = np.hypot(1, slope)
    assert result.contact_force == pytest.approx(pressure * length, rel=1e-11)
    assert result.friction_force == pytest.approx(
        tuple(t * length * tangent), abs=1e-10
    )
    assert result.displacement(mesh(0.5, 0.5)) == pytest.approx(
        (a / 2, b / 2), abs=1e-13
    )


def klarbring(angle):
    """One triangle that two vertices hold; the third, at (1, 0), may touch the plane y = 0.

    Returns the stiffness of that vertex and the problem for a coefficient and a load.
    """
    B = np.array([np.cos(np.radians(angle)), -np.sin(np.radians(angle))])
    raw = RawMesh(dim=2)
    p = [raw.Add(MeshPoint(Pnt(*place, 0))) for place in ((0, 0), B, (1, 0))]
    raw.Add(FaceDescriptor(surfnr=1, domin=1, bc=1))
    raw.Add(Element2D(1, p))
    for i, name in enumerate(["clamped", "free", "contact"]):
        raw.Add(Element1D([p[i], p[(i + 1) % 3]], index=i + 1))
        raw.SetBCName(i, name)
    lame_lambda, mu, (a, b), area = 4.0, 1.0, (1.0, -B[0] / B[1]), -B[1] / 2
    metal = Material.kinematic(
        lame_lambda=4.0, lame_mu=mu, yield_stress=1e6, hardening=1.0
    )
    K = mu * (a * a + b * b) * np.eye(2) + (lame_lambda + mu) * np.outer((a, b), (a, b))
    mesh = Mesh(raw)

    def problem(mu, load):
        at, law = {Point((1, 0)): tuple(load)}, Coulomb(mu)
        touches = {"contact": "contact", "gap": 0, "friction": law}
        return Problem(mesh, metal, "clamped", at, **touches, order=1)

    return area * K, problem


def equilibria(K, mu, load):
    """Contact forces of all that Coulomb's law allows at the vertex: open, stuck, slipping."""
    found = [0.0] if np.linalg.solve(K, load)[1] < 0 else []
    found += [load[1]] if load[1] > 0 and abs(load[0]) < mu * load[1] else []
    for sign in (1, -1):
        slip, n = np.linalg.solve([[K[0, 0], sign * mu], [K[1, 0], 1]], load)
        found += [n] if n > 0 and sign * slip > 0 else []
    return found


@pytest.mark.parametrize(
    ("part", "angle", "solver"),
    [
        (0.9, 60, semismooth_newton),
        (0.9, 150, primal_newton),
        (1.1, 150, semismooth_newton),
        (1.1, 60, primal_newton),
        (1.5, 60, semismooth_newton),
        (1.5, 150, primal_newton),
    ],
)
def test_several_equilibria_are_said(angle, part, solver):
    """Klarbring's example: one equilibrium below mu = K_tt/|K_nt|, for some loads three above."""
    K, problem = klarbring(angle)
    critical, seen = K[0, 0] / abs(K[0, 1]), set()
    for pushed in (0.5, 0.95, (1 + part) / 2, 2 * part):
        for load in (
            np.array([sign * pushed * critical, 1]) * 1e-3 for sign in (1, -1)
        ):
            forces = equilibria(K, part * critical, load)
            result = solver(problem(part * critical, load))
            assert min(abs(result.contact_force - force) for force in forces) < 1e-14
            assert result.status is (
                Status.NOT_UNIQUE if len(forces) > 1 else Status.CONVERGED
            )
            seen.add(len(forces))
    assert seen == ({1} if part < 1 else {1, 3})


def test_the_condition_for_one_solution_is_an_eigenvalue():
    """d.E'Sd < d.Sd for all d, beside the dense pencil; no search finds what it excludes."""
    rng, proved = np.random.default_rng(7), []
    for m, d in [(4, 1), (6, 2), (30, 1), (25, 2)] * 5:
        half = rng.standard_normal((m * (d + 1), m * (d + 1)))
        S = half @ half.T / len(half) + np.eye(len(half))
        mu = rng.uniform(0.1, 5.0)
        cone = FrictionCone(
            np.full(m, np.inf), np.full(m, mu), np.zeros(m, dtype=bool), d
        )
        gaps = rng.standard_normal(len(S)) - 1
        forces, exact = cone(Compliance.of(S), gaps, np.zeros(len(S)))
        if not exact:
            continue
        left = gaps + S @ forces
        follows, E = cone.follows(forces, left, 1e-12), np.zeros_like(S)
        for row in range(m):
            E[m + d * row : m + d * row + d, row] = follows[row]
        largest = eigh(E.T @ S + S @ E, 2 * S, eigvals_only=True)[-1]
        unique = is_unique(
            follows, lambda x, S=S: S @ x, lambda g, S=S: np.linalg.solve(S, g)
        )
        assert unique == (largest < 1) or (0.9 < largest < 1 and not unique)
        assert not unique or other_forces(cone, S, left, forces) is None
        proved.append(unique)
    assert set(proved) == {True, False}


@pytest.mark.parametrize(
    ("cells", "order", "mu"),
    [
        ((16, 8), 1, 0.1),
        ((32, 16), 1, 0.3),
        ((3, 3, 3), 1, 0.1),
        ((16, 8), 2, 0.3),
        ((2, 2, 2), 2, 0.1),
        ((2, 2, 2), 2, 0.3),
    ],
)
def test_small_coefficients_need_no_search(cells, order, mu, monkeypatch):
    """The condition holds on every mesh, and other equilibria are not looked for."""
    monkeypatch.setattr(contact_step, "other_forces", None)
    result = solved(pressed(cells, Coulomb(mu), order=order))
    assert "Friction" not in result.message


def pressed(cells, friction, gap=-0.02, order=1):
    """A block on its base, pressed down by 0.02: it bulges against the friction of the press."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=15.0, hardening=100.0
    )
    mesh = block.structured_mesh(*cells, simplices=True)
    touches = {"contact": "contact", "gap": gap, "friction": friction}
    return Problem(mesh, material, **touches, order=order)


@pytest.mark.parametrize(
    ("friction", "cells", "order"),
    [
        (0.0, (3, 3, 3), 1),
        (2.0, (8, 4), 2),
        (2.0, (3, 3, 3), 1),
        (40.0, (8, 4), 1),
        (40.0, (2, 2, 2), 2),
        (Coulomb(0.1), (8, 4), 1),
        (Coulomb(0.1), (3, 3, 3), 1),
        (Coulomb(0.8), (8, 4), 2),
        (Coulomb(0.8), (2, 2, 2), 2),
    ],
)
def test_plastic_block(cells, friction, order):
    """Iterate, both laws on each row, J + J* = 0, at most two steps more than without friction."""
    smooth = solved(pressed(cells, None, order=order))
    result = solved(pressed(cells, friction, order=order))
    assert result.iterations <= smooth.iterations + 2
    assert (
        abs(result.primal_energy + result.dual_energy) <= 1e-11 * result.primal_energy
    )
    n, t, slip = (
        result.nodal_contact_forces,
        result.nodal_friction_forces,
        result.nodal_slip,
    )
    size, slipped = np.linalg.norm(t, axis=1), np.linalg.norm(slip, axis=1)
    coulomb = isinstance(friction, Coulomb)
    bound = friction.coefficient * n if coulomb else friction * result.rows.weights
    assert (size <= bound + 1e-10 * n.max()).all()
    moving = slipped > 1e-9
    assert size[moving] == pytest.approx(bound[moving], abs=1e-9 * n.max())
    assert (t * slip).sum(axis=1)[moving] == pytest.approx(
        (size * slipped)[moving], abs=1e-10
    )
    total = np.array(result.equilibrium.resultant(result.equilibrium.contact))
    assert total[:-1] == pytest.approx(result.friction_force[:-1], abs=1e-9)


def test_a_steep_bound_on_a_fine_mesh():
    """Where the small problem is not solved, its best iterate still teaches the next one."""
    smooth, result = solved(pressed((64, 32), None)), solved(pressed((64, 32), 40.0))
    assert result.iterations <= smooth.iterations + 1
    products = (sum(r.history.column("back_substitutions")) for r in (result, smooth))
    assert next(products) <= 2 * next(products)


def test_a_held_tangent_is_no_other_equilibrium():
    """Any friction will do where a support holds the vertex along the press: it moves nothing."""
    for support in ((0, None), Roller()):
        problem = pressed((8, 4), Coulomb(0.3))
        load = {"contact": (9.0, 0.0)}
        result = solved(replace(problem, prescribed={"left": support}, traction=load))
        assert np.abs(result.nodal_slip).min() < 1e-15


def test_zero_bound_and_zero_coefficient_are_no_friction():
    smooth, *rough = (solved(pressed((8, 4), law)) for law in (None, 0.0, Coulomb(0.0)))
    for result in rough:
        assert np.abs(result.state.u - smooth.state.u).max() < 1e-13


def test_whatever_does_not_slip_does_not_feel_the_bound():
    results = [solved(pressed((8, 4), law)) for law in (1e4, 1e6, Coulomb(50.0))]
    held = replace(pressed((8, 4), None), prescribed={"contact": (0, None)})
    for result in results:
        assert np.abs(result.state.u - solved(held).state.u).max() < 1e-12


@pytest.mark.parametrize(
    ("solver", "cells"),
    in_turn([semismooth_newton, primal_newton], [(8, 4), (3, 3, 3)]),
)
def test_what_acts_across_an_open_gap(cells, solver):
    """The right half is far from the obstacle and is pushed along it: Tresca's bound acts there."""
    gap = IfPos(x - 0.6, 1.0, -0.02)
    load = (2.0, 0.0, 0.0)[: len(cells)]
    for law in (0.5, Coulomb(100.0, limit=0.5), Coulomb(0.3)):
        problem = pressed(cells, law, gap=gap)
        result = solver(replace(problem, traction={"contact": load}))
        assert result.status.is_success
        opens = result.open_gap > 1e-6
        assert opens.sum() >= 3
        friction = np.linalg.norm(result.nodal_friction_forces, axis=1)
        slips = opens & (np.linalg.norm(result.nodal_slip, axis=1) > 1e-8)
        assert slips.sum() >= 3
        if isinstance(law, Coulomb):
            assert not friction[opens].any()
        else:
            assert friction[slips] == pytest.approx(law * result.rows.weights[slips])
            assert (friction[opens] > 0).all()
            assert abs(result.primal_energy + result.dual_energy) < 1e-11


@pytest.mark.parametrize(("cells", "mu"), in_turn([(8, 4), (3, 3, 3)], [0.3, 100.0]))
def test_a_limit_of_coulombs_law(cells, mu):
    """|t| <= min(mu n, F w), equal where it slips; with a large F it is Coulomb's law."""
    limit = 4.0
    result = solved(pressed(cells, Coulomb(mu, limit=limit)))
    n = result.nodal_contact_forces
    bound = np.minimum(mu * n, limit * result.rows.weights)
    size = np.linalg.norm(result.nodal_friction_forces, axis=1)
    slips = np.linalg.norm(result.nodal_slip, axis=1) > 1e-9
    assert (size <= bound + 1e-10 * n.max()).all()
    assert size[slips] == pytest.approx(bound[slips], abs=1e-9 * n.max())
    limited = slips & (mu * n > limit * result.rows.weights)
    assert limited.any()
    plain = solved(pressed(cells, Coulomb(0.3)))
    large = solved(pressed(cells, Coulomb(0.3, limit=1e3)))
    assert np.abs(large.state.u - plain.state.u).max() < 1e-12


@pytest.mark.parametrize("d", [1, 2])
def test_given_bounds_are_always_solved(d):
    """Convex problems: forces within bounds, no gain possible, compliances of condition 1e6."""
    rng = np.random.default_rng(5)
    for m in (2, 5, 12, 25) * 8:
        size = m * (1 + d)
        turn = np.linalg.qr(rng.standard_normal((size, size)))[0]
        S = turn * 10.0 ** rng.uniform(-6, 0, size) @ turn.T
        S = (S + S.T) / 2
        gaps = rng.standard_normal(size)
        gaps[:m] -= 0.5
        bound = 10.0 ** rng.uniform(-4, 3) * rng.uniform(0, 1, m)
        tied = np.zeros(m, dtype=bool)
        cone = FrictionCone(bound, np.full(m, np.inf), tied, d)
        forces, exact = cone(Compliance.of(S), gaps, np.zeros(size))
        assert exact
        step = (gaps + S @ forces) / np.abs(S).sum(axis=1).max()
        moved = cone.projected(forces - step) - forces
        assert np.abs(moved).max() < 1e-8 * np.abs(forces).max()


def test_tresca_has_one_equilibrium_where_the_gap_opens():
    """A block whose friction had several equilibria while it acted under pressure only."""
    nu = 0.49
    soft = Material.kinematic(
        lame_lambda=2 * nu / (1 - 2 * nu), lame_mu=1.0, yield_stress=1e6, hardening=1.0
    )
    problem = Problem(
        block.structured_mesh(4, 8, size=(1, 2.0), simplices=True),
        soft,
        "clamped",
        {"right": (3.34607831e-05, -2.48799264e-04)},
        "contact",
        3.5e-05 + 0.000222 * sin(5 * x + 4.83),
        friction=0.002961,
        body_force=(0.00279666, 0.00206727),
    )
    cold = solved(problem)
    for shift in (-0.01, -0.001, 0.01):
        far = solved(replace(problem, gap=problem.gap + shift))
        warm = solved(problem, start=far)
        assert warm.contact_force == pytest.approx(cold.contact_force, rel=1e-10)


def test_tresca_on_a_nearly_incompressible_body():
    """Newton's method on the rows alone cycles here; it stopped after one step."""
    nu = 0.499
    soft = Material.kinematic(
        lame_lambda=2 * nu / (1 - 2 * nu),
        lame_mu=1.0,
        yield_stress=1e-3,
        hardening=0.01,
    )
    problem = Problem(
        block.structured_mesh(6, 2, size=(1, 0.3), simplices=True),
        soft,
        contact="contact",
        gap=-0.0017754493315417614,
        friction=0.003339519456573893,
        body_force=(0.0006575042328209087, 0),
    )
    cold = solved(problem)
    half = solved(replace(problem, friction=0.5 * problem.friction))
    assert np.abs(solved(problem, start=half).state.u - cold.state.u).max() < 1e-11


def test_same_load_again_changes_nothing():
    """Friction keeps the bulge when the press is lifted a little, and a press at rest rests."""
    problem = pressed((8, 4), Coulomb(0.3))
    problem = replace(problem, material=replace(problem.material, yield_stress=1e3))
    first = solved(problem)
    again = solved(replace(problem, initial_displacement=first.displacement))
    assert np.abs(again.state.u - first.state.u).max() < 1e-12
    assert not again.sliding.vec.FV().NumPy().any()
    kept = solved(replace(problem, initial_displacement=first.displacement, gap=-0.019))
    fresh = solved(replace(problem, gap=-0.019))
    bulge = [
        np.abs(r.rows.tangential @ r.state.u.ravel()).max()
        for r in (first, kept, fresh)
    ]
    assert bulge[0] == pytest.approx(bulge[1], rel=0.02)
    assert bulge[2] < 0.96 * bulge[0]


def test_histories_remember_where_the_body_stuck():
    """Two steps of ``evolve`` with friction; the same load a second time changes nothing."""
    problem = pressed((6, 3), Coulomb(0.3))
    history = evolve(
        problem, [(1.0, {}), (2.0, {"gap": -0.018}), (3.0, {"gap": -0.018})]
    )
    assert history.status is Status.CONVERGED
    first, second, third = (step.fields for step in history.steps)
    start = second.problem.initial_displacement.vec.FV().NumPy()
    assert (start == first.displacement.vec.FV().NumPy()).all()
    u, again = (f.displacement.vec.FV().NumPy() for f in (second, third))
    assert np.abs(u - again).max() < 1e-12 * np.abs(u).max()


def test_turned_bodies_give_turned_solutions():
    """Cone, not box: a block turned about the press axis, with other tangents and row numbers."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=15.0, hardening=100.0
    )
    results = []
    for angle in (0.0, 0.61):
        c, s = np.cos(angle), np.sin(angle)
        mesh = block.structured_mesh(2, 3, 2, simplices=True)
        for point in mesh.ngmesh.Points():
            a, b = point.p[:2]
            point[0], point[1] = c * a - s * b, s * a + c * b
        turned = Mesh(mesh.ngmesh)
        load = {"contact": (2 * c, 2 * s, 0.0)}
        law = Coulomb(0.3)
        problem = Problem(
            turned, material, "clamped", load, "contact", -0.02, friction=law
        )
        results.append(solved(problem))
    one, two = results
    assert one.primal_energy == pytest.approx(two.primal_energy, rel=1e-10)
    fx, fy, _ = two.friction_force
    assert (c * fx + s * fy, c * fy - s * fx) == pytest.approx(
        one.friction_force[:2], abs=1e-8
    )


def wedged(angle, friction, simplices=False, order=2, cells=(4, 3)):
    """A block in a corner whose third side is pushed in; contact alone holds it, at an angle."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    mesh = block.structured_mesh(*cells, simplices=simplices)
    for point in mesh.ngmesh.Points():
        point[0], point[1] = turn @ [point[0], point[1]]
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=20.0, plastic_modulus=50
    )
    walls = {"left": 0.0, "clamped": 0.0, "right": -0.004}
    return Problem(
        Mesh(mesh.ngmesh),
        metal,
        None,
        contact=tuple(walls),
        gap=walls,
        body_force=tuple(turn @ (-5.0, -3.0)),
        friction=friction,
        order=order,
    )


@pytest.mark.parametrize(
    ("angle", "simplices"), [(1.75, False), (2.65, False), (5.2, False), (1.45, True)]
)
def test_a_wedged_block_finds_an_equilibrium(angle, simplices, monkeypatch):
    """Four forces act at two components where walls meet: rounding chose among their splits."""
    monkeypatch.setattr(iteration, "several_solutions", lambda *_: (False, ""))
    assert solved(wedged(angle, Coulomb(0.2), simplices)).iterations <= 6


def test_a_run_that_goes_on_keeps_its_count_and_its_limit(monkeypatch):
    """Where no step length lowers the energy, a run goes on from there with new compliances."""
    monkeypatch.setattr(iteration, "several_solutions", lambda *_: (False, ""))
    for angle in (0.22, 1.76, 3.41):
        seen = []
        options = NewtonOptions(max_iterations=4)
        given = {"options": options, "monitor": seen.append}
        history = semismooth_newton(wedged(angle, Coulomb(0.2)), **given).history
        numbers = [record.iteration for record in history.records]
        assert [record.iteration for record in seen] == numbers
        assert numbers == list(range(len(numbers)))
        assert len(numbers) <= 5


def test_other_equilibria_of_a_wedged_block_are_found():
    """Turned blocks end in different ones, and the search had found none of the others."""
    found = [semismooth_newton(wedged(angle, Coulomb(0.2))) for angle in (0.0, 0.4)]
    assert {result.status for result in found} == {Status.NOT_UNIQUE}
    one, other = (result.contact_force for result in found)
    assert abs(one - other) > 1e-3 * one


def test_few_rows_that_depend_on_each_other_prove_nothing():
    """States do not determine their forces: trying them all had missed equilibria, silently."""
    few = wedged(0.0, Coulomb(0.2), True, order=1, cells=(2, 1))
    result = semismooth_newton(few)
    assert result.status is Status.NOT_UNIQUE or "no proof" in result.message


@pytest.mark.parametrize(
    ("cells", "law", "order"),
    [
        ((8, 4), 4.0, 1),
        ((8, 4), Coulomb(0.3), 2),
        ((2, 2, 2), 4.0, 2),
        ((3, 3, 3), Coulomb(0.3), 1),
    ],
)
def test_primal_method_agrees(cells, law, order):
    problem = pressed(cells, law, order=order)
    one, two = solved(problem), primal_newton(problem).raise_for_status()
    size = np.abs(one.state.u).max()
    assert np.abs(one.state.u - two.state.u).max() < 1e-9 * size
    assert two.nodal_friction_forces == pytest.approx(
        one.nodal_friction_forces, abs=1e-7
    )
    assert two.primal_energy == pytest.approx(one.primal_energy, rel=1e-11)
    assert two.dual_energy == pytest.approx(-two.primal_energy, rel=1e-9)


def test_start_from_a_coarser_mesh():
    coarse, problem = solved(pressed((8, 4), 4.0)), pressed((16, 8), 4.0)
    cold, warm = solved(problem), solved(problem, start=coarse)
    assert warm.iterations <= cold.iterations
    assert warm.history.residual_norms[1] < 0.2 * cold.history.residual_norms[1]
    assert np.abs(warm.state.u - cold.state.u).max() < 1e-12


class Mine(Coulomb):
    """A law whose bound nothing would ask for."""

    def bound(self, pressure):
        return 2 * pressure


BAD = {
    "negative": (-1.0, ValueError, "friction falls to -1: values >= 0"),
    "NaN": (float("nan"), ValueError, "friction=nan: a finite number"),
    "a vector": (CF((1.0, 1.0)), ValueError, "friction has shape (2,): a scalar"),
    "a string": ("1", TypeError, "friction='1': a number or a CoefficientFunction"),
    "a law of one's own": (
        Mine(0.3),
        TypeError,
        "a subclass of Coulomb would not change",
    ),
    "a negative limit": (
        Coulomb(0.3, limit=CF(-1.0)),
        ValueError,
        "friction.limit falls to -1: values >= 0",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_laws_are_refused(name):
    law, error, message = BAD[name]
    with pytest.raises(error) as caught:
        pressed((2, 2), law)
    assert message in str(caught.value)


def test_bad_coefficients_are_refused():
    with pytest.raises(ValueError, match="coefficient=-1: a finite number >= 0"):
        Coulomb(-1)
    with pytest.raises(TypeError, match="coefficient='1': a number or"):
        Coulomb("1")
    with pytest.raises(ValueError, match="limit=-1: a finite number >= 0"):
        Coulomb(0.3, limit=-1)


def test_small_problems_of_a_solid_know_the_compliance_of_the_elastic_body(monkeypatch):
    """147 forces of Tresca's law: 159 small Newton steps, from a diagonal guess ten times more."""
    steps = []
    counted = FrictionEquation.step
    monkeypatch.setattr(
        FrictionEquation, "step", lambda *given: steps.append(1) or counted(*given)
    )
    problem = Problem(
        block.structured_mesh(3, 3, 3, simplices=True),
        Material.kinematic(lame_lambda=1e3, lame_mu=1e3, yield_stress=5, hardening=1e2),
        None,
        contact="clamped",
        gap=0,
        prescribed={"left": (0, None, None)},
        traction={"contact": (0.5, 0, -6.0)},
        friction=1.0,
    )
    solved(problem)
    assert len(steps) < 400
