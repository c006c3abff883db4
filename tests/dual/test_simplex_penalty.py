"""The vectorised plastic term against NGSolve's integration of the same terms."""

import numpy as np
import pytest
from ngepc.geometries import block, lshape
from ngsolve import GridFunction, IfPos, x

from ngepc import Balanced, Coupled, Material, Problem, lshape_problem
from ngepc.discretisation.spaces import plastic_dual_space
from ngepc.dual.parts import PlasticPart
from ngepc.dual.penalty import PlasticPenalty
from ngepc.dual.simplex_penalty import SimplexPenalty
from ngepc.linalg.assembly import Placed

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
        (2, Balanced(gamma=1e9), 400, 3.0),
        (3, Balanced(gamma=1e9), 100, 0.8),
    ],
)
def test_same_integrals_as_ngsolve(dim, regularisation, points, size):
    mesh = lshape.paper_mesh(225) if dim == 2 else block.mesh(0.4)
    problem = Problem(mesh, MATERIAL, contact="contact", gap=0.1)
    R, q = smooth_field(problem, size)
    theirs = PlasticPenalty(problem, regularisation, R, points)
    ours = SimplexPenalty(problem, regularisation, R, points)
    assert 0 < ours.active(q) < 0.999 * (0.75 if dim == 2 else 1.0)
    assert ours.active(q) == pytest.approx(theirs.active(q), rel=1e-12)
    assert ours.energy(q) == pytest.approx(theirs.energy(q), rel=1e-12)
    a, b = (np.array(M.gradient(q).FV()) for M in (ours, theirs))
    assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()
    a, b = (entries(M.hessian(q), R.ndof) for M in (ours, theirs))
    assert np.abs(a - b).max() <= 1e-12 * np.abs(b).max()


def test_lower_orders_away_from_the_kink_agree_with_400_points():
    problem = lshape_problem(lshape.paper_mesh(833))
    R = plastic_dual_space(problem)
    penalty = SimplexPenalty(problem, Coupled(1e4), R, 400)
    noise = np.random.default_rng(0).normal(0, 0.45, (2, problem.mesh.nv))
    q = GridFunction(R).vec
    q.FV().NumPy()[:] = (noise + np.array([[3.0], [1.0]])).ravel()
    graded = penalty.energy(q), np.array(penalty.gradient(q).FV())
    assert min(len(c) for c in penalty._classes[:3]) > 20
    penalty._classes = [c[:0] for c in penalty._classes[:3]] + [np.concatenate(penalty._classes)]
    fine = penalty.energy(q), np.array(penalty.gradient(q).FV())
    assert graded[0] == pytest.approx(fine[0], rel=1e-13)
    assert np.abs(graded[1] - fine[1]).max() < 1e-12 * np.abs(fine[1]).max()


def test_elements_below_the_threshold_are_idle():
    problem = lshape_problem(lshape.paper_mesh(225))
    R, q = smooth_field(problem, 0.5)
    penalty = SimplexPenalty(problem, Coupled(1e4), R, 400)
    assert list(penalty._batches(q)) == []
    assert penalty.energy(q) == 0
    assert np.abs(np.asarray(penalty.hessian(q).AsVector().FV())).max() == 0


def test_only_straight_simplices_with_constants_take_the_short_way():
    def kind(problem, regularisation):
        part = PlasticPart()
        space = part.space(problem, regularisation)
        return type(part.penalty(problem, regularisation, space, 25))

    mesh = lshape.paper_mesh(65)
    plain = lshape_problem(mesh)
    assert kind(plain, Coupled(1e4)) is SimplexPenalty
    assert kind(plain, Balanced()) is SimplexPenalty
    varied = Material.kinematic(
        lame_lambda=1.0, lame_mu=1.0, yield_stress=IfPos(x - 0.5, 1.0, 2.0), hardening=1.0
    )
    assert kind(Problem(mesh, varied), Coupled(1e4)) is PlasticPenalty
    assert kind(Problem(block.structured_mesh(2, 2), MATERIAL), Coupled(1e4)) is PlasticPenalty
