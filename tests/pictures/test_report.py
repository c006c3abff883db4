"""Reports: one file that holds everything, reads as a table and opens in a browser."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from browser import Browser, chromium
from drawing import draw_quickly
from ngsolve import CF, sin, x
from solved import lshape_dual, lshape_primal

from ngepc import (
    Coulomb,
    Material,
    Point,
    Problem,
    Roller,
    evolve,
    load_cycle,
    lshape_problem,
    semismooth_newton,
)
from ngepc.geometries import block, lshape
from ngepc.pictures import UnitNames, plot_field
from ngepc.pictures.answers import describe_result
from ngepc.pictures.quantities import force_unit, number, units_of, vector
from ngepc.pictures.report import html_table, mesh_picture, narrow, write_report
from ngepc.pictures.rows import flat_rows
from ngepc.pictures.views import show, viewer_installed
from ngepc.pictures.wording import describe_material, describe_problem

ROWS = [
    {"gamma": 1e3, "paper": 8, "here": 7, "status": "converged"},
    {"gamma": 1e-7, "here": 12345678, "energy": -0.123456},
]


class Reader(HTMLParser):
    """Rows of the tables, sources of images, and tags that stay open."""

    VOID = ("meta", "img", "input", "br")

    def __init__(self, text):
        super().__init__()
        self.rows, self.images, self.open = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")
        elif tag == "img":
            self.images.append(dict(attributes)["src"])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def test_tables_have_all_columns_in_order_of_appearance():
    read = Reader(html_table(ROWS))
    assert read.open == []
    assert read.rows == [
        ["gamma", "paper", "here", "status", "energy"],
        ["1000", "8", "7", "converged", ""],
        ["1·10⁻⁷", "", "12345678", "", "−0.1235"],
    ]


def test_pictures_and_text_are_inside_the_file(tmp_path):
    figure = plot_field(lshape_primal())
    path = write_report(
        tmp_path / "deep" / "report.html",
        "A < B",
        ("Problem", ["see `--help` & more", lshape_primal().problem]),
        ("Pictures", [figure, figure]),
        ("Table", [ROWS]),
        ("Result", [lshape_primal()]),
    )
    text = path.read_text(encoding="utf-8")
    read = Reader(text)
    assert read.open == []
    assert len(read.images) == 2
    assert all(image.startswith("data:image/png;base64,iVBOR") for image in read.images)
    assert "A &lt; B" in text
    assert "see <code>--help</code> &amp; more" in text
    assert ["contact of 'contact'", "rigid obstacle, gap 0.1"] in read.rows
    assert ["status", "converged"] in read.rows
    assert ["support 'clamped'", "clamped"] in read.rows
    assert "http" not in text.replace("data:image", "")


def test_a_problem_is_described_by_all_it_is_given():
    material = lshape_primal().problem.material
    gap, held = (
        {"contact": 0.1, "right": CF(1.0) * x},
        {"clamped": (0, None), "left": (0, 0)},
    )
    given = {"gap": gap, "prescribed": held, "friction": Coulomb(0.3), "order": 2}
    given |= {
        "body_force": (0, -1),
        "pressure": {"contact": 1},
        "contact": "contact|right",
    }
    problem = Problem(block.structured_mesh(2, 2), material, None, **given)
    said = {row["quantity"]: row["value"] for row in describe_problem(problem)}
    assert said["mesh"] == "9 nodes, 4 elements of order 2"
    assert said["kinematics"] == "plane strain"
    assert said["contact of 'contact'"] == "rigid obstacle, gap 0.1"
    assert said["contact of 'right'"] == "rigid obstacle, gap varies in space"
    assert said["support 'clamped'"] == "u_x = 0"
    assert said["support 'left'"] == "u_x = 0, u_y = 0"
    assert said["load in the body"] == "body force (0, −1)"
    assert said["load on 'contact'"] == "pressure 1"
    assert said["friction"] == "Coulomb's law, coefficient 0.3"


def test_a_thick_body_is_described_with_units():
    """Thickness, springs, forces at points, the limit of friction."""
    corner = Point((1, 1))
    thick = Problem(
        block.structured_mesh(2, 2),
        lshape_primal().problem.material,
        None,
        {corner: (0.1, 0)},
        "contact",
        0.0,
        body_force=(0, -1),
        springs={"clamped": (3, 4), "right": 5.0, corner: (1, 2)},
        prescribed={"left": Roller((3, 4), 0.5)},
        friction=Coulomb(0.3, limit=2.0),
        initial_strain=1e-3,
        thickness=2.5,
        duration=4.0,
    )
    rows = describe_problem(thick, UnitNames("mm", "MPa"))
    said = [(row["quantity"], row["value"]) for row in rows]
    assert ("thickness", "2.5 mm") in said
    assert ("length of the time step", "4") in said
    assert ("support 'left'", "displacement along (0.6, 0.8): 0.5 mm") in said
    assert ("support 'clamped'", "springs, (3, 4) MPa/mm") in said
    assert ("support 'right'", "springs, 5 MPa/mm along the normal") in said
    assert (f"support {corner!r}", "springs, (1, 2) N/mm") in said
    assert (f"load on {corner!r}", "force (0.1, 0) N") in said
    assert ("load in the body", "body force (0, −1) MPa/mm") in said
    assert ("initial strain", "0.001") in said
    assert ("friction", "Coulomb's law, coefficient 0.3, at most 2 MPa") in said
    thin = describe_problem(thick.changed(thickness=None), UnitNames("mm", "MPa"))
    said = [(row["quantity"], row["value"]) for row in thin]
    assert (f"support {corner!r}", "springs, (1, 2) MPa") in said
    assert (f"load on {corner!r}", "force (0.1, 0) N/mm") in said


def test_loads_are_described_by_their_components_where_these_are_constant():
    values = np.array([[0.0, -1.5], [1e-9, -1.5]])
    assert vector(values, " MPa") == "(0, −1.5) MPa"
    turned = np.array([[0.0, 2.0], [2.0, 0.0]])
    assert vector(turned, " MPa") == "of size 2 MPa"
    assert vector(turned * [1, 3]) == "of size between 2 and 6"
    assert vector(0 * turned) == "(0, 0)"


@pytest.mark.parametrize(
    "traction", [(1.6, 0.4), CF((1.6, 0.4)), (CF(1.6), 0.4), [1.6, CF(0.4)]]
)
def test_a_traction_is_described_without_the_pressure_beside_it(traction):
    material = lshape_primal().problem.material
    mesh = block.structured_mesh(2, 2)
    loads = {"traction": {"right": traction}, "pressure": {"right": 0.2}}
    rows = describe_problem(Problem(mesh, material, "left", **loads))
    said = [row["value"] for row in rows if row["quantity"] == "load on 'right'"]
    assert said == ["pressure 0.2", "traction (1.6, 0.4)"]


def test_a_material_is_described_as_it_was_given():
    metal = {"young": 210e3, "poisson": 0.3, "yield_stress": 240.0}
    steel = Material.metal(**metal, tangent_modulus=2100.0)
    said = {
        r["quantity"]: r["value"]
        for r in describe_material(steel, UnitNames("mm", "MPa"))
    }
    assert said["Young's modulus E"] == "210000 MPa"
    assert said["yield stress R of a tensile test"] == "240 MPa"
    assert said["Poisson's ratio"] == "0.3"
    assert not any("Lam" in what for what in said)
    lame = lshape_primal().problem.material
    said = {r["quantity"]: r["value"] for r in describe_material(lame)}
    assert said["Young's modulus E"] == "2500"
    assert said["Poisson's ratio"] == "0.25"
    assert said["yield bound of |dev σ|"] == "1.25"
    assert said["yield stress R of a tensile test"] == "1.5309"  # (3/2)^(1/2) 1.25
    said = {r["quantity"]: r["value"] for r in describe_material(lame, size=2)}
    assert said["yield stress R of a tensile test"] == "1.7678"  # 2^(1/2) 1.25
    assert "Young's modulus E" not in said


def test_numbers_are_written_as_engineers_write_them():
    wanted = {
        210e3: "210000",
        121153.8: "121154",
        0.3: "0.3",
        -26213.44: "−26213",
        544.7512: "544.75",
        0.00028696: "0.00028696",
        4.2e-13: "4.2·10⁻¹³",
        2.1e11: "2.1·10¹¹",
        0.0: "0",
    }
    assert {value: number(value) for value in wanted} == wanted
    assert number(1152.48, " MPa", digits=3) == "1152 MPa"


def test_forces_have_the_unit_of_the_model():
    mm = UnitNames("mm", "MPa")
    plane = lshape_primal().problem
    metal = plane.material
    solid = Problem(block.structured_mesh(1, 1, 1), metal)
    sheet = replace(plane, kinematics="plane stress", thickness=2.0, order=1)
    ring = replace(plane, kinematics="axisymmetric")
    units = [force_unit(mm, p) for p in (plane, solid, sheet, ring)]
    assert units == [" N/mm", " N", " N", " N"]
    assert force_unit(UnitNames("cm", "MPa"), solid) == " MPa·cm²"
    assert force_unit(UnitNames("mm"), solid) == ""
    energies = [units_of(mm, p)["energy"] for p in (plane, solid, sheet, ring)]
    assert energies == ["N", "N·mm", "N·mm", "N·mm"]
    cm = UnitNames("cm", "MPa")
    energies = [units_of(cm, p)["energy"] for p in (plane, solid)]
    assert energies == ["MPa·cm²", "MPa·cm³"]
    assert units_of(UnitNames("mm"), solid)["energy"] == ""


def test_the_mesh_of_a_ring_has_the_axes_r_and_z():
    ring = replace(lshape_primal().problem, kinematics="axisymmetric")
    axes = mesh_picture(ring, UnitNames("mm")).axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("r (mm)", "z (mm)")


def test_the_error_is_called_guaranteed_only_if_it_is():
    square = block.structured_mesh(4, 4, simplices=True)
    metal = lshape_primal().problem.material
    pressed = Problem(square, metal, "clamped", contact="contact", gap=-0.001)

    def said(problem):
        rows = describe_result(semismooth_newton(problem))
        return {row["quantity"]: row["value"] for row in rows}["error of the mesh"]

    assert said(pressed).endswith("of the energy, guaranteed")
    wavy = replace(pressed, body_force=CF((0.0, 0.01 * sin(x))))
    assert said(wavy).endswith("known from samples of the data")
    rough = replace(pressed, friction=Coulomb(0.2))
    assert said(rough).endswith("an estimate without guarantee")


def test_vectors_and_mappings_get_columns_of_their_own():
    rows = [{"time": 1.0, "reaction": [1.0, 2.0], "reactions": {"left": [3.0, 4.0]}}]
    assert flat_rows(rows) == [
        {
            "time": 1.0,
            "reaction_x": 1.0,
            "reaction_y": 2.0,
            "reaction_x:left": 3.0,
            "reaction_y:left": 4.0,
        }
    ]
    wide = [{str(k): k for k in range(20)}]
    tables = narrow(wide)
    assert all(len(row) <= 9 and "0" in row for table in tables for row in table)
    assert {k for table in tables for row in table for k in row} == set(wide[0])


@pytest.fixture(scope="module")
def solved():
    """Example (a)."""
    return semismooth_newton(lshape_problem(lshape.paper_mesh(113)))


@pytest.fixture(scope="module")
def page(solved, tmp_path_factory):
    """The report on a result, a history, and the numbers of its steps."""
    path = tmp_path_factory.mktemp("report") / "r.html"
    history = evolve(solved.problem, load_cycle(solved.problem, [1.0], 2))
    rows = ("All numbers", [history.as_rows()])
    units = UnitNames("mm", "MPa")
    with pytest.MonkeyPatch.context() as patch:
        draw_quickly(patch)
        return write_report(path, "L", solved, history, rows, units=units)


def test_a_result_and_a_history_are_reports_of_their_own(solved, page):
    result = solved
    text = page.read_text(encoding="utf-8")
    read = Reader(text)
    for heading in ("The problem", "The answer", "Pictures", "The steps", "Curves"):
        assert f"<h2>{heading}</h2>" in text
    answer = dict(row for row in read.rows if len(row) == 2)
    assert answer["contact force"] == f"{result.contact_force:.5g} N/mm"
    assert "percent of the energy" in answer["error of the mesh"]
    interval = answer["interval of the contact force"].split()
    assert float(interval[0]) < result.contact_force < float(interval[2])
    assert interval[3] == "N/mm"
    assert answer["contact of 'contact'"] == "rigid obstacle, gap 0.1 mm"
    assert result.message in text
    assert not re.search(
        r">\s*[\[{]", re.sub("<style>.*?</style>", "", text, flags=re.S)
    )


@pytest.mark.skipif(chromium() is None, reason="no Chromium or Chrome is installed")
def test_reports_print_on_a4_without_cut_tables(page):
    with Browser(673, 1000) as tab:  # the width of A4 within its margins, in CSS pixels
        tab.open(page)
        tab.call("Emulation.setEmulatedMedia", media="print")
        widths = tab.evaluate(
            "[...document.querySelectorAll('table')].map(t => t.scrollWidth)"
        )
        assert len(widths) > 5
        assert max(widths) <= 673
        assert tab.evaluate("document.documentElement.scrollWidth") <= 673
        pdf = tab.call("Page.printToPDF", preferCSSPageSize=True)["data"]
        kept = "[...document.querySelectorAll('.wide')].every("
        kept += "t => getComputedStyle(t).breakInside === 'avoid')"
        assert tab.evaluate(kept)
    assert base64.b64decode(pdf).startswith(b"%PDF")


def test_reports_are_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "report.html"
    write_report(path, "old")
    with pytest.raises(TypeError, match=r"3\.5"):
        write_report(path, "new", ("Section", [3.5]))
    assert "<h1>old</h1>" in path.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == [path]


def test_empty_tables_are_refused(tmp_path):
    with pytest.raises(TypeError, match="text, a list of dictionaries"):
        write_report(tmp_path / "page.html", "t", ("Table", [[]]))


@pytest.mark.skipif(chromium() is None, reason="no Chromium or Chrome is installed")
@pytest.mark.skipif(
    not viewer_installed(), reason="the offline viewer is not installed"
)
@pytest.mark.parametrize("width", [390, 900])
def test_report_opens_from_disk_with_its_view(tmp_path, width):
    view = show({"dual": lshape_dual(), "exact": lshape_primal()}, name="method")
    sections = ("Counts", [ROWS, view])
    path = write_report(
        tmp_path / "report.html", "L-shape", sections, footer="made by a test"
    )
    with Browser(width, 900) as browser:
        seen = browser.open(path)
        browser.wait_for("frames[0].document.body.dataset.frame === '0'")
        browser.settle()
        pixels = browser.pixels()
        assert (np.ptp(pixels, axis=2) > 0.1).mean() > 0.01
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        frame = "frames[0].document.getElementById"
        browser.evaluate(f"{frame}('slider').value = 1")
        browser.evaluate(f"{frame}('slider').dispatchEvent(new Event('input'))")
        browser.settle()
        assert browser.evaluate(f"{frame}('label').textContent") == "exact"
        assert np.abs(pixels - browser.pixels()).mean() > 0.001
        assert (seen.requests, seen.errors) == ([], [])
