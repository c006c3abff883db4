"""Results, bounds and histories survive pickle, copies, and the way back from other processes."""

import copy
import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from bodies import CASES, STEEL, pressed_body
from featured import problem_with
from ngsolve import Integrate, Parameter, specialcf, x

from ngepc import (
    Contact,
    Coulomb,
    Problem,
    contact_force_bracket,
    error_bound,
    evolve,
    follow_path,
    lshape_problem,
    primal_newton,
    semismooth_newton,
)
from ngepc.geometries import lshape, published
from ngepc.model.features import FEATURES


def example():
    return lshape_problem(lshape.mesh(maxh=0.25))


def regularised(problem):
    return semismooth_newton(problem, 1e4)


def numbers(result):
    mesh = result.problem.mesh
    fields = (result.von_mises, result.yield_function, result.yield_excess)
    return np.r_[
        result.primal_energy,
        result.dual_energy,
        result.residual_norm,
        result.contact_force,
        result.reaction,
        result.history.energies,
        [Integrate(field, mesh) for field in fields],
    ]


def of_bound(bound):
    return np.r_[bound.total, bound.relative, numbers(bound.result)]


def of_history(history):
    last = history.steps[-1]
    stress = history.values(lambda f: Integrate(f.von_mises, f.problem.mesh))
    return np.r_[history.column("contact_force"), stress, numbers(last.solution)]


def of_bracket(force):
    return np.r_[force.lower, force.upper, force.discrete]


def history():
    return evolve(example(), [(t, {"gap": 0.1 / t}) for t in (1.0, 2.0)])


def plane():
    return semismooth_newton(replace(example(), kinematics=None, order=1))


WORKS = {
    "exact": (lambda: semismooth_newton(example()), numbers),
    "primal": (lambda: primal_newton(example()), numbers),
    "regularised": (lambda: regularised(example()), numbers),
    "a path": (lambda: follow_path(example()), lambda path: numbers(path.last)),
    "a history": (history, of_history),
    "a bracket": (lambda: contact_force_bracket(plane()), of_bracket),
    "fields": (
        lambda: plane().fields,
        lambda f: np.r_[Integrate(f.von_mises, f.problem.mesh)],
    ),
    "two bodies": (
        lambda: semismooth_newton(
            Problem(
                published.stacked_blocks(2, 0.3),
                STEEL,
                pressure={"top": 1.0},
                contact=Contact("above", "below"),
                friction=Coulomb(0.2),
            )
        ),
        numbers,
    ),
}
WORKS |= {
    f"{shape}, {kinematics}, order {order}": (
        lambda case=(shape, kinematics, order): semismooth_newton(pressed_body(*case)),
        numbers,
    )
    for shape, kinematics, order in CASES
    if order == 2 or kinematics == "axisymmetric"
}


@pytest.mark.parametrize("name", WORKS)
def test_pickled_and_copied_works_have_the_same_numbers(name):
    make, numbers_of = WORKS[name]
    work = make()
    before = numbers_of(work)
    for again in (pickle.loads(pickle.dumps(work)), copy.deepcopy(work)):
        assert numbers_of(again) == pytest.approx(before, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("feature", sorted(FEATURES.keys() - {"shared mesh"}))
def test_pickled_and_copied_problems_have_the_same_features(feature):
    """Methods cover a copy if they cover the problem."""
    problem = problem_with(feature)
    for again in (pickle.loads(pickle.dumps(problem)), copy.deepcopy(problem)):
        assert again.features.keys() == problem.features.keys()


def test_a_bound_survives():
    bound = error_bound(plane())
    for again in (pickle.loads(pickle.dumps(bound)), copy.deepcopy(bound)):
        assert again.total == bound.total
        assert again.relative == pytest.approx(bound.relative, rel=1e-12)


def test_what_is_copied_goes_on():
    """A copy starts the next solve, and has a mesh of its own."""
    first = semismooth_newton(example())
    again = pickle.loads(pickle.dumps(first))
    assert again.problem.mesh is again.displacement.space.mesh
    assert again.problem.mesh is not first.problem.mesh
    lower = replace(again.problem, gap=0.08)
    one = semismooth_newton(lower, start=again)
    two = semismooth_newton(replace(first.problem, gap=0.08), start=first)
    assert one.primal_energy == pytest.approx(two.primal_energy, rel=1e-12)
    assert one.iterations == two.iterations


def test_coefficients_survive():
    parameter = Parameter(2.0)
    for value in (
        specialcf.normal(2) * x,
        specialcf.mesh_size * parameter,
        parameter * x,
    ):
        again = pickle.loads(pickle.dumps(value))
        assert str(again) == str(value)
        assert tuple(again.dims) == tuple(value.dims)


def solved(gap):
    return semismooth_newton(replace(example(), gap=gap))


GAPS = (0.05, 0.1)


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_processes_return_results(method):
    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {method} on this system")
    context = multiprocessing.get_context(method)
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        results = list(pool.map(solved, GAPS))
    for gap, result in zip(GAPS, results, strict=True):
        assert result.primal_energy == pytest.approx(
            solved(gap).primal_energy, rel=1e-12
        )
        assert result.problem.gap == gap
        assert Integrate(result.von_mises, result.problem.mesh) > 0
