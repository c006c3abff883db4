"""Results as starts of other problems: equal multipliers, equal nodal values."""

import numpy as np
import pytest
from ngepc.geometries import lshape, wrench

from ngepc import (
    Balanced,
    Coupled,
    PenaltyContact,
    follow_path,
    lshape_problem,
    semismooth_newton,
    split,
    wrench_problem,
)
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.carried import carried_over, scaled_excess
from ngepc.dual.functional import DualFunctional


@pytest.fixture(scope="module")
def problem():
    return lshape_problem(lshape.paper_mesh(225))


@pytest.fixture(scope="module")
def coupled(problem):
    return semismooth_newton(problem, 1e4)


def parts(result_or_functional, v):
    blocks = result_or_functional.blocks
    z, q = (blocks.part_of(v, i).FV().NumPy() for i in (0, 1))
    return np.array(z), np.array(q).reshape(-1, blocks.problem.mesh.nv)


def functional(problem, regularisation):
    return DualFunctional(
        LinearBlocks(problem, regularisation, "sparsecholesky"), regularisation, 64
    )


def test_excess_is_scaled_in_its_direction():
    q = np.array([[3.0, 0.3, 0.0], [4.0, 0.4, 0.0]])
    scaled = scaled_excess(q, 1.0, 0.25)
    assert scaled[:, 0] == pytest.approx([3 * 2 / 5, 4 * 2 / 5])  # |q| = 1 + (5 - 1) / 4
    assert scaled[:, 1:] == pytest.approx(q[:, 1:])


def test_same_problem_starts_from_the_same_numbers(problem, coupled):
    v = carried_over(coupled, functional(problem, Coupled(1e4)))
    assert (v.FV().NumPy() == coupled.v.FV().NumPy()).all()


@pytest.mark.parametrize("target", [Coupled(1e5), Balanced(1e6, contact=PenaltyContact(gamma=7.0))])
def test_nodal_multipliers_are_kept(problem, coupled, target):
    if isinstance(target, Balanced):  # on the same spaces
        target = Balanced(1e6, contact=target.contact, tichonov=Coupled(1.0).tichonov)
    there = functional(problem, target)
    before, after = coupled.functional.regularisation, target
    (z, q), (z_new, q_new) = (
        parts(coupled.functional, coupled.v),
        parts(there, carried_over(coupled, there)),
    )
    beta = float(problem.beta)

    def multipliers(regularisation, z, q):
        excess = np.maximum(np.sqrt((q**2).sum(axis=0)) - beta, 0)
        return (
            regularisation.gamma_contact * np.maximum(z, 0),
            regularisation.gamma_plastic(problem) * excess,
        )

    for old, new in zip(multipliers(before, z, q), multipliers(after, z_new, q_new), strict=True):
        assert old.max() > 0
        assert new == pytest.approx(old, rel=1e-9, abs=1e-12 * old.max())


def test_solution_of_the_split_problem_starts_the_coupled_one_near_its_solution():
    """From there Algorithm 7.1 sees a hundredth of the residual that it sees from v = 0."""
    problem = wrench_problem(wrench.paper_mesh(437))
    near = semismooth_newton(problem, regularisation=split(Coupled(1e5)))
    there = functional(problem, Coupled(1e5))
    exact = semismooth_newton(problem, 1e5)
    V = exact.dual_energy

    def distance(v):
        blocks = there.blocks
        y = blocks.load.CreateVector()
        blocks.primal_of(v, y)
        return there.smooth_energy(y, v) + there.penalty(v) - V

    assert 0 <= distance(carried_over(near, there)) < 0.05 * V
    assert distance(carried_over(near, there)) < 1e-2 * distance(there.blocks.H_vector())


def test_path_by_the_split_ends_in_the_coupled_problem_with_few_steps():
    problem = wrench_problem(wrench.paper_mesh(873))
    path = follow_path(problem, regularisation=lambda gamma: split(Coupled(gamma)), closing=Coupled)
    papers = follow_path(problem)
    path.raise_for_status()
    assert path.result.functional.regularisation == Coupled(path.gamma_end)
    assert path.gamma_end == papers.gamma_end
    assert path.gammas[-1] == path.gammas[-2]
    assert path.total_inner_iterations <= papers.total_inner_iterations / 2
    assert path.residual_norms[-1] <= papers.residual_norms[-1]
    assert path.path_values[-1] == pytest.approx(papers.path_values[-1], rel=0.02)


@pytest.mark.parametrize(
    ("regularisation", "share", "error"),
    [
        (Balanced(1e3), 0.5, TypeError),
        (Coupled(1e3), 1.0, ValueError),
        (Coupled(1e3, plastic_shift=0.1), 0.5, ValueError),
    ],
)
def test_split_refuses_what_it_cannot_split(regularisation, share, error):
    with pytest.raises(error, match=r"regularisation|share"):
        split(regularisation, share)
