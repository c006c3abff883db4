"""Limit loads: closed forms, published values, and both sides shown to be admissible."""

import math
from dataclasses import replace

import numpy as np
import pytest
from campaigns.random_limits import problem as random_problem
from netgen.geom2d import SplineGeometry
from netgen.occ import Box, Glue, MoveTo, OCCGeometry, X, Y
from ngsolve import (
    CF,
    ET,
    VOL,
    Grad,
    Id,
    InnerProduct,
    Integrate,
    IntegrationRule,
    LinearForm,
    Mesh,
    Norm,
    Sym,
    Trace,
    VectorH1,
    ds,
    dx,
)
from ngsolve.meshes import MakeStructured3DMesh

from ngepc import (
    Coulomb,
    LimitStatus,
    Material,
    Point,
    Problem,
    Status,
    Tabulated,
    evolve,
    limit_load,
    load_cycle,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.limit.bracket import bracket_on, centre_of, lower_on
from ngepc.limit.load import PRECISE
from ngepc.limit.reading import growing_names, limit_data
from ngepc.limit.static import Statics
from ngepc.limit.yielding import SHAPES
from ngepc.linalg.conic import ACCURATE
from ngepc.studies.limit_problems import sheet_problem

CLAY = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=math.sqrt(2), hardening=1.0
)
"""Shear yield stress one."""


def polygon(corners, names, maxh):
    geometry = SplineGeometry()
    points = [geometry.AppendPoint(*corner) for corner in corners]
    for i, name in enumerate(names):
        ends = points[i], points[(i + 1) % len(points)]
        geometry.Append(["line", *ends], bc=name)
    return Mesh(geometry.GenerateMesh(maxh=maxh))


def vertical_cut():
    corners = [(-2, -1), (1.5, -1), (1.5, 0), (0, 0), (0, 1), (-2, 1)]
    names = ["held", "held", "free", "free", "free", "held"]
    mesh = polygon(corners, names, 0.5)
    return Problem(mesh, CLAY, "held", body_force=(0, -1))


def strip(**given):
    corners = [(0, -3), (4, -3), (4, 0), (1, 0), (0, 0)]
    mesh = polygon(corners, ["held", "held", "free", "load", "axis"], 0.6)
    supports = {"axis": (0, None)} | given.pop("prescribed", {})
    return Problem(mesh, CLAY, "held", prescribed=supports, **given)


