"""Single steps of bounds, goals and receipts beside direct computations."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns.receipts import opened
from ngsolve import IfPos, x

from ngepc import (
    Hill,
    Material,
    Problem,
    error_bound,
    goal_bound,
    semismooth_newton,
    write_receipt,
)
from ngepc.bounds.balance import BALANCED, balanced_stress
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.densities import AT_CORNERS, _means_by_flow
from ngepc.bounds.of_state import bound_data_of
from ngepc.bounds.oscillation import CarriedLoads
from ngepc.bounds.simplices import Simplices
from ngepc.discretisation.factors import Factors
from ngepc.discretisation.laws import law_of
from ngepc.discretisation.points import Points
from ngepc.geometries import block
from ngepc.goals import check_receipt, receipt
from ngepc.goals.adjoint import AdjointProblem
from ngepc.goals.adjoint_conditions import AdjointConditions
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.receipt_file import packed, proved_intervals
from ngepc.local.system import DiscreteProblem

MATERIAL = Material.kinematic(
    lame_lambda=1.5e3, lame_mu=1e3, yield_stress=5.0, hardening=1e2
)


def pressed(N=2, **data):
    """A few cells under a rigid plane."""
    mesh = block.mesh(0.5, (1.0, 0.7, 0.8)[:N])
    data = {"contact": "contact", "gap": -0.002 - 0.002 * x, "order": 1} | data
    return Problem(mesh, MATERIAL, **data)


@pytest.fixture(scope="module")
def goal():
    """The interval of a contact force."""
    return goal_bound(semismooth_newton(pressed()), "contact_force")


@pytest.fixture(scope="module")
def written(goal, tmp_path_factory):
    """The receipt of it, as it is read."""
    path = tmp_path_factory.mktemp("receipt") / "receipt.npz"
    write_receipt(goal, path)
    arrays, header = opened(path)
    return arrays, header


def test_one_pressure_of_an_adjoint_that_is_too_large_is_refused(written):
    """It is at most lambda times that of the solution at each point, not somewhere."""
    arrays, header = written
    proved_intervals(packed(arrays), header)
    own = arrays["pressure"][0]
    place = np.unravel_index(np.argmax(own), own.shape)
    for sign in (1, -1):
        pressure = arrays["pressure"].copy()
        pressure[1][place] = sign * 1.001 * own[place]
        words = packed(arrays | {"pressure": pressure})
        with pytest.raises(ValueError, match=r"^pressure: "):
            check_receipt.Body(words, header)


@pytest.mark.parametrize("stretched", [1.0, 1e-12, 1e3])
def test_a_receipt_keeps_clear_of_rounding(stretched, goal):
    """What lambda is larger by, times the distance, is more than the rounding of z . n."""
    other = replace(goal, factor=stretched * goal.factor)
    largest = np.abs(goal.bound.state.u).max()
    moves = max(np.abs(goal.pair.z).max(), 1.0)
    for wrong in (1e-15, 1e-13, 1e-10):
        factor, distance = receipt.factor_and_distance(other, largest, wrong)
        assert (factor - other.factor) * distance == pytest.approx(24 * wrong * moves)
        assert distance <= receipt.CLEAR_OF_GOAL * largest * (1 + 1e-12)
        assert factor >= other.factor * (1 + receipt.SPARE)


def test_lambda_for_a_zero_adjoint():
    """The least one with |c| <= lambda gap where c is not zero, also far below one."""
    slack = np.array([[0.2, 0.4], [0.5, 0.1], [0.0, 0.3]])
    nodes = SimpleNamespace(cells=SimpleNamespace(N=2))
    conditions = AdjointConditions(nodes, slack)
    for size in (1e-3, 1.0, 1e3):
        terms = SimpleNamespace(factor=size * np.array([-1.0, 0.2, 0.0]))
        assert conditions.enough(terms) == pytest.approx(5.0 * size)
    everywhere = SimpleNamespace(factor=np.ones(3))
    assert conditions.enough(everywhere) == np.inf
    assert conditions.enough(SimpleNamespace(factor=np.zeros(3))) == 0.0


@pytest.mark.parametrize("bound", [0.02, 50.0])
def test_what_friction_leaves_for_adjoints(bound):
    """F - |t|: nothing where rows slip, and no more than F where they stick."""
    load = {"traction": {"right": (0.4, 0.0)}, "friction": bound}
    result = semismooth_newton(pressed(**load))
    found = error_bound(result)
    bound_data = bound_data_of(result.discrete)
    spare = AdjointProblem(bound_data, found.state, found.pressure)._spare
    if bound < 1:
        assert found.state.sliding.all()
        assert spare.max() < 1e-9 * bound
    else:
        used = np.linalg.norm(bound_data.tangential(found.state), axis=2)
        np.testing.assert_allclose(spare + used, bound)
        assert used.max() > 0


@pytest.mark.parametrize("order", [1, 2])
def test_the_width_is_estimated(order):
    """Of an adjoint, over all cells: with twice lambda times what is open."""
    problem = pressed(order=order)
    result = semismooth_newton(problem)
    found = goal_bound(result, "contact_force")
    goals = GoalProblem(result)
    integrand = goals._of_bound.integrand(found.pair)
    factor = found.factor
    estimated = integrand.estimate(factor)
    inside = sum(side.sum() for side in integrand.bounds(factor))
    assert estimated == pytest.approx(inside + 2 * factor * integrand.opened, rel=0.2)
    more = replace(integrand, opened=integrand.opened + 3.0)
    assert more.estimate(factor) - estimated == pytest.approx(6.0 * factor)


@pytest.mark.parametrize("N", [2, 3])
def test_means_by_flow_are_exact_for_quadratics(N):
    """Where Hill's ellipsoid is not reached phi is one, which the points integrate exactly."""
    sheet = Hill.r_values(1.8, 1.1, 2.3)
    metal = replace(MATERIAL, hill=sheet)
    mesh = block.mesh(0.5, (1.0, 0.7, 0.8)[:N])
    problem = Problem(mesh, metal)
    points = Points(mesh, problem.kinematics, 2)
    law = law_of(problem, points)
    k = N + 1
    assert len(law.beta) == k * mesh.ne
    random = np.random.default_rng(N)
    volume = 1e-4 * random.normal(size=len(law.beta))
    at = law.returned(volume, 1e-4 * random.normal(size=law.back.shape))
    assert not at.yields.any()

    def at_corners(values):
        return np.matmul(AT_CORNERS[k], values.reshape(-1, k, values.shape[1]))

    cells = np.arange(mesh.ne)
    found = _means_by_flow(law, at, at_corners, cells).reshape(mesh.ne, -1)
    exact = law.energy_density(at).reshape(-1, k).mean(axis=1)
    np.testing.assert_allclose(found.mean(axis=1), exact, rtol=1e-10)


