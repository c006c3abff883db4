"""The worked examples for those who extend: each runs by itself and does what it says."""

import re
from pathlib import Path

import numpy as np
import pytest

from ngepc import Material, Problem, semismooth_newton

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
OWN = (ROOT / "docs" / "howto" / "own_parts.md").read_text(encoding="utf-8")
EXAMPLES = dict(
    re.findall(
        r"^## An? (.*?)\n.*?```python\n(.*?)^```", OWN + TEXT, re.DOTALL | re.MULTILINE
    )
)


@pytest.fixture
def example(request, tmp_path, monkeypatch):
    """The names that an example leaves behind, run in an empty folder."""
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "example"}
    exec(compile(EXAMPLES[request.param], request.param, "exec"), names)
    return names


def test_these_are_the_examples():
    assert list(EXAMPLES) == [
        "hardening law",
        "obstacle",
        "kinematics",
        "line search",
        "path in gamma",
        "preconditioner",
        "error indicator",
        "study",
    ]


def test_every_room_has_its_sentence():
    rooms = {
        p.name for p in (ROOT / "ngepc").iterdir() if (p / "__init__.py").is_file()
    }
    told = set(re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE))
    assert told == rooms - {"geometries", "notebooks"}


def test_the_files_of_new_parts_exist():
    """Those of the package are named from its folder on."""
    rows = re.search(r"^## New parts.*?^## ", TEXT, re.DOTALL | re.MULTILINE)[0]
    named = set(re.findall(r"`([\w/.]+/[\w/.]+\.\w+)`", rows))
    assert len(named) >= 25
    missing = [
        name
        for name in named
        if not any((folder / name).is_file() for folder in (ROOT, ROOT / "ngepc"))
    ]
    assert missing == ["notebooks/NN_name.ipynb"]


@pytest.mark.parametrize("example", ["hardening law"], indirect=True)
def test_an_own_law_meets_its_closed_form(example):
    result, law = example["saturating"], example["law"]
    assert str(result.status) == "converged"
    assert result.residual_norm < 1e-10
    assert example["peeq"] > 0.01
    assert law.stress(example["peeq"]) == pytest.approx(
        np.sqrt(3) * example["tau"], rel=1e-8
    )


@pytest.mark.parametrize("example", ["obstacle"], indirect=True)
def test_roof_presses_with_its_ridge(example):
    mesh = example["ground"]
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=10.0, hardening=100.0
    )
    problem = Problem(mesh, steel, contact="contact", gap=example["roof_gap"])
    result = semismooth_newton(problem)
    assert result.displacement(mesh(0.0, 0.0))[1] == pytest.approx(-0.03, rel=1e-9)
    assert result.contact_force > 0


@pytest.mark.parametrize("example", ["kinematics"], indirect=True)
def test_a_slice_of_thickness_five_carries_five_times_the_force(example):
    assert example["forces"][1] == pytest.approx(5 * example["forces"][0], rel=1e-9)


@pytest.mark.parametrize("example", ["line search"], indirect=True)
def test_thirds_converge(example):
    assert str(example["thirds"].status) == "converged"


@pytest.mark.parametrize("example", ["study"], indirect=True)
def test_the_study_writes_its_table_and_resumes(example):
    table = Path("out/orders.md").read_text(encoding="utf-8")
    assert table.startswith("# Orders")
    kept = sorted(path.name for path in Path("out/cells").iterdir())
    assert kept == sorted(f"orders-{k}-{n}.npz" for n in (33, 65, 113) for k in (1, 2))
    assert [r["energy"] for r in example["Orders"](Path("out")).run()] == [
        r["energy"] for r in example["records"]
    ]


@pytest.mark.parametrize("example", ["path in gamma"], indirect=True)
def test_an_own_path_ends_where_the_built_in_one_does(example):
    """At the same gamma, to the same residual; the value is that of one minimum."""
    own = example["last"]
    built_in = example["built_in"].last
    assert own.regularisation.gamma == built_in.regularisation.gamma == 1e5
    assert own.residual_norm <= example["target"]
    assert own.dual_energy == pytest.approx(built_in.dual_energy, rel=1e-2)
    assert example["own_steps"] > 1


@pytest.mark.parametrize("example", ["preconditioner"], indirect=True)
def test_an_own_preconditioner_changes_the_iterations_alone(example):
    own, multigrid = example["forces"]
    assert own == pytest.approx(multigrid, rel=1e-8)
    assert str(example["result"].status) == "converged"
    iterations = example["iterations"]
    assert iterations[0] > 3 * iterations[1]


@pytest.mark.parametrize("example", ["error indicator"], indirect=True)
def test_bounds_fall_on_meshes_of_an_own_indicator(example):
    """Faster than 1 / nodes, the best rate that order one could have."""
    for bounds in (example["by_jumps"], example["by_work"]):
        nodes = list(bounds)
        rate = np.polyfit(np.log(nodes), np.log(list(bounds.values())), 1)[0]
        assert len(bounds) == 4
        assert rate < -1.0
