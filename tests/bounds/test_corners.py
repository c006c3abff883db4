"""Contact pressures on bisected copies: their resultant, and what it saves."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import STEEL
from campaigns.crossings import finer

from ngepc import Problem, error_bound, semismooth_newton
from ngepc.bounds import balance
from ngepc.bounds.bound import clear_copy
from ngepc.bounds.corners import pressure_on_copy
from ngepc.geometries import block
from ngepc.model.support import rigid_motions
from ngepc.studies.bounds import bounded_example


@pytest.fixture(scope="module")
def result():
    return semismooth_newton(bounded_example("lshape", "uniform", 1601))


def works(forces, contact):
    motions = rigid_motions(contact.boundary.cells.points)
    return np.einsum("ni,nik->k", forces, motions[: len(forces)])


def test_the_pressure_has_force_and_moment_of_the_contact_forces(result):
    bound_data, carried, _, _, parents = clear_copy(result)
    contact = bound_data.contact
    P = pressure_on_copy(result, carried, contact, parents)
    pushed = contact.moments(P[:, :, None] * contact.normal[:, None])
    forces = np.zeros_like(carried.u)
    np.add.at(forces, contact.nodes, pushed)
    rows = result.discrete.rows.normal.T @ result.state.multipliers
    wanted = works(rows.reshape(result.state.u.shape), contact)
    assert P.min() >= 0
    np.testing.assert_allclose(works(forces, contact), wanted, rtol=1e-12, atol=1e-14)
    before = contact.from_rows.pressure(carried.multipliers)
    assert 0 < np.abs(P - before).max() < 0.1 * before.max()


def test_stresses_around_the_contact_zone_need_no_factors(monkeypatch):
    """And the bound is that with a stress balanced in the whole body, within two percent."""
    result = semismooth_newton(bounded_example("lshape", "uniform", 3201))
    factors = []
    original = balance.factorise

    def counted(state, tangent):
        factors.append(tangent)
        original(state, tangent)

    monkeypatch.setattr(balance, "factorise", counted)
    bound = error_bound(result)
    assert not factors
    monkeypatch.setattr(balance, "strain_nearby", lambda *given: None)
    whole = error_bound(result)
    assert len(factors) == 1
    assert bound.total == pytest.approx(whole.total, rel=0.02)


@pytest.mark.parametrize("cells", [(2, 60), (60, 2)])
@pytest.mark.parametrize("order", [1, 2])
def test_bounds_on_needles(cells, order):
    """They were 6 to 18 times the error on the mesh itself, 12 to 310 percent."""
    mesh = block.structured_mesh(*cells, simplices=True)
    pulled = {"right": (0.5, 0.2)}
    problem = Problem(mesh, STEEL, "clamped", pulled, order=order)
    result = semismooth_newton(problem)
    fine = semismooth_newton(replace(finer(problem, 1), order=2))
    error = result.primal_energy - fine.primal_energy
    assert error < error_bound(result).total < 3 * error
