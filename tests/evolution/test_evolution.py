"""Time steps one after the other: closed forms, hysteresis, cuts, checkpoints."""

import dataclasses
import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bodies import FLAT
from ngsolve import CF, IfPos, InnerProduct, Integrate, ds, dx, specialcf, x

from ngepc.evolution.load_path import Schedule, load_cycle
from ngepc.evolution.memory import Memory
from ngepc.evolution.solver import cold_start, evolve
from ngepc.geometries import block, lshape
from ngepc.methods.newton import semismooth_newton
from ngepc.model.elements import plastic_points
from ngepc.model.material import Material
from ngepc.model.places import Coulomb, Point, Roller
from ngepc.model.problem import Problem
from ngepc.primal.solver import PrimalOptions, primal_newton
from ngepc.results.options import NewtonOptions
from ngepc.results.outcome import SolverError, Status

HERE = Path(__file__).parent
BESIDE = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE.parent), *sys.path])}

BOUND, K, H, K1 = 1.25, 100.0, 2.0, 8.0
R = (H * BOUND) ** 2 * K1
ELASTIC = {"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": BOUND}
MATERIALS = {
    "kinematic": Material.kinematic(**ELASTIC, hardening=K),
    "isotropic": Material.isotropic(
        **ELASTIC, hardening_modulus=H, hardening_stiffness=K1
    ),
    "combined": Material(
        **ELASTIC, hardening=K, hardening_modulus=H, hardening_stiffness=K1
    ),
}


def bar(material, mesh, load=1.0):
    """A body on rollers, pulled at the right: the stress is diag(load, 0) everywhere."""
    rollers = {"left": (0, None), "clamped": (None, 0)}
    traction = {"right": (load, 0)}
    supports = {"clamped": None, "prescribed": rollers}
    return Problem(
        mesh, material, **supports, traction=traction, kinematics=FLAT[mesh.dim]
    )


@pytest.mark.parametrize("held", [True, False])
def test_initial_strains_are_no_elastic_energy(held):
    """Heated by s: held everywhere 1/2 C (s Id) : (s Id), free to expand in space nothing."""
    s = 1e-4
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    sides = ["left", "clamped", "front"]
    sides += ["right", "contact", "back"] if held else []
    axes = {"left": 0, "right": 0, "front": 1, "back": 1, "clamped": 2, "contact": 2}
    rollers = {
        name: tuple(0 if axis == axes[name] else None for axis in range(3))
        for name in sides
    }
    problem = Problem(
        mesh,
        MATERIALS["kinematic"],
        clamped=None,
        prescribed=rollers,
        initial_strain=s,
        order=1,
    )
    record = evolve(problem, [(1.0, {})]).raise_for_status().steps[0].record
    stored = 4.5 * 1e3 * s**2 + 3 * 1e3 * s**2
    expected = stored if held else 0.0
    assert record.elastic_energy == pytest.approx(expected, rel=1e-9, abs=1e-9 * stored)


def punched(material=MATERIALS["combined"], nodes=65):
    return Problem(
        lshape.paper_mesh(nodes),
        material,
        contact="contact",
        gap=0.02,
        traction={"load": -6 * specialcf.normal(2)},
        order=1,
    )


def plastic_strains(loads, k, r):
    """Coordinate of p after each load for |tau - k p| <= bound + r int |dp|, tau = load/sqrt(2)."""
    p, length, found = 0.0, 0.0, []
    for load in loads:
        tau = load / math.sqrt(2)
        overstress = abs(tau - k * p) - (BOUND + r * length)
        gained = max(overstress, 0.0) / (k + r)
        p, length = p + math.copysign(gained, tau - k * p), length + gained
        found.append(p)
    return found


@pytest.mark.parametrize(
    "mesh", [block.structured_mesh(2, 2), block.structured_mesh(2, 2, simplices=True)]
)
@pytest.mark.parametrize("kind", MATERIALS)
def test_loading_and_reversal_match_the_closed_form(kind, mesh):
    material = MATERIALS[kind]
    loads = [1.0, 4.0, 2.0, -4.5, 5.0]
    steps = [(float(i), {"traction": {"right": (t, 0)}}) for i, t in enumerate(loads)]
    evolution = evolve(bar(material, mesh), steps).raise_for_status()
    k, r = material.hardening, material.isotropic_hardening
    expected = plastic_strains(loads, k, r)
    found = [
        f.plastic_strain(mesh(0.3, 0.6))[0] * math.sqrt(2)
        for f in (step.fields for step in evolution.steps)
    ]
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-14)
    ends = evolution.values(lambda f: f.displacement(mesh(1.0, 0.5))[0])
    elongations = [
        t / 8e3 + t / 4e3 + p / math.sqrt(2)
        for t, p in zip(loads, expected, strict=True)
    ]
    assert ends == pytest.approx(elongations, rel=1e-11)
    assert evolution.column("max_plastic_strain") == pytest.approx(
        np.abs(expected), abs=1e-14
    )


