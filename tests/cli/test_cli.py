"""The command line: JSON on standard output, exit statuses, one-line errors, progress, Ctrl-C."""

import io
import json
import logging
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from ngepc import Material, Problem, Refinement, solve_to
from ngepc.__main__ import main, parsed
from ngepc.cli import solve
from ngepc.cli.commands import COMMANDS, EXAMPLES
from ngepc.geometries import block
from ngepc.results.records import FIELDS
from ngepc.studies.limit_problems import LIMITS

pytestmark = pytest.mark.usefixtures("quickly_drawn")


def record_of(capsys, *arguments):
    begin = time.perf_counter()
    assert main(["solve", *arguments, "--json", "-"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert 0 < record["wall_time_s"] < time.perf_counter() - begin
    return record


@pytest.mark.parametrize("choice", [["--gamma", "1e3"], [], ["--method", "primal"]])
def test_solve_prints_one_json_object_with_the_fields_of_the_schema(choice, capsys):
    record = record_of(capsys, "lshape", "--nodes", "113", *choice)
    assert list(record) == list(FIELDS)
    assert record["schema"] == 2
    assert (record["problem"], record["nodes"], record["elements"]) == (
        "lshape",
        113,
        192,
    )
    assert record["unknowns"] == 2 * (113 - 5)
    assert record["status"] == "converged"
    assert len(record["residual_norms"]) == record["iterations"] + 1
    assert len(record["step_lengths"]) == record["iterations"]
    assert record["contact_force"] > 0


def completions(line):
    """What the Tab key offers after a line, as a shell asks for it."""
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": " ", "COMP_LINE": line}
    asked |= {
        "COMP_POINT": str(len(line)),
        "COMP_TYPE": "9",
        "PATH": os.environ["PATH"],
    }
    asked |= {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = ["bash", "-c", f"{sys.executable} -m ngepc 8>&1 9>/dev/null"]
    run = subprocess.run(command, capture_output=True, text=True, check=True, env=asked)
    return run.stdout.split()


def test_the_tab_key_completes_commands_studies_and_options():
    assert {"solve", "path", "study", "report", "notebooks"} <= set(
        completions("ngepc ")
    )
    assert completions("ngepc study ta") == ["table1", "table2", "table3"]
    assert "--max-iterations" in completions("ngepc solve lshape --max")


def test_solutions_come_with_a_guaranteed_bound_and_regularised_states_without(capsys):
    exact, primal = (record_of(capsys, "lshape", "--nodes", "225", "--method", m)["error_bound"]
                     for m in ("default", "primal"))  # fmt: skip
    assert 0.001 < exact < 0.1
    assert primal == pytest.approx(exact, rel=1e-6)
    assert (
        record_of(capsys, "lshape", "--nodes", "225", "--gamma", "1e3")["error_bound"]
        is None
    )


def test_limit_loads_by_the_command_line(tmp_path, capsys):
    """20 / 3^(1/2) and the 3 aside; exit status 1 where the mesh may not become finer."""
    assert main(["limit", "square", "--json", "-", "--quiet"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["lower"] == pytest.approx(20 / 3**0.5, rel=1e-6)
    assert record["growing"] == ["contact"]
    assert 0 < record["wall_time_s"] < 300
    words = ["limit", "bree-hot", "--quiet", "--figures", str(tmp_path / "bree")]
    kept = tmp_path / "bree.json"
    assert main([*words, "--json", str(kept)]) == 0
    cycles = json.loads(kept.read_text())
    assert cycles["guaranteed"]
    assert cycles["lower"] <= 1 <= cycles["upper"]
    names = {path.name for path in (tmp_path / "bree").iterdir()}
    kinds = ("bracket", "mechanism", "residual")
    assert names == {f"bree-hot_{kind}.png" for kind in kinds}
    words = ["limit", "cut", "--max-cells", "60", "--figures", str(tmp_path / "cut")]
    assert main(words) == 1
    out, err = capsys.readouterr()
    assert "but max_cells forbids it" in out
    assert "elements: " in err
    names = {path.name for path in (tmp_path / "cut").iterdir()}
    assert names == {"cut_bracket.png", "cut_mechanism.png"}


def test_limit_loads_that_are_zero_or_infinite_by_the_command_line(
    tmp_path, capsys, monkeypatch
):
    """The status names them; there is a picture of a mechanism only where there is one."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.kinematic(
        lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=1.0
    )
    given = {"contact": "clamped", "gap": 0.0}
    walls = {"left": (0, None), "right": (0, None)}

    def body(pull, supports):
        loads = {"contact": (0.0, pull)}
        return Problem(mesh, metal, None, traction=loads, prescribed=supports, **given)

    lifted = body(1.0, {"left": (0, None)})
    pressed = body(-1.0, walls)
    monkeypatch.setitem(LIMITS, "cut", lambda: lifted)
    monkeypatch.setitem(LIMITS, "strip", lambda: pressed)
    folder = str(tmp_path)
    assert main(["limit", "cut", "--figures", folder]) == 0
    assert "the limit load is zero" in capsys.readouterr().out
    assert main(["limit", "strip", "--figures", folder]) == 1
    assert "No factor makes the body collapse" in capsys.readouterr().out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"cut_bracket.png", "cut_mechanism.png", "strip_bracket.png"}
    assert main(["limit", "strip", "--json", "-", "--quiet"]) == 1
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == "unlimited"


def test_summary_names_mesh_unknowns_method_gamma_and_time(capsys):
    assert main(["solve", "lshape", "--nodes", "113", "--gamma", "1e3"]) == 0
    out, err = capsys.readouterr()
    *rows, remark = out.splitlines()
    assert remark.startswith("Strains reach")
    lines = dict(line.split("  ", 1) for line in rows)
    assert lines["mesh"].strip() == "lshape, 113 nodes, 192 elements"
    assert lines["unknowns"].strip() == "216"
    assert "paper" in lines["method"]
    assert "1000" in lines["method"]
    assert lines["time"].strip().endswith(" s")
    assert err == "", "progress is for terminals"


@pytest.mark.parametrize("place", [0, 1, 4])
def test_quiet_and_verbose_stand_anywhere(place, capsys):
    arguments = ["solve", "lshape", "--nodes", "33"]
    assert main([*arguments[:place], "--quiet", *arguments[place:]]) == 0
    assert capsys.readouterr() == ("", "")
    assert parsed([*arguments[:place], "--verbose", *arguments[place:]]).verbose


def test_verbose_says_where_an_error_arose(tmp_path, capsys, caplog):
    missing = ["solve", "lshape", "--start", str(tmp_path / "none.npz")]
    for loud in ([], ["--verbose"]):
        with caplog.at_level(logging.INFO if loud else logging.WARNING):
            assert main([*missing, *loud]) == 2
        assert "error: --start" in capsys.readouterr().err
        assert ("Traceback" in caplog.text) == bool(loud)


def test_not_quiet_is_not_verbose():
    args = parsed(["solve", "lshape"])
    assert (args.quiet, args.verbose) == (False, False)


def test_progress_line_on_a_terminal(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    assert main(["solve", "lshape", "--nodes", "113"]) == 0
    text = sys.stderr.getvalue()
    assert "step 1" in text
    assert "plastic" in text
    assert "\n" not in text


def test_not_converged_is_exit_status_1_with_the_json_written(tmp_path, capsys):
    target = tmp_path / "new" / "result.json"
    arguments = ["solve", "lshape", "--nodes", "113", "--max-iterations", "2"]
    assert main([*arguments, "--json", str(target)]) == 1
    assert json.loads(target.read_text())["status"] == "iteration_limit"


@pytest.mark.parametrize(
    ("choice", "named"), [([], True), (["--quiet"], False), (["--json", "-"], False)]
)
def test_files_are_named_where_nothing_else_is_wanted(choice, named, tmp_path, capsys):
    kept = tmp_path / "run.npz"
    arguments = ["lshape", "--nodes", "33", "--save", str(kept), *choice]
    assert main(["solve", *arguments]) == 0
    written = capsys.readouterr().out
    assert kept.exists()
    assert (f"wrote {kept}\n" in written) == named


def test_states_that_are_no_solution_have_no_bound(capsys):
    arguments = ["lshape", "--nodes", "113", "--max-iterations", "1", "--json", "-"]
    assert main(["solve", *arguments]) == 1
    assert json.loads(capsys.readouterr().out)["error_bound"] is None


def test_an_error_that_no_allowed_mesh_reaches_is_exit_status_1(monkeypatch, capsys):
    few = partial(solve_to, options=Refinement(max_nodes=100))
    monkeypatch.setattr("ngepc.cli.solve.solve_to", few)
    assert (
        main(["solve", "lshape", "--nodes", "33", "--error", "1e-3", "--json", "-"])
        == 1
    )
    record = json.loads(capsys.readouterr().out)
    assert record["status"] == "mesh_limit"
    assert record["error_bound"] > 1e-3
    assert "max_nodes=100" in record["message"]


def test_solve_starts_from_the_coarse_mesh(capsys):
    assert (
        record_of(capsys, "lshape", "--gamma", "10", "--start", "coarse")["iterations"]
        == 1
    )


def test_csg_mesh_has_a_similar_energy(capsys):
    energies = [
        record_of(capsys, "lshape", *mesh, "--gamma", "1e3")["dual_energy"]
        for mesh in (["--nodes", "417"], ["--maxh", "0.03"])
    ]
    assert energies[1] == pytest.approx(
        energies[0], rel=0.04
    )  # both are first-order in h


def test_figures_are_written(tmp_path, capsys):
    arguments = [
        "solve",
        "lshape",
        "--nodes",
        "113",
        "--gamma",
        "1e3",
        "--figures",
        str(tmp_path),
    ]
    assert main(arguments) == 0
    names = {path.name for path in tmp_path.glob("*.png")}
    assert {"lshape_plastic_strain.png", "lshape_yield_function.png"} <= names


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["solve", "lshap"], "lshape"),
        (["solv", "lshape"], "solve"),
        (["solve", "lshape", "--nodes", "800"], "it has"),
        (["solve", "lshape", "--gamma", "-1"], "> 0"),
        (["solve", "lshape", "--gamma", "nan"], "> 0"),
        (["solve", "lshape", "--tolerance", "0"], "> 0"),
        (
            ["solve", "lshape", "--nodes", "833", "--maxh", "0.1"],
            "leave one of them out",
        ),
        (["solve", "lshape", "--start", "warm"], "coarse"),
        (["study", "table9"], "table1"),
        (
            ["solve", "lshape", "--method", "primal", "--gamma", "3"],
            "no regularisation",
        ),
        (
            ["solve", "lshape", "--error", "0.1", "--max-iterations", "5"],
            "--max-iterations",
        ),
        (["solve", "lshape", "--gama", "3"], "see ngepc solve --help"),
        (["study", "duality", "--levels", "1"], "see ngepc study duality --help"),
        (["study", "table1", "--levels", "7"], "1 to 6"),
        (["study", "table1", "--rows", "1e7"], "1e0"),
        ([], "COMMAND"),
    ],
)
def test_bad_usage_is_one_line_and_exit_status_2(
    arguments, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(arguments)
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr()
    assert status == 2
    assert captured.out == ""
    assert message in captured.err.splitlines()[-1]
    assert "Traceback" not in captured.err


def test_unwritable_target_fails_before_the_work(tmp_path, capsys):
    begin = time.perf_counter()
    assert main(["solve", "lshape", "--nodes", "24833", "--json", str(tmp_path)]) == 2
    assert time.perf_counter() - begin < 5
    assert "folder" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("done", "late"),
    [
        ("m.parser()", {"ngsolve", "numpy"}),
        ("m.function_of('check')", {"ngsolve", "scipy"}),
        ("m.function_of('solve')", {"matplotlib", "scipy.optimize", "scipy.spatial"}),
    ],
    ids=["help", "check", "solve"],
)
def test_commands_do_not_wait_for_what_they_do_not_need(done, late):
    code = f"import sys, ngepc.__main__ as m; {done}; print({late} & set(sys.modules))"
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == "set()"


def test_examples_of_help_pages_are_legal_and_each_command_has_one():
    calls = [line.split("  ")[0].split() for line in EXAMPLES.splitlines()[1:]]
    calls = [words for words in calls if words[0] == "ngepc"]
    assert {parsed(words[1:]).command for words in calls} == set(COMMANDS)


@pytest.mark.parametrize(
    "choice",
    [
        ["--nodes", "417", "--method", "primal"],
        ["--nodes", "417"],
        ["--nodes", "65", "--gamma", "1e3", "--start", "coarse"],
    ],
)
def test_methods_agree_on_the_primal_energy(choice, capsys):
    record = record_of(capsys, "lshape", *choice)
    if (
        "coarse" not in choice
    ):  # the paper's method at gamma = 1e3 is far from the limit
        assert record["primal_energy"] == pytest.approx(-0.3753, rel=0.02)
    assert record["contact_force"] > 2


def test_saved_run_becomes_a_report(tmp_path, capsys):
    """One of the paper's method; those of the others are below."""
    saved, page = tmp_path / "run.npz", tmp_path / "pages" / "run.html"
    asked = ["lshape", "--nodes", "113", "--gamma", "1e3"]
    assert main(["solve", *asked, "--save", str(saved)]) == 0
    assert main(["report", str(saved), "--out", str(page)]) == 0
    text = page.read_text()
    assert "contact force" in text
    assert text.count("data:image/png") >= 5


@pytest.mark.parametrize(
    ("asked", "shown"),
    [
        ([], "least energy in ("),
        (["--max-iterations", "2"], "least energy in ("),
        (["--error", "0.2"], "least energy in ("),
        (["--goal", "contact_force", "--percent", "20"], "'contact force' in ("),
    ],
)
def test_a_receipt_of_the_command_line_passes(asked, shown, tmp_path, capsys):
    proof = tmp_path / "proof.npz"
    arguments = ["lshape", "--nodes", "33", *asked, "--receipt", str(proof)]
    assert main(["solve", *arguments]) == int("--max-iterations" in asked)
    assert f"wrote {proof}\n" in capsys.readouterr().out
    assert main(["check", str(proof)]) == 0
    found = capsys.readouterr().out
    assert "PASS" in found
    assert shown in found


@pytest.mark.parametrize(
    ("asked", "named"),
    [
        (["proof.json"], "--receipt='proof.json': a name that ends in '.npz'"),
        (["proof.npz", "--gamma", "1e3"], "--receipt proof.npz: only the exact method"),
        (["proof.npz", "--method", "primal"], "only the exact method"),
    ],
)
def test_what_has_no_receipt_is_said_before_the_solve(asked, named, capsys):
    assert main(["solve", "lshape", "--receipt", *asked]) == 2
    assert named in capsys.readouterr().err


@pytest.mark.parametrize("method", ["default", "primal"])
def test_a_report_on_an_unfinished_run_tells_what_its_pictures_show(
    method, tmp_path, capsys
):
    saved, arguments = (
        tmp_path / "run.npz",
        ["lshape", "--nodes", "33", "--method", method],
    )
    limit = ["--max-iterations", "2"]
    assert main(["solve", *arguments, *limit, "--save", str(saved)]) == 1
    assert main(["report", str(saved)]) == 0
    text = (tmp_path / "run.html").read_text()
    assert "converged" in text
    assert "iteration_limit" not in text
    capsys.readouterr()
    whole = record_of(capsys, *arguments)["iterations"]
    assert f'<td class="text">Newton steps</td><td>{whole}</td>' in text
    assert record_of(capsys, *arguments, "--start", str(saved))["iterations"] < whole


def test_report_without_the_viewer_is_written_and_names_the_extra(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("ngepc.cli.figures.viewer_installed", lambda: False)
    saved = tmp_path / "run.npz"
    assert main(["solve", "lshape", "--nodes", "33", "--save", str(saved)]) == 0
    assert main(["report", str(saved)]) == 0
    text = (tmp_path / "run.html").read_text()
    assert "pip install &quot;ngepc[html]&quot;" in text
    assert text.count("data:image/png") == 5
    assert "<iframe" not in text


def test_report_refuses_what_is_no_run(tmp_path, capsys):
    other = tmp_path / "other.npz"
    other.write_bytes(b"something")
    for path, message in ((other, "damaged"), (tmp_path / "none.npz", "no such run")):
        assert main(["report", str(path)]) == 2
        assert message in capsys.readouterr().err


def stopping_at(step, monkeypatch):
    """Ctrl-C arrives when the monitor of a solve sees this step."""

    class Line:
        def __init__(self, label):
            pass

        def __call__(self, record):
            if record.iteration == step:
                raise KeyboardInterrupt

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    monkeypatch.setattr("ngepc.cli.solve.progress_line", Line)


def test_ctrl_c_names_the_step_and_how_to_resume(tmp_path, monkeypatch, capsys):
    saved = tmp_path / "run.npz"
    arguments = ["solve", "lshape", "--nodes", "113", "--gamma", "1e4"]
    whole = record_of(capsys, *arguments[1:])
    stopping_at(6, monkeypatch)
    assert main([*arguments, "--save", str(saved)]) == 130
    err = capsys.readouterr().err
    assert "interrupted after step 6" in err
    assert f"--start {saved}" in err
    monkeypatch.undo()
    rest = record_of(capsys, *arguments[1:], "--start", str(saved))
    assert rest["iterations"] == whole["iterations"] - 6
    assert rest["dual_energy"] == pytest.approx(whole["dual_energy"], rel=1e-10)


def test_ctrl_c_between_solves_promises_only_what_was_written(
    tmp_path, monkeypatch, capsys
):
    def pressed(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("ngepc.cli.solve.solve_to", pressed)
    assert main(["solve", "lshape", "--nodes", "33", "--error", "0.1"]) == 130
    err = capsys.readouterr().err
    assert err == "ngepc solve: interrupted; files written so far are kept\n"
    monkeypatch.setattr("ngepc.studies.counts.Table1.solve", pressed)
    assert main(["study", "table1", "--levels", "1", "--out", str(tmp_path)]) == 130
    assert "run the same command again" in capsys.readouterr().err


def test_ctrl_c_without_a_file_says_what_to_do_next_time(monkeypatch, capsys):
    stopping_at(2, monkeypatch)
    assert main(["solve", "lshape", "--nodes", "113"]) == 130
    err = capsys.readouterr().err
    assert "after step 2; use --save FILE" in err
    assert err.count("\n") == 1


def test_a_goal_that_is_zero_is_not_refined_to_a_percentage(capsys):
    """Nothing touches in Example (b): its contact force is 0, which two meshes show."""
    assert main(["solve", "wrench", "--goal", "contact_force"]) == 1
    written = capsys.readouterr()
    assert "The contact force is about 0" in written.out
    assert "goal           contact force: between 0 and " in written.out
    assert written.err.count("nodes") == 2


def test_a_goal_has_its_interval_in_record_and_picture(tmp_path, capsys):
    asked = ["lshape", "--nodes", "225", "--goal", "contact_force", "--percent", "10"]
    record = record_of(capsys, *asked, "--figures", str(tmp_path))
    assert record["goal_lower"] < 2.742 < record["goal_upper"]
    assert record["goal_upper"] - record["goal_lower"] < 0.2 * record["goal_upper"]
    assert (tmp_path / "lshape_interval.png").is_file()


def test_the_summary_has_the_interval_of_a_goal(capsys):
    asked = ["lshape", "--nodes", "225", "--goal", "work", "--percent", "10"]
    assert main(["solve", *asked]) == 0
    out = capsys.readouterr().out
    assert "goal           work of the loads: " in out
    assert "percent (between " in out
    assert main(["solve", "lshape", "--nodes", "113"]) == 0
    assert "goal" not in capsys.readouterr().out


def test_a_start_from_another_body_is_refused(tmp_path, capsys):
    saved = str(tmp_path / "run.npz")
    assert main(["solve", "lshape", "--nodes", "113", "--save", saved]) == 0
    capsys.readouterr()
    assert main(["solve", "wrench", "--start", saved]) == 2
    assert "a run of lshape, one of wrench is needed" in capsys.readouterr().err
    assert main(["solve", "lshape", "--nodes", "225", "--start", saved]) == 0


@pytest.mark.parametrize("asked", [{"goal": "work"}, {"error": 0.1}])
def test_a_goal_or_an_error_refines_the_mesh(asked, monkeypatch):
    run = SimpleNamespace(bound="bound")
    monkeypatch.setattr(solve, "_refined", lambda args, problem: ("result", run))
    given = {
        "problem": "lshape",
        "nodes": 113,
        "maxh": None,
        "goal": None,
        "error": None,
    }
    result, seconds, *found = solve._solution(SimpleNamespace(**given | asked))
    assert (result, *found) == ("result", "bound", run)
    assert 0 <= seconds < 10


def test_notebooks_come_without_solutions_unless_asked(tmp_path, capsys):
    assert main(["notebooks", str(tmp_path / "a")]) == 0
    first = capsys.readouterr().out.splitlines()[-1].rpartition("jupyter lab ")[2]
    assert Path(first).is_relative_to(tmp_path / "a")
    assert Path(first).is_file()
    assert not (tmp_path / "a" / "solutions").exists()
    assert list((tmp_path / "a" / "exercises").glob("*.ipynb"))
    assert main(["notebooks", str(tmp_path / "b"), "--solutions"]) == 0
    assert list((tmp_path / "b" / "solutions").glob("*.ipynb"))
    assert main(["notebooks", str(tmp_path / "b")]) == 2
    assert "--force" in capsys.readouterr().err
