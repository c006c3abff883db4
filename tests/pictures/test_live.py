"""The laboratory: every position is a solve, predictions are first order, and dragging is live."""

import base64
import json
import subprocess
import sys
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from browser import Browser, chromium
from ngsolve import x

from ngepc import Material, Problem, lshape_problem, semismooth_newton
from ngepc.geometries import block, lshape
from ngepc.local import choice
from ngepc.local.choice import DIRECT
from ngepc.local.warm import WarmSolver
from ngepc.pictures import views
from ngepc.pictures.drawable import drawable
from ngepc.pictures.live import ROOM, lab
from ngepc.pictures.sampling import corners_of
from ngepc.pictures.sliders import changed, load_size, round_step
from ngepc.studies.large import indented_block

needs_viewer = pytest.mark.skipif(
    not views.viewer_installed(), reason=f"no offline viewer: {views.EXTRA}"
)
needs_browser = pytest.mark.skipif(
    chromium() is None,
    reason="no Chromium or Chrome is installed (Debian: apt install chromium)",
)


@lru_cache
def body():
    return lshape_problem(lshape.paper_mesh(225))


def at(load, gap=0.1):
    g = body().traction["load"]
    return replace(body(), traction={"load": load / 10 * g}, gap=gap)


def stretched(by):
    """The body, whose upper side is moved instead of loaded."""
    return replace(body(), prescribed={"load": (None, by)}, traction=None)


CHANGES = {
    "load": lambda: (at(9.0), at(9.5)),
    "gap": lambda: (at(10.0, 0.1), at(10.0, 0.08)),
    "material": lambda: (
        body(),
        replace(body(), material=replace(body().material, hardening=80.0)),
    ),
    "support": lambda: (body(), stretched(0.01)),
    "prescribed": lambda: (stretched(0.01), stretched(0.02)),
}


@pytest.mark.parametrize("kind", CHANGES)
def test_what_is_kept_does_not_change_the_solution(kind):
    solver = WarmSolver()
    for problem in CHANGES[kind]():
        warm = solver.solve(problem)
        cold = semismooth_newton(problem)
        assert warm.status is cold.status
        assert warm.primal_energy == pytest.approx(cold.primal_energy, rel=1e-12)
        scale = np.abs(cold.state.u).max()
        np.testing.assert_allclose(warm.state.u, cold.state.u, atol=1e-8 * scale)
        assert warm.primal_energy + warm.dual_energy == pytest.approx(0.0, abs=1e-13)


@pytest.mark.parametrize("order", [1, 2])
def test_a_prediction_is_of_first_order(order):
    """Half the change leaves a quarter of the error, where no point begins to yield: or less."""
    errors = []
    for step in (0.4, 0.2, 0.1):
        solver = WarmSolver()
        first = replace(at(9.0), order=order)
        solver.solve(first)
        problem = replace(first, traction=at(9.0 + step).traction)
        predicted = solver.predict(problem)
        solved = solver.solve(problem)
        before = semismooth_newton(replace(at(9.0), order=order))
        moved = np.linalg.norm(solved.state.u - before.state.u)
        errors.append(np.linalg.norm(predicted.state.u - solved.state.u))
        assert errors[-1] < 0.3 * moved
    assert errors[1] < 0.35 * errors[0]
    assert errors[2] < 0.35 * errors[1]


def test_the_load_is_the_size_of_the_largest_one():
    assert load_size(body()) == pytest.approx(10.0)
    moved = changed(body(), {"load": 4.0, "gap": 0.05}, None)
    assert load_size(moved) == pytest.approx(4.0)
    assert moved.gap == 0.05
    assert moved.material is body().material
    assert changed(body(), {"load": 10.0}, None) is body()


def test_obstacles_of_any_shape_and_prescribed_displacements_move():
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
    )
    mesh = block.mesh(0.5, (1.0, 1.0))
    given = {"prescribed": {"left": (0.0, None)}, "contact": "contact"}
    given["springs"] = {"clamped": 1e4}
    given["clamped"] = None
    bent = Problem(mesh, steel, gap=0.1 * x - 0.05, **given)
    nearer = changed(bent, {"obstacle": -0.01}, None)
    solved = semismooth_newton(nearer)
    same = semismooth_newton(replace(bent, gap=0.1 * x - 0.06))
    assert solved.contact_force == pytest.approx(same.contact_force, rel=1e-10)
    pulled = replace(bent, prescribed={"left": (-0.02, None)})
    assert load_size(pulled) == pytest.approx(0.02)
    assert changed(pulled, {"load": 0.01}, None).prescribed == {"left": (-0.01, None)}