@pytest.mark.parametrize("solver", [semismooth_newton, primal_newton])
@pytest.mark.parametrize("load", [1.0, 4.0])
def test_what_yielding_dissipates(solver, load):
    """The yield stress beta times the plastic strain: the stress is uniform, the area one."""
    problem = bar(MATERIALS["kinematic"], block.structured_mesh(2, 2), load)
    (step,) = evolve(problem, [(1.0, {})], solver).raise_for_status().steps
    (gained,) = np.abs(plastic_strains([load], K, 0.0))
    assert step.record.dissipation == pytest.approx(BOUND * gained, rel=1e-9, abs=1e-12)
    assert (load > 2.0) == (gained > 1e-3)


@pytest.mark.parametrize("kind", MATERIALS)
def test_memory_is_that_of_the_flow_rule(kind):
    mesh, material = block.structured_mesh(2, 1), MATERIALS[kind]
    loads = [4.0, -4.5]
    steps = [(float(i), {"traction": {"right": (t, 0)}}) for i, t in enumerate(loads)]
    memory = evolve(bar(material, mesh), steps).memory
    functions = {
        name: memory.functions.function(v) for name, v in memory.arrays.items()
    }
    p = plastic_strains([0.0, *loads], material.hardening, material.isotropic_hardening)
    point = mesh(0.3, 0.3)
    assert functions["plastic_strain"](point)[0] == pytest.approx(p[-1], rel=1e-11)
    assert functions["back_stress"](point)[0] == pytest.approx(
        material.hardening * p[-1], rel=1e-11
    )
    length = np.abs(np.diff(p)).sum()
    factor = material.hardening_stiffness * material.hardening_modulus * BOUND
    assert functions["hardening_variable"](point) == pytest.approx(
        factor * length, rel=1e-11
    )


def test_hexahedra_in_three_dimensions_unload_elastically():
    mesh = block.structured_mesh(2, 1, 1)
    rollers = {
        "left": (0, None, None),
        "clamped": (None, None, 0),
        "front": (None, 0, None),
    }
    problem = Problem(
        mesh,
        MATERIALS["kinematic"],
        clamped=None,
        prescribed=rollers,
        traction={"right": (2.5, 0, 0)},
    )
    evolution = evolve(problem, load_cycle(problem, [1, 0])).raise_for_status()
    p = (2.5 * math.sqrt(2 / 3) - BOUND) / K
    end = evolution.values(lambda f: f.displacement(mesh(1.0, 0.5, 0.5))[0])
    left = p * math.sqrt(2 / 3)
    assert end == pytest.approx([2.5 / 2.5e3 + left, left], rel=1e-10)
    assert evolution.column("dissipation")[1] < 1e-14


def test_kinematic_hysteresis_closes():
    problem = bar(MATERIALS["kinematic"], block.structured_mesh(2, 2), load=4.0)
    evolution = evolve(
        problem, load_cycle(problem, [1, -1, 1, -1, 1], steps=3)
    ).raise_for_status()
    loop = evolution.values(lambda f: f.displacement(problem.mesh(1.0, 0.5))[0])
    assert loop[9:] == pytest.approx(loop[3:9], rel=1e-10)
    assert abs(loop[4] - loop[6]) > 0.01  # the same load on the way there and back


def test_kinematic_body_with_contact_settles_into_a_loop():
    problem = punched(MATERIALS["kinematic"], nodes=33)
    evolution = evolve(problem, load_cycle(problem, [1, -1] * 4)).raise_for_status()
    ends = evolution.values(lambda f: f.displacement(problem.mesh(0.0, 0.5))[1])
    drift = np.abs(np.array(ends[2:]) - np.array(ends[:-2]))
    assert drift[4:].max() < 0.3 * drift[:2].max()


