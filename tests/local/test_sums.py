"""Bodies in parts, without MPI: every number is that of the whole, and no sum can be left out.

``teams`` runs the processes as threads.  ``PYTHONPATH=tests python tests/local/test_sums.py`` takes
one sum over processes away after the other, or those that it is given, and tells which is the first
body that notices it, by a number that changes or a run that fails.  The tests do that for some.
"""

import re
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from ngsolve import IfPos, Integrate, Mesh, Norm, sqrt, x
from teams import Jacobi, run

import ngepc
from ngepc import Coulomb, Material, NewtonOptions, Problem, Voce, evolve
from ngepc import semismooth_newton as solve
from ngepc.geometries import block
from ngepc.geometries.outlines import netgen_mesh
from ngepc.local.indicators import error_indicators
from ngepc.model import parts
from ngepc.model.obstacles import Sphere
from ngepc.model.processes import Team

PACKAGE = Path(ngepc.__file__).parent
OPTIONS = NewtonOptions(inverse=Jacobi(max_iterations=3000), tolerance=1e-9)
METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
)
PERFECT = Material.with_law(lame_lambda=1e3, lame_mu=1e3, law=Voce(4.0, 0.0, 1.0))
SAMPLE = {
    "discretisation/conditions.py:ContactConditions.at_vertices summed": "clamped",
    "discretisation/conditions.py:at_rows summed": "ribs",
    "discretisation/gap_records.py:nearer_between_nodes maximum": "ribs",
    "discretisation/supports.py:Supports.pull summed": "springs",
    "evolution/result.py:StepRecord.of maximum": "steps",
    "linalg/descent.py:conjugate_gradients dot": "clamped",
    "local/indicators.py:averaged summed": "clamped",
    "model/support.py:_agreed summed": "halves",
    "results/equilibrium.py:Equilibrium.resultant total": "clamped",
    "results/result.py:DiscreteSolution._hidden_overlap maximum": "ribs",
    "results/remarks.py:longest_way maximum": "ribs",
}
"""Sums of each room that has any, those that few bodies notice, and such a body."""

UNNOTICED = {
    "discretisation/conditions.py:initial_displacements spread": "equal but for rounding",
    "local/active_set.py:InexactTarget.__call__ spread": "equal but for rounding",
    "local/active_set.py:InexactTarget._sets any": "in these bodies all end at the same set",
    "local/iterative.py:IterativeTangent.minimise dot": "whether a start is zero",
    "model/support.py:_agreed any": "all processes with the vertex see it",
    "results/iteration.py:slope_rounding dot": "an estimate of rounding",
    "results/iteration.py:slope_rounding maximum": "an estimate of rounding",
    "results/iteration.py:slope_rounding total": "an estimate of rounding",
}
"""Sums that may be left out without a change of a number, and why."""


def bodies(comm):
    """Solids with each kind of contact and support; a plane one for several boundaries.

    ``steps``, solved for two steps, and ``sphere`` are on a mesh before its refinement.
    """
    whole = block.structured_mesh(2, 2, 2, simplices=True)
    coarse = parts.distribute(whole if comm.rank == 0 else None, comm)
    pressed = {"contact": "contact", "gap": -0.03, "order": 1}
    mesh = coarse.refined()
    free = Problem(mesh, METAL, **pressed)
    yield "clamped", free
    yield "halves", halves(comm)
    yield "ribs", ribs(comm)
    rough = Problem(coarse, METAL, friction=Coulomb(0.3), **pressed)
    yield "steps", rough
    sphere = Sphere(centre=(0.5, 0.5, 1.95), radius=1.0)
    yield "sphere", replace(rough, friction=None, gap=sphere.gap(coarse))
    springs = {"clamped": 2e3, "left": (10.0, 20.0, 30.0)}
    yield "springs", replace(free, clamped=None, springs=springs)
    push = {"traction": {"contact": (0.5, 0.0, -4.0)}, "contact": None, "gap": None}
    yield "perfect", replace(free, material=PERFECT, **push)
    held = {"clamped": (0, 0, 0), "left": (0, None, None), "right": (0, None, None)}
    yield "guided", replace(free, clamped=None, prescribed=held)
    yield "Tresca", replace(free, friction=1.0 + x)


def strip():
    """Four by two squares cut in two; what is above and below the left half has other names.

    The cut between the parts ends where these boundaries end: a vertex of a boundary lies on a
    process that has no element of it.
    """
    points = np.array([(i / 2, j / 2) for j in range(3) for i in range(5)], dtype=float)
    cells = []
    for j in range(2):
        for i in range(4):
            a, b, c, d = np.array([0, 1, 6, 5]) + 5 * j + i
            cells += [(a, b, c), (a, c, d)]
    sides = {"contact": (0, 2, 0), "below": (2, 4, 0), "held": (0, 2, 10)}
    sides["above"] = (2, 4, 10)
    regions = [(2, "body", np.array(cells))]
    for name, (first, last, row) in sides.items():
        ends = [(row + i, row + i + 1) for i in range(first, last)]
        regions.append((1, name, np.array(ends)))
    regions.append((1, "left", np.array([(0, 5), (5, 10)])))
    regions.append((1, "right", np.array([(4, 9), (9, 14)])))
    return Mesh(netgen_mesh(2, points, regions))