@pytest.mark.parametrize("size", [1e-16, 1.0])
def test_stresses_are_balanced_in_all_units(size):
    """From the state of an unfinished iteration."""
    metal = Material.kinematic(
        lame_lambda=1.5e3 * size, lame_mu=1e3 * size, yield_stress=5.0 * size,
        hardening=1e2 * size,
    )  # fmt: skip
    mesh = block.mesh(0.5, (1.0, 0.7))
    problem = Problem(mesh, metal, traction={"right": (6.0 * size, 0.0)}, order=1)
    problem = replace(problem, kinematics="two-dimensional")
    result = semismooth_newton(problem)
    discrete = result.discrete
    state = discrete.state(1.01 * result.state.u)
    tangent = Factors(discrete, "sparsecholesky")
    stress = balanced_stress(state, tangent, discrete.load)[0]
    forces = discrete.points.forces(stress[:, 0], stress[:, 1:])
    missing = np.where(discrete.free, discrete.load - forces, 0.0)
    assert np.abs(missing).max() <= 2 * BALANCED * np.abs(discrete.load).max()


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_pressures_are_fitted_in_all_units(size):
    """The absolute tolerance of SciPy ended the search at pressures that were wrong by a half."""
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, hardening=1.0
    )
    mesh = block.structured_mesh(8, 8, simplices=True)
    problem = Problem(mesh, metal, contact="contact", gap=1.0, order=2)
    discrete = DiscreteProblem(problem)
    contact = bound_data_of(discrete).contact
    forces = np.random.default_rng(4).normal(size=len(discrete.rows))
    pressure = contact.from_rows.pressure(forces)
    found = contact.from_rows.pressure(size * forces) / size
    assert found == pytest.approx(pressure, rel=1e-9, abs=1e-9 * pressure.max())


def test_loads_of_strips_are_carried():
    """Resultant and moment of a body force on a strip inside cells."""
    strip = IfPos(x - 0.31, IfPos(0.37 - x, 1.0, 0.0), 0.0)
    force = 3.0 * strip, -5.0 * strip
    mesh = block.mesh(0.5, (1.0, 0.7))
    problem = Problem(mesh, MATERIAL, body_force=force, order=1)
    cells = Simplices.of(mesh)
    nodal = CarriedLoads(Boundary(problem, cells)).nodal
    area = 0.06 * 0.7
    np.testing.assert_allclose(nodal.sum(axis=(0, 1)), [3 * area, -5 * area], rtol=2e-3)
    X = cells.points[cells.nodes]
    turning = (X[..., 0] * nodal[..., 1] - X[..., 1] * nodal[..., 0]).sum()
    assert turning == pytest.approx(area * (-5 * 0.34 - 3 * 0.35), rel=2e-3)