def test_isotropic_hardening_shakes_down():
    problem = punched(MATERIALS["isotropic"])
    evolution = evolve(problem, load_cycle(problem, [1, -1, 1, -1])).raise_for_status()
    dissipation = evolution.column("dissipation")
    assert dissipation[0] > 0
    assert dissipation[3] < 0.3 * dissipation[1]


def test_steps_start_from_the_line_through_the_last_two():
    """A step three times as long as the last one starts from the last displacement."""
    problem = punched()
    starts = []

    def solver(step, start):
        """The exact method, which is told where to start."""
        starts.append(None if start is None else start.vec.FV().NumPy().copy())
        return semismooth_newton(step, start=start)

    pairs = [(t, {"gap": 0.02 - 0.01 * t}) for t in (0.5, 1.0, 1.25, 2.0)]
    evolution = evolve(problem, pairs, solver).raise_for_status()
    u = [step.fields.displacement.vec.FV().NumPy() for step in evolution.steps]
    assert starts[0] is None
    assert (starts[1] == u[0]).all()
    assert starts[2] == pytest.approx(1.5 * u[1] - 0.5 * u[0], abs=1e-15)
    assert (starts[3] == u[2]).all()


def test_a_step_that_fails_from_the_line_is_solved_from_the_last_displacement():
    problem = punched()
    starts = []

    def solver(step, start):
        """Give up where the start is not the displacement of a step."""
        starts.append(start)
        known = start is None or start.name != "start"
        options = None if known else NewtonOptions(max_iterations=1)
        return semismooth_newton(step, start=start, options=options)

    pairs = [(t, {"gap": 0.02 - 0.01 * t}) for t in (0.5, 1.0, 1.5)]
    evolution = evolve(problem, pairs, solver).raise_for_status()
    assert len(starts) == 4
    assert starts[3] is evolution.steps[1].fields.displacement


@pytest.mark.parametrize("kinematics", ["plane strain", "plane stress", "axisymmetric"])
def test_the_elastic_energy_of_a_record_is_that_of_the_fields(kinematics):
    problem = dataclasses.replace(
        punched(), kinematics=kinematics, initial_strain=1e-3 * (1 + x)
    )
    evolution = evolve(problem, load_cycle(problem, [1.0], steps=2)).raise_for_status()
    step = evolution.steps[-1]
    e = step.fields.elastic_strain
    stored = InnerProduct(step.fields.stress, e) / 2 * problem.kinematics.weight
    rules = plastic_points(problem.mesh, problem.order)
    expected = Integrate(stored * dx(intrules=rules), problem.mesh)
    assert step.record.elastic_energy == pytest.approx(expected, rel=1e-10)


def test_each_step_is_checked_once(monkeypatch):
    problem = punched()
    checked = []
    monkeypatch.setattr(
        "ngepc.model.problem.check_problem", lambda *given: checked.append(given)
    )
    pairs = [(t, {"gap": 0.02 - 0.01 * t}) for t in (0.5, 1.0, 1.5)]
    evolve(problem, pairs).raise_for_status()
    assert len(checked) == len(pairs)


def test_one_step_is_the_solver_alone():
    problem = punched()
    evolution = evolve(problem, [(1.0, {})])
    alone = primal_newton(problem)
    assert evolution.steps[0].record.primal_energy == pytest.approx(
        alone.primal_energy, rel=1e-14
    )
    assert evolution.steps[0].record.contact_force == pytest.approx(
        alone.contact_force, rel=1e-12
    )


@pytest.mark.parametrize(("stiffness", "hardening"), [(0.0, K), (K1, 0.0)])
def test_a_given_history_stays_where_nothing_adds_to_it(stiffness, hardening):
    """A scalar that moves the bound but does not grow, a back stress that stays."""
    isotropic = {"hardening_modulus": H, "hardening_stiffness": stiffness}
    material = Material(**ELASTIC, **isotropic, hardening=hardening)
    back = CF((0.3, 0, 0, 0, -0.3, 0, 0, 0, 0), dims=(3, 3))
    mesh = block.structured_mesh(2, 2)
    data = {"traction": {"right": (4.0, 0)}, "initial_hardening": (0.1, back)}
    problem = Problem(mesh, material, **data)
    alone = primal_newton(problem)
    first = evolve(problem, [(1.0, {})]).steps[0]
    assert first.record.primal_energy == pytest.approx(alone.primal_energy, rel=1e-12)
    without = primal_newton(dataclasses.replace(problem, initial_hardening=0.1))
    assert abs(without.primal_energy - alone.primal_energy) > 1e-3 * abs(
        alone.primal_energy
    )


