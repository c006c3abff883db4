"""Pictures: what they show agrees with the fields, and the colour scale with its rules."""

import itertools
import math
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from netgen.occ import Compound, MoveTo, OCCGeometry, Rectangle, Y
from ngsolve import CF, L2, GridFunction, InnerProduct, Integrate, Mesh, sqrt, x, y
from solved import block_primal, lshape_dual, lshape_primal

from ngepc import Contact, Material, Problem, lshape_problem, semismooth_newton
from ngepc.discretisation.spaces import displacement_space, plastic_space
from ngepc.geometries import block, lshape, ring
from ngepc.model.obstacles import Disc
from ngepc.pictures import (
    beside,
    monitors,
    plot_active_sets,
    plot_contact_pressure,
    plot_counts,
    plot_field,
    plot_history,
    plot_mesh,
    plot_plastic_zone,
)
from ngepc.pictures.course import quiz
from ngepc.pictures.curves import arc_lengths, pressure_curves
from ngepc.pictures.drawable import KINDS, UnitNames, drawable
from ngepc.pictures.monitors import live_plot_monitor
from ngepc.pictures.report import standard_figures
from ngepc.pictures.sampling import (
    Corners,
    colour_scale,
    corners_of,
    obstacle_lines,
    visible,
)
from ngepc.pictures.style import COLOURS, CONTACT, ELASTIC, PLASTIC, RC, save_figure
from ngepc.primal.solver import primal_newton
from ngepc.results.fields import Fields
from ngepc.results.outcome import History


def strips(values, areas):
    """A row of triangles with given values and areas."""
    points = np.zeros((len(values), 3, 2))
    points[:, 1, 0], points[:, 2, 1] = 1.0, 2 * np.asarray(areas)
    return Corners(
        points, 0 * points, np.repeat(np.array(values, float)[:, None], 3, axis=1)
    )


def zero_fields(mesh, clamped="clamped"):
    steel = Material.kinematic(
        lame_lambda=1.0, lame_mu=1.0, yield_stress=1.0, hardening=1.0
    )
    problem = Problem(mesh, steel, clamped)
    u, p = (
        GridFunction(displacement_space(problem)),
        GridFunction(plastic_space(problem)),
    )
    return Fields(problem, u, p)


FIGURES = {
    "field": lambda: plot_field(lshape_primal()),
    "yield function": lambda: plot_field(lshape_dual(), "yield_function", title="phi"),
    "component": lambda: plot_field(lshape_primal(), "stress_xy", mesh_lines=True),
    "zone": lambda: plot_plastic_zone(lshape_primal(), 0.02),
    "mesh": lambda: plot_mesh(lshape_primal()),
    "comparison": lambda: plot_field(
        {"dual": lshape_dual(), "primal": lshape_primal()}
    ),
    "active sets": lambda: plot_active_sets(lshape_primal()),
    "active sets in 3D": lambda: plot_active_sets(block_primal()),
    "history": lambda: plot_history(
        {"d": lshape_dual().history, "p": lshape_primal().history}
    ),
    "pressure": lambda: plot_contact_pressure(
        {"dual": lshape_dual(), "primal": lshape_primal()}, units=UnitNames("m", "Pa")
    ),
    "counts": lambda: plot_counts({"1e3": {417: 3, 833: 4}}, {"1e3": {417: 3, 833: 5}}),
    "body in 3D": lambda: plot_field(block_primal(), "displacement_z"),
    "pictures beside each other": lambda: beside(
        lambda axes: plot_field(lshape_primal(), axes=axes),
        lambda axes: plot_plastic_zone(lshape_primal(), 0.02, axes=axes),
    ),
    "zone in 3D": lambda: plot_plastic_zone(block_primal()),
}


def assert_nothing_is_cut_off(written):
    """A PNG with ink, but none in its first row and column."""
    assert written.startswith(b"\x89PNG")
    ink = (imread(BytesIO(written))[..., :3] < 0.95).any(axis=2)
    assert 0.01 < ink.mean() < 0.95
    assert not ink[0].any()
    assert not ink[:, 0].any(), "something is cut off at the left"


