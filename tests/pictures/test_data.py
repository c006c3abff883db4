"""What goes into pictures and reports: orientations, sizes, numbers, tables; no pixels."""

import numpy as np
import pytest
from ngsolve import x
from solved import lshape_primal

from ngepc import (
    Material,
    Problem,
    evolve,
    load_cycle,
    plot_curve,
    plot_field,
    plot_history,
    semismooth_newton,
)
from ngepc.geometries import block
from ngepc.pictures import UnitNames, plot_mesh
from ngepc.pictures.answers import (
    describe_result,
    largest,
    largest_at_points,
    reaction_answer,
)
from ngepc.pictures.drawable import NEVER_NEGATIVE, PLAIN, drawable, on_one_scale
from ngepc.pictures.fields import Drawing
from ngepc.pictures.quantities import number
from ngepc.pictures.report import html_table
from ngepc.pictures.sampling import corners_of
from ngepc.pictures.sliders import load_size
from ngepc.pictures.views import lines_of, scene_of
from ngepc.pictures.vtu import CELLS, is_turned
from ngepc.results.outcome import History, IterationRecord

METAL = Material.kinematic(
    lame_lambda=1e3, lame_mu=1e3, yield_stress=5.0, hardening=100.0
)


@pytest.mark.parametrize("shape", list(CELLS))
def test_orientation_of_cells(shape):
    """The sign of the determinant, also of sheared cells; mirrored ones are turned."""
    cell = CELLS[shape]
    corners = np.array(cell.corners, dtype=float)
    N = corners.shape[1]
    random = np.random.default_rng(0)
    for _ in range(50):
        map_ = random.normal(size=(N, N))
        turned = is_turned(corners @ map_.T + random.normal(size=N), cell)
        assert turned == (np.linalg.det(map_) < 0)


def test_the_size_of_loads_is_that_of_the_largest():
    """On boundaries; in the body, and of what moves, where there are none."""
    mesh = block.structured_mesh(2, 2)

    def size(**data):
        return load_size(Problem(mesh, METAL, "clamped", **data))

    loads = {"right": (3.0, 4.0), "contact": (1.0, 0.0), "left": (0.0, -2.0)}
    assert size(traction=loads, body_force=(9.0, 0.0)) == 5.0
    assert size(traction={"right": (3.0, 4.0), "left": (0.0, 0.0)}) == 5.0
    assert size(body_force=(0.6, -0.8)) == pytest.approx(1.0)
    moves = {"contact": (0.25, -0.5)}
    assert size(prescribed=moves) == 0.5
    assert size() == 0.0


def test_the_largest_displacement_is_that_of_a_corner():
    result = lshape_primal()
    mesh = result.problem.mesh
    sizes = [
        np.linalg.norm(result.displacement(mesh(*p))) for p in mesh.ngmesh.Points()
    ]
    assert largest(result, "displacement") == pytest.approx(max(sizes), rel=1e-9)


def test_reports_have_no_stress_above_what_the_metal_bears():
    """The law holds at the integration points; the stress at corners may be above it."""
    R, H = 235.0, 1000.0
    steel = Material.metal(young=2.1e5, poisson=0.3, yield_stress=R, plastic_modulus=H)
    bent = Problem(
        block.structured_mesh(6, 3, size=(2.0, 1.0)),
        steel,
        clamped="left",
        traction={"right": (0.0, 60.0)},
    )
    result = semismooth_newton(bent).raise_for_status()
    fields = result.fields
    stress = largest_at_points(fields, "von_mises")
    most = R + H * largest_at_points(fields, "accumulated_plastic_strain")
    assert R < stress <= most * (1 + 1e-9)
    assert largest(fields, "von_mises") > 1.05 * most
    rows = {row["quantity"]: row["value"] for row in describe_result(result)}
    assert rows["largest von Mises stress (integration points)"] == number(stress)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (210000.0, "210000"),
        (12345.6, "12346"),
        (1234.56, "1234.6"),
        (0.0287, "0.0287"),
        (-3.5, "−3.5"),
        (0.0, "0"),
        (4.2e-13, "4.2·10⁻¹³"),
        (4.25e20, "4.25·10²⁰"),
    ],
)
def test_numbers_as_engineers_write_them(value, text):
    assert number(value) == text


def test_tables_have_a_head_for_each_column():
    rows = [{"what": "force", "size": 2.0}, {"what": "<p>", "size": "?", "unit": "N"}]
    table = html_table(rows)
    head, body = table.split("</thead>")
    assert '<th class="text">what</th><th>size</th><th class="text">unit</th>' in head
    assert '<td class="text">force</td><td>2</td><td class="text"></td>' in body
    assert '<td class="text">&lt;p&gt;</td><td>?</td><td class="text">N</td>' in body


