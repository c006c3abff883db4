"""Reports: one file that holds everything, reads as a table and opens in a browser."""

from html.parser import HTMLParser

import numpy as np
import pytest
from browser import Browser, chromium
from ngsolve import CF, x
from solved import lshape_dual, lshape_primal

from ngepc import Coulomb, Problem
from ngepc.geometries import block
from ngepc.pictures import plot_field
from ngepc.pictures.report import describe_problem, html_table, write_report
from ngepc.pictures.views import show, viewer_installed

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
        ["1e−07", "", "12345678", "", "−0.1235"],
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
    assert ["contact", "contact"] in read.rows
    assert ["status", "converged"] in read.rows
    assert ["gap", "0.1"] in read.rows
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
    said = {row["what"]: row["value"] for row in describe_problem(problem)}
    assert said["body"] == "9 nodes, 4 elements, order 2, plane strain"
    assert said["gap"] == "contact: 0.1, right: varies"
    assert said["prescribed"] == "clamped: (0, None), left: (0, 0)"
    assert (said["body force"], said["pressure"]) == ("(0, -1)", "contact: 1")
    assert said["contact"] == "contact|right"
    assert "clamped" not in said
    assert "0.3" in said["friction"]


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