@pytest.mark.parametrize("name", FIGURES)
def test_figures_are_those_of_pyplot_until_they_are_written(name, request):
    """So that plt.savefig, plt.title and plt.show find them."""
    if "3D" in name:
        request.getfixturevalue("draws_solids")
    before, figure = plt.get_fignums(), FIGURES[name]()
    figure.set_dpi(60)
    assert plt.gcf() is figure
    assert_nothing_is_cut_off(figure._repr_png_())
    assert plt.get_fignums() == before


@pytest.mark.parametrize("name", ["field", "history", "pictures beside each other"])
def test_pyplot_writes_the_last_figure(name):
    FIGURES[name]().set_dpi(60)
    saved = BytesIO()
    plt.savefig(saved)
    assert_nothing_is_cut_off(saved.getvalue())


def test_without_pyplot_in_threads_and_notebooks_figures_are_free(monkeypatch):
    before = plt.get_fignums()
    drawn = FIGURES["counts"]
    with ThreadPoolExecutor(1) as pool:
        threaded = pool.submit(drawn).result()
    shell = SimpleNamespace(kernel=None)
    with monkeypatch.context() as notebook:
        kernel = SimpleNamespace(get_ipython=lambda: shell)
        notebook.setitem(sys.modules, "IPython", kernel)
        shown = drawn()
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot")
    for figure in (threaded, shown, drawn()):
        assert figure._repr_png_().startswith(b"\x89PNG")
    assert plt.get_fignums() == before


def test_a_picture_is_laid_out_like_a_drawn_one():
    def drawn():
        return beside(
            lambda axes: plot_field(lshape_dual(), axes=axes),
            lambda axes: plot_contact_pressure(lshape_dual(), axes=axes),
        )

    first = drawn()
    first.draw_without_rendering()
    second, bare = drawn().like(first), drawn()
    bare.set_layout_engine("none")
    assert beyond(second) == beyond(bare) == []
    wanted, own, other = (
        [a.get_position() for a in f.axes] for f in (first, second, bare)
    )
    np.testing.assert_allclose(own, wanted, atol=1e-3)
    assert not np.allclose(other, wanted, atol=1e-2)
    with pytest.raises(ValueError, match="zip"):
        plot_history(lshape_dual().history).like(first)


def test_axes_and_colour_bar_carry_units():
    figure = plot_field(lshape_primal(), "stress_xx", units=UnitNames("m", "Pa"))
    body, bar = figure.axes
    assert (body.get_xlabel(), body.get_ylabel()) == ("x (m)", "y (m)")
    assert bar.get_ylabel() == r"stress $\sigma_{xx}$ (Pa)"
    assert body.get_aspect() == 1.0


def test_obstacle_is_drawn_at_the_gap():
    lines = [c for c in plot_field(lshape_primal()).axes[0].collections]
    tops = [
        np.array(line.get_segments())[..., 1]
        for line in lines
        if isinstance(line, LineCollection) and np.allclose(line.get_linewidth(), 1.4)
    ]
    assert len(tops) == 1
    np.testing.assert_allclose(tops[0], 1.1, rtol=1e-14)


def test_obstacle_stays_outside_on_meshes_with_turned_edges():
    result = primal_newton(lshape_problem(lshape.mesh(maxh=0.2)))
    lines = plot_field(result).axes[0].collections
    obstacle = next(line for line in lines if np.allclose(line.get_linewidth(), 1.4))
    np.testing.assert_allclose(
        np.array(obstacle.get_segments())[..., 1], 1.1, rtol=1e-14
    )


