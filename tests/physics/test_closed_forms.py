"""Both solvers against closed forms in 2D and 3D: shells in a rigid ring, layers, bars, cycles.

The dual method is run as ``Balanced`` with ``FullProduct`` where it reproduces homogeneous states
to the accuracy of its Tichonov term, |q| / gamma_T.  With the H^1_0 product (R2) q is zero on the
boundary of the body: one layer of elements there does not yield, an error of order h.
"""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from bodies import FLAT
from closed_forms import Ring
from netgen.csg import CSGeometry, Plane, Pnt, Vec
from netgen.geom2d import CSG2d, EdgeInfo, Solid2d
from ngsolve import CF, IfPos, InnerProduct, Integrate, Mesh, ds, x, y, z
from pairs import every_pair, in_turn
from pressed_shell import PressedShell
from scipy.optimize import brentq

from ngepc import Coupled, FullProduct, Material, Problem, Status, outward_normal
from ngepc.discretisation.spaces import plastic_dual_space
from ngepc.evolution.load_path import load_cycle
from ngepc.evolution.solver import cold_start, evolve
from ngepc.geometries import block, ring
from ngepc.methods.newton import semismooth_newton
from ngepc.primal.solver import primal_newton

STEEL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=100.0
)
METHODS = {"primal": primal_newton, "dual": lambda problem: semismooth_newton(problem)}


def solve(method, problem):
    result = METHODS[method](problem)
    assert result.status is Status.CONVERGED
    return result


def distance(u, v, mesh):
    """L2 norm of u - v relative to that of v."""
    difference = u - v
    squares = (Integrate(InnerProduct(w, w), mesh) for w in (difference, v))
    return math.sqrt(next(squares) / next(squares))


def shell_problem(N, maxh, pressure, gap=math.inf):
    """A quarter of a ring or an eighth of a shell, held by symmetry alone."""
    if N == 2:
        mesh, sides = ring.quarter_mesh(maxh), ("left", "bottom")
    else:
        mesh, sides = ring.shell_octant_mesh(maxh), ("left", "front", "bottom")
    prescribed = {
        name: tuple(0 if i == axis else None for i in range(N))
        for axis, name in enumerate(sides)
    }
    contact = {} if gap == math.inf else {"contact": "outer", "gap": gap}
    load = {"inner": -pressure * outward_normal(mesh)}
    return Problem(
        mesh,
        STEEL,
        clamped=None,
        prescribed=prescribed,
        traction=load,
        **contact,
        kinematics=FLAT[mesh.dim],
    )


SHELLS = {  # N, pressure, gap, mesh widths, bounds for the relative errors on the finer mesh
    "elastic ring": (2, 0.5, 2e-4, (0.2, 0.1), 0.004),
    "plastic ring": (2, 1.2, math.inf, (0.1, 0.05), 0.01),
    "plastic ring in a rigid one": (2, 1.2, 4e-4, (0.2, 0.1), 0.004),
    "plastic shell in a rigid one": (3, 1.6, 2e-4, (0.5, 0.25), 0.08),
}


@pytest.mark.parametrize(
    ("name", "method"),
    [
        (name, method)
        for name, (N, *_) in SHELLS.items()
        for method in METHODS
        if N == 2 or method == "dual"
    ],
)
def test_pressed_shells_are_approximated_at_second_order(name, method):
    N, pressure, gap, widths, bound = SHELLS[name]
    exact = PressedShell(material=STEEL, N=N, pressure=pressure, gap=gap)
    assert (exact.plastic_radius > 1) == ("plastic" in name)
    assert (exact.contact_pressure > 0.03) == (gap < math.inf)
    errors = []
    for maxh in widths:
        problem = shell_problem(N, maxh, pressure, gap)
        result = solve(method, problem)
        errors.append(
            distance(result.displacement, exact.displacement_vector, problem.mesh)
        )
    assert errors[1] < bound
    assert errors[1] < 0.4 * errors[0]
    if exact.contact_pressure:
        wall = Integrate(CF(1) * ds("outer"), problem.mesh)
        assert result.contact_force / wall == pytest.approx(
            exact.contact_pressure, rel=10 * bound
        )