def square(**given):
    """SSNV124: a square in plane strain, sigma_y = 10, on two planes of symmetry."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=math.sqrt(2 / 3) * 10, hardening=1.0
    )
    supports = {"clamped": (None, 0), "left": (0, None)} | given.pop("prescribed", {})
    return Problem(mesh, steel, None, prescribed=supports, **given)


@pytest.fixture(scope="module")
def cut():
    return limit_load(vertical_cut(), 0.04)


@pytest.fixture(scope="module")
def punch():
    return limit_load(strip(pressure={"load": 1}), 0.02)


def test_vertical_cut(cut):
    """Kammoun, Pastor, Smaoui, Pastor, IJNAMG 34 (2010): [3.7752, 3.7776]."""
    assert cut.status is LimitStatus.REACHED
    assert cut.relative_width <= 0.04
    assert cut.lower <= 3.7776
    assert cut.upper >= 3.7752
    assert "Hardening is neglected" in cut.message


def test_a_limit_load_is_printed_with_its_message(cut):
    """What the two numbers are, and that hardening is neglected."""
    assert repr(cut).startswith("<LimitLoad: load factor in [")
    assert str(cut) == f"{cut!r}\n{cut.message}"


def test_prandtl(punch):
    """2 + pi, through fans that bisection alone does not make."""
    assert punch.lower <= 2 + math.pi <= punch.upper
    assert punch.relative_width <= 0.02


def test_a_rigid_punch_is_the_force_of_its_support():
    """Half of it on a smooth strip of half width one: again 2 + pi."""
    found = limit_load(strip(prescribed={"load": (None, -1)}), 0.1)
    assert found.growing == ("load",)
    assert found.lower <= 2 + math.pi <= found.upper


def test_units_do_not_matter():
    """Forces: the factor is that of the problem as it is given.

    Exactly so for powers of two, the units of the programs; else to the precision of these.
    """
    one = limit_load(strip(pressure={"load": 1}), 0.2)
    double = limit_load(strip(pressure={"load": 1024.0}), 0.2)
    assert 1024 * double.lower == one.lower
    assert 1024 * double.upper == one.upper
    thousand = limit_load(strip(pressure={"load": 1000.0}), 0.2)
    precision = PRECISE * one.records[-2].relative_width
    assert 1000 * thousand.lower == pytest.approx(one.lower, rel=precision)
    assert 1000 * thousand.upper == pytest.approx(one.upper, rel=precision)


@pytest.mark.parametrize("shape", ["quadrilaterals", "hexahedra"])
def test_other_elements_are_cut_into_simplices(shape):
    """The bounds are those of a mesh of simplices with the same vertices."""
    soft = Material.metal(young=1e3, poisson=0.3, yield_stress=1.0, tangent_modulus=0.0)
    if shape == "quadrilaterals":
        meshes = [block.structured_mesh(2, 2, simplices=cut) for cut in (False, True)]
        given = {"clamped": "clamped", "traction": {"contact": (1.0, 0)}}
    else:
        meshes = [MakeStructured3DMesh(cut, 2, 2, 1) for cut in (True, False)]
        given = {"clamped": "bottom", "traction": {"top": (0, 0, 1.0)}}
    found, same = (limit_load(Problem(m, soft, **given), 0.5) for m in meshes)
    assert found.records[0].cells == same.records[0].cells
    assert found.lower == pytest.approx(same.lower, rel=1e-3)
    assert found.upper == pytest.approx(same.upper, rel=1e-3)
    assert found.stress is not None
    assert found.mechanism is not None


@pytest.mark.parametrize("side", [0.0, 3.0])
def test_square_with_a_load_that_stays(side):
    """20 / 3^(1/2) for the difference of the tractions: one field of stress is exact."""
    loads = {"contact": (0, 1.0)} | ({"right": (side, 0)} if side else {})
    found = limit_load(square(traction=loads), 1e-3, growing=["contact"])
    assert found.lower == pytest.approx(20 / math.sqrt(3) + side, rel=1e-6)
    assert found.upper == pytest.approx(20 / math.sqrt(3) + side, rel=1e-6)


def test_square_of_the_published_collection():
    """SSNV124 with a load that stays: 14.6837, where its power is -0.25.

    The published limit and that power are those of 0.8 on one side, which grows, and 0.2 on the
    other: 0.8 x - 0.2 = 20 / 3^(1/2).
    """
    loads = {"contact": (0, 0.8), "right": (0.2, 0)}
    found = limit_load(square(traction=loads), 1e-3, growing=["contact"])
    assert found.lower == pytest.approx(14.6837, rel=1e-5)
    assert found.upper == pytest.approx(25 / math.sqrt(3) + 0.25, rel=1e-6)
    power = Integrate(
        CF((0.2, 0)) * found.mechanism * ds("right"), found.mesh
    ) / Integrate(0.8 * found.mechanism[1] * ds("contact"), found.mesh)
    assert power == pytest.approx(-0.25, rel=1e-4)


@pytest.mark.parametrize("side", [0.0, 0.5])
def test_thin_sheet(side):
    """Plane stress: x^2 - x y + y^2 = sigma_y^2."""
    loads = {"contact": (0, 1.0)} | ({"right": (side, 0)} if side else {})
    found = limit_load(square(traction=loads, kinematics="plane stress"), 1e-3)
    exact = 10 / math.sqrt(1 - side + side**2)
    assert found.lower == pytest.approx(exact, rel=1e-6)
    assert found.upper == pytest.approx(exact, rel=1e-6)


def test_thin_sheet_with_a_hole():
    """Gaydon, McCrum, J. Mech. Phys. Solids 2 (1954): 1 - R / L of the yield stress."""
    found = limit_load(sheet_problem(), 0.05)
    assert found.lower <= 0.8 * (1 + 2e-3)  # the hole is a polygon
    assert found.upper >= 0.8
    assert found.relative_width <= 0.05


def weak_residual(result, load, names):
    """Largest force that stress and loads leave on functions of degree three, without supports."""
    space = VectorH1(result.mesh, order=3, **names)
    w = space.TestFunction()
    form = LinearForm(space)
    form += InnerProduct(result.stress, Sym(Grad(w))) * dx
    form += (-1.0) * load(w)
    form.Assemble()
    free = np.array(list(space.FreeDofs()), dtype=bool)
    scale = LinearForm(InnerProduct(CF((1, 1)), w) * dx).Assemble().vec.FV().NumPy()
    return np.abs(form.vec.FV().NumPy()[free]).max() / np.abs(scale).max()


def at_points(result, value, order=4):
    points = result.mesh.MapToAllElements(
        {ET.TRIG: IntegrationRule(ET.TRIG, order)}, VOL
    )
    return np.asarray(value(points))


def deviator(A):
    return A - Trace(A) / 2 * CF((1, 0, 0, 1), dims=(2, 2))


def test_the_stress_is_admissible(cut, punch):
    """To 1e-12, by other means than those which made it: weak form of degree three, points."""
    loads = (
        (cut, lambda w: -cut.lower * w[1] * dx, {"dirichlet": "held"}),
        (
            punch,
            lambda w: -punch.lower * w[1] * ds("load"),
            {"dirichletx": "held|axis", "dirichlety": "held"},
        ),
    )
    for found, load, names in loads:
        assert found.lower == found.records[-1].lower
        assert weak_residual(found, load, names) < 1e-12
        size = at_points(found, Norm(deviator(found.stress)))
        assert size.max() <= math.sqrt(2) * (1 + 1e-12)


def test_the_mechanism_is_admissible(cut, punch):
    """No change of volume, no motion of supports, and less dissipation than the bound says."""
    works = (
        (cut, lambda v: -v[1] * dx, "held"),
        (punch, lambda v: -v[1] * ds("load"), "held"),
    )
    for found, work, held in works:
        v = found.mechanism
        strain = Sym(Grad(v))
        size = at_points(found, Norm(strain)).max()
        assert np.abs(at_points(found, Trace(strain))).max() < 1e-12 * size
        assert Integrate(Norm(v) * ds(held), found.mesh) == 0
        dissipated = Integrate(
            math.sqrt(2) * Norm(strain) * dx(bonus_intorder=8), found.mesh
        )
        factor = dissipated / Integrate(work(v), found.mesh)
        assert factor <= found.upper * (1 + 1e-9)
        assert factor == pytest.approx(found.upper, rel=1e-3)


def test_indicators_add_up_to_the_width(cut, punch):
    for found in (cut, punch):
        values = np.array(found.indicators.vec)
        assert values.min() > -1e-12
        last = found.records[-1]
        assert found.upper == last.upper
        assert values.sum() == pytest.approx(found.relative_width, rel=1e-9)


def test_friction_drags_at_most_its_bound():
    """A strong block pulled between two obstacles, away from a wall to which soft matter ties it.

    On the block friction is F on both sides, on the soft part, whose speed falls to zero, less.
    """
    strong = MoveTo(0, 0).Rectangle(0.875, 1).Face()
    soft = MoveTo(0.875, 0).Rectangle(0.125, 1).Face()
    for part, name in ((strong, "strong"), (soft, "soft")):
        part.faces.name = name
        part.edges.Max(Y).name = "contact"
        part.edges.Min(Y).name = "clamped"
    strong.edges.Min(X).name = "left"
    soft.edges.Max(X).name = "right"
    geometry = OCCGeometry(Glue([strong, soft]), dim=2)
    mesh = Mesh(geometry.GenerateMesh(maxh=0.25))
    bound = mesh.MaterialCF({"strong": math.sqrt(2), "soft": 1e-3})
    clay = replace(CLAY, yield_stress=bound)
    given = {"contact": "clamped|contact", "gap": 0.0, "friction": 0.25}
    given |= {"prescribed": {"right": (0, 0)}, "traction": {"left": (-1, 0)}}
    found = limit_load(Problem(mesh, clay, None, **given), 0.03)
    assert found.upper >= 2 * 0.25 * 0.875
    assert found.lower <= 2 * 0.25 + 0.01
    assert found.relative_width <= 0.03
    smooth = limit_load(Problem(mesh, clay, None, **given | {"friction": 0.0}), 0.5)
    assert smooth.upper < 0.05


def test_a_load_that_only_obstacles_carry_has_no_limit():
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"left": (0, 0), "right": (0, None)}
    problem = Problem(
        mesh,
        CLAY,
        None,
        pressure={"contact": 1},
        prescribed=supports,
        contact="clamped",
        gap=0,
    )
    found = limit_load(problem)
    assert found.status is LimitStatus.UNLIMITED
    assert found.lower == math.inf


def test_large_constant_loads_that_the_body_carries():
    """On the first mesh there is no stress that balances them."""
    loads = {"contact": (0, 1.0), "right": (30.0, 0), "left": (0, 5)}
    found = limit_load(square(traction=loads), 0.05, ["contact"], max_cells=200)
    assert found.records[0].lower == -math.inf
    assert found.status is LimitStatus.REACHED
    assert found.lower > 30


@pytest.mark.parametrize("force", [(0, 200.0), (200.0, 0)])
def test_constant_loads_that_are_too_large_are_named_on_the_first_mesh(force):
    """A shear of 1.2 times the strength at the support: no growing load can help."""
    heavy = square(traction={"contact": (1.0, 0)}, body_force=force)
    found = limit_load(heavy, growing=["contact"])
    assert found.status is LimitStatus.OVERLOADED
    assert not found.status.is_success
    assert len(found.records) == 1
    assert found.lower == -math.inf
    assert found.upper < 0
    assert (found.upper == -math.inf) == (found.mechanism is None)
    for nothing in (found.stress, found.indicators):
        assert nothing is None


@pytest.mark.parametrize("pull", [4.61, 5.0])
def test_constant_loads_that_are_slightly_too_large_are_named(pull):
    """The square carries at most 4.51 along: no pressure across can help with more."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    loads = {"traction": {"right": (pull, 0)}, "pressure": {"contact": 2.0}}
    material = Material.metal(
        young=1000, poisson=0.3, yield_stress=10, plastic_modulus=0
    )
    heavy = Problem(mesh, material, "clamped", **loads)
    found = limit_load(heavy, growing=["contact"], max_cells=600)
    assert found.status is LimitStatus.OVERLOADED
    assert found.lower == -math.inf
    assert found.upper < 0