def test_a_straight_obstacle_is_as_long_as_the_body_below_it():
    result = lshape_primal()
    lines = obstacle_lines(result.fields, 1.0)
    body = corners_of(result.fields, CF(0.0)).deformed(1.0)[..., 0]
    assert body.max() > 1.05, "the body leans over its contact boundary"
    assert lines[..., 0].max() == pytest.approx(body.max(), rel=1e-12)
    assert lines[..., 0].min() == pytest.approx(min(0.0, body.min()), abs=1e-12)


def test_obstacle_is_left_out_where_there_is_none():
    mesh = lshape.mesh(maxh=0.05)
    disc = Disc(centre=(0.5, 1.3), radius=0.25)  # half as wide as the contact boundary
    problem = replace(lshape_problem(mesh), gap=disc.gap(mesh))
    elastic = replace(problem.material, yield_stress=1e9)
    fields = primal_newton(replace(problem, material=elastic)).fields
    lines = obstacle_lines(fields, 1.0)
    assert 0.2 < np.ptp(lines[..., 0]) <= 0.5
    assert lines[..., 1].min() == pytest.approx(1.05, abs=1e-3)
    assert lines[..., 1].max() <= 1.3


@pytest.mark.parametrize("threshold", [0.0, 0.02, 0.1])
def test_dark_area_is_the_measure_of_the_plastic_zone(threshold):
    result = lshape_primal()
    body = (
        plot_plastic_zone(result, threshold, deformation_scale=0.0)
        .axes[0]
        .collections[0]
    )
    corners = corners_of(result.fields, result.fields.equivalent_plastic_strain)
    dark = body.get_array().reshape(-1, 3)[:, 0] > 0.5
    expected = Integrate(result.fields.plastic_zone(threshold), result.problem.mesh)
    assert corners.measures[dark].sum() == pytest.approx(expected, rel=1e-12)


def test_corners_carry_areas_positions_and_values():
    result = lshape_primal()
    corners = corners_of(result.fields, 2 * x - y)
    assert corners.measures.sum() == pytest.approx(0.75, rel=1e-13)
    expected = corners.points @ [2.0, -1.0]
    np.testing.assert_allclose(corners.values, expected, atol=1e-14)


@pytest.mark.parametrize("cuts", [2, 3, 5])
def test_cut_triangles_cover_the_same_body_with_the_same_values(cuts):
    result = lshape_primal()
    corners, finer = (corners_of(result.fields, 2 * x - y, cuts=n) for n in (1, cuts))
    assert len(finer.points) == cuts**2 * len(corners.points)
    assert finer.measures.sum() == pytest.approx(corners.measures.sum(), rel=1e-12)
    assert np.ptp(finer.measures * cuts**2) == pytest.approx(
        np.ptp(corners.measures), abs=1e-12
    )
    np.testing.assert_allclose(finer.values, finer.points @ [2.0, -1.0], atol=1e-14)


def test_quadrilaterals_are_cut_and_bordered():
    fields = zero_fields(block.structured_mesh(3, 2, size=(1.0, 0.5), simplices=False))
    corners, borders = (
        corners_of(fields, x * y, cuts=4),
        corners_of(fields, border=True),
    )
    assert len(corners.points) == 6 * 2 * 16
    assert corners.measures.sum() == pytest.approx(0.5, rel=1e-12)
    expected = corners.points[..., 0] * corners.points[..., 1]
    np.testing.assert_allclose(corners.values, expected, atol=1e-14)
    assert borders.measures.sum() == pytest.approx(6 * 2 * (1 / 3 + 1 / 4), rel=1e-12)


def test_curved_elements_are_drawn_curved():
    """A quarter of a ring with second-order elements: area and outline of circles."""
    mesh = ring.quarter_mesh(0.5)
    mesh.Curve(3)
    fields = zero_fields(mesh, "inner")
    exact = math.pi * 3 / 4
    straight, curved = (
        abs(corners_of(fields, cuts=n).measures.sum() - exact) for n in (1, None)
    )
    assert curved < 0.1 * straight
    for borders in (corners_of(fields, border=True), corners_of(fields, where="outer")):
        radii = np.linalg.norm(borders.points, axis=2)
        assert radii.max() == pytest.approx(2.0, rel=1e-3)
    assert radii.min() == pytest.approx(2.0, rel=1e-3)


