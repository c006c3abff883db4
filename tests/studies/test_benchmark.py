"""The benchmark's arithmetic, its records and its command; no time is judged here."""

import json
import math

import pytest
from ngepc.geometries import lshape

from ngepc import lshape_problem, semismooth_newton
from ngepc.__main__ import main
from ngepc.studies.benchmark import (
    NODES,
    Cell,
    Measurement,
    StepClock,
    growth,
    peak_memory,
    summary,
)
from ngepc.studies.benchmark_output import plot_benchmark


def measurement(nodes, seconds, mode="exact"):
    return Measurement(
        mode=mode, nodes=nodes, unknowns=4 * nodes, status="converged", iterations=9,
        elastic_seconds=seconds / 2, step_seconds=seconds, step_ratio=2.0, mean_ratio=2.0,
        largest_ratio=3.0, setup_ratio=5.0, peak_megabytes=None, load_average=None,
    )  # fmt: skip


@pytest.mark.parametrize("exponent", [1.0, 1.15, 1.5])
def test_growth_is_the_exponent_of_a_power_law(exponent):
    law = [measurement(n, 1e-5 * n**exponent) for n in (1601, 3201, 24833)]
    assert growth(law) == pytest.approx(exponent, rel=1e-12)
    assert math.isnan(growth(law[:1]))


def test_all_meshes_belong_to_the_family():
    assert lshape.PAPER_NODES[1:] == NODES[: len(lshape.PAPER_NODES) - 1]
    assert [lshape.paper_mesh(n).nv for n in NODES[-2:]] == list(NODES[-2:])


def test_one_elastic_solve_between_any_two_steps():
    problem = lshape_problem(lshape.paper_mesh(113))
    clock = StepClock(problem)
    result = semismooth_newton(problem, 1e2, monitor=clock)
    assert len(clock.spans) == result.iterations + 1
    assert len(clock.elastic) == result.iterations + 2
    clock.elastic, clock.spans = [1.0, 3.0, 1.0], [10.0, 4.0]
    assert clock.ratios == [5.0, 2.0]
    cell = summary(Cell("coupled", 113), result, clock)
    assert (cell.setup_ratio, cell.step_ratio, cell.largest_ratio) == (5.0, 2.0, 2.0)
    assert cell.iterations == result.iterations
    assert cell.unknowns < 4 * 113 + 2 * 20


def test_peak_memory_counts_a_large_array():
    before = peak_memory()
    if before is None:
        pytest.skip("this system does not tell")
    block = bytearray(b"x" * (400 << 20))
    assert peak_memory() >= len(block) / (1 << 20)
    assert peak_memory() >= before


def test_plot_shows_each_mode_with_its_bound():
    figure = plot_benchmark([measurement(n, 1e-5 * n, m) for m in ("exact", "coupled")
                             for n in (1601, 3201)])  # fmt: skip
    ratio = figure.axes[1]
    assert {line.get_ydata()[0] for line in ratio.lines if line.get_linestyle() == "--"} == {3, 8}


def test_command_writes_table_plot_and_records(tmp_path, capsys):
    arguments = ["benchmark", "--levels", "1", "--mode", "exact", "--out", str(tmp_path)]
    assert main([*arguments, "--json", "-"]) == 0
    (cell,) = json.loads(capsys.readouterr().out)["cells"]
    assert (cell["nodes"], cell["status"]) == (1601, "converged")
    assert cell["unknowns"] < 4 * 1601
    assert {p.name for p in tmp_path.iterdir()} == {
        f"benchmark.{ending}" for ending in ("csv", "md", "json", "png")
    }


def test_too_many_levels_are_bad_usage(capsys):
    assert main(["benchmark", "--levels", "8"]) == 2
    assert "1 to 7" in capsys.readouterr().err