def test_a_negative_limit_load_is_said():
    """Pressed with 15 across, the square needs a pressure of 15 - 20/3^(1/2) along."""
    loads = {"contact": (0, 1.0), "right": (-15.0, 0)}
    found = limit_load(square(traction=loads), growing=["contact"])
    assert found.status is LimitStatus.REACHED
    assert found.lower <= 20 / math.sqrt(3) - 15 <= found.upper < 0
    assert "constant loads alone make the body collapse" in found.message
    carried = limit_load(square(traction=loads), growing=["right"])
    assert carried.lower > 0
    assert "collapse" not in carried.message


@pytest.mark.parametrize("push", [15.0, 1e8])
def test_a_factor_that_is_very_negative_is_one(push):
    """A growing load that is small beside the constant one holds it, whatever the ratio is."""
    loads = {"contact": (0, 1.0), "right": (-push, 0)}
    found = limit_load(square(traction=loads), growing=["contact"])
    assert found.status is LimitStatus.REACHED
    assert found.lower <= 20 / math.sqrt(3) - push <= found.upper < 0


@pytest.mark.filterwarnings("error")
def test_constant_loads_near_rounding_divide_by_no_zero():
    """Pressed with 1e10 times the strength: neither the stress nor the centre has a margin."""
    problem = Problem(
        block.structured_mesh(3, 3, simplices=True),
        CLAY,
        None,
        {"right": (1.0, 0), "contact": (0, -1e10)},
        prescribed={"left": (0, None)},
        contact="clamped",
        gap=0.0,
        friction=10.0,
    )
    found = limit_load(problem, 0.05, growing=["right"], max_cells=100)
    assert found.lower <= found.upper < 0


