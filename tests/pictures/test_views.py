"""Interactive pages in a real browser: drawn, offline, without errors; the slider moves them."""

import base64
import gzip
import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from browser import Browser, chromium
from matplotlib import colormaps
from netgen.occ import Compound, MoveTo, OCCGeometry, Y
from ngsolve import Mesh
from solved import block_primal, lshape_dual, lshape_primal

from ngepc import (
    Contact,
    Material,
    Problem,
    evolve,
    load_cycle,
    primal_newton,
    semismooth_newton,
    wrench_problem,
)
from ngepc.geometries import wrench
from ngepc.pictures import views
from ngepc.pictures.sampling import corners_of
from ngepc.pictures.views import EXTRA, NOISE, View, lines_of, pressure_peak, show

needs_browser = pytest.mark.skipif(
    chromium() is None,
    reason="no Chromium or Chrome is installed (Debian: apt install chromium)",
)
needs_viewer = pytest.mark.skipif(
    not views.viewer_installed(), reason=f"no offline viewer: {EXTRA}"
)
MOVE = (
    "(v => { const s = document.getElementById('slider'); s.value = v;"
    " s.dispatchEvent(new Event('input')); })"
)


@pytest.fixture(scope="module")
def browser():
    with Browser() as tab:
        yield tab


def opened(browser, path, fragment=""):
    """Pixels of a page that made no requests and reported no errors."""
    seen = browser.open(path, fragment)
    browser.wait_for("document.body.dataset.frame !== undefined")
    browser.settle()
    assert seen.requests == []
    assert seen.errors == []
    return browser.pixels()


def coloured(pixels):
    """Share of pixels that are neither white nor grey."""
    return (np.ptp(pixels, axis=2) > 0.02).mean()


def share_of(pixels, colour, tolerance=0.02):
    return (np.abs(pixels - np.array(colour[:3])).max(axis=2) < tolerance).mean()


@needs_browser
def test_the_browser_notices_requests_and_errors(browser, tmp_path):
    bad = tmp_path / "bad.html"
    bad.write_text('<img src="http://127.0.0.1:9/x.png"><script>nowhere()</script>')
    seen = browser.open(bad)
    assert seen.requests == ["http://127.0.0.1:9/x.png"]
    assert any("nowhere" in error for error in seen.errors)


@needs_browser
@needs_viewer
def test_exported_page_shows_the_body_in_the_colours_of_the_scale(browser, tmp_path):
    path = show(lshape_primal(), title="L-shape").save(tmp_path / "deep" / "view.html")
    pixels = opened(browser, path)
    below_header = pixels[70:]
    assert 0.05 < coloured(below_header) < 0.6
    assert share_of(below_header, colormaps["YlGnBu"](1.0), 0.05) > 0.003
    assert share_of(below_header, (1.0, 1.0, 1.0)) > 0.4
    assert browser.evaluate("document.querySelector('h1').textContent") == "L-shape"


@needs_browser
@needs_viewer
def test_deformation_can_be_left_out(browser, tmp_path):
    moved = opened(browser, show(lshape_primal()).save(tmp_path / "a.html"))
    still = opened(
        browser, show(lshape_primal(), deformation_scale=0.0).save(tmp_path / "b.html")
    )
    assert np.abs(moved - still).mean() > 0.01


@needs_browser
@needs_viewer
def test_slider_moves_through_the_results_and_back(browser, tmp_path):
    results = {
        "γ = 10": lshape_dual(417, 10.0),
        "γ = 1000": lshape_dual(),
        "exact": lshape_primal(),
    }
    path = show(results, name="γ").save(tmp_path / "slider.html")
    pictures, labels = [opened(browser, path)], [browser.evaluate("label.textContent")]
    for position in (1, 2, 0):
        browser.evaluate(f"{MOVE}({position})")
        browser.settle()
        pictures.append(browser.pixels())
        labels.append(browser.evaluate("label.textContent"))
    assert labels == ["γ = 10", "γ = 1000", "exact", "γ = 10"]
    for a, b in ((0, 1), (1, 2), (0, 2)):
        assert np.abs(pictures[a] - pictures[b])[70:430].mean() > 0.005
    assert np.abs(pictures[0] - pictures[3])[70:430].mean() < 1e-3
    assert browser.seen.errors == []


