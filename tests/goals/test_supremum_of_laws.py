"""The supremum of a goal for nonlinear hardening laws, against a dense search."""

from dataclasses import replace

import featured
import numpy as np
import pytest
from campaigns.crossings import finer
from campaigns.intervals import value_of

from ngepc import MeanDisplacement, Voce, goal_bound, semismooth_newton
from ngepc.discretisation.resistance import Resistance
from ngepc.geometries import block
from ngepc.goals.goal_bound import GoalProblem
from ngepc.goals.pieces import mean_squares, pieces_last
from ngepc.goals.supremum import ScaledLaw
from ngepc.goals.supremum_of_laws import CLOSE, NonlinearLaw

COUNT = 200


class Points:
    """Random laws, and p and w near those of a state with errors of a given size."""

    def __init__(self, isotropic, factor, error):
        random = np.random.default_rng(3)
        self.two_mu = random.uniform(1, 3, COUNT)
        self.hardening = random.uniform(0.01, 1, COUNT)
        beta = random.uniform(0.2, 1, COUNT)
        before = random.uniform(0, 0.1, COUNT)
        self.resistance = Resistance(beta, isotropic, before, linear=np.zeros(COUNT))
        self.factor = factor

        trial = random.normal(size=(COUNT, 1, 3))
        size = np.linalg.norm(trial[:, 0], axis=1)
        gained = self.resistance.gained_at(size, self.two_mu + self.hardening)
        stress = trial * (1 - self.two_mu * gained / size)[:, None, None]
        c = (factor / self.two_mu)[:, None, None]
        self.p = c * (stress + error * random.normal(size=(COUNT, 3, 3)))
        self.w = c * (trial + error * random.normal(size=(COUNT, 3, 3)))
        self.c = c[:, :, 0]

    def searched(self):
        """Phi by values at many plastic strains."""
        y = np.linalg.norm(self.p + self.w, axis=2)
        beta = self.resistance.beta[:, None]
        inside = y <= 2 * self.c * beta
        best = np.where(inside, y**2 / (4 * self.c), beta * (y - self.c * beta))
        for g in np.append(np.linspace(0, 3, 1500), np.linspace(3, 60, 1500)):
            bound = self.resistance.bound(np.full(COUNT, g))
            r = (bound + self.hardening * g)[:, None]
            rho = r + (self.two_mu * g)[:, None]
            pulled = rho[..., None] * self.p + r[..., None] * self.w
            value = np.linalg.norm(pulled, axis=2) - self.c * rho * r
            best = np.maximum(best, value)
        return best

    def without_errors(self):
        """The value of Phi where both arguments belong to the same state."""
        return np.einsum("nkd,nkd->nk", self.p, self.w) / self.c

    def law(self):
        return NonlinearLaw(self.resistance, self.two_mu, self.hardening, self.factor)

    def found(self):
        return self.law().potential(self.p, self.w)

    def elastic(self):
        return self.law().elastic(pieces_last(self.p), pieces_last(self.w))

    def quadratic(self):
        """The means of Phi where nothing yields."""
        return mean_squares(pieces_last(self.p + self.w)) / (4 * self.c[:, 0])


@pytest.mark.parametrize("error", [1.0, 0.05])
@pytest.mark.parametrize("factor", [0.05, 5.0])
def test_no_plastic_strain_gives_a_larger_value(factor, error):
    points = Points(Voce(1.5, 0.5, 20.0), factor, error)
    searched = points.searched()
    part = (points.found() - searched) / (searched - points.without_errors())
    assert part.min() > -1e-10
    assert part.max() < 0.1


def test_a_constant_bound_is_linear_hardening():
    points = Points(None, 0.7, 0.1)
    beta = points.resistance.beta
    linear = ScaledLaw.of(points.two_mu, points.hardening, beta, points.factor)
    expected = linear.potential(points.p, points.w)
    found = points.found()
    off = (found - expected) / (expected - points.without_errors())
    assert off.max() < 1.001 * CLOSE
    assert off.min() > -0.1
    assert np.median(np.abs(off)) < 0.01
    elastic = points.elastic()
    assert 0 < elastic.sum() < COUNT
    exact = points.quadratic()[elastic]
    for law in (linear, points.law()):
        bound = law.means(points.p, points.w)[0][elastic]
        np.testing.assert_allclose(bound, exact, rtol=1e-12)


TOUCHES = {"contact": "contact", "gap": 1e-4}
COARSE = {"mesh": block.structured_mesh(2, 2, simplices=True)}


@pytest.mark.parametrize(
    ("feature", "changes"),
    [
        ("hardening law", TOUCHES),
        ("hardening law", TOUCHES | COARSE | {"order": 2}),
        ("initial strain", {}),
    ],
)
def test_intervals_contain_the_value_of_a_fine_mesh(feature, changes):
    problem = replace(featured.problem_with(feature), **changes)
    problem = finer(problem, 2 - problem.order)
    result = semismooth_newton(problem)
    fine = semismooth_newton(finer(problem, 1))
    assert result.state.at.yields.any()
    goals = GoalProblem(result)
    for goal in ("work", MeanDisplacement("right", 0)):
        coarse = goals.bound_of(goal)
        assert coarse.lower < value_of(fine, goal) < coarse.upper
    assert goal_bound(fine, goal).width < 0.7 * coarse.width