def test_a_thickness_of_one_is_none():
    problem = square(traction={"contact": (1.0, 0)})
    limits = [limit_load(replace(problem, thickness=t), 0.1) for t in (None, 1, 1.0)]
    assert len({(limit.lower, limit.upper) for limit in limits}) == 1
    with pytest.raises(ValueError, match=r"thickness=2\.0: a limit load needs"):
        limit_load(replace(problem, thickness=2.0))


def test_a_history_ends_near_a_limit_load_that_is_refused():
    """As the refusal says; the limit load of thickness one has the same factor."""
    soft = Material.metal(young=1e3, poisson=0.3, yield_stress=1.0, tangent_modulus=0.0)
    mesh = block.structured_mesh(4, 4, simplices=True)
    thin = Problem(mesh, soft, traction={"contact": (2.0, 0)})
    thick = replace(thin, thickness=2.0)
    with pytest.raises(ValueError, match=r"evolve\(problem, load_cycle\("):
        limit_load(thick)
    known = limit_load(thin, 0.1)
    history = evolve(thick, load_cycle(thick, [1.0], steps=10))
    assert history.status in (Status.LIMIT_LOAD, Status.ITERATION_LIMIT)
    assert 0.95 * known.lower < history.steps[-1].record.time < 1.1 * known.upper


