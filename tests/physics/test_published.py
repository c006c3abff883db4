"""Published problems and closed forms of ``ngepc study benchmarks``, those that take seconds."""

from functools import partial

import pytest

from ngepc.studies.benchmarks import BENCHMARKS, Benchmarks
from ngepc.studies.contact_problems import mindlin
from ngepc.studies.solid_problems import Quantity

ELSEWHERE = {
    "vertical cut",
    "Prandtl's strip",
    "Bree's plate",
    "Bree's plate, shakedown",
    "relaxation",
}
"""What other tests compare with the same closed forms.

Limit and shakedown loads in tests/limit, Bree's cycles in tests/evolution/test_temperature.py,
relaxation in tests/physics/test_rates.py.
"""

COARSER = {"Mindlin": partial(mindlin, 0.07)}
"""A coarser mesh than that of the study, with its tolerances."""

QUICK = sorted(set(BENCHMARKS) - {"sphere on a flat", "SSNV506"} - ELSEWHERE)


@pytest.mark.parametrize("name", QUICK)
def test_numbers_are_met(name):
    _, quantities = COARSER.get(name, BENCHMARKS[name].solve)()
    assert [q for q in quantities if not q.holds] == []


def test_a_difference_beyond_the_tolerance_is_seen():
    assert not Quantity("force", 2.0, "P", 0.01, 2.03).holds
    assert Quantity("force", -2.0, "P", 0.01, -2.01).difference == pytest.approx(0.005)


def test_the_study_writes_a_row_for_each_quantity(tmp_path):
    Benchmarks(tmp_path, rows=["step-42"]).run()  # kept without a picture
    study = Benchmarks(tmp_path, rows=["SSNP14", "step-42"], figures=True)
    records = study.run()
    written = [path.name for path in study.write(records)]
    assert written == ["benchmarks.csv", "benchmarks.md", "benchmarks.json"]
    lines = (tmp_path / "benchmarks.md").read_text().splitlines()
    rows = [line for line in lines if line.startswith("|")]
    assert len(rows) == 2 + 3 + 1
    assert "eps_xy at A | 0.0136014 P | 0.0136014 | +0.00 % | 0.1 % |" in rows[3]
    assert (tmp_path / "benchmark_step_42.png").stat().st_size > 5000
    assert study.succeeded(records)
    assert not study.succeeded([records[0] | {"beyond": " (beyond)"}])
