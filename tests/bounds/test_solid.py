"""The stress of a bound on tetrahedra is admissible, and the bound holds against finer meshes."""

from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
import pytest
from bodies import prisms
from campaigns.crossings import finer
from campaigns.intervals import value_of
from ngsolve import BND, CF, x, y, z

import ngepc
from ngepc import (
    Coulomb,
    Material,
    NewtonOptions,
    Roller,
    evolve,
    goal_bound,
    primal_newton,
    semismooth_newton,
    solve_to,
)
from ngepc.bounds import corners, solid
from ngepc.bounds.algebraic import FewSolves, algebraic_part
from ngepc.bounds.bound import error_bound
from ngepc.bounds.copies import bisected
from ngepc.bounds.corners import state_in_eighths
from ngepc.bounds.coverage import FACET_RULES
from ngepc.bounds.data import Effort
from ngepc.bounds.element import ELEMENTS
from ngepc.bounds.of_state import bound_data_of, bound_of_state
from ngepc.bounds.simplices import FACETS, Simplices
from ngepc.bounds.transfer import on_mesh
from ngepc.discretisation.factors import Factors
from ngepc.geometries import block
from ngepc.goals.refinement import Refinement
from ngepc.linalg.direct import FactorisationError
from ngepc.local import choice
from ngepc.local.iterative import IterativeTangent
from ngepc.local.system import DiscreteProblem
from ngepc.model.kinematics import SOLID
from ngepc.studies.bounds import LIMITS, bounded_example
from ngepc.studies.large import indented_block

Problem = partial(ngepc.Problem, order=1)
MATERIAL = Material(
    lame_lambda=1e3,
    lame_mu=1e3,
    yield_stress=1.25,
    hardening=60.0,
    hardening_modulus=2.0,
    hardening_stiffness=6.0,
)
ELASTIC = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=1e6, hardening=1e2
)
P_0 = CF((2e-4, 1e-4, 0, 1e-4, -3e-4, 5e-5, 0, 5e-5, 1e-4), dims=(3, 3))
BACK = CF((0.012, 0.006, 0, 0.006, -0.018, 0, 0, 0, 0.006), dims=(3, 3))
PARTS = ELEMENTS[3].parts


def loaded(material=ELASTIC):
    """Affine tractions on one side, constant ones on another, weight."""
    traction = {
        "right": CF((0.3 + 0.2 * y, -0.1 - 0.2 * z, 0.1)),
        "contact": (0.0, 0.1, -0.2),
    }
    return Problem(
        block.mesh(0.5), material, traction=traction, body_force=(0.1, 0.0, -0.3)
    )


def pressed():
    """A paraboloid above, weight, history, a traction."""
    return Problem(
        block.mesh(0.4),
        MATERIAL,
        traction={"right": (1.0, 0.3, 0.2)},
        contact="contact",
        gap=0.1 * ((x - 0.4) ** 2 + (y - 0.6) ** 2) - 2e-3,
        body_force=(0.3, 0.1, -1.0),
        initial_plastic_strain=P_0,
        initial_hardening=(0.01, BACK),
    )


def rollers():
    """An eighth of a block that is stretched; what is prescribed moves."""
    held = {
        "left": (0, None, None),
        "clamped": (None, None, 0),
        "front": (None, 0, None),
    }
    return Problem(
        block.mesh(0.4),
        MATERIAL,
        clamped=None,
        prescribed={**held, "right": (2e-3 + 1e-3 * z, None, None)},
        traction={"contact": (0.5, 0.2, -0.3)},
    )


def dragged():
    """A plate presses the whole top, the block slides under it."""
    return Problem(
        block.mesh(0.4),
        MATERIAL,
        traction={"right": (0.3, 0.2, 0.0)},
        contact="contact",
        gap=-1e-3,
        friction=0.2,
    )


PROBLEMS = {
    "loaded": loaded,
    "pressed": pressed,
    "rollers": rollers,
    "dragged": dragged,
}


@pytest.fixture(scope="module", params=PROBLEMS)
def bound(request):
    return error_bound(semismooth_newton(PROBLEMS[request.param]()))