def test_sliders_of_a_metal_are_the_numbers_of_its_data_sheet():
    sheet = {"young": 210e3, "poisson": 0.3, "yield_stress": 235.0}
    metal = Material.metal(**sheet, plastic_modulus=2100.0)
    bar = Problem(
        block.structured_mesh(1, 1),
        metal,
        clamped=None,
        prescribed={"left": (0, None), "clamped": (None, 0)},
        traction={"right": (300.0, 0.0)},
        kinematics="plane stress",
    )
    assert changed(bar, sheet | {"plastic_modulus": 2100.0}, None) is bar
    moved = changed(bar, {"young": 200e3, "yield_stress": 250.0}, None)
    assert moved.material.data_sheet == metal.data_sheet | {
        "young": 200e3,
        "yield_stress": 250.0,
    }
    strain = semismooth_newton(moved).strain(moved.mesh(0.5, 0.5))[0]
    assert strain == pytest.approx(300 / 200e3 + 50 / 2100, rel=1e-9)
    with pytest.raises(ValueError, match="young, poisson, yield_stress, plastic_mod"):
        changed(bar, {"tangent_modulus": 1000.0}, None)


def test_steps_are_round():
    assert [round_step(s) for s in (0.06, 1.0, 4.99, 0.0129)] == pytest.approx(
        [0.05, 1.0, 2.0, 0.01]
    )


@needs_viewer
@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({}, "at least one slider"),
        ({"load": (1.0, 0.0)}, "least < most"),
        ({"load": 3.0}, "least < most"),
        ({"lod": (0.0, 1.0)}, "load, obstacle, gap, lame_lambda"),
    ],
)
def test_bad_ranges_are_refused(ranges, message):
    with pytest.raises((TypeError, ValueError), match=message):
        lab(body(), **ranges)


@needs_viewer
def test_sliders_of_ones_own():
    def change(problem, radius):
        return replace(problem, gap=0.1 + 0.01 * radius)

    laboratory = lab(body(), radius=(0.0, 2.0), change=change)
    (*_, frame) = laboratory.frames({"radius": 2.0})
    assert laboratory.last.problem.gap == pytest.approx(0.12)
    assert frame["caption"] == "radius 2"


@needs_viewer
def test_a_slow_solve_is_announced_by_a_prediction():
    laboratory = lab(body(), load=(0.0, 12.0), gap=(0.0, 0.2))
    assert [f["exact"] for f in laboratory.frames({"load": 9.0})][-1]
    laboratory.seconds = 1.0
    predicted, solved = laboratory.frames({"load": 9.5})
    assert not predicted["exact"]
    assert "predicted" in predicted["caption"]
    assert solved["exact"]
    assert solved["last"]
    assert "load 9.5" in solved["caption"]
    assert "converged" in solved["said"]
    names = [curve["title"] for curve in solved["curves"]]
    assert names == ["contact pressure", "contact force", "residual"]
    force = solved["curves"][1]["here"][1]
    assert force == pytest.approx(laboratory.last.contact_force)


@needs_viewer
def test_what_cannot_be_solved_is_said_and_the_next_position_is_solved():
    def change(problem, radius):
        if radius > 1:
            raise ValueError("radius=2: too large")
        return problem

    laboratory = lab(body(), change=change, radius=(0.0, 2.0))
    (frame,) = laboratory.frames({"radius": 2.0})
    assert frame["last"]
    assert frame["scene"] is None
    assert "too large" in frame["said"]
    (*_, frame) = laboratory.frames({"radius": 0.5})
    assert frame["scene"] is not None


@needs_viewer
def test_what_a_function_of_the_user_raises_is_said_to_the_page():
    def change(problem, depth):
        return replace(problem, gap={0.5: -0.01}[depth])

    laboratory = lab(body(), change=change, depth=(0.0, 1.0))
    (frame,) = laboratory.answers({"depth": 1.0})
    assert (frame["said"], frame["last"]) == ("KeyError: 1.0", True)
    (*_, frame) = laboratory.answers({"depth": 0.5})
    assert frame["scene"] is not None
    with pytest.raises(KeyError):
        lab(body(), change=change, depth=(0.0, 2.0))


@needs_viewer
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
def test_loads_beyond_the_limit_are_shown_with_their_status():
    """Also at the start, where there is no solution yet, and where numbers overflow."""
    perfect = Material.metal(
        young=1e3, poisson=0.3, yield_stress=2.0, plastic_modulus=0.0
    )
    held = Problem(block.structured_mesh(3, 3), perfect, pressure={"right": 9.0})
    laboratory = lab(held, load=(0.0, 1e300))
    assert "limit load" in laboratory.first["said"]
    assert laboratory.view()._repr_html_()
    (*_, frame) = laboratory.frames({"load": 1e300})
    json.dumps(frame, allow_nan=False)
    (*_, frame) = laboratory.frames({"load": 0.1})
    assert "converged" in frame["said"]