def test_work_balances_energy_as_steps_shrink():
    """Work of the loads = stored + hardening + dissipated energy, up to O(time step)."""
    material, mesh = MATERIALS["kinematic"], lshape.paper_mesh(33)
    problem = Problem(mesh, material, traction={"load": (0.0, 3.0)})
    errors = []
    for steps in (4, 8):
        evolution = evolve(problem, load_cycle(problem, [1.0], steps=steps))
        work, force, end = 0.0, 0.0, 0.0
        for step in evolution.steps:
            moved = Integrate(3.0 * step.fields.displacement[1] * ds("load"), mesh)
            new = step.record.time
            work, force, end = work + 0.5 * (force + new) * (moved - end), new, moved
        stored = evolution.column("elastic_energy")[-1] + sum(
            evolution.column("dissipation")
        )
        p = evolution.memory.functions.function(
            evolution.memory.arrays["plastic_strain"]
        )
        back = 0.5 * K * Integrate(InnerProduct(p, p), mesh)
        errors.append(abs(work - stored - back) / work)
    assert errors[1] < 0.6 * errors[0] < 0.05


def test_gaps_and_supports_change_in_time():
    mesh = block.structured_mesh(2, 2)
    sides = {"left": (0, None), "right": (0, None)}
    problem = Problem(
        mesh, MATERIALS["kinematic"], contact="contact", gap=0.1, prescribed=sides
    )
    steps = [
        (1.0, {"gap": -0.01}),
        (2.0, {"gap": 0.1}),
        (3.0, {"gap": -0.02 * IfPos(x, 1, 1)}),
    ]
    evolution = evolve(problem, steps).raise_for_status()
    force = evolution.column("contact_force")
    assert force[1] == pytest.approx(0.0, abs=1e-12)
    assert force[2] > force[0] > 1
    assert evolution.values(
        lambda f: f.displacement(mesh(0.5, 1.0))[1]
    ) == pytest.approx(
        [-0.01, evolution.steps[1].fields.displacement(mesh(0.5, 1.0))[1], -0.02]
    )


def failing_above(iterations):
    def solver(problem, start=None):
        return primal_newton(problem, start, PrimalOptions(max_iterations=iterations))

    return solver


@pytest.fixture(scope="module")
def cut():
    """A step to the whole load, whose solver takes at most six Newton steps."""
    problem = punched(MATERIALS["kinematic"])
    return evolve(problem, load_cycle(problem, [1.0]), failing_above(6))


def test_failing_steps_are_cut_and_said(cut):
    problem = cut.problem
    schedule = load_cycle(problem, [1.0])
    whole = evolve(problem, schedule).raise_for_status()
    assert whole.steps[0].record.iterations > 6
    assert cut.status is Status.CONVERGED
    assert cut.times[-1] == 1.0
    assert len(cut.steps) > 1
    assert max(cut.column("cuts")) >= 1
    assert max(cut.column("iterations")) <= 6
    fine = [(t, schedule.changes(t)) for t in cut.times]
    again = evolve(problem, fine).raise_for_status()
    assert again.column("contact_force") == pytest.approx(
        cut.column("contact_force"), rel=1e-8
    )


def durations(evolution):
    return [step.problem.duration for step in evolution.steps]


def test_steps_know_how_long_they_last(cut):
    problem = bar(MATERIALS["kinematic"], block.structured_mesh(1, 1), 3.0)
    pairs = [(0.5, {}), (2.0, {}), (2.25, {})]
    assert durations(evolve(problem, pairs)) == [0.5, 1.5, 0.25]
    listed = Schedule.listed(pairs, begin=-1.0)
    assert durations(evolve(problem, listed)) == [1.5, 1.5, 0.25]
    unknown = evolve(problem, [(0.0, {}), (2.0, {})])
    assert durations(unknown) == [None, 2.0]
    function = Schedule((3.0, 4.0), lambda time: {}, begin=1.0)
    assert durations(evolve(problem, function)) == [2.0, 1.0]
    assert durations(cut) == np.diff([0.0, *cut.times]).tolist()
    with pytest.raises(ValueError, match=r"begin=0.5: increasing .* 0.5 does not come"):
        Schedule.listed(pairs, begin=0.5)


