"""Which rows are examined for other equilibria, and what is said where that is too many."""

from types import SimpleNamespace

import numpy as np
import pytest

from ngepc import Material, Problem, semismooth_newton
from ngepc.discretisation import contact_step
from ngepc.discretisation.contact_step import SEARCHED, several_solutions
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


def test_factors_with_springs_of_the_rows():
    """(K + R' k R) u = f; each row belongs to one node with order one, not with order two."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
    )
    problem = Problem(mesh, metal, contact="contact", gap=-1e-3, order=1)
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
    quadratic = semismooth_newton(problem.changed(order=2))
    assert Factors(quadratic.state.body, "sparsecholesky").stiffened is None
