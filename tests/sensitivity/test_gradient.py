"""Gradients of functionals: central differences, Taylor, the envelope theorem, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns.derivatives import Derivatives, compared, envelope_error, taylor_slopes
from campaigns.random_data import (
    functionals,
    last_state,
    moved,
    once,
    random_problem,
    sizes,
)
from ngsolve import CF, Id, IfPos, InnerProduct, Integrate, ds, dx, x, y

from ngepc import (
    Coulomb,
    Material,
    NewtonOptions,
    Point,
    Problem,
    Response,
    Roller,
    SolverError,
    evolve,
    lshape_problem,
    semismooth_newton,
)
from ngepc.geometries import block, lshape
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.functionals import (
    DisplacementAt,
    Reaction,
    as_functional,
    misfit,
)
from ngepc.sensitivity.gradient import gradient
from ngepc.sensitivity.parameters import Direction


@pytest.fixture(scope="module")
def lshape_result():
    return semismooth_newton(lshape_problem(lshape.paper_mesh(417)))


SEEDS = (4, 7, 12, 18, 26, 45)
"""All kinematics, kinds of elements, orders and bounds of friction; the campaign has 200."""


@pytest.mark.parametrize("seed", SEEDS)
def test_gradients_agree_with_central_differences(seed):
    """Without friction, Tresca's, Coulomb's, from 24 on two bodies."""
    problem = random_problem(seed)
    found = [c for c in compared(problem, every=slice(seed % 5, None, 12)) if c.smooth]
    assert len(found) >= 4
    assert max(c.error for c in found) < 1e-8


@pytest.mark.parametrize("seed", [2, 11, 33])
def test_taylor_remainder_is_of_second_order(seed):
    assert min(taylor_slopes(random_problem(seed), seed).values()) > 1.95


@pytest.mark.parametrize("seed", [3, 6, 12, 29])
def test_envelope_theorem_with_all_data(seed):
    assert envelope_error(random_problem(seed)) < 1e-10


def test_envelope_theorem(lshape_result):
    state = lshape_result.state
    plastic = state.at.gained
    slopes = gradient(
        lshape_result, "primal_energy", ["gap", "traction", "hardening", "yield_stress"]
    )
    expected = {
        "gap": -state.multipliers.sum(),
        "traction": -np.vdot(state.discrete.load, state.u),
        "hardening": state.discrete.points.integral(0.5 * plastic**2),
        "yield_stress": state.discrete.points.integral(plastic),
    }
    for name, value in expected.items():
        assert slopes[name] == pytest.approx(value, rel=1e-10)


@pytest.mark.parametrize("seed", [8, 12, 28])
def test_a_thickness_multiplies_derivatives_of_forces_and_energies(seed):
    """All data are per area, so that displacements and integrals over the plane stay the same."""
    problem = random_problem(seed)
    names = list(sizes(problem))
    thin, thick = once(problem), once(problem.changed(thickness=2.5))
    for key, functional in functionals(problem).items():
        factor = 1.0 if key in ("displacement", "form") else 2.5
        one, other = (gradient(r, functional, names) for r in (thin, thick))
        size = max(abs(v) for v in one.values())
        expected = [factor * one[n] for n in names]
        found = [other[n] for n in names]
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-8 * size)


def test_moving_a_support_costs_the_work_of_its_force():
    result = once(random_problem(4))
    slopes = gradient(result, "primal_energy", ["prescribed"])
    values, (support,) = result.discrete.supports.values, result.problem.prescribed
    force = [Reaction(support, i).slope(result.state).value for i in range(2)]
    components = result.problem.prescribed[support]
    assert slopes["prescribed"] == pytest.approx(np.dot(force, components), rel=1e-9)
    assert values.any()


def test_a_constant_is_the_sum_of_its_regions(lshape_result):
    left, material = IfPos(0.5 - x, 1.0, 0.0), lshape_result.problem.material
    slopes = gradient(
        lshape_result,
        "contact_force",
        {
            "left": Direction("yield_stress", left),
            "right": Direction("yield_stress", 1 - left),
            "all": Direction("yield_stress"),
        },
    )
    assert slopes["left"] + slopes["right"] == pytest.approx(slopes["all"], rel=1e-12)
    fields = replace(material, yield_stress=CF(material.yield_stress))
    other = semismooth_newton(replace(lshape_result.problem, material=fields))
    factor = gradient(other, "contact_force", ["yield_stress"])["yield_stress"]
    assert factor == pytest.approx(material.yield_stress * slopes["all"], rel=1e-8)


def test_a_load_or_gap_is_the_sum_over_its_boundaries():
    problem = random_problem(1)
    problem = replace(problem, traction={**problem.tractions, "left": (y, 0.1)})
    result = once(problem)
    (right,) = set(problem.tractions) - {"left"}
    names = ["traction", "traction:left", f"traction:{right}", "gap", "gap:contact"]
    slopes = gradient(result, "contact_force", names)
    parts = slopes["traction:left"] + slopes[f"traction:{right}"]
    assert parts == pytest.approx(slopes["traction"], rel=1e-12)
    assert slopes["gap:contact"] == pytest.approx(slopes["gap"], rel=1e-12)
    pushes = {
        "pressure": Direction("pressure", {"left": y}),
        "traction": Direction("traction", {"left": (y, 0.0)}),
    }
    slopes = gradient(result, "contact_force", pushes)
    assert slopes["pressure"] == pytest.approx(slopes["traction"], rel=1e-12)


def test_reactions_balance_what_changes(lshape_result):
    names = ["yield_stress", "gap"]
    force = gradient(lshape_result, "contact_force", names)
    reaction = gradient(lshape_result, Reaction("clamped", 1), names)
    for name in names:  # the obstacle of Example (a) pushes along y
        assert reaction[name] == pytest.approx(force[name], rel=1e-8)


@pytest.mark.parametrize("seed", [19])
def test_energies_and_pressure_agree_with_differences(seed):
    problem = random_problem(seed)
    (names, h), result = (
        (("traction", "lame_mu", "yield_stress", "gap"), 1e-5),
        once(problem),
    )
    top = "|".join(problem.contact_names)

    def pressed(u, p, stress, pressure):
        edge = ds(top, bonus_intorder=2)
        return (1 + x) * pressure**2 * edge + InnerProduct(u, u) * dx

    for functional in ("elastic_energy", "dissipation", pressed):
        slopes, F = gradient(result, functional, names), as_functional(functional)
        for name, size in sizes(problem).items():
            if name in names:
                ends = [
                    once(moved(problem, {name: t * h * size}), result) for t in (-1, 1)
                ]
                before, after = (F.slope(last_state(end)).value for end in ends)
                difference = (after - before) / (2 * h * size)
                assert slopes[name] == pytest.approx(difference, rel=1e-5, abs=1e-7)
    record = evolve(problem, [(1.0, {})]).steps[0].record
    for name in ("elastic_energy", "dissipation"):
        told = as_functional(name).slope(result.state).value
        assert told == pytest.approx(getattr(record, name), rel=1e-9)
    pressure = result.contact_pressure
    integral = Integrate((1 + x) * pressure**2, problem.mesh.Boundaries(top))
    of_u = (
        as_functional(lambda u, p, stress: InnerProduct(u, u) * dx)
        .slope(result.state)
        .value
    )
    both = as_functional(pressed).slope(result.state).value
    assert both - of_u == pytest.approx(integral, rel=1e-9)


def test_a_field_that_fits_has_no_slope(lshape_result):
    slopes = gradient(
        lshape_result, misfit(lshape_result.displacement), ["hardening", "gap"]
    )
    assert slopes.functional == pytest.approx(0.0, abs=1e-25)
    assert max(map(abs, slopes.values())) < 1e-14


def test_the_answer_is_a_mapping_that_says_what_it_is_worth(lshape_result):
    slopes = gradient(lshape_result, "contact_force", "gap")
    assert list(slopes) == ["gap"]
    assert slopes.functional == pytest.approx(lshape_result.contact_force)
    assert slopes.differentiable
    assert slopes.message == ""


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ("friction", "the problem has none"),
        ("young", "one of lame_lambda"),
        ("body_force", "the problem has none, its loads are: traction"),
        ("initial_plastic_strain", "the problem has none"),
        ("prescribed", "the problem has none"),
        ("traction:left", "one of load is needed"),
        ("hardening:left", "only 'hardening' has a derivative"),
        (Direction("gap", {"load": 1.0}), "the contact boundaries are"),
        (Direction("gap", 1 / (x - x)), "finite values are needed"),
        (Direction("lame_mu", CF((x, y))), "a scalar is needed"),
        (Direction("lame_mu", 1 / (x - x)), "finite values are needed"),
        (Direction("traction", {"load": (1.0, 2.0, 3.0)}), "2 components are needed"),
        (Direction("traction", {"load": (np.nan, 0.0)}), "a finite number is needed"),
        (Direction("body_force", (1.0, 2.0, 3.0)), "2 components are needed"),
        (Direction("initial_plastic_strain", Id(2)), "plastic strains are trace-free"),
        (Direction("prescribed", {"load": (1.0, None)}), "no such support"),
        (Direction("prescribed", {"load": Roller(None, 1.0)}), "no such support"),
    ],
)
def test_parameters_that_are_refused(lshape_result, parameters, text):
    wanted = {"one": parameters} if isinstance(parameters, Direction) else parameters
    with pytest.raises(ValueError, match=text):
        gradient(lshape_result, "contact_force", wanted)


def test_changes_of_loads_and_supports_name_their_boundary(lshape_result):
    for datum in ("traction", "pressure", "prescribed"):
        with pytest.raises(
            TypeError, match="a mapping of boundary name -> change is needed"
        ):
            gradient(
                lshape_result, "contact_force", {"one": Direction(datum, (1.0, 0.0))}
            )


def test_obstacle_and_support_that_meet_move_either_way():
    """Also where the changed data would not be those of a body: a clamp above the obstacle."""
    stiff = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=10.0
    )
    mesh = block.structured_mesh(4, 4, simplices=True)
    push = {"clamped": (0.0, 10.0)}
    problem = Problem(mesh, stiff, "left", push, contact="contact", gap=1e-3)
    motions = {
        "away": Direction("gap", 1.0),
        "closer": Direction("gap", -1.0),
        "tilted": Direction("gap", -x),
        "back": Direction("gap", x),
        "lifted": Direction("prescribed", {"left": (0.0, 1.0)}),
    }
    for p in (problem, replace(problem, clamped=None, prescribed={"left": (0.0, 0.0)})):
        slopes = gradient(semismooth_newton(p), "contact_force", motions)
        assert slopes["away"] < slopes["back"] < -1.0
        assert slopes["closer"] == pytest.approx(-slopes["away"], rel=1e-12)
        assert slopes["tilted"] == pytest.approx(-slopes["back"], rel=1e-12)
        assert slopes["lifted"] == pytest.approx(-slopes["away"], rel=1e-9)


@pytest.mark.parametrize(
    ("functional", "text"),
    [
        ("force", "one of contact_force"),
        (DisplacementAt((5.0, 5.0), 0), "a point in the body"),
        (Reaction("load", 0), "does not hold component 0"),
        (Reaction("clamped", 2), "component=2"),
    ],
)
def test_functionals_that_are_refused(lshape_result, functional, text):
    with pytest.raises(ValueError, match=text):
        gradient(lshape_result, functional, "gap")


def test_reactions_of_points_are_refused():
    with pytest.raises(
        TypeError, match=r"equilibrium\.reactions has the forces of points"
    ):
        Reaction(Point((0, 0)), 1)


def test_misfits_that_are_refused(lshape_result):
    """A misspelt boundary is none: NGSolve integrates nothing over it."""
    with pytest.raises(ValueError, match="boundary='top': there is no boundary 'top'"):
        gradient(lshape_result, misfit(CF((0, 0)), "top"), "gap")
    with pytest.raises(ValueError, match="observed"):
        gradient(lshape_result, misfit(CF((0, 0, 0)), "contact"), "gap")


def test_numbers_of_a_response_that_are_refused():
    response = Response(
        lshape_problem(lshape.paper_mesh(113)), "contact_force", ["gap"]
    )
    for theta in (0.1, None, "a"):
        with pytest.raises(TypeError, match=r"theta=.*: a sequence of 1 numbers"):
            response(theta)


def test_forms_that_are_none(lshape_result):
    with pytest.raises(TypeError, match="integrals are needed"):
        gradient(lshape_result, lambda u, p, stress: u[0], "gap")
    with pytest.raises(TypeError, match="a name, a form or a functional"):
        gradient(lshape_result, 3.0, "gap")
    with pytest.raises(TypeError, match=r"\(u, p, stress\).* has 1 argument$"):
        gradient(lshape_result, lambda fields: fields.displacement, "gap")


@pytest.mark.parametrize("measure", [ds("contcat"), dx("steal")])
def test_forms_over_no_part_of_the_mesh_are_refused(measure, lshape_result):
    """A misspelt name, which NGSolve integrates to zero, alone or beside other integrals."""
    forms = (
        lambda u, p, stress: u[0] * measure,
        lambda u, p, stress: u[1] * ds("contact") + u[0] * measure,
    )
    for form in forms:
        with pytest.raises(ValueError, match=r"no part of the mesh: .*'clamped'"):
            gradient(lshape_result, form, "gap")


def test_what_is_no_solution_has_no_derivative():
    problem = lshape_problem(lshape.paper_mesh(113))
    stopped = semismooth_newton(problem, options=NewtonOptions(max_iterations=1))
    with pytest.raises(SolverError):
        gradient(stopped, "contact_force", "gap")
    regularised = semismooth_newton(problem, 1e2)
    with pytest.raises(TypeError, match="without gamma"):
        gradient(regularised, "contact_force", "gap")


def pushed_block(friction: object) -> Problem:
    """A block that is pressed onto the obstacle above and pushed along it: all of it slips."""
    material = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=8.0, hardening=50.0
    )
    mesh = block.structured_mesh(8, 4, size=(2, 1), simplices=True)
    push = {"right": (6.0, 0.0)}
    return Problem(
        mesh, material, traction=push, contact="contact", gap=-0.003, friction=friction
    )


def test_friction_that_slips_all_over_balances():
    """With Tresca's bound F the obstacle holds back F times the area, with Coulomb's mu n."""
    names, reaction = ["friction", "traction", "gap"], Reaction("clamped", 0)
    result = semismooth_newton(pushed_block(0.05)).raise_for_status()
    assert result.state.sliding.all()
    slopes = gradient(result, reaction, names)
    assert slopes["friction"] == pytest.approx(result.rows.weights.sum(), rel=1e-9)
    assert slopes["traction"] == pytest.approx(-6.0, rel=1e-9)
    result = semismooth_newton(pushed_block(Coulomb(0.01))).raise_for_status()
    assert result.state.sliding.all()
    slopes, force = (
        gradient(result, reaction, names),
        gradient(result, "contact_force", names),
    )
    assert slopes["gap"] == pytest.approx(0.01 * force["gap"], rel=1e-9)
    expected = result.contact_force + 0.01 * force["friction"]
    assert slopes["friction"] == pytest.approx(expected, rel=1e-9)


def test_friction_where_the_gap_is_open():
    """Tresca's bound acts on open rows, too: derivatives against differences, sides kept."""
    names = ["friction", "traction", "gap"]
    problem = replace(pushed_block(0.05), gap=IfPos(x - 1.0, 0.1, -0.003))
    result = semismooth_newton(problem).raise_for_status()
    assert result.state.sliding.all()
    assert (result.nodal_contact_forces == 0).any()
    slopes = gradient(result, "primal_energy", names)
    work = np.linalg.norm(result.nodal_slip, axis=1) @ result.rows.weights
    assert slopes["friction"] == pytest.approx(work, rel=1e-9)
    force = gradient(result, "contact_force", names)
    step = 1e-4
    one, two = (
        semismooth_newton(replace(problem, friction=0.05 + change)).contact_force
        for change in (step, -step)
    )
    assert force["friction"] == pytest.approx((one - two) / (2 * step), rel=1e-6)