def test_closed_form_of_the_shell_agrees_with_the_one_of_the_ring():
    """Two derivations: one for N = 2 in the stresses, one for all N in the deviator."""
    other = Ring(1e3, 1e3, 1.25, 100.0)
    for pressure in (0.4, 0.9, 1.2):
        shell = PressedShell(material=STEEL, N=2, pressure=pressure)
        assert shell.plastic_radius == pytest.approx(other.radius(pressure), rel=1e-12)
        mesh = ring.quarter_mesh(0.5)
        u = other.displacement(pressure)
        assert distance(shell.displacement_vector, u, mesh) < 1e-11


@pytest.mark.parametrize("gap", [math.inf, 2e-4])
@pytest.mark.parametrize("N", [2, 3])
def test_closed_form_of_the_shell_is_in_equilibrium(N, gap):
    """sigma_r' + (N-1) (sigma_r - sigma_t) / r = 0 and its boundary values, by differences."""
    shell = PressedShell(material=STEEL, N=N, pressure=1.3, gap=gap)
    assert 1.05 < shell.plastic_radius < 1.9
    k, mu, h = math.sqrt((N - 1) / N), 1e3, 1e-5

    def stresses(r):
        slope = float(shell.displacement(r + h) - shell.displacement(r - h)) / (2 * h)
        hoop = float(shell.displacement(r)) / r
        t = 2 * mu * (k * (slope - hoop) + float(shell.plastic_strain(r)))
        radial = (1e3 + 2 * mu / N) * (slope + (N - 1) * hoop) + k * t
        return radial, t, t / k

    for r in (1.02, 0.5 * (1 + shell.plastic_radius), 0.5 * (shell.plastic_radius + 2)):
        slope = (stresses(r + 1e-3)[0] - stresses(r - 1e-3)[0]) / 2e-3
        assert slope == pytest.approx(-(N - 1) * stresses(r)[2] / r, rel=1e-4)
        flow = 1.25 + 100.0 * float(shell.plastic_strain(r))
        assert abs(stresses(r)[1]) < flow * (1 + 1e-6)
        assert r > shell.plastic_radius or abs(stresses(r)[1]) > flow * (1 - 1e-6)
    assert stresses(1 + 2 * h)[0] == pytest.approx(-1.3, rel=1e-3)
    assert stresses(2 - 2 * h)[0] == pytest.approx(-shell.contact_pressure, abs=1e-3)
    assert float(shell.displacement(2.0)) <= gap


def test_shells_that_yield_throughout_are_refused():
    with pytest.raises(ValueError, match="the whole shell yields"):
        PressedShell(material=STEEL, N=2, pressure=5.0)
    with pytest.raises(ValueError, match="N=4"):
        PressedShell(material=STEEL, N=4, pressure=1.0)


LAYERS = {
    "soft": {
        "lame_lambda": 1e3,
        "lame_mu": 1e3,
        "yield_stress": 1.25,
        "hardening": 100.0,
    },
    "hard": {
        "lame_lambda": 500.0,
        "lame_mu": 3e3,
        "yield_stress": 8.0,
        "hardening": 400.0,
    },
}


def layered_column(N, maxh):
    """Soft below hard, each half of the height 1, with an interface between them."""
    if N == 3:
        half = Plane(Pnt(0, 0, 0.5), Vec(0, 0, 1)).bc("interface")
        bottom = Plane(Pnt(0, 0, 0), Vec(0, 0, -1)).bc("clamped")
        top = Plane(Pnt(0, 0, 1), Vec(0, 0, 1)).bc("contact")
        sides = None
        for axis, n in (
            ("left", (-1, 0)),
            ("right", (1, 0)),
            ("front", (0, -1)),
            ("back", (0, 1)),
        ):
            at = Pnt(*(0.5 * max(c, 0) for c in n), 0)
            plane = Plane(at, Vec(*n, 0)).bc(axis)
            sides = plane if sides is None else sides * plane
        geometry = CSGeometry()
        geometry.Add((sides * bottom * half).mat("soft"))
        geometry.Add((sides * top - half).mat("hard"))
        return Mesh(geometry.GenerateMesh(maxh=maxh))
    geometry = CSG2d()
    names = {"soft": ("clamped", "interface"), "hard": ("interface", "contact")}
    for low, (name, (bottom, top)) in zip((0.0, 0.5), names.items(), strict=True):
        corners = ((0, low), (1, low), (1, low + 0.5), (0, low + 0.5))
        edges = zip(corners, (bottom, "right", top, "left"), strict=True)
        outline = [item for at, edge in edges for item in (at, EdgeInfo(bc=edge))]
        geometry.Add(Solid2d(outline, mat=name))
    return Mesh(geometry.GenerateMesh(maxh=maxh))