def halves(comm):
    """A plane body with contact and friction on one of two processes, a support on the other."""
    mesh = parts.distribute(strip() if comm.rank == 0 else None, comm)
    disc = Sphere(centre=(0.3, -0.5), radius=0.52)
    return Problem(
        mesh,
        METAL,
        None,
        {"left": (0.2, -6.0)},
        prescribed={"above": (0.0, 0.0)},
        contact="contact",
        gap=disc.gap(mesh),
        friction=Coulomb(IfPos(0.9 - x, 0.3 * (0.9 - x), 0.0)),
        kinematics="plane strain",
        order=1,
    )


def ribs(comm):
    """A plane body of order two under a high and a very low rib, both before one process.

    The low one counts beside the gaps of that process, not beside the largest of all.  Friction
    ends at the cut, where its coefficient is the mean of those of both sides.
    """
    whole = block.structured_mesh(4, 2, size=(2, 1), simplices=True)
    mesh = parts.distribute(whole if comm.rank == 0 else None, comm)
    opening = IfPos(x - 1.5, 0.6 * (x - 1.5), 0.0)
    return Problem(
        mesh,
        METAL,
        contact="contact",
        gap=opening - 0.02 - rib(0.3, 0.01) - rib(0.8, 1e-5),
        friction=Coulomb(IfPos(1 - x, 0.3, 0.0)),
        kinematics="plane strain",
        order=2,
    )


def rib(place, height):
    """A rib with a width of 0.1 along the obstacle, narrower than a facet."""
    part = 1 - sqrt((x - place) ** 2) / 0.05
    return height * IfPos(part, part, 0.0)


def refused(comm):
    """The kind of error for a vertex with two given displacements, each known to one process."""
    mesh = parts.distribute(strip() if comm.rank == 0 else None, comm)
    held = {"above": (0.0, 0.0), "held": (0.0, 0.1)}
    try:
        Problem(mesh, METAL, None, prescribed=held, kinematics="plane strain", order=1)
    except ValueError as error:
        return "must agree" in str(error)
    return "accepted"


def between(result):
    """A state on the way to a solution, which is not feasible."""
    discrete = result.state.discrete
    return discrete.state(2.0 * result.state.u, contact=0.5 * result.state.contact)


def overlaps(result):
    """Whether states short of a solution are said to overlap the obstacle between nodes.

    Half of the displacement is; where only 1.3 percent are missing the overlap is 1.2 percent of
    the largest displacement of the process with the ribs, and 0.8 percent of that of all.
    """
    for share in (0.5, 0.987):
        part = result.state.discrete.state(
            share * result.state.u, contact=result.state.contact
        )
        yield "Between nodes" in replace(result, state=part).message


def integrals(result):
    """Those of contact pressure and friction over the contact boundary."""
    problem = result.problem
    boundary = problem.mesh.Boundaries("|".join(problem.touching_names))
    for density in (result.contact_pressure, Norm(result.friction_stress)):
        here = Integrate(density, problem.mesh, definedon=boundary)
        yield problem.processes.total(here)


def numbers(result):
    """Room -> what a user reads, the same on all processes."""
    state = between(result)
    problem = result.problem
    processes = problem.processes
    indicators = error_indicators(result).vec.FV().NumPy()
    balance = result.equilibrium
    return {
        "model": [processes.node_count, processes.maximum(np.abs(result.open_gap))],
        "discretisation": [
            result.contact_area,
            result.state.body.yield_forces,
            state.penetration,
            state.touching_distance * 1e9,
            state.trial_forces,
            state.force_scale,
            state.residual_norm,
            state.friction_work,
            result.state.flowing,
            *balance.resultant(balance.applied),
            *balance.moment(balance.applied),
        ],
        "results": [
            result.contact_force,
            *integrals(result),
            *result.friction_force,
            result.contact_facets,
            result.largest_strain,
            result.largest_rotation,
            *np.concatenate([*balance.reactions.values(), np.zeros(3)]),
        ],
        "local": [
            result.iterations,
            result.primal_energy,
            result.history.records[-1].plastic_active,
            result.history.records[-1].friction_active,
            result.residual_rounding if hasattr(result, "residual_rounding") else 0.0,
            processes.total(float(indicators.sum())),
        ],
        "iterations": [sum(result.history.column("linear_iterations"))],
    }


def history(problem):
    """Room -> numbers and words of a short history under a plane that tilts to the other side."""
    steps = [(1.0, {"gap": 0.02 - 0.06 * x}), (2.0, {"gap": 0.08 * x - 0.06})]
    found = evolve(problem, steps, partial(solve, options=OPTIONS))
    names = (
        "contact_force",
        "elastic_energy",
        "dissipation",
        "max_plastic_strain",
        "max_contact_pressure",
        "max_slip",
    )
    rows = found.as_rows()
    figures = [row[name] for row in rows for name in names]
    return {"evolution": np.array(figures), "words": found.message}


