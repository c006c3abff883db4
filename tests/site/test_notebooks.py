"""The notebooks: stripped in the repository, complete, and run from top to bottom."""

import ast
import importlib
import json
import os
import re
import sys
from copy import deepcopy
from functools import cache
from pathlib import Path

import pytest

from ngepc.__main__ import main
from ngepc.pictures.course import Answers, quiz

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.rglob("*.ipynb"))
LECTURES = sorted(FOLDER.glob("*.ipynb"))
SESSIONS = sorted(FOLDER.glob("exercises/*.ipynb"))
CHAPTERS = ["Notation", "Problem", "Weak form", "Code", "Picture", "Check", "Now you"]

ENVIRONMENT = os.environ | {
    "NGS_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONPATH": os.pathsep.join(
        [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    ),
    "PYTHONWARNINGS": "ignore",
}

QUICKLY_DRAWN = """
from matplotlib.axis import Axis
from matplotlib.layout_engine import ConstrainedLayoutEngine
from ngepc.pictures import stills
from ngepc.pictures.style import RC
ConstrainedLayoutEngine.execute = lambda engine, figure: None
Axis.draw = lambda axis, renderer: None
RC["figure.dpi"] = 40
stills.SIDE = 400
"""
KEPT = "import gc; gc.freeze()"
"""What the notebooks before have imported is no garbage: a reset searches for it."""

COARSER = {
    "00_lab.ipynb": {'"nodes": 833,': '"nodes": 417,'},
    "01_first_solve.ipynb": {"GenerateMesh(maxh=2.0)": "GenerateMesh(maxh=4.0)"},
    "02_lshape_mesh_independence.ipynb": {
        "problem = lshape_problem(lshape.paper_mesh(417))": (
            "problem = lshape_problem(lshape.paper_mesh(225))"
        ),
        '{"1e3": (113, 225, 417, 833), "1e4": (113, 225, 417)}': (
            '{"1e3": (113, 833), "1e4": (113, 225)}'
        ),
        "(113, 225, 417, 833, 1601)": "(113, 833)",
        "fine = semismooth_newton(lshape_problem(lshape.paper_mesh(833))": (
            "fine = semismooth_newton(lshape_problem(lshape.paper_mesh(417))"
        ),
    },
    "03_wrench_path.ipynb": {"(70.0, 3.43e3, path.gamma_end)": "(70.0,)"},
    "04_regularisation.ipynb": {
        "problem = lshape_problem(lshape.paper_mesh(113))": (
            "problem = lshape_problem(lshape.paper_mesh(65))"
        )
    },
    "06_load_cycles.ipynb": {"maxh=0.05": "maxh=0.1"},
    "07_indentation_3d.ipynb": {
        "times=(1, 2, 3, 3.25, 3.5, 4)": "times=(1.5, 2.5, 3, 4)",
        "evolve(problem, path)": "evolve(replace(problem, order=1), path)",
    },
    "08_which_solver.ipynb": {
        "paper_mesh(3201)": "paper_mesh(833)",
        "MESHES = (65, 113, 225)": "MESHES = (65, 225)",
        "(1e3, 1e2, 1e1, 1.0)": "(1e3, 1.0)",
    },
    "11_guaranteed_error.ipynb": {"paper_mesh(33)), 0.01": "paper_mesh(33)), 0.03"},
    "12_calibration.ipynb": {
        "TIMES = (0.2, 0.4, 0.6, 0.8, 1.0, 1.1)": "TIMES = (0.4, 0.8, 1.0, 1.1)",
        "block.mesh(0.25,": "block.mesh(0.5,",
        '"yield_stress": 5.0, "hardening": 200.0': (
            '"yield_stress": 3.0, "hardening": 100.0'
        ),
    },
    "13_friction_two_bodies.ipynb": {"(16, 8, size=(2, 1)": "(8, 4, size=(2, 1)"},
    "14_limit_loads.ipynb": {
        "limit_load(cut, relative_width=0.02)": "limit_load(cut, relative_width=0.04)",
        "limit_load(strip, relative_width=0.02)": (
            "limit_load(strip, relative_width=0.05)"
        ),
    },
    "15_a_number_you_may_sign.ipynb": {"percent=0.5": "percent=1"},
    "exercises/1_newton_without_armijo.ipynb": {
        "max_iterations=80": "max_iterations=8"
    },
    "exercises/3_new_hardening_law.ipynb": {
        "steps=40": "steps=6",
        "steps=14": "steps=2",
    },
    "exercises/8_calibration.ipynb": {"block.mesh(0.25,": "block.mesh(0.5,"},
    "solutions/1_newton_without_armijo.ipynb": {
        "paper_mesh(245)": "paper_mesh(123)",
        "gammas = (1e2, 1e3, 1e4, 1e5)": "gammas = (1e2, 1e4, 1e5)",
        "bare = NewtonOptions(linesearch=None, max_iterations=60)": (
            "bare = NewtonOptions(linesearch=None, max_iterations=40)"
        ),
    },
    "solutions/3_new_hardening_law.ipynb": {
        "steps=40": "steps=20",
        "steps=14": "steps=10",
        "example = lshape_problem(lshape.paper_mesh(113))": (
            "example = lshape_problem(lshape.paper_mesh(65))"
        ),
    },
    "solutions/6_own_path.ipynb": {
        "paper_mesh(873)": "paper_mesh(123)",
        "paper_mesh(225)": "paper_mesh(65)",
    },
    "solutions/8_calibration.ipynb": {
        "block.mesh(0.25,": "block.mesh(0.5,",
        '"yield_stress": 5.0, "hardening": 200.0': (
            '"yield_stress": 3.0, "hardening": 100.0'
        ),
    },
}
"""Notebook -> meshes, steps and accuracies of its cells, and those with which they run here.

``make docs`` runs them as they are.
"""

FULL = re.compile(r"no more timer available \(.+\), reusing last one\n")
"""What NGSolve says once to a process that has made some ten thousand objects with timers."""


def name(path):
    return path.relative_to(FOLDER).as_posix()


@cache
def nbformat():
    """The library of notebooks, which is slow to import and is when it is needed.

    Without the grammar of international addresses, which takes longer than all the rest.
    """
    sys.modules.setdefault("rfc3987_syntax", None)
    return importlib.import_module("nbformat")


@cache
def read_once(path):
    """A notebook as it is in the repository."""
    return nbformat().read(path, as_version=4)


def read(path):
    """A notebook that may be changed."""
    return deepcopy(read_once(path))


def coarser(path):
    """A notebook as it runs here."""
    notebook = read(path)
    for fine, coarse in COARSER.get(name(path), {}).items():
        for cell in notebook.cells:
            cell.source = cell.source.replace(fine, coarse)
    return notebook


def code_cells(path):
    return [cell for cell in read_once(path).cells if cell.cell_type == "code"]


@pytest.fixture(scope="module")
def execute():
    """Run notebooks in one kernel, which takes seconds to start: each in a folder, without names.

    ``make docs`` gives each its own.  Pictures are drawn, but coarsely, without ticks and not laid
    out: that is tested with the pictures.
    """
    new = nbformat().v4
    client = importlib.import_module("nbclient").NotebookClient(
        new.new_notebook(), timeout=170, kernel_name="python3"
    )

    def run(notebook, folder):
        client.nb = notebook
        fresh = new.new_code_cell(
            f"%cd -q {folder}\n{QUICKLY_DRAWN}\n%reset -f\n{KEPT}"
        )
        notebook.cells.insert(0, fresh)
        client.execute(cleanup_kc=False, env=ENVIRONMENT)
        return notebook

    yield run
    client.nb = new.new_notebook()
    client.execute(cleanup_kc=True)


def test_no_outputs_are_kept():
    for path in NOTEBOOKS:
        text = path.read_text(encoding="utf-8")
        assert len(text) < 25_000, name(path)
        kept = set(json.loads(text)["metadata"])
        assert kept == {"kernelspec", "language_info"}, name(path)
        for cell in code_cells(path):
            assert cell.outputs == [], name(path)
            assert cell.execution_count is None, name(path)


def test_code_fits_the_page():
    """Cells of the site are 88 characters wide where the window is narrow."""
    lines = [
        (name(path), line)
        for path in NOTEBOOKS
        for cell in code_cells(path)
        for line in cell.source.split("\n")
    ]
    assert [(place, line) for place, line in lines if len(line) > 88] == []


@pytest.mark.parametrize("place", COARSER)
def test_what_is_made_coarser_is_there(place):
    text = "\n".join(cell.source for cell in code_cells(FOLDER / place))
    assert [text.count(fine) for fine in COARSER[place]] == [1] * len(COARSER[place])


@pytest.mark.parametrize("path", LECTURES, ids=name)
def test_notation_comes_first_and_a_check_last(path):
    cells = read(path).cells
    lines = [
        line
        for c in cells
        if c.cell_type == "markdown"
        for line in c.source.split("\n")
    ]
    headings = [line.removeprefix("## ") for line in lines if line.startswith("## ")]
    wanted = [
        next((h for h in headings if h.startswith(chapter)), None)
        for chapter in CHAPTERS
    ]
    assert None not in wanted, (headings, wanted)
    assert wanted == sorted(wanted, key=headings.index)
    assert any("assert" in cell.source for cell in code_cells(path))


@pytest.mark.parametrize("path", SESSIONS, ids=name)
def test_exercises_have_hints_and_the_solutions_ask_the_same(path):
    solution = FOLDER / "solutions" / path.name
    questions = [
        [
            ast.unparse(n)
            for cell in code_cells(p)
            for n in ast.walk(ast.parse(cell.source))
            if isinstance(n, ast.Call) and ast.unparse(n.func) == "check"
        ]
        for p in (path, solution)
    ]
    assert len(questions[0]) >= 4
    assert questions[0] == questions[1]
    assert "<details><summary>Hint</summary>" in path.read_text()
    assert any("# your line" in cell.source for cell in code_cells(path))
    assert "# your line" not in solution.read_text()
    assert (
        code_cells(solution)[-1].source == "assert all(check.done.values()), check.done"
    )


@pytest.mark.parametrize("path", SESSIONS, ids=name)
def test_an_exercise_imports_what_its_solution_needs(path):
    solution = FOLDER / "solutions" / path.name
    assert code_cells(path)[0].source == code_cells(solution)[0].source


def test_the_exact_method_has_forty_lines():
    """Which its title promises, and its text."""
    path = FOLDER / "10_exact_method.ipynb"
    (newton,) = (
        node
        for cell in code_cells(path)
        for node in ast.parse(cell.source).body
        if isinstance(node, ast.FunctionDef) and node.name == "newton"
    )
    assert 35 < newton.end_lineno - newton.lineno + 1 <= 40
    text = "\n".join(cell.source for cell in read(path).cells)
    assert text.count("forty lines") == 4
    assert "thirty" not in text


def test_all_imports_stand_in_the_first_cell():
    imports = (ast.Import, ast.ImportFrom)
    for path in NOTEBOOKS:
        first, *others = (ast.parse(cell.source) for cell in code_cells(path))
        assert any(isinstance(node, imports) for node in first.body), name(path)
        nodes = [node for cell in others for node in ast.walk(cell)]
        assert not [n for n in nodes if isinstance(n, imports)], name(path)


@pytest.mark.parametrize("path", LECTURES, ids=name)
def test_every_lecture_ends_with_its_quiz(path):
    assert code_cells(path)[-1].source == f'quiz("{path.stem}")'
    questions = quiz(path.stem)
    assert len(questions) >= 3
    for question in questions:
        assert len(set(question["choices"])) == len(question["choices"]) >= 2
    shown = quiz(path.stem)._repr_html_()
    assert not re.search("[α-ω]_", shown)
    assert shown.count("Right. ") == len(questions)


def test_unfinished_answers_are_told_from_wrong_ones(capsys):
    check = Answers()
    check("missing", lambda: {}[100.0])
    check("wrong", lambda: 1 > 2)
    check("fine", lambda: 2 > 1)
    assert capsys.readouterr().out.splitlines() == [
        "fill in: missing (100.0)",
        "not yet: wrong",
        "right:   fine",
    ]
    assert check.done == {"missing": False, "wrong": False, "fine": True}
    assert list(check.errors) == ["missing"]
    check("missing", lambda: True)
    assert not check.errors


@pytest.mark.notebooks
@pytest.mark.parametrize("path", NOTEBOOKS, ids=name)
def test_runs_from_top_to_bottom(path, execute, tmp_path):
    notebook = execute(coarser(path), tmp_path)
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    warned = [o["text"] for o in outputs if o.get("name") == "stderr"]
    assert not [text for text in warned if not FULL.fullmatch(text)]
    if path in SESSIONS:
        assert re.search("fill in|not yet", "".join(o.get("text", "") for o in outputs))
        assert not any(
            "right: " in o.get("text", "") for o in outputs if path.stem[0] == "7"
        )
        assert not any("Error" in o.get("text", "") for o in outputs)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=name)