def uniaxial(law, N, e):
    """(stress, plastic strain) along the column at the strain e < 0, nothing moves sideways."""
    k, two_mu = math.sqrt((N - 1) / N), 2 * law["lame_mu"]
    p = max(two_mu * k * abs(e) - law["yield_stress"], 0.0) / (
        two_mu + law["hardening"]
    )
    bulk = law["lame_lambda"] + two_mu / N
    return bulk * e + k * (two_mu * k * e + two_mu * p), p


def layered_problem(N, maxh, push):
    mesh = layered_column(N, maxh)
    data = {
        name: mesh.MaterialCF({m: LAYERS[m][name] for m in LAYERS})
        for name in LAYERS["soft"]
    }
    walls = {"left|right": (0, *(None,) * (N - 1))}
    if N == 3:
        walls["front|back"] = (None, 0, None)
    return Problem(
        mesh,
        Material(**data),
        contact="contact",
        gap=-push,
        prescribed=walls,
        kinematics=FLAT[mesh.dim],
    )


def layered_solution(N, push):
    """(strain of the soft layer, of the hard one, pressure): equal stresses, given shortening."""
    soft, hard = LAYERS["soft"], LAYERS["hard"]

    def mismatch(e):
        return uniaxial(soft, N, e)[0] - uniaxial(hard, N, -2 * push - e)[0]

    e = brentq(mismatch, -2 * push, 0.0, xtol=1e-17)
    return e, -2 * push - e, -uniaxial(soft, N, e)[0]


@pytest.mark.parametrize("N", [2, 3])
def test_layers_of_two_materials_under_an_obstacle(N):
    """The soft layer yields, the hard one does not; the primal method is exact."""
    push = 0.002
    below, above, pressure = layered_solution(N, push)
    assert uniaxial(LAYERS["soft"], N, below)[1] > 1e-4
    assert uniaxial(LAYERS["hard"], N, above)[1] == 0.0
    height = (x, y, z)[N - 1]
    lift = IfPos(height - 0.5, 0.5 * below + above * (height - 0.5), below * height)
    exact = CF((*(0.0,) * (N - 1), lift))
    problem = layered_problem(N, 0.2 if N == 2 else 0.5, push)
    primal, dual = (solve(method, problem) for method in METHODS)
    area = Integrate(CF(1) * ds("contact"), problem.mesh)
    assert distance(primal.displacement, exact, problem.mesh) < 1e-9
    assert primal.contact_force == pytest.approx(pressure * area, rel=1e-9)
    assert distance(dual.displacement, exact, problem.mesh) < 1e-12
    assert dual.contact_force == pytest.approx(pressure * area, rel=1e-9)


def test_q_is_free_on_interfaces_between_materials():
    """q = 0 of (R2) is a condition on the boundary of the body."""
    problem = layered_problem(2, 0.2, 0.001)
    free = plastic_dual_space(problem).components[0].FreeDofs()
    inside = problem.mesh.Boundaries("interface").Elements()
    vertices = {v.nr for element in inside for v in element.vertices}
    held = [v for v in vertices if not free[v]]
    assert len(vertices) > 5
    assert len(held) == 2


def stretched_bar(N, maxh, stretch):
    """A bar on rollers, its right end moved by ``stretch``: uniaxial stress."""
    mesh = block.mesh(maxh, (1.0,) * N)
    sides = ("left", "clamped") if N == 2 else ("left", "front", "clamped")
    rollers = {
        name: tuple(0 if i == axis else None for i in range(N))
        for axis, name in enumerate(sides)
    }
    right = {"right": (stretch, *(None,) * (N - 1))}
    return Problem(
        mesh, STEEL, clamped=None, prescribed=rollers | right, kinematics=FLAT[mesh.dim]
    )