def test_a_limit_of_friction():
    """Where min(mu n, F) = F nothing changes with mu."""
    reaction = Reaction("clamped", 0)
    limited = pushed_block(Coulomb(100.0, limit=0.05))
    result = semismooth_newton(limited).raise_for_status()
    assert result.state.sliding.all()
    assert gradient(result, reaction, ["friction"])["friction"] == pytest.approx(
        0, abs=1e-9
    )


def test_friction_region_by_region():
    left = IfPos(0.5 - x, 1.0, 0.0)
    result = semismooth_newton(pushed_block(Coulomb(0.01)))
    parts = {
        "left": Direction("friction", left),
        "right": Direction("friction", 1 - left),
    }
    slopes = gradient(result, "contact_force", parts | {"all": Direction("friction")})
    assert slopes["left"] + slopes["right"] == pytest.approx(slopes["all"], rel=1e-10)
    field = semismooth_newton(pushed_block(Coulomb(0.01 + 0 * x)))
    factor = gradient(field, "contact_force", "friction")["friction"]
    assert factor == pytest.approx(0.01 * slopes["all"], rel=1e-9)


SUPPORTS = [
    (16, (0.0, None)),
    (16, (None, 1e-4 * y)),
    (20, (0.0, 1e-3 * y)),
    (19, (0.0, None, None)),
]