def test_no_output_is_caught_in_a_widget(path):
    """Where ``interactive`` catches outputs, nbclient may miss that a cell has ended."""
    text = path.read_text(encoding="utf-8")
    assert not re.search(
        r"\b(interact|interactive|interactive_output|Output)\b\(", text
    )


@pytest.mark.notebooks
def test_pictures_are_drawn_without_the_viewer(execute, tmp_path):
    notebook = coarser(FOLDER / "01_first_solve.ipynb")
    first, *_, last = (cell for cell in notebook.cells if cell.cell_type == "code")
    first.source += "\nfrom ngepc.pictures import views"
    first.source += (
        "\nasked, views.viewer_installed = views.viewer_installed, lambda: False"
    )
    last.source = f"views.viewer_installed = asked\n{last.source}"
    outputs = [
        o for c in execute(notebook, tmp_path).cells for o in c.get("outputs", [])
    ]
    kinds = [set(o["data"]) for o in outputs if "data" in o]
    pictures = sum("image/png" in kind for kind in kinds)
    assert pictures == 4  # the material, the view, a field, the pressure
    assert (
        sum("text/html" in kind for kind in kinds) == 2
    )  # the table of the result, the quiz


def test_interrupting_the_kernel_keeps_the_state():
    start_new_kernel = importlib.import_module(
        "jupyter_client.manager"
    ).start_new_kernel
    manager, client = start_new_kernel(kernel_name="python3", env=ENVIRONMENT)
    try:
        setup = (
            "from ngepc import NewtonOptions, lshape_problem, semismooth_newton\n"
            "from ngepc.geometries import lshape\n"
            "problem = lshape_problem(lshape.paper_mesh(113))\n"
            "def tell(record):\n"
            "    if record.iteration == 1: print('running', flush=True)\n"
            "    import time; time.sleep(0.05)\n"
        )
        client.execute_interactive(setup, timeout=60)

        def interrupt(message):
            if message["msg_type"] == "stream":
                manager.interrupt_kernel()

        client.execute_interactive(
            "result = semismooth_newton(problem, gamma=1e5, monitor=tell)",
            timeout=60,
            output_hook=interrupt,
        )
        answers = []
        client.execute_interactive(
            "print(result.status.label, result.iterations > 0, result.displacement.vec.Norm() > 0)",
            timeout=60,
            output_hook=lambda m: answers.append(m["content"].get("text", "")),
        )
        assert "".join(answers).split() == ["stopped", "True", "True"]
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


