"""Geometries, data and counts of the studies beside closed forms; nothing large is solved."""

import itertools
import json
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from ngsolve import Integrate
from ngsolve.meshes import MakeStructured2DMesh
from solved import lshape_dual

from ngepc import PyAMG, lshape_problem
from ngepc.geometries import block, lshape
from ngepc.studies import (
    contact_problems,
    counts,
    material_problems,
    overlap,
    paths,
    threads,
)
from ngepc.studies.convergence import convergence_quotients
from ngepc.studies.large import solved_in_a_row
from ngepc.studies.locking import cantilever, cook, punch

QUADS = partial(MakeStructured2DMesh, quads=True)
RESULTS = Path(__file__).resolve().parents[2] / "results"


@pytest.mark.parametrize(
    ("make", "corners"),
    [
        (cantilever, [(0, -0.5), (10, -0.5), (10, 0.5), (0, 0.5)]),
        (punch, [(0, -4), (4, -4), (4, 0), (0, 0)]),
        (cook, [(0, 0), (48, 44), (48, 60), (0, 44)]),
    ],
)
def test_bodies_of_the_study_of_locking(make, corners):
    """Corners as published, and the area of the polygon."""
    mesh = make(QUADS, 2, 1).mesh
    a, b = np.array(corners).T
    area = 0.5 * (a @ np.roll(b, -1) - b @ np.roll(a, -1))
    assert Integrate(1.0, mesh) == pytest.approx(area, rel=1e-12)
    points = np.array([v.point for v in mesh.vertices])
    for corner in corners:
        assert np.abs(points - corner).max(axis=1).min() < 1e-12


class TakenError(Exception):
    """What a study would have solved."""


def taken(monkeypatch, module, name, call):
    """The arguments of the first call of a function of a module."""

    def instead(*arguments, **named):
        raise TakenError(*arguments, named)

    monkeypatch.setattr(module, name, instead)
    with pytest.raises(TakenError) as caught:
        call()
    return caught.value.args


def test_bree_s_cylinder_is_heated_and_cooled(monkeypatch):
    """One thick, and a thermal strain that is linear in the thickness, full at odd times."""
    problem, schedule, _ = taken(
        monkeypatch,
        material_problems,
        "evolve",
        lambda: material_problems.bree_cycles(0.5, 3.0),
    )
    radius = material_problems.RADIUS
    points = np.array([v.point for v in problem.mesh.vertices])
    assert points[:, 0].min() == pytest.approx(radius)
    assert np.ptp(points[:, 0]) == pytest.approx(1.0)
    assert schedule.times == tuple(0.5 * k for k in range(1, 17))
    stress = 3.0 * material_problems.YIELD / material_problems.E
    for time, share in ((0.5, 0.5), (1.0, 1.0), (1.5, 0.5), (2.0, 0.0), (3.0, 1.0)):
        strain = schedule.changes(time)["initial_strain"]
        inside = strain(problem.mesh(radius, 0.01))
        outside = strain(problem.mesh(radius + 1.0, 0.01))
        assert inside == pytest.approx(share * stress, abs=1e-12)
        assert outside == pytest.approx(-share * stress, abs=1e-12)


def test_what_is_lost_in_bree_s_cylinder(monkeypatch):
    """The last cycle's growth over R/E, and its dissipation over R^2/E and the volume."""
    radius, low = material_problems.RADIUS, material_problems.LOW
    steps = [
        SimpleNamespace(
            fields=SimpleNamespace(displacement=lambda place, k=k: (0.5 * k, 0.0)),
            solution="the last one",
        )
        for k in range(16)
    ]
    run = SimpleNamespace(steps=steps, column=lambda name: np.arange(16.0))
    run.raise_for_status = lambda: run
    monkeypatch.setattr(material_problems, "evolve", lambda *_: run)
    growth, lost, last = material_problems.bree_cycles(0.5, 3.0)
    unit = material_problems.YIELD / material_problems.E
    assert growth == pytest.approx(2.0 / (radius + 0.5) / unit)
    volume = np.pi * ((radius + 1) ** 2 - radius**2) * low
    assert lost == pytest.approx(54.0 / volume / unit / material_problems.YIELD)
    assert last == "the last one"