@needs_browser
@needs_viewer
def test_fragment_of_the_address_chooses_the_frame(browser, tmp_path):
    path = show({"a": lshape_dual(), "b": lshape_primal()}, name="kind").save(
        tmp_path / "slider.html"
    )
    opened(browser, path, "#1")
    assert browser.evaluate("label.textContent") == "b"
    opened(browser, path, "#77")
    assert browser.evaluate("label.textContent") == "b"


@needs_browser
@needs_viewer
def test_comparison_draws_every_panel(browser, tmp_path):
    view = show({"dual": lshape_dual(), "exact": lshape_primal()})
    pixels = opened(browser, view.save(tmp_path / "compare.html"))
    for half in (pixels[90:, :345], pixels[90:, 355:]):
        assert 0.05 < coloured(half) < 0.6


@needs_browser
@needs_viewer
@pytest.mark.parametrize("field", ["stress_zz", "contact_pressure"])
def test_blocks_are_drawn_in_three_dimensions(browser, tmp_path, field):
    pixels = opened(browser, show(block_primal(), field).save(tmp_path / "block.html"))
    assert 0.05 < (pixels[70:] < 0.97).any(axis=2).mean() < 0.7


@needs_viewer
def test_contact_pressure_of_blocks_reaches_their_surface():
    packed = re.search(
        r'id="page">([^<]*)<', show(block_primal(), "contact_pressure").html
    )[1]
    ((scene,),) = json.loads(gzip.decompress(base64.b64decode(packed)))["panels"]
    points = b"".join(map(base64.b64decode, scene["Bezier_trig_points"]))
    values = np.frombuffer(points, np.float32).reshape(-1, 4)[:, 3]
    assert values.max() == pytest.approx(scene["funcmax"], rel=1e-6)
    assert 0 < (values > 0).mean() < 0.5


@needs_viewer
def test_views_leave_no_widget_with_a_second_copy_of_the_data(monkeypatch):
    monkeypatch.setattr("netgen.webgui.WebGuiWidget", None)
    assert "data" in show(lshape_primal()).html


@needs_browser
@needs_viewer
def test_frame_of_a_notebook_shows_the_same_page(browser, tmp_path):
    notebook = tmp_path / "cell.html"
    view = show(lshape_primal())
    notebook.write_text(f'<meta charset="utf-8">{view._repr_html_()}', encoding="utf-8")
    seen = browser.open(notebook)
    browser.wait_for("frames[0].document.body.dataset.frame === '0'")
    browser.settle()
    assert 0.03 < coloured(browser.pixels()[90:]) < 0.6
    assert (seen.requests, seen.errors) == ([], [])


@needs_browser
@needs_viewer
def test_play_button_moves_the_slider_and_stops(browser, tmp_path):
    results = {"a": lshape_dual(417, 10.0), "b": lshape_dual(), "c": lshape_primal()}
    opened(browser, show(results, name="kind").save(tmp_path / "slider.html"))
    browser.evaluate("document.getElementById('play').click()")
    browser.wait_for("document.body.dataset.frame === '2'")
    browser.wait_for("document.body.dataset.frame === '0'")
    browser.evaluate("document.getElementById('play').click()")
    assert browser.evaluate("document.body.dataset.playing") == "false"


def test_pressures_of_rounding_size_are_not_drawn_high():
    touching = lshape_primal()
    greatest = touching.contact_pressure.vec.FV().NumPy().max()
    assert pressure_peak([touching]) == pytest.approx(greatest)
    far_away = primal_newton(replace(touching.problem, gap=10.0))
    bound = touching.problem.material.yield_stress
    assert pressure_peak([far_away]) == pytest.approx(NOISE * bound)
    assert np.abs(far_away.contact_pressure.vec.FV().NumPy()).max() < 1e-6 * bound


def test_no_pressure_is_drawn_higher_than_the_peak():
    regularised = semismooth_newton(wrench_problem(wrench.paper_mesh(873)), gamma=70.0)
    problem = regularised.problem
    contact = "|".join(problem.contact_names)
    values = corners_of(
        regularised.fields, regularised.contact_pressure, contact
    ).values
    assert values.min() < -10 * values.max()
    assert np.abs(values).max() <= pressure_peak([regularised])