def test_surface_of_a_block_has_its_area_and_the_stress_from_inside():
    fields = block_primal().fields
    corners = corners_of(fields, visible(fields, fields.stress[2, 2]))
    assert corners.measures.sum() == pytest.approx(6.0, rel=1e-12)
    assert np.abs(corners.values).max() > 0.1


def test_pressure_curve_integrates_to_the_contact_force():
    result = lshape_dual()
    ((s, pressure),) = pressure_curves(result)
    assert (s[0], s[-1]) == (0.0, pytest.approx(1.0, rel=1e-12))
    assert (np.diff(s) >= 0).all()
    assert np.trapezoid(pressure, s) == pytest.approx(result.contact_force, rel=1e-12)


def test_pressure_between_two_bodies_is_drawn_on_the_first_of_them():
    lower, upper = Rectangle(1, 1).Face(), MoveTo(0, 1.01).Rectangle(1, 1).Face()
    lower.edges.name, upper.edges.name = "side", "free"
    lower.edges.Max(Y).name, lower.edges.Min(Y).name = "below", "floor"
    upper.edges.Min(Y).name, upper.edges.Max(Y).name = "above", "top"
    mesh = Mesh(OCCGeometry(Compound([lower, upper]), dim=2).GenerateMesh(maxh=0.3))
    steel = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=10.0
    )
    pair = Contact("above", "below")
    result = semismooth_newton(
        Problem(mesh, steel, "floor", prescribed={"top": (0, -0.03)}, contact=pair)
    )
    ((s, pressure),) = pressure_curves(result)
    assert result.contact_force > 1.0
    assert np.trapezoid(pressure, s) == pytest.approx(result.contact_force, rel=1e-10)
    assert len(obstacle_lines(result.fields, 1.0)) == 0
    assert plot_field(result).axes
    assert standard_figures(result)["contact_pressure"].axes


def test_arc_lengths_put_shuffled_segments_in_order():
    angle = np.linspace(0, 2 * np.pi, 13)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    segments = np.stack([ring[:-1], ring[1:]], axis=1)
    rng = np.random.default_rng(3)
    mixed = segments[rng.permutation(12)]
    mixed[::2] = mixed[::2, ::-1]
    s, curves = arc_lengths(mixed)
    assert set(curves) == {0}
    side = np.linalg.norm(segments[0, 1] - segments[0, 0])
    np.testing.assert_allclose(np.sort(s.min(axis=1)), side * np.arange(12), atol=1e-13)
    np.testing.assert_allclose(np.abs(s[:, 1] - s[:, 0]), side, atol=1e-13)
    places = np.round(s % (12 * side - 1e-9) / side).astype(
        int
    )  # each end at one arc length
    for place in range(12):
        met = mixed[places == place]
        np.testing.assert_allclose(met, np.broadcast_to(met[0], met.shape), atol=1e-12)
    s, curves = arc_lengths(np.concatenate([segments[:5], segments[:5, ::-1] + 3.0]))
    assert sorted(np.bincount(curves)) == [5, 5]
    assert s.max() == pytest.approx(5 * side)


def test_no_contact_pressure_is_drawn_at_the_bottom():
    """Not in the middle of an axis with negative pressures."""
    away = primal_newton(replace(lshape_primal().problem, gap=10.0))
    axes = plot_contact_pressure(away).axes[0]
    assert not axes.lines[0].get_ydata().any()
    assert axes.get_ylim() == (0.0, 1.0)


def test_one_small_element_does_not_swallow_the_scale():
    values = np.r_[np.linspace(0.0, 1.0, 100), 50.0]
    limits = colour_scale(strips(values, np.r_[np.ones(100), 1e-3]))
    assert limits.vmin == 0.0
    assert 0.9 < limits.vmax <= 1.0
    assert limits.extend == "max"