def test_a_ring_that_yields_as_a_whole():
    """Nadai: sigma_t - sigma_r integrated from outside by many small steps."""
    pressure = 0.0
    inner, outer = material_problems.RADII
    radii = np.linspace(outer, inner, 20_001)
    for r, following in itertools.pairwise(radii):
        middle = 0.5 * (r + following)
        half = pressure + (following - r) / 2 * (
            (material_problems.hoop(pressure) - pressure) / r
        )
        pressure += (following - r) * (material_problems.hoop(half) - half) / middle
    assert material_problems.ring_limit() == pytest.approx(-pressure, rel=1e-7)


def test_the_block_below_a_sphere_has_eight_cells_along_its_width(monkeypatch):
    """And 24 along the contact."""
    width, height, contact, fine, coarse, _ = taken(
        monkeypatch,
        contact_problems,
        "half_block",
        lambda: contact_problems.pressed_sphere(1.0, [0.1], 0.5, 4.0, None),
    )
    assert (width, height) == (4.0, 4.0)
    assert contact == 0.5
    assert 24 * fine == pytest.approx(contact)
    assert 8 * coarse == pytest.approx(width)


def test_a_fit_finds_the_ellipse_of_hertz(monkeypatch):
    """Peak and half width, wherever rows without pressure are."""
    place = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 3.0, 30.0])
    p = 5.0 * np.sqrt(np.maximum(1 - place**2, 0.0))
    points = np.stack([place, 0 * place], axis=1)
    monkeypatch.setattr(contact_problems, "vertex_coordinates", lambda mesh: points)
    result = SimpleNamespace(
        rows=SimpleNamespace(between=lambda values: values, weights=np.full(8, 0.5)),
        nodal_contact_forces=0.5 * p,
        problem=SimpleNamespace(mesh=None),
    )
    assert contact_problems.fitted(result) == pytest.approx((5.0, 1.0), rel=1e-10)


def test_counts_are_taken_of_all_examples():
    """Example (a) with small hardening is among them, each once."""
    cells = counts.NewtonCounts(Path("unused"), levels=1).cells()
    kinds = [(c["body"], c["hardening"], c["nodes"]) for c in cells]
    assert len(set(kinds)) == len(kinds)
    for nodes in counts.HARDENED_NODES:
        for ratio in counts.RATIOS:
            assert ("lshape", ratio, nodes) in kinds


@pytest.mark.parametrize("name", ["table1", "table2"])
def test_notes_of_tables_explain_their_rows_and_statuses_only(name):
    """Those of the committed tables, whose text names no row that is not there."""
    kind = {"table1": counts.Table1, "table2": counts.Table2}[name]
    cells = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))["cells"]
    rows = list(dict.fromkeys(cell["row"] for cell in cells))
    (note,) = kind(Path("unused"), levels=6, rows=rows).notes(cells)
    assert note in (RESULTS / f"{name}.md").read_text(encoding="utf-8")
    for row in counts.OWN_ROWS:
        assert (f"'{row}' is" in note) == (row in rows and not row.endswith("*"))
    assert ("'stagnated'" in note) == ("stagnated" in {c["status"] for c in cells})


def test_the_largest_difference_of_energies_is_told():
    def run(energy):
        return {"status": "converged", "energy": energy, "iterations": 3}

    records = [
        {"body": "block", "default": run(1.0), "primal": run(1.0 + 1e-9)},
        {"body": "block", "default": run(2.0), "primal": run(2.0 + 2e-5)},
    ]
    told = " ".join(counts.NewtonCounts(Path("unused")).notes(records))
    assert "at most 1.0e-05" in told


def test_rows_with_many_steps_are_drawn(tmp_path, monkeypatch):
    """The others are named above the picture."""
    drawn = {}

    def plot_counts(ours, paper):
        drawn.update(ours)
        return SimpleNamespace(axes=[SimpleNamespace(set_title=drawn_title.append)])

    drawn_title = []
    monkeypatch.setattr(counts, "plot_counts", plot_counts)
    monkeypatch.setattr(counts, "save_figure", lambda figure, path: path)
    few, many = counts.FEW, counts.FEW + 5
    records = [
        {"row": "1e2", "iterations": few, "paper": None, "nodes": 417},
        {"row": "1e4", "iterations": many, "paper": None, "nodes": 417},
    ]
    study = counts.Table1(tmp_path, rows=("1e4",))
    study.draw(records)
    assert drawn == {"gamma = 1e4": {417: many}}