def test_three_panels_of_a_long_body_fit_on_a_page():
    """3.6 inches each, and the scale of colours."""
    mesh = block.structured_mesh(4, 1, size=(8.0, 1.0))
    problem = Problem(mesh, METAL, "left", traction={"right": (0.0, 0.1)}, order=1)
    result = semismooth_newton(problem)
    figure = plot_field(dict.fromkeys("abc", result), "von_mises")
    width, height = figure.get_size_inches()
    assert width <= 3 * 3.6 + 1.0
    assert 0.5 < height < 4.0


def test_quantities_that_are_never_negative_are_drawn_from_zero():
    """Those of earlier steps are polynomials through the points, and undershoot at corners."""
    mesh = block.structured_mesh(6, 3, size=(2.0, 1.0))
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=1.0, tangent_modulus=100.0
    )
    bent = Problem(mesh, metal, "left", traction={"right": (0.0, 0.25)})
    fields = evolve(bent, load_cycle(bent, [1.0, 0.0], steps=2)).steps[-1].fields
    assert corners_of(fields, fields.accumulated_plastic_strain).values.min() < 0
    for name in NEVER_NEGATIVE:
        _, (sampled,), colours = on_one_scale([fields], name, PLAIN, (None, None))
        assert sampled.values.min() >= 0
        assert colours.norm.vmin == 0
        assert colours.norm.extend in ("neither", "max")


def test_step_lengths_are_drawn_over_powers_of_two():
    """Damped steps are halves: each has its line of the grid; residuals are in decades."""
    figure = plot_history(lshape_primal().history)
    left, right = figure.axes[:2]
    assert left.yaxis.get_transform().base == 10
    assert right.yaxis.get_transform().base == 2
    (line,) = right.lines[:1]
    steps, lengths = line.get_data()
    history = lshape_primal().history
    np.testing.assert_array_equal(steps, np.arange(1, len(history.records)))
    np.testing.assert_array_equal(lengths, history.step_lengths)


@pytest.mark.parametrize("halvings", [0, 3, 5, 6, 7, 20])
def test_step_lengths_on_an_axis_have_few_digits(halvings):
    lengths = (1.0, 0.5**halvings, 1.0)
    records = [
        IterationRecord(iteration=k, residual_norm=1.0, step_length=t, halvings=0)
        for k, t in enumerate(lengths)
    ]
    figure = plot_history(History(records))
    axis = figure.axes[1].yaxis
    low, high = axis.get_view_interval()
    places = [place for place in axis.get_majorticklocs() if low <= place <= high]
    words = axis.get_major_formatter().format_ticks(places)
    assert len(words) > 1
    assert all(len(word) <= 8 or word.startswith("$") for word in words)


def test_a_field_that_is_positive_everywhere_is_drawn_from_zero():
    """A stretched block of one stress: the scale ends there and begins at zero."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=1.0, plastic_modulus=100.0
    )
    fields = semismooth_newton(
        Problem(
            mesh,
            metal,
            clamped=None,
            prescribed={"left": (0.0, None), "clamped": (None, 0.0)},
            pressure={"right": x - 3.0},
        )
    ).fields
    given = [fields], "accumulated_plastic_strain", PLAIN
    _, (sampled,), colours = on_one_scale(*given, (None, None))
    assert sampled.values.min() > 0.5 * sampled.values.max()
    assert colours.norm.vmin == 0.0
    *_, chosen = on_one_scale(*given, (1e-3, None))
    assert chosen.norm.vmin == 1e-3


def test_bodies_of_revolution_have_the_axes_r_and_z():
    """Of pictures, views, components and forces; x, y and z of all others."""
    mesh = block.structured_mesh(2, 2, simplices=True)
    metal = Material.metal(
        young=1e3, poisson=0.3, yield_stress=1.0, plastic_modulus=100.0
    )
    for kinematics, first, second, third in (
        ("axisymmetric", "r", "z", "θ"),
        ("plane strain", "x", "y", "z"),
    ):
        problem = Problem(mesh, metal, pressure={"right": -0.5}, kinematics=kinematics)
        history = evolve(problem, load_cycle(problem, [1.0], steps=1))
        result = history.steps[-1].solution
        for figure in (plot_field(result, units=UnitNames("mm")), plot_mesh(problem)):
            labels = figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
            assert [label[0] for label in labels] == [first, second]
        assert scene_axes(result) == [first, second, ""]
        assert f"_{{{third}{third}}}" in drawable(result, "stress_zz").label
        assert f"u_{{{second}}}" in drawable(result, "displacement_y").label
        forces = [line["quantity"][-1] for line in reaction_answer(result, PLAIN)]
        assert forces == [first, second]
        curve = plot_curve(history, "time", "reaction_y:clamped").axes[0]
        assert curve.get_ylabel().endswith(f"component {second}")


def scene_axes(result):
    """Names of the axes of a view."""
    what, _, colours = on_one_scale([result], "von_mises", PLAIN, (None, None))
    lines = lines_of([result])
    scene = scene_of(result, what[0], None, colours, Drawing(1.0), lines)
    return scene["gui_settings"]["axes_labels"]