def stresses(bound):
    """Tensors (nt, part, vertex, 3, 3) and the places of the five points of each cell."""
    coordinates = bound.admissible.reshape(-1, 4, 4, 6)
    sigma = coordinates[..., 0, None, None] * np.eye(3)
    sigma = sigma + np.einsum("tkvd,dij->tkvij", coordinates[..., 1:], SOLID.basis)
    cells = Simplices.of(bound.problem.mesh)
    places = cells.points[cells.nodes]
    return (
        sigma,
        np.concatenate([places, places.mean(axis=1, keepdims=True)], axis=1),
        cells,
    )


def size(bound):
    return np.abs(bound.admissible).max()


def unit_normals(places, face):
    a, b, c = (places[:, v] for v in face)
    n = np.cross(b - a, c - a)
    return n / np.linalg.norm(n, axis=1)[:, None]


def test_divergence(bound):
    sigma, places, cells = stresses(bound)
    f = np.array(bound.problem.body_force or (0.0, 0.0, 0.0), dtype=float)
    width = cells.volume.min() ** (1 / 3)
    for k, part in enumerate(PARTS):
        frame = np.concatenate([places[:, part], np.ones((len(places), 4, 1))], axis=2)
        slopes = np.linalg.inv(frame)[:, :3]  # [direction, vertex]
        divergence = np.einsum("tvij,tjv->ti", sigma[:, k], slopes)
        assert np.abs(divergence + f).max() <= 1e-11 * size(bound) / width


def test_inner_tractions_are_continuous(bound):
    sigma, places, _ = stresses(bound)
    for k, j in combinations(range(4), 2):
        face = [*(v for v in range(4) if v not in (k, j)), 4]
        n = unit_normals(places, face)
        for v in face:
            jump = sigma[:, k, PARTS[k].index(v)] - sigma[:, j, PARTS[j].index(v)]
            assert np.abs(np.einsum("tij,tj->ti", jump, n)).max() <= 1e-12 * size(bound)


def outer_tractions(bound):
    """{face: [(tractions at its ascending vertices, outer normal), ...]}"""
    sigma, places, cells = stresses(bound)
    found = {}
    for k, face in enumerate(FACETS[3]):
        n = unit_normals(places, face)
        n *= np.sign(np.einsum("ti,ti->t", n, places[:, face[0]] - places[:, 4]))[
            :, None
        ]
        values = [
            np.einsum("tij,tj->ti", sigma[:, k, PARTS[k].index(v)], n) for v in face
        ]
        sn, vertices = np.stack(values, axis=1), cells.nodes[:, face]
        for key, value, normal in zip(vertices, sn, n, strict=True):
            order = np.argsort(key)
            found.setdefault(tuple(key[order].tolist()), []).append(
                (value[order], normal)
            )
    return found


def test_tractions(bound):
    """Continuous inside, the given ones outside; contact presses, with friction at most."""
    problem, found = bound.problem, outer_tractions(bound)
    jumps = [sides[0][0] + sides[1][0] for sides in found.values() if len(sides) == 2]
    assert np.abs(jumps).max() <= 1e-12 * size(bound)
    held = {name: (True,) * 3 for name in problem.clamped_names}
    for name, values in (problem.prescribed or {}).items():
        held[name] = tuple(v is not None for v in values)
    points = Simplices.of(problem.mesh).points
    for face in problem.mesh.Elements(BND):
        vertices = sorted(v.nr for v in face.vertices)
        ((sn, n),) = found[tuple(vertices)]
        if face.mat in problem.contact_names:
            pressure = -sn @ n
            assert pressure.min() >= -1e-12 * size(bound)
            shear = np.linalg.norm(sn + pressure[:, None] * n, axis=1)
            assert shear.max() - (problem.friction or 0) <= 1e-12 * size(bound)
            continue
        g = (problem.traction or {}).get(face.mat, (0.0, 0.0, 0.0))
        if not isinstance(g, tuple):
            g = [(0.3 + 0.2 * p[1], -0.1 - 0.2 * p[2], 0.1) for p in points[vertices]]
        free = ~np.array(held.get(face.mat, (False,) * 3))
        assert np.abs((sn - np.array(g))[:, free]).max(initial=0.0) <= 1e-12 * size(
            bound
        )