@pytest.mark.parametrize(("seed", "held"), SUPPORTS)
def test_coulomb_friction_beside_a_support(seed, held):
    """A support at the edge of contact takes a row or a tangent of it; rows before others gape."""
    base = random_problem(seed)
    mesh = block.structured_mesh(6, 3, size=(1.0, 0.7), simplices=True)
    problem = replace(
        base,
        mesh=mesh if base.N == 2 else base.mesh,
        gap=0.0015 - 0.003 * x,
        friction=Coulomb(0.2),
        prescribed={"clamped": (0.0,) * base.N, "left": held},
    )
    result = once(problem)
    rows, supported = result.rows, ~result.discrete.free.ravel()
    assert (
        len(rows) < 7
        or (rows.tangential @ supported).any()
        or (rows.normal @ supported).any()
    )
    sides = LinearContact(result.state)
    assert sides.slips.sum() >= 3
    assert not sides.closed.all()
    found = [c for c in compared(problem, every=slice(0, None, 15)) if c.smooth]
    assert len(found) >= 3
    assert max(c.error for c in found) < 1e-8


def test_the_study_says_what_it_found(tmp_path):
    study = Derivatives(tmp_path, count=1)
    records = study.run()
    assert study.succeeded(records)
    assert not study.succeeded([records[0] | {"largest error": 2e-6}])
    study.write(records)
    table = (tmp_path / "derivatives.md").read_text()
    assert "| all | 1 |" in table
    assert "| kinematics plane stress | 1 |" in table  # of the first random problem