def test_constant_loads_for_which_no_stress_is_found():
    """A body that its weight nearly crushes, on too coarse a mesh."""
    heavy = Problem(
        block.structured_mesh(2, 2, simplices=True),
        CLAY,
        "clamped",
        traction={"contact": (1.0, 0)},
        body_force=(1.7, 0),
    )
    found = limit_load(heavy, growing=["contact"], max_cells=8)
    assert found.status is LimitStatus.TOO_WEAK
    assert math.isfinite(found.upper)


def on_obstacle(size=1.0, held=None, **given):
    """A square on a smooth obstacle, beside a plane of symmetry."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    supports = {"left": (0, None)} | (held or {})
    given = {"contact": "clamped", "gap": 0, "friction": 0.0} | given
    if held is None:
        given["traction"] = {"contact": (0, size)}
    return Problem(mesh, CLAY, None, prescribed=supports, **given)


def test_a_load_that_lifts_a_body_off_has_the_limit_zero():
    """Both bounds are zero, exactly, without a finer mesh; downwards it is 2, the strength."""
    found = limit_load(on_obstacle())
    assert found.status is LimitStatus.FREE
    assert found.status.is_success
    assert (found.lower, found.upper, found.relative_width) == (0.0, 0.0, 0.0)
    assert "rigid motion" in found.message
    assert len(found.records) == 1
    speed = found.mechanism(found.mesh(0.5, 1.0))
    assert speed == pytest.approx((0.0, 1.0), abs=1e-6)
    pressed = limit_load(on_obstacle(-1.0))
    assert pressed.lower <= 2 <= pressed.upper


def test_weight_holds_a_body_on_an_obstacle():
    """It lifts off when the traction is the weight; a weight upwards does so alone."""
    for weight in (0.5, -0.5):
        body = on_obstacle(body_force=(0, -weight))
        found = limit_load(body, growing=["contact"])
        assert found.lower == pytest.approx(weight, rel=1e-4)
        assert found.upper == pytest.approx(weight, rel=1e-4)


def test_a_support_that_moves_a_body_freely_needs_no_force():
    up = limit_load(on_obstacle(held={"contact": (0, 1)}), growing=["contact"])
    assert up.status is LimitStatus.FREE
    assert up.upper == 0
    down = limit_load(on_obstacle(held={"contact": (0, -1)}), 0.05)
    assert down.status is LimitStatus.REACHED
    assert down.lower > 1.9


def test_parts_move_on_their_own():
    """Of two bodies in one mesh a load lifts one; friction would prevent that it slides, too."""
    parts = []
    for name, left in (("one", 0), ("two", 2)):
        part = MoveTo(left, 0).Rectangle(1, 1).Face()
        part.edges.name = "free"
        part.edges.Min(Y).name = "ground"
        part.edges.Min(X).name = "axis"
        part.edges.Max(Y).name = name
        part.edges.Max(X).name = f"{name} right"
        parts.append(part)
    mesh = Mesh(OCCGeometry(Glue(parts), dim=2).GenerateMesh(maxh=0.5))
    given = {"contact": "ground", "gap": 0.0, "prescribed": {"axis": (0, None)}}

    def pulled(x, y, friction=0.0):
        loads = {"one": (0, -1), "two": (x, y)}
        body = Problem(mesh, CLAY, None, traction=loads, friction=friction, **given)
        return limit_load(body, 0.1)

    assert pulled(0, 1).status is LimitStatus.FREE
    assert pulled(0, -1).lower > 1.8
    assert pulled(0, -1, friction=0.1).lower > 1.8


def test_loads_of_zero_are_refused():
    """Their factor would be infinite; of a support that does not move there is none, too."""
    for given in (
        {"traction": {"contact": (0.0, 0.0)}},
        {"body_force": (0.0, 0.0)},
        {"prescribed": {"clamped": (0, 0), "left": (CF(0.0), None)}},
    ):
        with pytest.raises(ValueError, match="these loads are zero"):
            limit_load(square(**given))


@pytest.mark.parametrize("seed", range(10))
def test_random_bodies(seed):
    """No lower bound above an upper one; tests/campaigns does the same for hundreds."""
    body, growing = random_problem(seed)
    shape = SHAPES["plane strain"]
    data, _ = limit_data(body, growing_names(body, growing)).without_units()
    found, _ = bracket_on(data, shape, None)
    assert found.lower <= found.upper


def test_elastic_plastic_runs_agree():
    """Perfect plasticity has solutions below the bracket and none well above it.

    Its velocities are those of one mesh, so that it collapses above the limit, not below.
    """
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    mesh = polygon(corners, ["held", "right", "top", "free"], 0.25)
    law = Tabulated([0.0], [math.sqrt(3)])
    perfect = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=law)

    def pushed(load):
        return Problem(mesh, perfect, "held", traction={"top": (load, 0)}, order=2)

    bracket = limit_load(pushed(1.0), 0.05)
    below = semismooth_newton(pushed(0.98 * bracket.lower))
    assert below.status is Status.CONVERGED
    beyond = semismooth_newton(pushed(1.15 * bracket.upper))
    assert beyond.status is Status.LIMIT_LOAD


def cube(held, load):
    """A cube on three planes of symmetry, and one more for plane strain."""
    mesh = block.structured_mesh(1, 1, 1, simplices=True)
    supports = {"clamped": (None, None, 0), "left": (0, None, None)} | held
    return Problem(mesh, CLAY, None, prescribed=supports, traction={"contact": load})


def test_a_cube_that_is_pulled():
    """3^(1/2) times the shear yield stress, twice of it in plane strain."""
    front = {"front": (None, 0, None)}
    back = {"back": (None, 0, None)}
    for held, exact in ((front, math.sqrt(3)), (front | back, 2.0)):
        found = limit_load(cube(held, (0, 0, 1)), 1e-3)
        assert found.lower == pytest.approx(exact, rel=1e-6)
        assert found.upper == pytest.approx(exact, rel=1e-6)


def test_both_sides_are_admissible_in_space():
    """Weak form, yield and volume as in the plane; the stress answers for half of every slip."""
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    load = {"contact": (1, 0, 0)}
    problem = Problem(mesh, CLAY, "clamped", traction=load)
    found = limit_load(problem, 0.1, max_cells=200)
    space = VectorH1(found.mesh, order=2, dirichlet="clamped")
    w = space.TestFunction()
    form = LinearForm(space)
    form += InnerProduct(found.stress, Sym(Grad(w))) * dx
    form += -found.lower * w[0] * ds("contact")
    form.Assemble()
    free = np.array(list(space.FreeDofs()), dtype=bool)
    assert np.abs(form.vec.FV().NumPy()[free]).max() < 1e-12
    points = found.mesh.MapToAllElements({ET.TET: IntegrationRule(ET.TET, 3)}, VOL)
    deviator = found.stress - Trace(found.stress) / 3 * Id(3)
    assert np.asarray(Norm(deviator)(points)).max() <= math.sqrt(2) * (1 + 1e-12)
    parts = [Grad(component) for component in found.mechanism.components]
    divergence = sum(parts[i][i] for i in range(3))
    assert np.abs(np.asarray(divergence(points))).max() < 1e-12
    values = np.array(found.indicators.vec)
    assert values.min() > -1e-10
    last = found.last
    width = (last.upper - last.lower) / last.lower
    assert values.sum() == pytest.approx(width, rel=1e-9)


REFUSED = {
    "springs": {"springs": {"right": 1.0}},
    "initial_strain": {"initial_strain": 0.1},
    "initial_plastic_strain": {
        "initial_plastic_strain": CF((0.1, 0, 0, 0, -0.1, 0, 0, 0, 0), dims=(3, 3))
    },
    "initial_hardening": {"initial_hardening": 0.1},
    "gap": {"contact": "right", "gap": 0.1},
    "friction": {"contact": "right", "gap": 0.0, "friction": Coulomb(0.3)},
    "traction": {"traction": {Point((1, 1)): (0, 1)}},
}


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_is_not_covered_is_refused_by_name(name):
    with pytest.raises(ValueError, match=name):
        limit_load(square(**({"traction": {"contact": (0, 1)}} | REFUSED[name])))


def test_arguments_are_checked():
    problem = square(traction={"contact": (0, 1)})
    with pytest.raises(ValueError, match=r"growing=.*there is no load 'left'"):
        limit_load(problem, growing=["left"])
    with pytest.raises(TypeError, match="growing='top': a sequence"):
        limit_load(problem, growing="top")
    with pytest.raises(ValueError, match="relative_width=0"):
        limit_load(problem, 0)
    with pytest.raises(ValueError, match="no load"):
        limit_load(square())


@pytest.mark.parametrize("seed", [2002, 2005])
def test_meshes_follow_what_holds_the_lower_bound_down(seed):
    """Two random bodies whose lower bound once stood still while the mesh got finer.

    In the first one a constant shear ends at a corner of one triangle; in the second one stresses
    at a corner that no mechanism strains hold the lower bound 17 percent below the upper one.
    """
    body, growing = random_problem(seed)
    found = limit_load(body, 0.1, growing, max_cells=1000)
    assert found.status is LimitStatus.REACHED


def test_prices_add_up_to_the_lower_bound():
    """Strong duality: the strengths times their multipliers, without constant loads."""
    problem = strip(pressure={"load": 1})
    data, _ = limit_data(problem, growing_names(problem, None)).without_units()
    shape = SHAPES["plane strain"]
    statics = Statics(data, shape)
    found = lower_on(statics, centre_of(statics), ACCURATE)
    assert (found.price >= 0).all()
    assert found.price.sum() == pytest.approx(found.field.factor, rel=1e-6)


def test_solvers_of_solids_end_with_solutions():
    """Of an unstructured mesh whose corners keep the first lower bound at zero."""
    foot = Box((0, 0, 0), (3, 2, 1)) + Box((0, 0, 1), (1, 2, 3))
    foot.faces.name = "free"
    foot.faces.Min(X).name = "clamped"
    foot.faces.Max(X).name = "load"
    mesh = Mesh(OCCGeometry(foot).GenerateMesh(maxh=2.0, parallel_meshing=False))
    soft = Material.metal(young=1e3, poisson=0.3, yield_stress=1.0, tangent_modulus=0.0)
    problem = Problem(mesh, soft, "clamped", traction={"load": (0, 0, -0.1)})
    found = limit_load(problem, 0.1, max_cells=100)
    assert len(found.records) > 1
    assert {word for record in found.records for word in record.words} == {"Solved"}