def test_a_field_without_peaks_is_shown_in_full():
    limits = colour_scale(strips(np.linspace(2.0, 3.0, 50), np.ones(50)))
    assert (limits.vmin, limits.vmax, limits.extend) == (2.0, 3.0, "neither")


@pytest.mark.parametrize("zeros", [0, 1, 30])
def test_the_scale_of_the_negative_field_is_the_mirrored_one(zeros):
    """A yield function that is zero in most of the body has zero on its scale."""
    values = np.r_[np.zeros(zeros), np.linspace(8.0, 10.0, 40)]
    scale, mirrored = (
        colour_scale(strips(v, np.ones(len(v)))) for v in (values, -values)
    )
    assert (mirrored.vmin, mirrored.vmax) == (-scale.vmax, -scale.vmin)
    assert scale.vmin == (0.0 if zeros else 8.0)


def test_colour_range_settles_under_refinement_while_the_maximum_grows():
    most, peak = [], []
    for nodes in (417, 1601, 6273):
        problem = lshape_problem(lshape.paper_mesh(nodes))
        zero = GridFunction(displacement_space(problem))
        fields = Fields(problem, zero, GridFunction(plastic_space(problem)))
        singular = GridFunction(L2(problem.mesh, order=0))
        singular.Set(1 / sqrt(sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2) + 1e-9))
        corners = corners_of(fields, singular)
        most.append(colour_scale(corners).vmax)
        peak.append(corners.values.max())
    assert peak[2] > 1.5 * peak[0]
    assert most[2] == pytest.approx(most[1], rel=0.05)


def test_signed_fields_get_symmetric_limits():
    limits = colour_scale(
        strips(np.linspace(-3.0, 1.0, 40), np.ones(40)), symmetric=True
    )
    assert limits.vmin == -limits.vmax == -3.0


def test_the_scale_of_a_field_that_is_zero_begins_at_zero():
    """A pressure of zero has the colour of no pressure, not the one in the middle."""
    zero = strips(np.zeros(5), np.ones(5))
    limits = [colour_scale(zero), colour_scale(zero, symmetric=True)]
    limits += [colour_scale(zero, ends=ends) for ends in ((None, 0.0), (-2.0, None))]
    ends = [(0.0, 1.0), (-1.0, 1.0), (-1.0, 0.0), (-2.0, 0.0)]
    assert [(scale.vmin, scale.vmax) for scale in limits] == ends


@pytest.mark.parametrize("value", [0.0, 4.0, -2.0])
def test_constant_fields_have_a_scale(value):
    limits = colour_scale(strips([value] * 5, np.ones(5)))
    assert limits.vmin < limits.vmax
    assert limits.vmin <= value <= limits.vmax


@pytest.mark.parametrize("name", KINDS)
def test_every_named_field_is_a_finite_scalar(name):
    result = lshape_primal()
    if not hasattr(result, name) and not hasattr(result.fields, name):
        with pytest.raises(ValueError, match=f"{name}.*no such field"):
            drawable(result, name)
        return
    what = drawable(result, name)
    values = corners_of(result.fields, what.coefficient).values
    assert what.coefficient.dim == 1
    assert np.isfinite(values).all()