def test_the_error_of_an_iterable_of_steps_is_not_replaced():
    def steps():
        yield 1.0, {"gap": float("O.1")}

    with pytest.raises(ValueError, match="could not convert string"):
        Schedule.listed(steps())
    for wrong in (1.0, [1.0], [(1.0,)], ["step"]):
        with pytest.raises(TypeError, match=r"pairs .* are needed"):
            Schedule.listed(wrong)


@pytest.mark.parametrize("name", ["duration", "order", "thickness"])
def test_the_body_and_the_length_of_a_step_are_no_changes(name):
    """Histories belong to the integration points, energies to the thickness of the body."""
    problem = bar(MATERIALS["kinematic"], block.structured_mesh(1, 1), 3.0)
    with pytest.raises(ValueError, match=f"'{name}': a step can change material"):
        evolve(problem, [(1.0, {}), (2.0, {name: 2})])


@pytest.mark.parametrize("cuts", [0, 1])
def test_a_step_that_cannot_be_cut_further_is_named(cuts):
    problem = punched()
    evolution = evolve(problem, load_cycle(problem, [1.0]), failing_above(1), cuts=cuts)
    assert evolution.status is Status.ITERATION_LIMIT
    assert "to time" in evolution.message
    with pytest.raises(SolverError):
        evolution.raise_for_status()


def test_listed_steps_are_not_cut():
    evolution = evolve(punched(), [(1.0, {})], failing_above(1))
    assert evolution.status is Status.ITERATION_LIMIT
    assert evolution.steps == []


KILLED = """
import os, signal, sys
from ngsolve import SetNumThreads
from test_evolution import evolve, load_cycle, punched

def kill(step):
    if step.record.time > 1.4:
        os.kill(os.getpid(), signal.SIGKILL)

SetNumThreads(1)
problem = punched()
evolve(problem, load_cycle(problem, [1, -1, 0.5], steps=2), checkpoint=sys.argv[1], monitor=kill)
"""


@pytest.mark.parametrize("way", ["stopped", "killed"])
def test_restart_continues_to_the_same_digits(tmp_path, way):
    problem, file = punched(), tmp_path / "steps.npz"
    schedule = load_cycle(problem, [1, -1, 0.5], steps=2)
    whole = evolve(problem, schedule)

    def interrupt(step):
        if step.record.time > 1.4:
            raise StopIteration

    if way == "killed":
        run = [sys.executable, "-c", KILLED, str(file)]
        assert subprocess.run(run, cwd=HERE, env=BESIDE).returncode == -signal.SIGKILL
    else:
        stopped = evolve(problem, schedule, checkpoint=file, monitor=interrupt)
        assert stopped.status is Status.STOPPED
        assert len(stopped.steps) == 3
    solved = []
    rest = evolve(
        problem, schedule, checkpoint=file, monitor=lambda s: solved.append(s)
    )
    assert len(solved) == 3
    assert rest.as_rows() == whole.as_rows()
    for name, values in whole.memory.arrays.items():
        assert (rest.memory.arrays[name] == values).all()
    finished = evolve(problem, schedule, checkpoint=file, monitor=interrupt)
    assert finished.status is Status.CONVERGED
    assert finished.as_rows() == whole.as_rows()
    stress = [
        e.steps[3].fields.stress(problem.mesh(0.7, 0.7)) for e in (whole, finished)
    ]
    assert stress[0] == stress[1]


def test_restart_with_friction_continues_to_the_same_digits(tmp_path):
    """What a solver learns of the compliance of the contact rows is not kept."""
    file = tmp_path / "steps.npz"
    problem = dataclasses.replace(punched(), friction=Coulomb(0.3))
    schedule = load_cycle(problem, [1.0], steps=3)
    whole = evolve(problem, schedule)

    def interrupt(step):
        if step.record.time > 0.5:
            raise StopIteration

    stopped = evolve(problem, schedule, checkpoint=file, monitor=interrupt)
    assert len(stopped.steps) == 2
    rest = evolve(problem, schedule, checkpoint=file)
    assert rest.as_rows() == whole.as_rows()
    assert (rest.steps[-1].contact == whole.steps[-1].contact).all()
    assert whole.column("max_slip")[-1] > 0


