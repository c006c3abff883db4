"""Example (b): energies of two independent codes, Newton counts of Table 2, outer counts."""

import math

import pytest

from ngepc import (
    PathOptions,
    duality_report,
    follow_path,
    semismooth_newton,
    wrench_problem,
)
from ngepc.geometries import wrench
from ngepc.studies.paper import TABLE_3_INNER, TABLE_3_OUTER


@pytest.fixture(scope="module")
def problems():
    return {nodes: wrench_problem(wrench.paper_mesh(nodes)) for nodes in (437, 873)}


def test_dual_energy_of_873_nodes_agrees_with_an_independent_code(problems):
    result = semismooth_newton(problems[873], 1e3)
    assert result.dual_energy == pytest.approx(0.0042380782, rel=1e-6)


@pytest.mark.parametrize(
    ("gamma", "least", "most"), [(10, 2, 2), (1e3, 10, 20), (1e4, 18, 30)]
)
def test_newton_counts_from_zero(problems, gamma, least, most):
    result = semismooth_newton(problems[437], gamma)
    result.raise_for_status()
    assert least <= result.iterations <= most


@pytest.mark.parametrize("nodes", [873])
def test_outer_iterations_of_table_3(problems, nodes):
    column = wrench.PAPER_NODES.index(nodes)
    path = follow_path(problems[nodes])
    path.raise_for_status()
    assert path.outer_iterations == TABLE_3_OUTER[column]
    assert path.gamma_end == pytest.approx(10 * 7**5)
    assert path.total_inner_iterations < 2 * TABLE_3_INNER[column]


def test_path_takes_fewer_steps_than_a_direct_solve(problems):
    """The same precision at the same gamma, from v = 0."""
    path = follow_path(problems[437])
    options = PathOptions(gamma_start=path.gamma_end, gamma_end=path.gamma_end)
    direct = follow_path(problems[437], options)
    assert direct.total_inner_iterations > path.total_inner_iterations


def test_path_to_the_gamma_of_the_figures_approaches_the_limit(problems):
    """V_gamma settles: T, M1 and M2 vanish, the normal stress of the open contact too."""
    reports = []
    options = PathOptions(gamma_end=10 * 7.0**7, inner_scale=1e-3)
    path = follow_path(
        problems[437], options, observer=lambda r: reports.append(duality_report(r))
    )
    path.raise_for_status()
    assert path.steps[-1].change < 2e-3
    last = reports[-1]
    for name in ("contact_penalty", "plastic_penalty", "tichonov"):
        assert last.parts[name] < 5e-3 * last.dual_energy
    assert last.tension < 1e-6
    assert last.penetration == 0.0  # the contact is not active, as the paper expects
    load = 6e-3 * math.hypot(3, 0.6)
    assert abs(path.last.contact_force) < 1e-5 * load


def test_handle_bends_down_and_yields_at_its_root(problems):
    result = semismooth_newton(problems[437], 1e5)
    mesh = problems[437].mesh
    tip, root = mesh(7.9, 1.5), mesh(3.2, 2.9)
    assert result.displacement(tip)[1] < 10 * result.displacement(root)[1] < 0
    zone = result.fields.plastic_zone(1e-2)
    assert zone(root) == 1.0
    assert zone(tip) == 0.0
    assert result.yield_function(tip) < 0