@needs_viewer
def test_an_elastic_position_leaves_the_scale_of_colours_as_it_is():
    """Play passes the load 0, where all plastic strains are 0."""
    laboratory = lab(replace(body(), traction=at(0.1).traction), load=(0.0, 12.0))
    for load in (10.0, 0.0, 10.0):
        (*_, frame) = laboratory.frames({"load": load})
    strain = laboratory.last.fields.equivalent_plastic_strain
    peak = corners_of(laboratory.last.fields, strain).values.max()
    assert frame["scene"]["funcmin"] == 0.0
    assert 0.1 * peak < frame["scene"]["funcmax"] <= ROOM * peak


def numbers(texts):
    """The numbers that webgui reads, (arrays, pieces, 4)."""
    each = [np.frombuffer(base64.b64decode(text), np.float32) for text in texts]
    return np.stack(each).reshape(len(texts), -1, 4)


@needs_viewer
@pytest.mark.parametrize("dim", [2, 3])
def test_a_picture_has_the_positions_and_values_of_the_viewer(dim):
    problem = body() if dim == 2 else indented_block(1)
    laboratory = lab(problem, lame_mu=(500.0, 2000.0))
    (*_, frame) = laboratory.frames({})
    result = laboratory.last
    lines = views.lines_of([result])._replace(peak=laboratory.peak)
    given = [laboratory.colours, laboratory.drawing, lines]
    what = drawable(result, laboratory.field)
    viewer = views.scene_of(result, what, None, *given)
    for name in ("Bezier_trig_points", "edges"):
        ours = numbers(frame["scene"][name])
        theirs = numbers(viewer[name])
        centres = [one[..., :3].mean(axis=0).round(5) for one in (ours, theirs)]
        first, second = (np.lexsort(one.T) for one in centres)
        sums = ours[:, first].sum(axis=0), theirs[:, second].sum(axis=0)
        np.testing.assert_allclose(*sums, rtol=1e-5, atol=1e-6)
    assert viewer["objects"] == frame["scene"]["objects"]


def test_factors_are_kept_for_solids_that_multigrid_would_solve(monkeypatch):
    monkeypatch.setattr(choice, "MOST_BY_FACTORS_LARGER", 500)
    problem = indented_block(1)
    solver = WarmSolver()
    solver.solve(problem)
    moved = replace(problem, gap=problem.gap + 1e-4)
    assert solver.predict(moved) is not None
    warm = solver.solve(moved)
    assert warm.linear_solver == DIRECT
    cold = semismooth_newton(moved)
    assert cold.linear_solver != DIRECT
    assert warm.contact_force == pytest.approx(cold.contact_force, rel=1e-8)


@pytest.fixture(scope="module")
def served():
    """The address of a laboratory that the command serves."""
    command = [sys.executable, "-m", "ngepc", "lab", "lshape", "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        line = process.stdout.readline()
        yield line.split(" at ")[1].split()[0]
        process.terminate()


FRAMES = "document.querySelector('.ngepc-lab').state.frames"
DRAWN = "document.querySelector('.ngepc-lab').state"


@needs_browser
@needs_viewer
def test_dragging_is_live_in_the_browser(served):
    with Browser(600, 500) as tab:
        seen = tab.visit(served)
        tab.wait_for("document.body.dataset.ready === 'yes'")
        start = 10.0 / 12.0
        tab.drag("input[name=load]", (start, 0.3), 30)
        while_dragging = tab.evaluate(FRAMES)
        tab.wait_for(f"!{DRAWN}.busy")
        tab.settle()
        drawn = tab.evaluate(f"{DRAWN}.drawn")
        load = tab.evaluate("document.querySelector('input[name=load]').exact")
        assert while_dragging >= 5
        assert tab.evaluate(FRAMES) < 32 * 2
        assert 3.0 < load < 4.3
        assert drawn["exact"]
        assert drawn["values"]["load"] == load
        caption = tab.evaluate("document.querySelector('.caption').textContent")
        assert caption.startswith(f"load {load:g}, gap 0.1")
        solved = semismooth_newton(
            changed(lshape_problem(lshape.paper_mesh(833)), {"load": load}, None)
        )
        force = drawn["curves"][1]["here"][1]
        assert force == pytest.approx(solved.contact_force, rel=1e-9, abs=1e-9)
        shown = tab.pixels()
        assert (np.ptp(shown, axis=2) > 0.02).mean() > 0.01
        assert seen.errors == []
        assert all(request.startswith(served) for request in seen.requests)


def test_the_page_is_for_those_who_know_its_address(served):
    other = served.rsplit("/", 2)[0] + "/guess/"
    with Browser() as tab:
        tab.visit(other)
        assert "404" in tab.evaluate("document.body.textContent")
    assert json.dumps(served)