@pytest.mark.parametrize("name", MATERIALS)
def test_a_history_goes_on_from_the_fields_of_another(name):
    """The fields at the end of three steps are all that two more steps need, with friction."""
    problem = Problem(
        block.structured_mesh(3, 3, simplices=True),
        MATERIALS[name],
        contact="contact",
        gap=-2e-3,
        friction=0.3,
        traction={"right": (2.0, 0.0)},
    )
    factors = [0.5, 1.0, -1.0, 0.2, -2.0]
    whole = evolve(problem, load_cycle(problem, factors))
    first = evolve(problem, load_cycle(problem, factors[:3]))
    last = first.steps[-1].fields
    left = problem.changed(
        initial_plastic_strain=last.plastic_strain,
        initial_hardening=(last.hardening_variable, last.back_stress),
        initial_accumulated=last.accumulated_plastic_strain,
        initial_displacement=last.displacement,
    )
    rest = evolve(left, load_cycle(left, factors[3:]))
    for quantity in ("contact_force", "max_plastic_strain", "elastic_energy"):
        expected = whole.column(quantity)[3:]
        assert rest.column(quantity) == pytest.approx(expected, rel=1e-7)
    assert whole.column("dissipation")[-1] > 0


def test_the_result_of_a_step_does_not_claim_to_have_taken_no_newton_steps():
    problem = bar(MATERIALS["kinematic"], block.structured_mesh(1, 1), load=2.0)
    step = evolve(problem, load_cycle(problem, [1.0])).steps[0]
    assert step.record.iterations > 0
    assert "Newton steps" not in step.solution.summary()
    assert "Newton steps" in semismooth_newton(problem).summary()


def test_columns_and_quantities_are_named_where_they_do_not_exist():
    problem = bar(MATERIALS["kinematic"], block.structured_mesh(1, 1))
    history = evolve(problem, load_cycle(problem, [1.0]))
    with pytest.raises(ValueError, match="name='force': one of time, cuts, "):
        history.column("force")
    with pytest.raises(TypeError, match="quantity='force': a function of the fields"):
        history.values("force")


def test_restart_in_the_middle_of_a_cut_step(cut, tmp_path):
    problem, file = cut.problem, tmp_path / "steps.npz"
    schedule = load_cycle(problem, [1.0])
    solver = failing_above(6)

    def interrupt(step):
        raise StopIteration

    evolve(problem, schedule, solver, checkpoint=file, monitor=interrupt)
    assert evolve(problem, schedule, solver, checkpoint=file).as_rows() == cut.as_rows()


def test_damaged_and_foreign_checkpoints_are_refused_and_kept(tmp_path):
    problem, file = punched(), tmp_path / "steps.npz"
    steps = [(1.0, {}), (2.0, {"gap": 0.01})]
    evolve(problem, steps, checkpoint=file)
    content = file.read_bytes()
    other = dataclasses.replace(problem, gap=0.03)
    with pytest.raises(ValueError, match="other work: problem"):
        evolve(other, steps, checkpoint=file)
    with pytest.raises(ValueError, match="other work: times"):
        evolve(problem, [*steps, (3.0, {})], checkpoint=file)
    with pytest.raises(ValueError, match="step to time 2 had other data"):
        evolve(problem, [steps[0], (2.0, {"gap": 0.015})], checkpoint=file)
    assert file.read_bytes() == content
    file.write_bytes(content[:-200])
    with pytest.raises(ValueError, match="damaged"):
        evolve(problem, steps, checkpoint=file)
    assert file.read_bytes() == content[:-200]


def test_checkpoint_that_cannot_be_written_is_an_error_before_the_work(tmp_path):
    def solver(problem, start=None):
        raise AssertionError("no work must be done")

    with pytest.raises(OSError, match="folder"):
        evolve(punched(), [(1.0, {})], solver, checkpoint=tmp_path)


def test_dual_solver_follows_the_same_history():
    """The methods differ by discretisation, by far less than the history matters."""
    problem = punched(MATERIALS["kinematic"], nodes=225)
    schedule = load_cycle(problem, [1, 0.2])
    primal = evolve(problem, schedule).raise_for_status()
    dual = evolve(problem, schedule, cold_start(semismooth_newton))
    dual.raise_for_status()
    forgotten = evolve(problem, [(2.0, schedule.changes(2.0))]).raise_for_status()
    for name in ("contact_force", "elastic_energy"):
        with_history, without = primal.column(name)[1], forgotten.column(name)[0]
        difference = abs(dual.column(name)[1] - with_history)
        assert difference < 0.25 * abs(with_history - without), name