def test_indicators_are_nowhere_negative(bound):
    assert bound.per_cell.min() >= -1e-12 * bound.strain_energy
    assert bound.indicators.vec.FV().NumPy().sum() == pytest.approx(
        bound.total, rel=1e-12
    )


def test_energies_of_meshes_do_not_cross(bound):
    fine = error_bound(semismooth_newton(finer(bound.problem, 1)))
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    most = (
        2.0 if bound.problem.friction else 1.5
    )  # tangential tractions are not sharpened
    assert bound.total < most * (bound.energy - fine.energy + fine.total)


def test_the_element():
    """30 stresses without divergence, fixed by the moments; constant stresses are among them."""
    element = ELEMENTS[3]
    assert element.free == 30
    assert np.linalg.matrix_rank(element.moments[:, :30], tol=1e-9) == 30
    table = element.stresses[:, :, :30].reshape(96, 30)
    constant = np.tile(np.eye(6), (16, 1))
    assert np.linalg.norm(constant - table @ (table.T @ constant)) <= 1e-12


def test_a_solution_in_the_space_has_no_error():
    """Uniaxial stretch beyond yield: eps and sigma are constant."""
    held = {
        "left": (0, None, None),
        "clamped": (None, None, 0),
        "front": (None, 0, None),
    }
    prescribed = {**held, "right": (5e-3, None, None)}
    problem = Problem(block.mesh(0.5), MATERIAL, clamped=None, prescribed=prescribed)
    bound = error_bound(semismooth_newton(problem))
    assert bound.state.at.yields.all()
    assert abs(bound.total) <= 1e-10 * bound.strain_energy


def test_unconverged_and_primal_results_have_bounds():
    problem = pressed()
    solved, other = semismooth_newton(problem), primal_newton(problem)
    one = error_bound(solved)
    assert error_bound(other).total == pytest.approx(one.total, rel=1e-4)
    iterate = error_bound(
        semismooth_newton(problem, options=NewtonOptions(max_iterations=2))
    )
    assert iterate.algebraic >= iterate.energy - solved.primal_energy > 0
    assert iterate.least_energy <= one.energy


def test_pressure_on_a_whole_side_is_sharpened():
    """A plate presses the whole top: the pressure of the nodal forces alone gives 0.0074."""
    material = Material.kinematic(
        lame_lambda=1.5e3, lame_mu=1e3, yield_stress=1.25, hardening=1e2
    )
    mesh = block.structured_mesh(8, 8, 8, simplices=True)
    problem = Problem(mesh, material, contact="contact", gap=-0.01 - 0.01 * x)
    bound = error_bound(semismooth_newton(problem))
    assert bound.energy - 0.0404 <= bound.total <= 1.8 * (bound.energy - 0.0404)
    assert bound.pressure.min() >= 0


def test_effectivity_of_an_elastic_and_a_plastic_cube():
    """729 nodes; energies by meshes of up to 4913 nodes and their bounds."""
    for stress, traction, energy, most in (
        (1e6, (0.3, 0.1, -0.5), -1.7858e-4, 1.2),
        (1.25, (1.0, 0.1, -0.5), -6.66e-3, 1.5),
    ):
        material = Material.kinematic(
            lame_lambda=1.5e3, lame_mu=1e3, yield_stress=stress, hardening=1e2
        )
        mesh = block.structured_mesh(8, 8, 8, simplices=True)
        bound = error_bound(
            semismooth_newton(Problem(mesh, material, traction={"contact": traction}))
        )
        assert 1.0 <= bound.total / (bound.energy - energy) <= most


def test_a_single_step_of_the_search_gives_a_bound():
    result = semismooth_newton(pressed())
    bound_data = bound_data_of(result.discrete)
    bound_data.effort = Effort(newton=0, steps=1)
    tangent = Factors(result.discrete, "sparsecholesky")
    first, last = (
        bound_of_state(bound_data, result.state, tangent).total,
        error_bound(result).total,
    )
    least = error_bound(semismooth_newton(finer(result.problem, 1))).least_energy
    assert first > last >= result.primal_energy - least - last


def test_meshes_follow_the_bound():
    """A sphere pressed into a block; data that are constant on elements are carried."""
    solved = solve_to(indented_block(0), 0.9, Refinement(max_nodes=600))
    assert solved.reached
    lower = [record.energy - record.total for record in solved.records]
    upper = [record.energy for record in solved.records]
    assert max(lower) <= min(upper)


