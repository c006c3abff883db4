"""The vectorised plastic term against NGSolve's integration of the same terms."""

import numpy as np
import pytest
from bodies import flat_problem
from ngsolve import GridFunction, IfPos, x

from ngepc import Coupled, DualSpaces, Material, lshape_problem
from ngepc.discretisation.quadrature import SMOOTH, classify
from ngepc.discretisation.spaces import plastic_dual_space
from ngepc.dual.parts import PlasticPart
from ngepc.dual.penalty import PlasticPenalty
from ngepc.dual.simplex_penalty import SimplexPenalty
from ngepc.geometries import block, lshape
from ngepc.linalg.assembly import Placed
from ngepc.model.elements import element_vertices

MATERIAL = Material.kinematic(lame_lambda=1.0e3, lame_mu=1.0e3, yield_stress=1.25, hardening=100.0)


def smooth_field(problem, size, seed=1):
    """A vector of P1 with d components that vary over the body."""
    R = plastic_dual_space(problem)
    q = GridFunction(R).vec
    rng = np.random.default_rng(seed)
    points = np.asarray(problem.mesh.ngmesh.Coordinates())[: problem.mesh.nv, : problem.N]
    components = len(q) // problem.mesh.nv
    waves = [np.sin(points @ rng.normal(0, 3, problem.N) + rng.normal()) for _ in range(components)]
    q.FV().NumPy()[:] = size * np.concatenate(waves)
    return R, q


def entries(matrix, n):
    """The lower triangle as a dense array."""
    keys, values = Placed(matrix).lower_triangle(n)
    dense = np.zeros(n * n)
    np.add.at(dense, keys, values)
    return dense


@pytest.mark.parametrize(
    ("dim", "regularisation", "points", "size"),
    [
        (2, Coupled(1e4), 400, 1.3),
        (2, Coupled(1e4, plastic_shift=300.0), 16, 1.3),
        (2, Coupled(0.02), 400, 3.0),
        (3, Coupled(0.02), 100, 0.8),
    ],
)
def test_same_integrals_as_ngsolve(dim, regularisation, points, size):
    mesh = lshape.paper_mesh(225) if dim == 2 else block.mesh(0.4)
    problem = flat_problem(mesh, MATERIAL, contact="contact", gap=0.1)
    R, q = smooth_field(problem, size)
    weights = regularisation.parameters.weights(problem, regularisation.units)
    theirs = PlasticPenalty(problem, weights, R, points).at(q)
    ours = SimplexPenalty(problem, weights, R, points).at(q)
    assert 0 < ours.active < 0.999 * (0.75 if dim == 2 else 1.0)
    assert ours.active == pytest.approx(theirs.active, rel=1e-12)
    assert ours.energy == pytest.approx(theirs.energy, rel=1e-12)
    a, b = (np.array(M.gradient.FV()) for M in (ours, theirs))
    assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()
    a, b = (entries(M.hessian(), R.ndof) for M in (ours, theirs))
    assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()


def weights_of(problem, gamma=1e4):
    return Coupled(gamma).parameters.weights(problem, Coupled(gamma).units)


KERNELS = pytest.mark.parametrize("kernel", [SimplexPenalty, PlasticPenalty])


def beyond(problem, noise):
    """q beyond the threshold, more or less gentle."""
    R = plastic_dual_space(problem)
    random = np.random.default_rng(0).normal(0, noise, (2, problem.mesh.nv))
    q = GridFunction(R).vec
    q.FV().NumPy()[:] = (random + np.array([[3.0], [1.0]])).ravel()
    return R, q


@KERNELS
def test_a_low_order_away_from_the_kink_agrees_with_400_points(kernel, monkeypatch):
    problem = lshape_problem(lshape.paper_mesh(833))
    R, q = beyond(problem, 0.15)
    (nodes,), values = element_vertices(problem.mesh), np.array(q.FV()).reshape(2, -1)
    assert (classify(values, nodes, 1.25, 1.25) == SMOOTH).sum() > 100
    usual = kernel(problem, weights_of(problem), R, 400).at(q)
    monkeypatch.setattr("ngepc.discretisation.quadrature.SMOOTH_VARIATION", 0.0)
    fine = kernel(problem, weights_of(problem), R, 400).at(q)
    assert usual.energy == pytest.approx(fine.energy, rel=1e-13)
    a, b = (np.array(state.gradient.FV()) for state in (usual, fine))
    assert np.abs(a - b).max() < 1e-12 * np.abs(b).max()


@KERNELS
def test_the_classifier_decides_for_both_kernels(kernel, monkeypatch):
    """Where everything counts as gentle the integrals change: the test above can fail."""
    problem = lshape_problem(lshape.paper_mesh(833))
    R, q = beyond(problem, 1.0)
    usual = kernel(problem, weights_of(problem), R, 400).at(q).energy
    monkeypatch.setattr("ngepc.discretisation.quadrature.SMOOTH_VARIATION", 1e9)
    coarse = kernel(problem, weights_of(problem), R, 400).at(q).energy
    assert abs(coarse / usual - 1) > 1e-9


def test_elements_below_the_threshold_are_idle():
    problem = lshape_problem(lshape.paper_mesh(225))
    R, q = smooth_field(problem, 0.5)
    state = SimplexPenalty(problem, weights_of(problem), R, 400).at(q)
    assert sum(len(elements) for elements in state.elements.values()) == 0
    assert state.energy == 0
    assert np.abs(np.asarray(state.hessian().AsVector().FV())).max() == 0


def test_a_state_stays_when_others_are_made():
    """Active sets belong to the state, not to the term: the order of questions does not matter."""
    problem = lshape_problem(lshape.paper_mesh(113))
    for kind in (SimplexPenalty, PlasticPenalty):
        R, q = smooth_field(problem, 1.3)
        term, other = kind(problem, weights_of(problem), R, 64), smooth_field(problem, 2.0, 5)[1]
        alone = term.at(q)
        expected = alone.energy, np.array(alone.gradient.FV()), entries(alone.hessian(), R.ndof)
        here, there = term.at(q), term.at(other)
        assert there.energy != expected[0]
        assert there.gradient.Norm() > 0
        assert here.energy == expected[0]
        assert (np.array(here.gradient.FV()) == expected[1]).all()
        there.hessian()
        assert (entries(here.hessian(), R.ndof) == expected[2]).all()


def test_only_straight_simplices_with_constants_take_the_short_way():
    def kind(problem, vectorised=True):
        part = PlasticPart(problem, DualSpaces())
        return type(part.term(weights_of(problem), 25, vectorised))

    mesh = lshape.paper_mesh(65)
    plain = lshape_problem(mesh)
    assert kind(plain) is SimplexPenalty
    assert kind(plain, vectorised=False) is PlasticPenalty
    varied = Material.kinematic(
        lame_lambda=1.0, lame_mu=1.0, yield_stress=IfPos(x - 0.5, 1.0, 2.0), hardening=1.0
    )
    assert kind(flat_problem(mesh, varied)) is PlasticPenalty
    assert kind(flat_problem(block.structured_mesh(2, 2), MATERIAL)) is PlasticPenalty