def readings(comm, only=()):
    """(body, room) -> numbers of all bodies or of some; words are compared, too."""
    found = {("refusal", "words"): refused(comm)}
    for name, problem in bodies(comm):
        if only and name not in only:
            continue
        result = solve(problem, options=OPTIONS)
        for room, values in numbers(result).items():
            found[name, room] = np.array(values, dtype=float)
        told = result.summary()
        # One process alone searches for equilibria.
        alone = r"Friction\b.*?\. "
        note = re.sub(alone, "", told.get("note", "") + " ").strip()
        found[name, "words"] = (told["status"], told["body"], note)
        if name == "ribs":
            found[name, "overlaps"] = np.array([*overlaps(result)], dtype=float)
        if name == "steps":
            for room, values in history(problem).items():
                found["history", room] = values
    return found


ROUNDED = 0.05
"""Fraction by which numbers of linear iterations may differ: sums are rounded in another order."""


def differences(one, two):
    """Where the numbers of two processes are not those of one."""
    for key in two[0]:
        expected = one[key]
        for found in two:
            close = ROUNDED if key[1] == "iterations" else 1e-6
            same = (
                found[key] == expected
                if key[1] == "words"
                else np.allclose(found[key], expected, rtol=close, atol=1e-9)
            )
            if not same:
                yield key


@cache
def whole(only=()):
    """The numbers of one process, of all bodies or of some."""
    return run(1, partial(readings, only=only))[0]


def caller():
    """Module and function of the package that called a method of ``Team``."""
    frame = sys._getframe(2)
    while frame.f_code.co_filename.endswith("processes.py"):
        frame = frame.f_back
    return place_of(frame.f_code)


@cache
def place_of(code):
    """Module of the package and name of a function, None for one of another package."""
    path = Path(code.co_filename)
    if not path.is_relative_to(PACKAGE):
        return None
    return f"{path.relative_to(PACKAGE)}:{code.co_qualname}"


LOCAL = {
    "total": lambda team, value: value,
    "summed": lambda team, values: values,
    "spread": lambda team, values: values,
    "dot": lambda team, a, b: float(np.vdot(a, b)),
    "norm": lambda team, a: float(np.linalg.norm(a)),
    "maximum": lambda team, values: float(values.max(initial=0.0)),
    "any": lambda team, flags: bool(flags.any()),
}
"""What is left of each sum where a process takes its own part for the whole."""


def with_sums(patch, left_out=None, seen=None):
    """Let the sum at one place be left out, and note at which places there are sums."""
    for name, local in LOCAL.items():
        usual = getattr(Team, name)

        def method(self, *values, name=name, local=local, usual=usual):
            place = f"{caller()} {name}"
            if seen is not None and self.size > 1:
                seen.add(place)
            found = usual(self, *values)
            return local(self, *values) if place == left_out else found

        patch.setattr(Team, name, method)


@cache
def two_processes():
    """Where the numbers of two processes differ, and where the package sums over them."""
    seen = set()
    with pytest.MonkeyPatch.context() as patch:
        with_sums(patch, seen=seen)
        different = list(differences(whole(), run(2, readings)))
    places = sorted(place for place in seen if not place.startswith("None"))
    return different, places


def told_by(place, body, expected, seen=None):
    """What notices that the sum at one place is left out, of a body; empty for nothing."""
    with pytest.MonkeyPatch.context() as patch:
        with_sums(patch, left_out=place, seen=seen)
        try:
            found = run(2, partial(readings, only=(body,)))
        except Exception as error:  # a run that fails has noticed the missing sum
            return f"{type(error).__name__} of {body}: {error}"
    different = set(differences(expected, found))
    return ", ".join(sorted(f"{room} of {name}" for name, room in different))


def first_told(place):
    """What the first body that notices a missing sum tells, or why none does."""
    seen = set()
    for body in run(1, lambda comm: [name for name, _ in bodies(comm)])[0]:
        if told := told_by(place, body, whole((body,)), seen):
            return told
    if place not in seen:
        return "there is no such sum in these bodies"
    return UNNOTICED.get(place, "NOTHING NOTICES IT")


def test_every_number_of_two_processes_is_that_of_one():
    assert two_processes()[0] == []


def test_every_number_of_three_processes_is_that_of_one():
    """Of bodies with each kind of support, with friction and without, in the plane and in space."""
    some = partial(readings, only=("springs", "Tresca", "halves", "ribs"))
    assert list(differences(whole(), run(3, some))) == []


def test_each_room_that_sums_is_in_the_sample():
    found = two_processes()[1]
    assert set(SAMPLE) | set(UNNOTICED) <= set(found)
    assert {p.split("/")[0] for p in SAMPLE} == {p.split("/")[0] for p in found}


@pytest.mark.parametrize("place", SAMPLE)
def test_a_sum_that_is_left_out_is_noticed(place):
    assert told_by(place, SAMPLE[place], whole())


if __name__ == "__main__":
    for place in sys.argv[1:] or two_processes()[1]:
        print(f"{place}: {first_told(place)}", flush=True)
