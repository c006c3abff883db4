"""Algorithm 7.2: outer rule, inner tolerances, safeguard, checkpoints."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from samples import stop_after

from ngepc import (
    Coupled,
    DualSpaces,
    FullProduct,
    NewtonOptions,
    PathOptions,
    SolverError,
    Status,
    Units,
    follow_path,
    lshape_problem,
    semismooth_newton,
    wrench_problem,
)
from ngepc.__main__ import main
from ngepc.dual.algorithm import NewtonSystem
from ngepc.dual.blocks import LinearBlocks
from ngepc.dual.functional import DualFunctional
from ngepc.dual.path import contact_mesh_width, mesh_width
from ngepc.dual.solver import prepared
from ngepc.geometries import lshape, wrench


@pytest.fixture(scope="module")
def problem():
    return wrench_problem(wrench.paper_mesh(245))


@pytest.fixture(scope="module")
def path(problem):
    return follow_path(problem)


def test_mesh_widths_of_known_meshes():
    # 417 nodes: squares of side 1/16 cut along both diagonals, legs 1/16 / sqrt(2) ... altitudes
    mesh = lshape.paper_mesh(417)
    areas_side = math.sqrt(
        2 * 0.75 / mesh.ne
    )  # right isosceles triangles of equal area
    assert mesh_width(mesh) == pytest.approx(areas_side / math.sqrt(2))
    assert contact_mesh_width(lshape_problem(mesh)) == pytest.approx(1 / 16)


def test_gammas_grow_by_theta_and_the_outer_rule_ends_the_path(problem, path):
    h, tau = mesh_width(problem.mesh), PathOptions().outer_tolerance
    assert path.status is Status.CONVERGED
    assert path.gammas == pytest.approx(
        [10 * 7**k for k in range(path.outer_iterations)]
    )
    V = np.array(path.path_values)
    changes = np.abs(np.diff(V) / V[:-1])
    assert changes == pytest.approx([step.change for step in path.steps[1:]])
    assert changes[-1] < tau * h
    assert all(change >= tau * h for change in changes[:-1])


def test_each_gamma_meets_both_inner_tolerances_after_a_step(problem, path):
    options = PathOptions()
    h, h_c = mesh_width(problem.mesh), contact_mesh_width(problem)
    for step in path.steps:
        loose = options.inner_tolerance / math.sqrt(step.gamma)
        assert step.iterations >= 1
        assert step.contact_residual_norm < options.inner_scale * max(h_c, loose)
        assert step.plastic_residual_norm < options.inner_scale * max(h, loose)


def test_tight_inner_tolerances_give_the_solutions_of_algorithm_7_1(problem):
    options = PathOptions(gamma_start=10, growth=10, gamma_end=1e3, inner_scale=1e-10)
    path = follow_path(problem, options)
    direct = semismooth_newton(problem, 1e3)
    assert path.gammas == [10, 100, 1000]
    assert path.path_values[-1] == pytest.approx(direct.dual_energy, rel=1e-12)
    assert path.last.displacement.vec.FV().NumPy() == pytest.approx(
        direct.displacement.vec.FV().NumPy(), abs=1e-9
    )


def test_paper_tolerances_without_scale_pass_after_one_step_each(problem):
    path = follow_path(problem, PathOptions(inner_scale=1.0, max_outer_iterations=2))
    assert path.inner_iterations == [1, 1]


def test_safeguard_follows_the_path_until_the_residual_is_small(problem, path):
    tolerance = path.residual_norms[-1] / 10
    guarded = follow_path(problem, PathOptions(residual_tolerance=tolerance))
    assert guarded.status is Status.CONVERGED
    assert guarded.outer_iterations > path.outer_iterations
    assert guarded.path_values[: path.outer_iterations] == path.path_values
    assert guarded.residual_norms[-1] < tolerance


def test_safeguard_without_need_changes_nothing(problem, path):
    guarded = follow_path(
        problem, PathOptions(residual_tolerance=2 * path.residual_norms[-1])
    )
    assert guarded.path_values == path.path_values


def test_limits_and_failures_are_named(problem):
    short = follow_path(problem, PathOptions(max_outer_iterations=3))
    assert short.status is Status.ITERATION_LIMIT
    assert "max_outer_iterations" in short.message
    hasty = NewtonOptions(max_iterations=2)
    failed = follow_path(problem, PathOptions(newton=hasty))
    assert failed.status is Status.ITERATION_LIMIT
    assert f"gamma = {failed.gamma_end:.3g}" in failed.message
    assert failed.steps[-1].status is Status.ITERATION_LIMIT
    with pytest.raises(SolverError, match="gamma"):
        failed.raise_for_status()


def test_monitors_stop_the_path_and_keep_the_state(problem):
    stopped = follow_path(problem, monitor=stop_after(2))
    assert stopped.status is Status.STOPPED
    assert stopped.outer_iterations == 2
    inner = follow_path(problem, newton_monitor=stop_after(4))
    assert inner.status is Status.STOPPED
    assert inner.last.displacement.space.mesh.nv == problem.mesh.nv


def test_elastic_step_needs_one_solve_for_each_gamma(problem):
    soft = replace(problem, traction={"load": (0, -1e-6)}, contact=None, gap=None)
    path = follow_path(soft, PathOptions(gamma_end=1e3))
    assert path.status is Status.CONVERGED
    assert path.inner_iterations == [1, 1, 1, 1]


def test_body_without_contact_and_without_load(problem):
    free = replace(problem, contact=None, gap=None, traction=None)
    path = follow_path(free)
    assert path.status is Status.CONVERGED
    assert path.path_values == [0.0, 0.0]
    assert path.inner_iterations == [0, 0]


@pytest.mark.parametrize("done", [1, 4])
def test_interrupted_path_ends_with_the_same_digits(problem, path, tmp_path, done):
    file = tmp_path / "path.npz"
    follow_path(problem, monitor=stop_after(done), checkpoint=file)
    resumed = follow_path(problem, checkpoint=file)
    assert resumed.inner_iterations == path.inner_iterations
    assert resumed.path_values == pytest.approx(path.path_values, rel=1e-12)
    assert resumed.last.v.FV().NumPy() == pytest.approx(
        path.last.v.FV().NumPy(), abs=1e-12
    )
    assert resumed.last.residual_norm == pytest.approx(
        path.last.residual_norm, rel=1e-9
    )


def test_finished_checkpoint_is_the_result(problem, path, tmp_path):
    file = tmp_path / "path.npz"
    follow_path(problem, checkpoint=file)
    written = file.read_bytes()
    again = follow_path(problem, checkpoint=file, monitor=stop_after(1))
    assert again.status is Status.CONVERGED
    assert again.path_values == path.path_values
    assert again.last.history.residual_norms == path.last.history.residual_norms
    assert file.read_bytes() == written


def test_foreign_old_and_damaged_checkpoints_are_refused_and_kept(problem, tmp_path):
    file = tmp_path / "path.npz"
    limited = PathOptions(max_outer_iterations=2)
    follow_path(problem, limited, checkpoint=file)
    written = file.read_bytes()
    other_load = replace(problem, traction={"load": (0, -6.0001e-3)})
    other_mesh = wrench_problem(wrench.paper_mesh(123))
    cases = [
        (problem, replace(limited, growth=8.0), "growth"),
        (
            problem,
            replace(limited, newton=NewtonOptions(quadrature_points=100)),
            "newton",
        ),
        (other_load, limited, "problem"),
        (other_mesh, limited, "mesh"),
    ]
    for data, options, reason in cases:
        with pytest.raises(ValueError, match=reason):
            follow_path(data, options, checkpoint=file)
        assert file.read_bytes() == written
    for damaged in (
        b"",
        written[:-40],
        written[:200],
        b"no archive",
        written[:300] + b"x" * 80,
    ):
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match="checkpoint"):
            follow_path(problem, limited, checkpoint=file)
        assert file.read_bytes() == damaged


def test_checkpoint_of_another_version_is_refused(problem, tmp_path, monkeypatch):
    file = tmp_path / "path.npz"
    limited = PathOptions(max_outer_iterations=1)
    follow_path(problem, limited, checkpoint=file)
    monkeypatch.setattr("ngepc.results.checkpoint.__version__", "0.0.1")
    with pytest.raises(ValueError, match="version"):
        follow_path(problem, limited, checkpoint=file)


def test_path_in_other_spaces_meets_its_direct_solution(tmp_path):
    """The Tichonov choice and the units stay along the path."""
    problem, file = lshape_problem(lshape.paper_mesh(113)), tmp_path / "path.npz"
    spaces = DualSpaces(tichonov=FullProduct(), units=Units(stress=2.0, length=0.5))
    options = PathOptions(gamma_start=10, growth=10, gamma_end=1e3, inner_scale=1e-9)
    path = follow_path(problem, options, spaces=spaces).raise_for_status()
    regularisation = Coupled(1e3, tichonov=spaces.tichonov, units=spaces.units)
    direct = semismooth_newton(problem, regularisation=regularisation, start=path.last)
    assert path.last.regularisation == direct.regularisation
    assert path.last.dual_energy == pytest.approx(direct.dual_energy, rel=1e-10)
    follow_path(problem, options, stop_after(2), spaces=spaces, checkpoint=file)
    resumed = follow_path(problem, options, spaces=spaces, checkpoint=file)
    assert resumed.path_values == pytest.approx(path.path_values, rel=1e-12)
    with pytest.raises(ValueError, match="spaces"):
        follow_path(problem, options, checkpoint=file)


def test_what_fixes_the_spaces_cannot_change_along_a_path(problem):
    """Such a path used to end CONVERGED with a wrong energy; no argument can ask for it now."""
    spaces = DualSpaces(tichonov=FullProduct(), units=Units(length=0.9))
    kept = DualFunctional(LinearBlocks(problem, spaces, "sparsecholesky"), 400, 1e4)
    assert kept.regularisation == Coupled(
        1e4, tichonov=spaces.tichonov, units=spaces.units
    )
    for argument in ("regularisation", "parameters"):
        with pytest.raises(TypeError, match=argument):
            follow_path(
                problem,
                **{argument: lambda gamma: Coupled(gamma, tichonov=FullProduct())},
            )


def test_a_system_refuses_a_functional_on_other_blocks(problem):
    one, other = (prepared(problem, Coupled(10.0), NewtonOptions()) for _ in range(2))
    with pytest.raises(ValueError, match="made with other blocks"):
        NewtonSystem(one.blocks, "sparsecholesky").factorise(other, None)


def test_a_path_has_no_fields_of_its_own(path):
    """Counts are those of the path, fields those of ``last``: no name means both."""
    assert (
        path.last.iterations == path.inner_iterations[-1] < path.total_inner_iterations
    )
    for name in ("iterations", "history", "displacement"):
        assert not hasattr(path, name)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gamma_start", 0.0),
        ("growth", 1.0),
        ("inner_tolerance", -1.0),
        ("inner_scale", math.nan),
        ("outer_tolerance", 0),
        ("gamma_end", 5.0),
        ("residual_tolerance", 0.0),
        ("reduction", 1.0),
        ("max_outer_iterations", 0),
        ("growth", "7"),
        ("newton", {}),
    ],
)
def test_options_outside_their_range_are_refused(name, value):
    with pytest.raises((ValueError, TypeError), match=name):
        PathOptions(**{name: value})


def test_command_writes_the_records(tmp_path, capsys):
    target, file = tmp_path / "path.json", tmp_path / "path.npz"
    command = [
        "path",
        "wrench",
        "--nodes",
        "123",
        "--json",
        str(target),
        "--checkpoint",
        str(file),
    ]
    assert main(command) == 0
    record = json.loads(target.read_text())
    outer = record["outer_iterations"]
    for key in ("inner_iterations", "gammas", "path_values", "residual_norms"):
        assert len(record[key]) == outer
    assert record["status"] == "converged"
    assert record["total_inner_iterations"] == sum(record["inner_iterations"])
    assert (
        record["gamma_end"]
        == record["gammas"][-1]
        == pytest.approx(10 * 7 ** (outer - 1))
    )
    assert record["dual_energy"] == pytest.approx(record["path_values"][-1], rel=1e-9)
    assert main([*command, "--growth", "8"]) == 2
    assert "growth" in capsys.readouterr().err
    assert main([*command[:4], "--max-outer-iterations", "2"]) == 1
    assert main([*command[:4], "--growth", "0.5"]) == 2