@pytest.mark.parametrize(
    ("word", "make"),
    [
        ("prisms", lambda: Problem(prisms(1), MATERIAL)),
        (
            "lame_mu",
            lambda: Problem(block.mesh(0.5), replace(MATERIAL, lame_mu=1e3 + x)),
        ),
        (
            "friction",
            lambda: Problem(
                block.mesh(0.5),
                MATERIAL,
                contact="contact",
                gap=0.0,
                friction=Coulomb(0.3),
            ),
        ),
    ],
)
def test_what_is_not_covered_is_refused_by_name(word, make):
    class Result:
        displacement = contact_pressure = None

    result = Result()
    result.problem = make()
    with pytest.raises(ValueError, match=word):
        error_bound(result)


@pytest.mark.parametrize("name", ["pressed", "rollers"])
def test_order_two_has_a_lower_bound_below_finer_energies(name):
    """The energy is above, what is missing is a part of that of order one."""
    problem = replace(PROBLEMS[name](), order=2)
    bound = error_bound(semismooth_newton(problem))
    fine = semismooth_newton(finer(problem, 1)).primal_energy
    assert bound.least_energy < fine < bound.energy
    assert bound.moved < 1e-12
    assert bound.per_cell.min() > -1e-9 * bound.total
    one = error_bound(semismooth_newton(PROBLEMS[name]()))
    assert bound.total < 0.7 * one.total


def test_order_two_is_bounded_by_less_than_three_errors():
    """A cube that is pulled beyond yield, the energy extrapolated: 1.9."""
    problem = replace(bounded_example("plastic", "uniform", 125), order=2)
    bound = error_bound(semismooth_newton(problem))
    assert bound.total < 2.2 * (bound.energy - LIMITS["plastic"])


def test_a_quadratic_obstacle_is_met_exactly_by_order_two():
    """A paraboloid on a quarter of a block: the force to 20 percent on less than 200 nodes."""
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
    )
    problem = ngepc.Problem(
        block.mesh(0.3, (0.5, 0.5, 1.0)),
        steel,
        "clamped",
        contact="contact",
        gap=(x**2 + y**2) / 2 - 0.03,
        prescribed={"left": (0, None, None), "front": (None, 0, None)},
        order=2,
    )
    solved = solve_to(problem, goal="contact_force", percent=20)
    assert solved.reached
    assert solved.guaranteed
    assert solved.bound.moved < 1e-12
    assert solved.records[-1].nodes < 200
    assert solved.goal.lower < 4.06 / 4 < solved.goal.upper


def test_facets_are_looked_at_where_smooth_obstacles_rise_most():
    """-|x|^2 over the affine function of its vertices, random triangles: 95 percent or more."""
    triangles = np.random.default_rng(0).standard_normal((500, 3, 2))
    grid = [
        (i / 40, j / 40, 1 - (i + j) / 40) for i in range(41) for j in range(41 - i)
    ]

    def highest(shares):
        rise = -((shares @ triangles) ** 2).sum(axis=2)
        return (rise + (triangles**2).sum(axis=2) @ shares.T).max(axis=1)

    assert (highest(FACET_RULES[3].shares) >= 0.95 * highest(np.array(grid))).all()


def test_histories_of_order_two_start_from_affine_ones():
    """Plastic strains of a step vary on the elements of the next one."""
    problem = ngepc.Problem(
        block.mesh(0.6),
        MATERIAL,
        "clamped",
        traction={"contact": (1.5, 0.1, -0.5)},
        order=2,
    )
    run = evolve(problem, [(0.6, {}), (1.0, {})], error=0.8)
    last = run.steps[-1].solution
    bound = error_bound(last)
    assert np.ptp(last.discrete.law.initial.reshape(-1, 4, 5), axis=1).max() > 0
    assert bound.relative <= 0.8
    fine = semismooth_newton(finer(last.problem, 1)).primal_energy
    assert bound.least_energy < fine < bound.energy