def test_the_figures_of_the_paper_have_their_numbers():
    """2, 3 are of Example (a), 5, 6 of Example (b)."""
    assert {2, 3, 5, 6} <= set(paths.FIGURES)
    assert paths.FIGURES[2][1] == ("strain", "zone")
    assert {paths.FIGURES[number][0] for number in (2, 3)} == {"lshape"}
    assert {paths.FIGURES[number][0] for number in (5, 6)} == {"wrench"}
    figure = paths.drawn(2, lshape_dual(113))
    assert len([axes for axes in figure.axes if axes.get_xlabel() == "x"]) == 2


def test_quotients_are_those_of_the_distances():
    problem = lshape_problem(lshape.paper_mesh(33))
    found = convergence_quotients(problem, 1e3)
    distances = np.array(found["distances"])
    assert len(distances) > 2
    assert found["status"] == "converged"
    quotients = distances[1:] / distances[:-1]
    assert found["quotients"] == pytest.approx(quotients, rel=1e-12)
    assert quotients[-1] < 0.5


def test_linear_iterations_are_counted_for_each_solve():
    """The largest and the mean, of a block by conjugate gradients."""
    ((_, found),) = solved_in_a_row(
        block.structured_mesh(1, 1, 1, simplices=True), 1, 0.1, PyAMG()
    )
    pairs = list(zip(found["linear_iterations"], found["solves"], strict=True))
    assert sum(solves for _, solves in pairs) > 0
    each = [linear / solves for linear, solves in pairs if solves]
    assert found["most"] == pytest.approx(max(each))
    total = sum(found["linear_iterations"]) / sum(found["solves"])
    assert found["mean"] == pytest.approx(total)


def test_times_of_threads_are_those_of_the_solve(monkeypatch):
    """Clocks that go on by two and by one whenever they are read."""
    problem = lshape_problem(lshape.paper_mesh(33))
    monkeypatch.setitem(threads.BODIES, "small", lambda: problem)
    clocks = {
        "perf_counter": iter(range(0, 100, 2)),
        "process_time": iter(range(50, 150)),
    }
    for name, clock in clocks.items():
        monkeypatch.setattr(threads.time, name, partial(next, clock))
    found = threads.solved_by_threads("small", 1)
    assert found["status"] == "converged"
    assert (found["wall_s"], found["cpu_s"]) == (2, 1)


def test_masing_s_loop_is_that_of_the_curve():
    """All numbers of the bar agree with the curve twice as large."""
    for quantity in material_problems.masing()[1]:
        assert quantity.ours == pytest.approx(quantity.reference, rel=1e-6)


def test_hardening_of_blocks_is_a_multiple_of_mu():
    for body in ("tetrahedra", "hexahedra"):
        nodes = min(counts.BLOCKS[body])
        problem = counts.problem_of(body, nodes, 1e-3)
        assert problem.material.hardening == 1e-3 * problem.material.lame_mu


def test_the_quarter_of_a_block_is_fine_below_the_sphere():
    """A box 0.5 x 0.5 x 1, with the smallest cell at (0, 0, 1)."""
    for hexahedra in (True, False):
        mesh = overlap.graded_quarter(2, hexahedra=hexahedra)
        points = np.array([v.point for v in mesh.vertices])
        np.testing.assert_allclose(points.min(axis=0), 0.0, atol=1e-14)
        np.testing.assert_allclose(points.max(axis=0), [0.5, 0.5, 1.0])
        assert Integrate(1.0, mesh) == pytest.approx(0.25)
        steps = np.diff(np.unique(points[:, 2].round(12)))
        assert (np.diff(steps) < 0).all()
        across = np.diff(np.unique(points[:, 0].round(12)))
        assert (np.diff(across) > 0).all()