def test_memory_of_the_initial_state_is_what_was_given():
    mesh = block.structured_mesh(2, 2)
    problem = bar(MATERIALS["combined"], mesh)
    first = evolve(problem, [(1.0, {"traction": {"right": (4.0, 0)}})])
    onward = first.memory.problem(problem, {})
    again = Memory.initial(onward)
    for name, values in first.memory.arrays.items():
        assert np.abs(again.arrays[name] - values).max() < 1e-14


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([], "at least one step"),
        ([(1.0, {}), (1.0, {})], "does not come after"),
        ([(1.0, {"gaps": 0.1})], "name 'gaps'"),
        ([(1.0, {"mesh": None})], "name 'mesh'"),
        ([(1.0, {"initial_accumulated": 0.1})], "name 'initial_accumulated'"),
        ([(1.0, {"initial_displacement": (0, 0)})], "name 'initial_displacement'"),
        ([(float("nan"), {})], "times"),
        ([(1.0, {"gap": float("nan")})], "gap"),
    ],
)
def test_bad_steps_are_refused_before_the_work(steps, message):
    def solver(problem, start=None):
        raise AssertionError("no work must be done")

    with pytest.raises(ValueError, match=message):
        evolve(punched(), steps, solver)


@pytest.mark.parametrize("steps", [3, [1.0, 2.0], "ab"])
def test_steps_of_the_wrong_kind_are_refused(steps):
    with pytest.raises(TypeError, match="steps"):
        evolve(punched(), steps)


def test_schedules_check_their_times():
    with pytest.raises(ValueError, match="does not come after"):
        Schedule([0.0, 1.0], lambda t: {})
    with pytest.raises(TypeError, match="changes"):
        Schedule([1.0], {})
    with pytest.raises(ValueError, match="factors"):
        load_cycle(punched(), [])
    with pytest.raises(ValueError, match="problem has no loads to scale"):
        load_cycle(dataclasses.replace(punched(), traction=None), [1])


@pytest.mark.parametrize("support", [(0.0, None), Roller()])
def test_supports_and_gaps_are_no_loads_to_scale(support):
    """A punch pressed into half a block by its gap would not move in a load cycle."""
    held = punched().changed(traction={}, prescribed={"load": support})
    with pytest.raises(
        ValueError, match="gaps are not scaled: a Schedule changes them"
    ):
        load_cycle(held, [1, 0])
    pushed = held.changed(prescribed={"load": (1e-3, None)})
    assert load_cycle(pushed, [0.5]).at(1.0)["prescribed"] == {"load": (5e-4, None)}


def test_checkpoints_of_other_solver_settings_or_friction_are_other_work():
    from ngepc import semismooth_newton
    from ngepc.evolution.solver import cold_start
    from ngepc.geometries import lshape
    from ngepc.model.problem import lshape_problem
    from ngepc.results.checkpoint import problem_fingerprint

    names = {cold_start(semismooth_newton, gamma=g).__qualname__ for g in (1e3, 1e4)}
    assert len(names) == 2
    problem = lshape_problem(lshape.paper_mesh(65))
    digests = {
        problem_fingerprint(p)
        for p in (
            problem,
            dataclasses.replace(problem, friction=0.1),
            dataclasses.replace(problem, friction=0.2),
        )
    }
    assert len(digests) == 3


def test_all_data_of_a_problem_are_in_its_fingerprint():
    """Also fields of one's own kinematics, and of a material with the same law; places by name."""
    from ngsolve import CF

    from ngepc.model.kinematics import PLANE_STRAIN, Kinematics
    from ngepc.model.places import Roller
    from ngepc.results.checkpoint import problem_fingerprint

    @dataclasses.dataclass(frozen=True, eq=False)
    class Slice(Kinematics):
        thickness: float = 1.0

    def digest(**changes):
        data = {
            "clamped": "clamped",
            "contact": "contact",
            "gap": 0,
            "kinematics": PLANE_STRAIN,
        }
        given = {"mesh": mesh, "material": MATERIALS["combined"], **data, **changes}
        return problem_fingerprint(Problem(**given))

    mesh = block.structured_mesh(2, 2)
    plane = (PLANE_STRAIN.N, PLANE_STRAIN.basis)
    elastic = {"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": 1.0}
    hardened = [
        Material.isotropic(**elastic, hardening_modulus=H, hardening_stiffness=k)
        for H, k in ((2.0, 1.0), (1.0, 4.0))  # the same (H sigma_y)^2 k
    ]
    corner = Point((1, 1))
    different = [
        *({"kinematics": Slice("slice", *plane, thickness=h)} for h in (1.0, 5.0)),
        *({"material": one} for one in hardened),
        *({"springs": {"left": k}} for k in (1.0, (1.0, 1.0))),
        *({"traction": {corner: (f, 0.0)}} for f in (1.0, CF(2.0) * x + 2)),
        *(
            {"prescribed": {"left": c}}
            for c in ((0, None), (None, 0), Roller(), Roller((1, 2)))
        ),
        *({"gap": g} for g in (0.1, x, 1 - x)),
    ]
    assert len({digest(**changes) for changes in different}) == len(different)
    both = {"left|right": 1.0}
    assert digest(gap=0.0) == digest(gap={"contact": 0})
    assert digest(pressure=both) == digest(pressure={"right": 1.0, "left": 1})
    assert digest(pressure=both) != digest(traction={"left|right": (1.0, 0.0)})
    assert digest(clamped=("left", "right")) == digest(clamped="left|right")