def rubbed(friction, cells=(2, 2, 2), **data):
    """A cube of order two under a plate that is dragged along."""
    given = {"traction": {"right": (0.5, 0.2, 0.1)}, "contact": "contact"}
    given |= {"gap": -1.5e-3, "friction": friction, "order": 2}
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.25, hardening=60.0
    )
    mesh = block.structured_mesh(*cells, simplices=True)
    return Problem(mesh, steel, **given | data)


def test_friction_of_order_two():
    """The slip is a parabola, from a quadratic start; the tractions are those of order one."""
    problem = rubbed(
        0.2 + 0.1 * x, (2, 1, 1), initial_displacement=(1e-4 * x * x, 0, 0)
    )
    result = semismooth_newton(problem)
    bound = error_bound(result)
    fine = error_bound(semismooth_newton(finer(problem, 1)))
    assert result.state.sliding.any()
    assert bound.guaranteed
    assert bound.least_energy < fine.least_energy < fine.energy < bound.energy
    assert bound.per_cell.min() > -1e-9 * bound.total
    lower = error_bound(semismooth_newton(replace(problem, order=1, **AT_REST)))
    unmoved = error_bound(semismooth_newton(replace(problem, **AT_REST)))
    assert max(lower.least_energy, unmoved.least_energy) < unmoved.energy
    assert unmoved.total < 0.6 * lower.total


@pytest.mark.parametrize(("friction", "most"), [(0.05, 90), (2.0, 350)])
def test_goals_with_friction_of_order_two(friction, most):
    """The cube slips, or sticks; the fine values are in the intervals, which order one widens."""
    problem = rubbed(friction)
    interval = goal_bound(semismooth_newton(problem), "work")
    fine = semismooth_newton(finer(problem, 1))
    assert interval.guaranteed
    assert interval.lower < value_of(fine, "work") < interval.upper
    assert interval.percent < most
    lower = goal_bound(semismooth_newton(replace(problem, order=1)), "work")
    assert interval.width < lower.width


AT_REST = {"initial_displacement": None}


def test_steps_of_a_history_with_friction_of_order_two():
    """The start of the second step is the quadratic displacement of the first one."""
    back = {"traction": {"right": (-0.3, 0.1, 0.0)}}
    history = evolve(rubbed(0.1), [(1.0, {}), (2.0, back)]).raise_for_status()
    step = history.steps[-1]
    bound = error_bound(step.solution)
    problem = step.problem.changed(initial_accumulated=None)  # no part of this law
    everywhere = np.ones(problem.mesh.ne, dtype=bool)
    fine = on_mesh(problem, *bisected(problem.mesh, everywhere))
    better = error_bound(semismooth_newton(fine))
    assert bound.least_energy < better.least_energy < better.energy < bound.energy


def sheared(poisson=0.3, hardening=1e-3, larger=0.0):
    """A cube of order two that yields throughout; ``hardening`` is h over mu."""
    mu = 1e3
    material = Material.kinematic(
        lame_lambda=2 * mu * poisson / (1 - 2 * poisson),
        lame_mu=mu,
        yield_stress=1.25,
        hardening=hardening * mu,
    )
    load = (1 + larger) * CF((1.0, 0.1, -0.5))
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    return Problem(mesh, material, traction={"contact": load}, order=2)


@pytest.mark.parametrize("poisson", [0.3, 0.4999])
def test_bounds_of_softly_hardening_solids(poisson, monkeypatch):
    """They depend neither on rounding nor on Poisson's ratio, and Newton steps lower them.

    Conjugate gradients in single precision left 0.51 to 0.55 times the strain energy with Poisson's
    ratio 0.3, and 30 to 22,000 times with 0.4999, for loads that differ by 1e-9 to 1e-2.
    """
    found = []
    for steps, larger in ((0, 0.0), (12, 0.0), (12, 1e-9)):
        monkeypatch.setattr(solid, "NEWTON_BY_FACTORS", steps)
        result = semismooth_newton(sheared(poisson, larger=larger))
        bound_data = bound_data_of(result.discrete)
        effort = bound_data.lower.effort
        bound_data.lower.effort = replace(effort, newton=steps)
        tangent = Factors(result.discrete, "sparsecholesky")
        found.append(bound_of_state(bound_data, result.state, tangent).relative)
    first, last, other = found
    assert last < 0.95 * first
    assert last < 0.35
    assert other == pytest.approx(last, rel=1e-6)