def uniaxial_stress(N, stretch, p_0=0.0):
    """(stress, plastic strain |p| with its sign) after a stretch from a state with p_0.

    The back stress is 100 p.  Axial compliance 1/E, E by N: sigma/E + k p = stretch.
    """
    k, lame, mu = math.sqrt((N - 1) / N), 1e3, 1e3
    young = 1 / (1 / (N**2 * (lame + 2 * mu / N)) + k**2 / (2 * mu))
    trial = k * young * (stretch - k * p_0) - 100.0 * p_0
    excess = max(abs(trial) - 1.25, 0.0) / (k**2 * young + 100.0)
    p = p_0 + math.copysign(excess, trial)
    return young * (stretch - k * p), p


@pytest.mark.parametrize(
    ("stretch", "method", "N"), every_pair([4e-4, 0.01, -0.01], METHODS, [2, 3])
)
def test_bars_with_moved_ends(N, method, stretch):
    result = solve(method, stretched_bar(N, 1.0, stretch))
    mesh = result.problem.mesh
    stress, p = uniaxial_stress(N, stretch)
    diagonal = np.diag([stress] + [0.0] * (N - 1)).ravel().tolist()
    tichonov = 2.1e-6  # relative
    assert distance(result.stress, CF(tuple(diagonal), dims=(N, N)), mesh) < tichonov
    size = Integrate(result.equivalent_plastic_strain, mesh)
    assert size == pytest.approx(abs(p), rel=1e-6, abs=1e-8)
    assert result.reaction == pytest.approx([0.0] * N, abs=1e-9)
    assert result.equilibrium.reactions["right"][0] == pytest.approx(
        stress, rel=tichonov
    )


@pytest.mark.parametrize(("method", "N"), in_turn(METHODS, [2, 3]))
def test_bars_pulled_and_pushed_in_steps(N, method):
    """A cycle 0, 1, -1 of the stretch in steps, with the memory of the steps before."""
    problem = stretched_bar(N, 1.0, 0.004)
    solver = primal_newton if method == "primal" else cold_start(METHODS["dual"])
    history = evolve(
        problem, load_cycle(problem, [1, -1], steps=3), solver
    ).raise_for_status()
    p = 0.0
    for step in history.steps:
        stretch = 0.004 * float(np.interp(step.record.time, (0, 1, 2), (0, 1, -1)))
        stress, p = uniaxial_stress(N, stretch, p)
        assert Integrate(step.fields.stress[0], problem.mesh) == pytest.approx(
            stress, rel=1e-5
        )
        assert step.record.max_plastic_strain == pytest.approx(
            abs(p), rel=1e-5, abs=1e-9
        )
    assert p < -1e-3


def error_of_a_homogeneous_plastic_state(regularisation, n):
    """Relative error of the mean axial stress of a bar of n x n x 2 triangles."""
    mesh = block.structured_mesh(n, n, simplices=True)
    problem = dataclasses.replace(stretched_bar(2, 0.5, 0.01), mesh=mesh)
    result = semismooth_newton(problem, regularisation=regularisation)
    return abs(Integrate(result.stress[0], mesh) / uniaxial_stress(2, 0.01)[0] - 1)


def test_gradient_product_costs_a_layer_of_elements_at_the_boundary():
    """Where q = 0 on the boundary the error is of order h, otherwise there is none."""
    zero_at_the_boundary = Coupled(1e4, gamma_tichonov=1e8)
    errors = [
        error_of_a_homogeneous_plastic_state(zero_at_the_boundary, n) for n in (5, 7)
    ]
    assert errors[0] < 0.19
    assert errors[0] / errors[1] == pytest.approx(1.4, abs=0.06)
    assert error_of_a_homogeneous_plastic_state(None, 4) < 1e-7


def test_coupled_regularisation_approaches_the_homogeneous_state():
    """Moreau-Yosida means h + 1/gamma; the Tichonov strain |q|/gamma only shares p with it."""
    stress, _ = uniaxial_stress(3, 0.01)
    errors = []
    for gamma in (1e3, 1e4):
        problem = stretched_bar(3, 1.0, 0.01)
        regularisation = Coupled(gamma, tichonov=FullProduct())
        result = semismooth_newton(problem, regularisation=regularisation)
        assert result.status is Status.CONVERGED
        errors.append(abs(Integrate(result.stress[0], problem.mesh) / stress - 1))
    assert errors[0] < 1e-5
    assert [a / b for a, b in itertools.pairwise(errors)] == pytest.approx(
        [10], rel=0.2
    )
