"""Which rows are examined for other equilibria, and what is said where that is too many."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngepc import Material, Problem, semismooth_newton
from ngepc.discretisation import contact_step
from ngepc.discretisation.contact_step import (
    LINEARISED,
    SEARCHED,
    is_unique,
    several_solutions,
)
from ngepc.discretisation.factors import Factors
from ngepc.geometries import block
from ngepc.model.processes import Team


def state(multipliers, tied, open_gap):
    """A solution with rows in the plane, some of which are tied; nothing is solved."""
    count = len(multipliers)
    cone = SimpleNamespace(
        d=1,
        coefficient=np.full(count, 0.3),
        cap=np.full(count, np.inf),
        given=np.zeros(count, dtype=bool),
        tied=np.array(tied),
        enumerable=False,
    )
    conditions = SimpleNamespace(processes=Team(), friction=cone, sum_of=np.sum)
    body = SimpleNamespace(contact=conditions, row_stiffness=np.ones(count))
    return SimpleNamespace(
        body=body, multipliers=np.array(multipliers), open_gap=np.array(open_gap)
    )


@pytest.fixture
def examined(monkeypatch):
    """The rows that were examined."""
    found = []

    def other_forces(here, compliance, rows):
        found.append(set(rows.tolist()))

    monkeypatch.setattr(contact_step, "_other_forces", other_forces)
    return found


def test_tied_rows_come_first_then_those_that_press_or_are_closest(examined):
    here = state(
        [0, 0, 3, 0, -1, 2], [0, 0, 0, 0, 1, 1], [0.4, 0.1, 0.0, 0.2, 0.0, 0.0]
    )
    here.body.contact.friction.tied = here.body.contact.friction.tied.astype(bool)
    assert several_solutions(here, None, most=8) == (False, SEARCHED)
    assert examined == [{4, 5, 2, 1}]


@pytest.mark.parametrize(
    ("multipliers", "tied"),
    [([1, 2, 3, 4, 5, 0], 6 * [False]), ([0, 0, 0, 0, 0, 0], [True] * 5 + [False])],
)
def test_more_rows_that_press_or_are_tied_are_not_examined(multipliers, tied, examined):
    """Four rows of two forces each may be."""
    here = state(multipliers, tied, 6 * [0.0])
    several, message = several_solutions(here, None, most=8)
    assert not several
    assert message.startswith("Friction on 6 rows: ")
    assert "not examined" in message
    assert examined == []


@pytest.mark.parametrize(
    ("most", "enumerable", "plastic", "message"),
    [
        (8, True, 0.0, ""),
        (8, True, 0.1, LINEARISED),
        (8, False, 0.0, SEARCHED),
        (4, True, 0.0, SEARCHED),
    ],
)
def test_what_proves_that_there_is_no_other_equilibrium(
    most, enumerable, plastic, message, examined
):
    """That all states of all rows of an elastic body were tried."""
    here = state([2, 1, 0, 0], 4 * [False], [0.0, 0.0, 0.1, 0.2])
    here.body.contact.friction.enumerable = enumerable
    here.plastic_measure = plastic
    assert several_solutions(here, None, most=most) == (False, message)
    assert len(examined[0]) == most // 2


def test_another_equilibrium_is_said_with_its_force(monkeypatch):
    """The sums of the normal forces of rows that are not tied."""
    other = np.array([-5.0, 4.0, 2.0, 8.0, 8.0, 8.0])
    monkeypatch.setattr(contact_step, "_other_forces", lambda *_: other)
    here = state([3.0, 2.0, -7.0], [False, False, True], 3 * [0.0])
    several, message = several_solutions(here, None, most=6)
    assert several
    assert "force 6 instead of 5." in message


@pytest.mark.parametrize("size", [0.02, 0.5, 0.8, 1.0, 1.2])
def test_how_many_steps_prove_that_forces_are_unique(size):
    """As many as leave a chance of 1e-6, by the bound of Kuczynski and Wozniakowski.

    The values of Ritz are those of the Krylov space, by dense matrices.
    """
    random = np.random.default_rng(3)
    m = 15
    Q = random.normal(size=(2 * m, 2 * m)) / np.sqrt(2 * m)
    S = Q @ Q.T + 2 * np.eye(2 * m)
    follows = size * random.uniform(-1, 1, (m, 1))
    asked = []

    def compliance(d):
        asked.append(d)
        return S @ d

    assert is_unique(follows, compliance, lambda g: np.linalg.solve(S, g))
    C = np.linalg.inv(np.linalg.inv(S)[:m, :m])
    root = np.linalg.cholesky(C)
    E = np.vstack([np.zeros((m, m)), np.diag(follows[:, 0])])
    A = np.linalg.solve(root, np.linalg.solve(root, E.T @ S @ E / 4).T)
    start = np.linalg.solve(root, np.random.default_rng(0).standard_normal(m))
    basis = np.zeros((m, 0))
    for k in range(1, m):
        new = A @ basis[:, -1] if k > 1 else start
        for _ in range(2):
            new = new - basis @ (basis.T @ new)
        basis = np.column_stack([basis, new / np.linalg.norm(new)])
        left = 1 - np.linalg.eigvalsh(basis.T @ A @ basis)[-1]
        chance = 1.648 * np.sqrt(m) * np.exp(-(2 * k - 1) * np.sqrt(left))
        if chance <= 1e-6:
            break
    assert len(asked) == k < m - 1


def test_large_coefficients_are_not_proved_to_be_unique():
    """Where the largest quotient is above one."""
    S = np.eye(8)
    follows = np.full((4, 1), 2.5)
    assert not is_unique(follows, lambda d: S @ d, lambda g: g)
    assert is_unique(0.7 * follows, lambda d: S @ d, lambda g: g)


def test_the_first_guess_of_the_compliance():
    """Rows are as stiff as their nodes and the springs of rollers together."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
    )
    problem = Problem(mesh, metal, contact="contact", gap=-1e-3, order=1)
    body = semismooth_newton(problem).state.body
    body.contact.springs = lambda stiffness: 3 * stiffness
    np.testing.assert_allclose(4 * body.row_stiffness * body.compliance().diagonal, 1.0)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    ("cells", "simplices"), [((2, 2), True), ((2, 2, 2), True), ((2, 2, 2), False)]
)
def test_factors_with_springs_of_the_rows(cells, simplices, order):
    """(K + R' k R) u = f; a row belongs to one node, with order two to the nodes of one facet."""
    mesh = block.structured_mesh(*cells, simplices=simplices)
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
    )
    problem = Problem(mesh, metal, contact="contact", gap=-1e-3, order=order)
    result = semismooth_newton(problem)
    body = result.state.body
    factors = Factors(body, "sparsecholesky")
    factors.update(result.state.moduli)
    random = np.random.default_rng(0)
    springs = random.uniform(1.0, 1e3, body.contact.matrix.shape[0])
    forces = np.where(body.free, random.normal(size=body.free.shape), 0.0)
    u = factors.stiffened(springs)(forces)
    R = body.contact.matrix
    held = (R.T @ (springs * (R @ u.ravel()))).reshape(u.shape)
    rest = np.where(body.free, factors.multiply(u) + held - forces, 0.0)
    assert np.abs(rest).max() < 1e-9 * np.abs(forces).max()