def two_squares():
    """A square on another one, pressed by 0.5."""
    lower = MoveTo(0, 0).Rectangle(1, 1).Face()
    upper = MoveTo(0, 1).Rectangle(1, 1).Face()
    lower.edges.Max(Y).name, lower.edges.Min(Y).name = "under", "floor"
    upper.edges.Min(Y).name, upper.edges.Max(Y).name = "over", "top"
    bodies = OCCGeometry(Compound([lower, upper]), dim=2)
    steel = Material.metal(
        young=2.5e3, poisson=0.25, yield_stress=5.0, plastic_modulus=150.0
    )
    problem = Problem(
        Mesh(bodies.GenerateMesh(maxh=0.5)),
        steel,
        "floor",
        pressure={"top": 0.5},
        contact=Contact("over", "under"),
        prescribed={"top": (0.0, None)},
    )
    return semismooth_newton(problem)


@needs_viewer
def test_lines_that_are_not_drawn_are_not_in_the_legend():
    pressed = lshape_primal()
    lines = {
        "obstacle and pressure": (pressed, ["obstacle", "contact pressure"]),
        "fields": (pressed.fields, ["obstacle"]),
        "two bodies": (two_squares(), ["contact pressure"]),
        "solid": (block_primal(), []),
    }
    for source, names in lines.values():
        page = show(source).html
        legend = page[page.index('<p class="lines">') : page.index("</p>")]
        assert re.findall("</b> ([a-z]+(?: [a-z]+)?)", legend) == names


def test_steps_of_a_history_are_drawn_with_their_contact_pressure():
    problem = lshape_primal().problem
    history = evolve(problem, load_cycle(problem, [1], steps=2))
    lines = lines_of(history.steps)
    assert lines.names == ("obstacle", "contact pressure")
    assert lines.peak == pytest.approx(max(history.column("max_contact_pressure")))


@needs_viewer
def test_pages_name_no_address_of_the_network():
    text = show(lshape_primal()).html
    assert re.findall(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//""", text) == []
    addresses = set(re.findall(r"https?://[\w./-]+", text))
    assert addresses <= {"http://www.w3.org/1999/xhtml"}


@needs_viewer
def test_numpy_keeps_its_error_settings():
    code = (
        "import numpy as np; before = np.geterr();"
        "from ngepc import lshape_problem, semismooth_newton, show;"
        "from ngepc.geometries import lshape;"
        "show(semismooth_newton(lshape_problem(lshape.paper_mesh(21))));"
        "assert np.geterr() == before, np.geterr()"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_missing_viewer_says_what_to_install(monkeypatch):
    monkeypatch.setattr(views.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"pip install \"ngepc\[html\]\""):
        show(lshape_primal())


@needs_viewer
def test_text_of_pages_is_escaped(tmp_path):
    results = {"</script><b>": lshape_dual(), "2": lshape_primal()}
    view = show(results, title="<i>title</i>", name="a<b $x")
    assert "</script><b>" not in view.html
    assert "<i>title" not in view.html
    assert "a&lt;b $x" in view.html
    assert view.save(tmp_path / "x.html").read_text(encoding="utf-8") == view.html


def test_frames_hold_whole_pages():
    shown = View('<p class="x">&amp;</p>')._repr_html_()
    assert 'srcdoc="&lt;p class=&quot;x&quot;&gt;&amp;amp;&lt;/p&gt;"' in shown


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: show(lshape_primal(), "nothing"), "nothing"),
        (lambda: show({}), "at least one"),
        (
            lambda: show(lshape_primal(), deformation_scale=-1.0),
            "deformation_scale=-1.0",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@needs_browser
@needs_viewer
def test_frames_of_notebooks_are_no_taller_than_their_panels(tmp_path):
    """Two panels side by side are less high than wide; where there is room they are not cut."""
    pair = show({"one": lshape_primal(), "two": lshape_primal()})
    page = tmp_path / "page.html"
    page.write_text(f"<body>{pair._repr_html_()}")
    height = "document.querySelector('iframe').offsetHeight"
    inside = "document.querySelector('iframe').contentDocument"
    drawn = f"{inside}.body.dataset.frame !== undefined"
    panels = f"[...{inside}.querySelectorAll('.place')].map(p => p.clientHeight)"
    bottom = (
        f"Math.max(...[...{inside}.querySelectorAll('.place')]"
        ".map(p => p.getBoundingClientRect().bottom))"
    )
    for width, tall in ((600, 350), (1200, 480)):
        with Browser(width, 600) as tab:
            assert tab.open(page).errors == []
            tab.wait_for(drawn)
            assert tab.evaluate(height) == pytest.approx(tall, abs=20)
            assert tab.evaluate(height) - tab.evaluate(bottom) < 4
            assert min(tab.evaluate(panels)) > 200
