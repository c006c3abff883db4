"""The arithmetic of costs, its records and its command; no time is judged here."""

import json

import numpy as np
import pytest

from ngepc import lshape_problem, semismooth_newton
from ngepc.__main__ import main
from ngepc.geometries import lshape
from ngepc.studies import cost
from ngepc.studies.cost import NODES, Cost
from ngepc.studies.examples import peak_memory
from ngepc.studies.work import exponent


@pytest.mark.parametrize("a", [1.0, 1.15, 1.5])
def test_growth_is_the_exponent_of_a_power_law(a):
    nodes = (1601, 3201, 24833)
    assert exponent(nodes, [1e-5 * n**a for n in nodes]) == pytest.approx(a, rel=1e-12)


def test_all_meshes_belong_to_the_family():
    assert lshape.PAPER_NODES[1:] == NODES[: len(lshape.PAPER_NODES) - 1]
    assert [lshape.paper_mesh(n).nv for n in NODES[-2:]] == list(NODES[-2:])


def test_one_elastic_solve_between_any_two_steps(monkeypatch):
    """Ratios are those to the mean of the elastic solves before and after a step."""
    count = semismooth_newton(lshape_problem(lshape.paper_mesh(113))).iterations
    seconds = iter([1.0, 3.0] * 50)
    called = []
    monkeypatch.setattr(
        cost, "elastic_solve", lambda p: called.append(p) or next(seconds)
    )
    found = cost.measure("default", 113)
    assert found["iterations"] == count
    assert len(called) == count + 2
    assert found["step_ratio"] == pytest.approx(found["step_seconds"] / 2)
    assert (
        0 < found["step_ratio"] <= found["largest_ratio"] <= found["solve_seconds"] / 2
    )


def test_peak_memory_counts_a_large_array():
    before = peak_memory()
    if before is None:
        pytest.skip("this system does not tell")
    block = bytearray(400 << 20)
    np.frombuffer(block, dtype=np.uint8)[::4096] = 1  # each page is used
    assert peak_memory() >= len(block) / (1 << 20)
    assert peak_memory() >= before


def test_command_writes_table_and_records(tmp_path, monkeypatch):
    monkeypatch.setattr("ngepc.studies.cost.MODES", ("default",))
    assert main(["study", "cost", "--levels", "1", "--out", str(tmp_path)]) == 0
    (found,) = json.loads((tmp_path / "cost.json").read_text())["cells"]
    assert (found["nodes"], found["status"]) == (1601, "converged")
    assert found["largest_ratio"] >= found["step_ratio"] > 0
    assert {p.name for p in tmp_path.iterdir() if p.is_file()} == {
        f"cost.{ending}" for ending in ("csv", "md", "json")
    }


def test_what_is_not_there_is_refused(tmp_path):
    with pytest.raises(ValueError, match="1 to 7"):
        Cost(tmp_path, 8).cells()