def test_newton_steps_where_a_part_yields(monkeypatch):
    """Of order one there were none: 95 times the strain energy, and 17 with twelve."""
    gap = 1e-4 + 2e-3 * (x - 0.3) ** 2
    problem = replace(sheared(), order=1, contact="contact", gap=gap)
    load = {"right": (0.54, -0.72, 0.9)}
    result = semismooth_newton(replace(problem, traction=load))
    bounds = []
    for steps in (0, 12):
        monkeypatch.setattr(solid, "NEWTON_BY_FACTORS", steps)
        bounds.append(error_bound(result).total)
    assert bounds[1] < 0.5 * bounds[0]


def test_factors_of_the_faces_invert_their_stiffness():
    """With springs, a support along no axis, and faces whose normal displacement is held."""
    mesh = block.structured_mesh(2, 2, 2, simplices=True)
    problem = Problem(
        mesh,
        replace(ELASTIC, yield_stress=1.0, hardening=0.1),
        traction={"contact": (2.0, 0.3, -1.0)},
        prescribed={"front": Roller(direction=(0.0, 0.6, 0.8))},
        springs={"right": (5.0, 0.0, 80.0)},
    )
    bound_data = bound_data_of(DiscreteProblem(problem))
    random = np.random.default_rng(1)
    state = bound_data.discrete.state(random.standard_normal((mesh.nv, 3)))
    faces = bound_data.search(state).faces
    assert faces.soft
    held = np.zeros(faces.free.shape)
    top = np.flatnonzero(bound_data.cells.normal[:, 2] > 0.99)
    top = top[bound_data.cells.outer[top]]
    held[3 * top] = (0.0, 0.0, 1.0)
    force = random.standard_normal(held.shape)
    for along in (0 * held, held):
        with faces.holding(along):
            wanted = faces.kept(force)
            found = faces.solve(wanted)
            assert faces.kept(found) == pytest.approx(found, abs=1e-9)
            missing = faces.product(found) - wanted
            assert np.abs(missing).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("hardening", [1e-3, 0.1])
def test_soft_solids_keep_their_mesh_where_eighths_have_no_factors(
    hardening, monkeypatch
):
    """Without factors the stress on the finer mesh is worse than that on the mesh itself."""
    result = semismooth_newton(sheared(hardening=hardening))
    assert state_in_eighths(result) is not None
    monkeypatch.setattr(corners, "MOST_FACTORISED", 500)
    assert (state_in_eighths(result) is None) is (hardening < 0.01)


def test_adjoints_share_the_matrices_of_the_bound():
    """Those of the best stress are the matrices at the tangent of the state."""
    result = semismooth_newton(pressed())
    bound_data = bound_data_of(result.discrete)
    state = result.state
    tangent = Factors(bound_data.discrete, "sparsecholesky")
    pressure = bound_data.contact.from_rows.pressure(state.multipliers)
    shared = bound_data.best_stress(state, tangent, pressure).search
    again = bound_data.search(state)
    assert np.array_equal(shared.compliance, again.compliance)
    delta = np.random.default_rng(0).standard_normal(shared.faces.free.shape)
    assert np.array_equal(shared.faces.product(delta), again.faces.product(delta))
    assert np.array_equal(shared.faces.smooth(delta), again.faces.smooth(delta))


@pytest.mark.parametrize("gives_up", [False, True])
def test_large_solids_of_order_two_are_balanced_by_multigrid(gives_up, monkeypatch):
    """The algebraic part is that with factors, which take over where multigrid gives up."""

    def fails(*args):
        raise FactorisationError("no")

    given = semismooth_newton(
        replace(pressed(), order=2), options=NewtonOptions(max_iterations=2)
    )
    known = algebraic_part(given.state, Factors(given.discrete, "sparsecholesky"))
    monkeypatch.setattr(choice, "MOST_BY_FACTORS", 0)
    tangent = FewSolves(given.discrete)
    assert isinstance(tangent._tangent, IterativeTangent)
    if gives_up:
        monkeypatch.setattr(IterativeTangent, "minimise", fails)
    assert known > 1e-4 * given.primal_energy
    assert algebraic_part(given.state, tangent) == pytest.approx(known, rel=1e-7)
    assert isinstance(tangent._tangent, Factors) is gives_up