JUMP = IfPos((y - 0.4) * (0.43 - y), 1.0, 0.0)
"""One in a strip that lies between the integration points of most elements."""


@pytest.mark.parametrize(
    ("datum", "change", "where"),
    [
        ("body_force", CF((0.0, 1.0)) * JUMP, "at 1/"),
        ("pressure", {"right": JUMP}, "at 1/"),
        ("initial_strain", JUMP, "at 1/"),
        ("lame_mu", JUMP, "at 1/"),
        ("gap", JUMP, "at nodes"),
        ("friction", JUMP, "at nodes"),
        (
            "initial_plastic_strain",
            JUMP * CF((1, 0, 0, -1), dims=(2, 2)),
            "at integration points",
        ),
    ],
)
def test_changes_that_samples_may_miss_are_said(datum, change, where):
    problem = Problem(
        block.structured_mesh(2, 2, simplices=True),
        Material.kinematic(
            lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
        ),
        traction={"left": (0.3, -0.4)},
        contact="contact",
        gap=-1e-3,
        friction=0.3,
        kinematics="two-dimensional",
    )
    result = semismooth_newton(problem)
    strip = Direction(datum, change)
    found = gradient(result, "primal_energy", {"strip": strip})
    assert found.differentiable
    assert f"Changes known from samples only: strip ({where}" in found.message
    whole = gradient(result, "primal_energy", ["lame_mu", "gap"])
    assert whole.message == ""
