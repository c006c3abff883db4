"""The robustness study in small, and what its committed table promises."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from campaigns.robustness import (
    ASPECT,
    CASES,
    CONTACT,
    GAMMA,
    HARDENING,
    METHODS,
    POISSON,
    Robustness,
    extreme_problem,
    solve,
)
from samples import state_of
from witness import balance_residual, dual_residual

from ngepc import Status, primal_newton

LIMIT, CELLS = 60, 6
RESULTS = Path(__file__).resolve().parent.parent.parent / "results"
LABELS = {status.label for status in Status}

ROWS = [
    "usual",
    f"Poisson {POISSON[-1]:g}",
    *(f"h/mu {value:g}" for value in (1e-1, 1e-4, 1e-6)),
    f"aspect ratio {ASPECT[-1]:g}",
    *(f"contact {value}" for value in CONTACT),
    *(f"gamma {value:g}" for value in (1e0, 1e9)),
]
"""The ends of all ranges; the committed table has what lies between."""
DROWNED = {"h/mu 0.0001", "h/mu 1e-06"}
"""Rows where rounding leaves more than 1e-10 of the dual residual; in the last of the primal."""
STEEP = {"gamma 1e+06", "gamma 1e+09"}
"""Rows that the coupled method need not master from a cold start."""


def test_the_data_go_to_their_extremes():
    assert max(POISSON) == 0.4999
    assert (max(HARDENING), min(HARDENING)) == (1e-1, 1e-6)
    assert (min(GAMMA), max(GAMMA)) == (1.0, 1e9)
    assert max(ASPECT) == 1e3
    assert set(CONTACT) == {"none", "one node", "full", "grazing", "from an end"}
    assert set(ROWS) <= set(CASES)


def check_state(result, method):
    """A named status, finite numbers, and residuals that an independent look confirms."""
    last = getattr(result, "last", result)
    assert isinstance(result.status, Status)
    assert np.isfinite(state_of(last)).all()
    assert math.isfinite(last.primal_energy)
    if result.status is not Status.CONVERGED:
        assert "residual" in result.message
    elif method == "primal":
        assert balance_residual(last) < 2e-10
    elif method == "coupled":  # inner tolerances of the path are those of Algorithm 7.2
        witness = dual_residual(last, 100)
        assert witness.norm < 1e-10 + witness.rounding


@pytest.mark.parametrize("row", ROWS)
def test_every_method_ends_a_row_as_it_should(row):
    results = {method: solve(CASES[row], method, LIMIT, CELLS) for method in METHODS}
    for method, result in results.items():
        check_state(result, method)
    primal, default = results["primal"], results["default"]
    if row == "h/mu 1e-06":
        assert primal.status is Status.STAGNATED
        assert "Rounding errors" in primal.message
    else:
        assert primal.status is Status.CONVERGED
    assert primal.iterations <= 15
    assert default.status is Status.CONVERGED or row in DROWNED
    assert default.iterations <= 20
    assert results["coupled"].status is Status.CONVERGED or row in STEEP | DROWNED


@pytest.mark.parametrize(
    ("contact", "least", "most"),
    [
        ("none", 0.0, 0.0),
        ("one node", 1e-9, 0.35),
        ("full", 0.75, 1.1),
        ("grazing", 0.0, 0.35),
        ("from an end", 1e-9, 0.6),
    ],
)
def test_contact_states_are_what_they_are_called(contact, least, most):
    """Measure of the upper side that touches, by the primal solution."""
    problem = extreme_problem(CASES[f"contact {contact}"], CELLS)
    touching = primal_newton(problem).history.records[-1].contact_active
    assert least <= touching <= most


def test_committed_table_has_all_cells_and_no_state_without_a_name():
    with (RESULTS / "robustness.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    stored = json.loads((RESULTS / "robustness.json").read_text())["cells"]
    assert len(stored) == len(CASES) * len(METHODS)
    assert {(c["row"], c["method"]) for c in stored} == {
        (r, m) for r in CASES for m in METHODS
    }
    assert list(table[0])[:5] == ["row", "method", "limit", "iterations", "status"]
    assert {"residual", "plastic", "contact_force", "message"} <= set(table[0])
    assert list(dict.fromkeys(row["row"] for row in table)) == list(CASES)
    for cell in stored:
        assert cell["status"] in LABELS
        assert cell["status"] == "converged" or cell["message"]
        assert math.isfinite(cell["residual"])
        assert isinstance(cell["iterations"], int)
    for cell in stored:
        steep = cell["method"] == "coupled" and cell["row"].startswith("gamma")
        drowned = cell["row"] in ("h/mu 0.0001", "h/mu 1e-05", "h/mu 1e-06")
        if not steep and not drowned:
            assert cell["status"] == "converged", cell


def test_unknown_rows_are_refused():
    with pytest.raises(ValueError, match=r"rows=\['junk'\]: the table has usual"):
        Robustness("out", ["junk"])