def test_vectors_and_matrices_are_drawn_by_their_norms():
    result = lshape_primal()
    mesh, sigma = result.problem.mesh, result.stress
    norm = drawable(result, "stress").coefficient
    assert Integrate(norm**2, mesh) == pytest.approx(
        Integrate(InnerProduct(sigma, sigma), mesh), rel=1e-12
    )
    component = drawable(result, "stress_xy").coefficient
    assert Integrate((component - sigma[0, 1]) ** 2, mesh) == 0.0
    labels = [drawable(result, name).label for name in ("stress", "displacement")]
    assert ["|_F$" in label for label in labels] == [True, False]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda r: plot_field(r, "stres"), "stress"),
        (lambda r: plot_field(r, "stress_xz"), "stress_xz"),
        (lambda r: plot_field(r, "stress_x"), "2 of the letters"),
        (lambda r: plot_field(r, "yield_function_x"), "no components"),
        (lambda r: plot_field(r, 3), "field=3"),
        (lambda r: plot_field(r, "contact_pressure"), "a solid"),
        (lambda r: plot_field(r, deformation_scale=-1), "deformation_scale=-1"),
        (lambda r: plot_field(r, vmin=2.0, vmax=1.0), "vmin < vmax"),
        (lambda r: plot_plastic_zone(r, -0.1), "threshold=-0.1"),
        (lambda r: plot_field({}), "at least one"),
        (
            lambda r: plot_field({"a": r, "b": r}, axes=plot_field(r).axes[0]),
            "there are 2",
        ),
        (lambda r: plot_history({"run": History()}), "no records"),
        (lambda r: plot_history({}), "at least one"),
        (lambda r: beside(), "at least one"),
        (lambda r: plot_counts({}), "at least one"),
        (lambda r: plot_field(CF(1.0)), "result of a solver"),
        (lambda r: plot_contact_pressure(block_primal()), "3D"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call(lshape_primal())


def test_titles_say_how_the_problem_was_solved():
    class Labelled:
        method_label = "gamma = 1000"

        def __init__(self, result):
            self.fields, self.problem = result.fields, result.problem

    source = Labelled(lshape_dual())
    assert plot_field(source).axes[0].get_title() == "gamma = 1000"
    assert plot_plastic_zone(source).axes[0].get_title().endswith("\ngamma = 1000")
    assert plot_field(source, title="mine").axes[0].get_title() == "mine"
    large = {"deformation_scale": 20.0}
    assert plot_field(source, title="mine", **large).axes[0].get_title() == (
        "mine (displacements x 20)"
    )
    assert (
        "displacements x 20" in plot_plastic_zone(source, **large).axes[0].get_title()
    )
    assert "displacements" not in plot_mesh(source).axes[0].get_title()


def deuteranopia(colour):
    """Linear RGB as people without green cones see it (Machado, Oliveira and Fernandes 2009)."""
    matrix = [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
              [-0.011820, 0.042940, 0.968881]]  # fmt: skip
    return np.clip(np.array(matrix) @ linear(colour), 0, 1)


def linear(colour):
    rgb = np.array(to_rgb(colour))
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(rgb):
    """CIE L*a*b* of linear RGB."""
    matrix = [
        [0.4124, 0.3576, 0.1805],
        [0.2126, 0.7152, 0.0722],
        [0.0193, 0.1192, 0.9505],
    ]
    X, Y, Z = np.cbrt(np.array(matrix) @ rgb / [0.9505, 1.0, 1.089])
    return np.array([116 * Y - 16, 500 * (X - Y), 200 * (Y - Z)])


def closest(colours, seen):
    """The least distance between two of the colours, in units of which 2 is just seen."""
    points = [lab(seen(colour)) for colour in colours]
    return min(np.linalg.norm(a - b) for a, b in itertools.combinations(points, 2))


@pytest.mark.parametrize("seen", [linear, deuteranopia])
def test_colours_are_told_apart_without_green_cones(seen):
    assert closest(COLOURS, seen) > 12
    assert closest((ELASTIC, PLASTIC, CONTACT), seen) > 30


def test_the_measure_of_colours_can_fail():
    """Red and green of equal lightness, the usual mistake."""
    assert closest(("#c0392b", "#5d8a2a"), linear) > 60
    assert closest(("#c0392b", "#5d8a2a"), deuteranopia) < 20


def test_all_figures_have_one_style_which_users_can_take(tmp_path):
    figures = [plot_field(lshape_primal()), plot_history(lshape_primal().history)]
    for figure in figures:
        for axes in figure.axes[:1]:
            assert axes.xaxis.label.get_size() == RC["axes.labelsize"]
            assert not axes.spines["top"].get_visible()
    with plt.style.context("ngepc.pictures.ngepc"):
        assert plt.rcParams["axes.prop_cycle"] == RC["axes.prop_cycle"]
    assert plt.rcParams["axes.prop_cycle"] != RC["axes.prop_cycle"]
    for ending, begin in (("pdf", b"%PDF"), ("svg", b"<?xml")):
        assert (
            save_figure(figures[1], tmp_path / f"new/a.{ending}")
            .read_bytes()
            .startswith(begin)
        )


def beyond(figure):
    """Titles and labels that do not fit into a figure."""
    FigureCanvasAgg(figure).draw()
    frame = figure.bbox.padded(1)
    texts = [t for a in figure.axes for t in (a.title, a.xaxis.label, a.yaxis.label)]
    boxes = {t.get_text(): t.get_window_extent() for t in texts if t.get_text()}
    return [
        t
        for t, b in boxes.items()
        if not (frame.contains(*b.min) and frame.contains(*b.max))
    ]


class Shown:
    """A place in a notebook."""

    def update(self, figure):
        """Forget it."""


def test_words_stay_inside_wide_low_pictures_and_those_of_monitors(monkeypatch):
    watched = []
    monkeypatch.setattr(
        monitors, "_display", lambda figure: watched.append(figure) or Shown()
    )
    with live_plot_monitor() as monitor:
        monitor(replace(lshape_dual().history.records[0], snapshot=lshape_dual))
    flat = zero_fields(block.structured_mesh(16, 1, size=(16.0, 1.0)))
    panels = dict.fromkeys(
        "abc", zero_fields(block.structured_mesh(4, 2, size=(2.0, 1.0)))
    )
    drawn = [
        plot_field(flat, CF(x)),
        plot_field(panels, "accumulated_plastic_strain"),
        watched[0],
    ]
    assert [len(figure.axes) for figure in drawn] == [2, 4, 3]
    assert [beyond(figure) for figure in drawn] == [[], [], []]
    narrow = plot_field(flat, CF(x), title="words " * 99)
    assert beyond(narrow), "the measure can fail"


def test_quizzes_are_there():
    found = quiz("01_first_solve")
    page = found._repr_html_()
    assert page.count("<details>") == sum(len(one["choices"]) for one in found)
    assert page.count("Right. ") == len(found) > 0
    with pytest.raises(ValueError, match="lecture='02': one of 00_lab, 01_first_solve"):
        quiz("02")


@pytest.mark.parametrize("size", [1e-12, 1e9])
def test_arc_lengths_in_all_units(size):
    """Two pieces of a line apart from each other, and a point twice."""
    points = size * np.array([(0, 0), (1, 0), (3, 0), (5, 0), (6, 0)], dtype=float)
    segments = np.stack([points[[0, 1, 3]], points[[1, 2, 4]]], axis=1)
    s, curves = arc_lengths(segments)
    assert curves[0] == curves[1] != curves[2]
    np.testing.assert_allclose(np.ptp(s[:2]), 3 * size)
    assert not arc_lengths(np.zeros((1, 2, 2)))[0].any()


@pytest.mark.parametrize("length", [1.0, 1e-3])
def test_figures_of_plane_bodies_have_their_shape_in_all_units(length):
    """Twice as wide as high, and about 6 inches wide."""
    mesh = block.structured_mesh(2, 2, size=(2 * length, length), simplices=True)
    metal = Material.kinematic(
        lame_lambda=1e3, lame_mu=1e3, yield_stress=1.0, hardening=9.0
    )
    traction = {"right": (1e-6, 0.0)}
    result = semismooth_newton(Problem(mesh, metal, traction=traction, order=1))
    width, height = plot_field(result, "stress").get_size_inches()
    assert 6.0 < width < 9.0
    assert 2.5 < height < width