@pytest.fixture(scope="module")
def rolled():
    """A square between rollers and an obstacle, pulled and pushed; its history and its file."""
    mesh = block.structured_mesh(3, 3, simplices=True)
    problem = Problem(
        mesh,
        MATERIALS["combined"],
        clamped="clamped",
        prescribed={"left": (0, None)},
        traction={"right": (3.0, 0.5)},
        contact="contact",
        gap=-0.001,
    )
    return problem, load_cycle(problem, [1, -1], steps=2)


@pytest.mark.parametrize("solver", [primal_newton, cold_start(semismooth_newton)])
def test_records_tell_the_force_of_every_support(rolled, solver):
    """Loads, obstacles and supports balance in every step; the rollers hold one component."""
    problem, schedule = rolled
    evolution = evolve(problem, schedule, solver).raise_for_status()
    supports = evolution.reactions("clamped") + evolution.reactions("left")
    assert supports == pytest.approx(np.array(evolution.column("reaction")), abs=1e-12)
    total = (
        supports
        + evolution.column("applied_force")
        + evolution.column("contact_resultant")
    )
    assert total == pytest.approx(np.zeros((4, 2)), abs=1e-9)
    pushes = np.array(evolution.column("contact_resultant"))[:, 1]
    assert pushes == pytest.approx(
        -np.array(evolution.column("contact_force")), rel=1e-9
    )
    assert pushes.min() < -0.5
    assert repr(evolution) == "<Evolution: converged, 4 steps, the last one to time 2>"
    assert repr(evolution.steps[0]).startswith(
        "<EvolutionStep: to time 0.5, Newton steps "
    )
    with pytest.raises(ValueError, match=r"support='right'.* of clamped, left"):
        evolution.reactions("right")


def test_the_force_of_a_point(rolled):
    """Its springs take what the clamp does not."""
    problem, schedule = rolled
    corner = Point((1.0, 1.0))
    history = evolve(problem.changed(springs={corner: (5.0, 7.0)}), schedule)
    forces = history.reactions(corner)
    lasts = history.steps[-1].solution.equilibrium.reactions[corner]
    assert forces[-1] == pytest.approx(lasts, rel=1e-12)
    assert np.abs(forces).min() > 0
    with pytest.raises(ValueError, match=r"support=Point\(where=\(0.0, 1.0\)\)"):
        history.reactions(Point((0.0, 1.0)))


def test_reactions_come_back_from_a_checkpoint(rolled, tmp_path):
    problem, schedule = rolled
    file = tmp_path / "steps.npz"
    whole = evolve(problem, schedule, checkpoint=file)
    again = evolve(problem, schedule, checkpoint=file)
    assert again.as_rows() == whole.as_rows()
    assert (again.reactions("left") == whole.reactions("left")).all()


def test_elastic_unloading_takes_no_newton_step_where_the_line_through_two_steps_is_exact():
    """The state that a step leaves is on the yield surface: rounding must not count as yielding.

    The first step after the turn starts in the wrong direction.
    """
    problem = bar(
        MATERIALS["kinematic"], block.structured_mesh(4, 4, simplices=True), load=4.0
    )
    evolution = evolve(
        problem, load_cycle(problem, [1, 0.4], steps=3)
    ).raise_for_status()
    assert evolution.column("iterations")[3:] == [2, 0, 0]
    assert max(evolution.column("dissipation")[3:]) < 1e-15