def test_the_command_copies_all_notebooks(tmp_path, capsys):
    target = tmp_path / "course"
    assert main(["notebooks", str(target), "--solutions"]) == 0
    copies = sorted(p.relative_to(target).as_posix() for p in target.rglob("*"))
    assert [c for c in copies if c.endswith(".ipynb")] == [name(p) for p in NOTEBOOKS]
    assert "00_lab.ipynb" in capsys.readouterr().out


def test_the_command_replaces_nothing_unasked(tmp_path, capsys):
    mine = tmp_path / "03_wrench_path.ipynb"
    mine.write_text("my work")
    assert main(["notebooks", str(tmp_path)]) == 2
    assert "--force" in capsys.readouterr().err
    assert [mine] == list(tmp_path.iterdir())
    assert mine.read_text() == "my work"
    assert main(["notebooks", str(tmp_path), "--force"]) == 0
    assert mine.read_text() != "my work"


@pytest.mark.parametrize("path", LECTURES, ids=name)
def test_every_chapter_is_a_slide(path):
    cells = read(path).cells
    for cell in cells:
        if cell.cell_type == "markdown" and cell.source.startswith(("# ", "## ")):
            assert cell.metadata["slideshow"]["slide_type"] == "slide"
    assert cells[1].metadata["slideshow"]["slide_type"] == "skip"
