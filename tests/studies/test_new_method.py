"""The studies of the default method: its counts, and what locks."""

import json
from functools import partial

import numpy as np
import pytest
from ngsolve.meshes import MakeStructured2DMesh

from ngepc import PyAMG, semismooth_newton
from ngepc.__main__ import main
from ngepc.geometries import block
from ngepc.studies.counts import BLOCKS, LAWS, NewtonCounts, problem_of
from ngepc.studies.examples import nested, timed
from ngepc.studies.large import indented_block, solved_in_a_row
from ngepc.studies.locking import KINDS, Locking, cantilever, deflection, solve_with


def test_counts_of_one_mesh(tmp_path):
    study = NewtonCounts(tmp_path, levels=1)
    (record,) = study.kept(study.cells()[0])
    assert record["nested"]["iterations"] <= record["default"]["iterations"] <= 11
    assert record["default"]["energy"] == pytest.approx(
        record["primal"]["energy"], rel=1e-12
    )
    _, row = study.table([record])
    assert row[:3] == ["Example (a)", "", "833"]
    assert row[-2:] == ["11", "0.1"]
    assert "on 1 mesh, the first one started from 417 nodes" in study.notes([record])[2]


def test_blocks_have_the_nodes_they_are_called_by():
    for elements, sizes in BLOCKS.items():
        smallest = min(sizes)
        assert problem_of(elements, smallest, 0.1).mesh.nv == smallest


def test_meshes_in_a_row_are_those_of_the_indented_block():
    """Copies forget where tetrahedra are to be bisected next, with as many nodes elsewhere."""
    *_, (fine, _) = solved_in_a_row(block.mesh(maxh=0.4), 2, 0.1, PyAMG())
    meshes = (fine.problem.mesh, indented_block(2).mesh)
    places = (np.array(mesh.ngmesh.Coordinates()) for mesh in meshes)
    assert np.array_equal(*places)


def test_hardening_is_the_ratio_to_mu():
    material = problem_of("lshape", 833, 1e-3).material
    assert material.hardening == pytest.approx(1e-3 * material.lame_mu)


@pytest.mark.parametrize("law", LAWS)
def test_other_laws_take_few_steps(law):
    problem = problem_of(law, 113, 0.1)
    result = semismooth_newton(problem).raise_for_status()
    assert result.iterations <= 15
    assert result.state.at.yields.any()


def test_nested_solution_is_the_cold_one():
    result = nested("wrench", "default", 873)
    _, cold = timed(semismooth_newton, result.problem)
    assert result.primal_energy == pytest.approx(cold["energy"], rel=1e-12)


def test_mean_volume_at_one_point_changes_nothing():
    """Linear triangles have one integration point: the mean is the value."""
    problem = cantilever(partial(MakeStructured2DMesh, quads=False), 2, 1)
    plain, mean = (deflection(solve_with(problem, m)) for m in (False, True))
    assert plain == pytest.approx(mean, rel=1e-12)


def test_locking_study(tmp_path):
    arguments = ["study", "locking", "--levels", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    cells = json.loads((tmp_path / "locking.json").read_text())["cells"]
    value = {(c["problem"], c["elements"]): c["value"] for c in cells}
    beam, soil, _ = dict.fromkeys(c["problem"] for c in cells)
    assert set(KINDS) == {elements for _, elements in value}
    assert value[beam, "P1"] < 0.05 < 0.85 < value[beam, "P2"] < 1
    assert value[beam, "Q1"] < 0.05 < 0.85 < value[beam, "Q1, mean volume"] < 1
    assert value[soil, "P1"] > 2 > 1.4 > value[soil, "Q1, mean volume"] > 1
    with pytest.raises(ValueError, match="levels=5"):
        Locking(tmp_path, 5).cells()
