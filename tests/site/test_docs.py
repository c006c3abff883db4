"""The documentation: its snippets run, its links lead somewhere, every public name is in it."""

import re
import runpy
import subprocess
import sys
import zlib
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from browser import Browser, chromium

import ngepc
from ngepc import pictures as plotting
from ngepc.pictures.views import viewer_installed

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
COPIED = ("notebooks", "results")
"""Folders that the build copies beside the pages."""
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted(
        p for p in DOCS.rglob("*.md") if p.relative_to(DOCS).parts[0] not in COPIED
    ),
]
SNIPPET = re.compile(
    r"(<!-- not run: [^>]+ -->\n)?^```python\n(.*?)^```", re.DOTALL | re.MULTILINE
)
NEEDS_MPI = DOCS / "howto" / "distributed.md"
"""The page whose script tests/local/test_processes.py runs."""
RUN_ELSEWHERE = (NEEDS_MPI, DOCS / "first_steps.md")
WITH_SNIPPETS = [
    p
    for p in PAGES
    if p not in RUN_ELSEWHERE and SNIPPET.search(p.read_text(encoding="utf-8"))
]
ON_THEIR_OWN = ("README.md", "CONTRIBUTING.md")
"""Pages whose snippets need nothing; the others begin where the first steps end."""
COARSER = {
    "docs/first_steps.md": {"maxh=0.25": "maxh=5.0", "maxh=1.0": "maxh=12.0"},
    "docs/cycles.md": {"steps=50": "steps=5"},
    "docs/error_bound.md": {
        "relative_error=0.05": "relative_error=0.6",
        " error=0.1)": " error=0.8)",
    },
    "docs/gallery.md": {"paper_mesh(833)": "paper_mesh(113)"},
    "docs/goal_bound.md": {"percent=5": "percent=20", "at_most=4200": "at_most=6000"},
    "docs/hardening.md": {
        "paper_mesh(113)": "paper_mesh(65)",
        "steps=100": "steps=5",
        "steps=400": "steps=5",
    },
    "docs/howto/geometry.md": {
        "mesh = Mesh(OCCGeometry(shape).GenerateMesh(maxh=0.2": (
            "mesh = Mesh(OCCGeometry(shape).GenerateMesh(maxh=0.4"
        )
    },
    "docs/howto/pictures.md": {"dpi=200": "dpi=40"},
    "docs/howto/moving_obstacles.md": {
        "mesh(8, 8)": "mesh(4, 4)",
        "[0.5, 1.0, 1.25, 1.5, 1.75, 2.0]": "[0.5, 1.0, 2.0]",
    },
    "docs/limit_loads.md": {"relative_width=0.03": "relative_width=0.1"},
    "docs/rates.md": {"steps=60": "steps=6"},
    "docs/sensitivities.md": {
        "paper_mesh(225)": "paper_mesh(113)",
        "block.mesh(0.25,": "block.mesh(0.5,",
        '"yield_stress": 5.0, "hardening": 200.0': (
            '"yield_stress": 3.0, "hardening": 100.0'
        ),
    },
}
"""Page -> meshes, steps and accuracies of its snippets, and those with which they run here.

On the mesh of the first steps all other pages begin.
"""

BUILD = """import gc, sys
from functools import cache
sys.modules["rfc3987_syntax"] = None
import sphinx.cmd.build as sphinx
from sphinx.search.en import SearchEnglish
SearchEnglish.stem = cache(SearchEnglish.stem)
gc.disable()
raise SystemExit(sphinx.main())
"""
"""``python -m sphinx`` without the search for garbage among the nodes of all pages.

Nor with the grammar of international addresses, which takes seconds to read and checks nothing.
Words have one stem on all pages.
"""


def name(path):
    return path.relative_to(ROOT).as_posix()


def snippets(path):
    found = SNIPPET.findall(path.read_text(encoding="utf-8"))
    return [code for not_run, code in found if not not_run]


def coarser(path, code):
    """Code of a page as it runs here."""
    for fine, coarse in COARSER.get(name(path), {}).items():
        code = code.replace(fine, coarse)
    return code


@pytest.mark.parametrize("page", COARSER)
def test_what_is_made_coarser_is_there(page):
    text = "".join(snippets(ROOT / page))
    assert [text.count(fine) for fine in COARSER[page]] == [1] * len(COARSER[page])


def run_in(folder, code):
    """The names that a file with this code leaves behind, run in a folder."""
    (folder / "block.py").write_text(code)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return runpy.run_path("block.py")


FIRST_STEPS, *NO_MORE = snippets(DOCS / "first_steps.md")


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    """The folder in which the first steps are taken."""
    return tmp_path_factory.mktemp("empty")


@pytest.fixture(scope="module")
def first_steps(empty):
    """What the file of the first steps leaves behind on a coarser mesh: its names."""
    if not viewer_installed():
        pytest.skip("the first steps draw with the extra 'html'")
    return run_in(empty, coarser(DOCS / "first_steps.md", FIRST_STEPS))


def test_first_steps_lead_to_a_picture_and_a_page(first_steps, empty):
    assert NO_MORE == []
    assert first_steps["result"].contact_force > 0
    assert (empty / "block.png").stat().st_size > 10_000
    assert (empty / "block.html").stat().st_size > 100_000


@pytest.mark.parametrize("path", WITH_SNIPPETS, ids=name)
def test_snippets_run_one_after_the_other(
    path, first_steps, tmp_path, monkeypatch, quickly_drawn, capsys
):
    monkeypatch.chdir(tmp_path)
    names = {} if name(path) in ON_THEIR_OWN else dict(first_steps)
    for number, code in enumerate(snippets(path), 1):
        place = f"{name(path)}, snippet {number}"
        exec(compile(coarser(path, code), place, "exec"), names)


def test_what_is_not_run_is_rare():
    every = [
        found for path in PAGES for found in SNIPPET.findall(path.read_text("utf-8"))
    ]
    assert len(every) > 15
    assert sum(bool(not_run) for not_run, _ in every) <= 2  # MPI; JAX and PyTorch


FENCED = re.compile(r"^```[^\n`]*\n(.*?)^```", re.DOTALL | re.MULTILINE)


def test_code_fits_the_page():
    """Pages of the site are 88 characters of code wide where the window is narrow."""
    lines = [
        (name(path), line)
        for path in PAGES
        for block in FENCED.findall(path.read_text(encoding="utf-8"))
        for line in block.split("\n")
    ]
    assert len(lines) > 1000
    assert [(page, line) for page, line in lines if len(line) > 88] == []


TARGET = re.compile(r"\]\(([^)#\s]+?)(?:#[^)]*)?\)")


def test_links_of_the_sources_lead_somewhere():
    """GitHub shows the sources: there a link to a page has to be one to its file."""
    links = [
        (path, target)
        for path in PAGES
        for target in TARGET.findall(path.read_text(encoding="utf-8"))
        if not target.startswith(("http:", "https:", "ngepc."))
    ]
    assert len(links) > 100
    places = [(path, to, (path.parent / to).resolve()) for path, to in links]
    copies = {DOCS / folder for folder in COPIED}
    broken = [
        (path, to)
        for path, to, place in places
        if not place.exists() or copies & set(place.parents)
    ]
    assert [f"{name(path)} links to {target}" for path, target in broken] == []


def test_links_have_words():
    """GitHub shows nothing where a link has no text, however well the site fills it in."""
    assert [name(p) for p in PAGES if "[](" in p.read_text(encoding="utf-8")] == []


class Page(HTMLParser):
    """What a page of the site links to, loads, and offers as anchors."""

    def __init__(self, path):
        super().__init__()
        self.links, self.loads, self.anchors, self.shown = set(), set(), {""}, set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        values = {key: value or "" for key, value in attributes}
        self.anchors |= {values[key] for key in ("id", "name") if key in values}
        if tag == "a" and "href" in values:
            self.links.add(values["href"])
        elif tag == "link" and values.get("rel") in ("stylesheet", "preload", "icon"):
            self.loads.add(values["href"])
        elif "src" in values:
            self.loads.add(values["src"])


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The documentation built without warnings, notebooks not executed.

    Pages show the first level of the contents only, which saves two fifths of the time.
    """
    for needed in ("myst_nb", "sphinx_book_theme"):
        pytest.importorskip(
            needed, reason="needs the extra docs, which make test installs"
        )
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-c", BUILD, "-W", "--keep-going", "-q", "-b", "html"]
    command += ["-D", "html_theme_options.collapse_navbar=1"]
    command += ["-D", "html_theme_options.max_navbar_depth=1"]
    places = ["-d", str(tmp_path_factory.mktemp("doctrees")), str(DOCS), str(folder)]
    run = subprocess.run(
        [*command, *places], capture_output=True, text=True, timeout=300
    )
    assert run.returncode == 0, run.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    """The pages of the site, without the templates that the theme leaves in its folder."""
    paths = (path.relative_to(site) for path in sorted(site.rglob("*.html")))
    return {path: Page(site / path) for path in paths if path.parts[0] != "_static"}


def test_site_has_every_public_name(site):
    inventory = (site / "objects.inv").read_bytes().split(b"\n", 4)[4]
    documented = {
        line.split()[0] for line in zlib.decompress(inventory).decode().splitlines()
    }
    public = {f"ngepc.{name}" for name in ngepc.__all__ if not name.startswith("_")}
    drawing = {name for name, value in vars(plotting).items() if callable(value)}
    assert len(drawing) >= 10
    assert public | {f"ngepc.pictures.{name}" for name in drawing} <= documented


def test_the_overview_of_the_reference_has_every_public_name():
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"`(\w+)`", text))
    public = {name for name in ngepc.__all__ if not name.startswith("_")}
    assert public <= shown


def test_links_of_the_site_lead_somewhere(site, pages):
    broken = []
    for path, page in pages.items():
        for link in page.links | page.loads:
            parts = urlsplit(link)
            if parts.scheme in ("http", "https", "mailto", "data"):
                continue
            target = path if not parts.path else path.parent / unquote(parts.path)
            target = (site / target).resolve()
            other = pages.get(target.relative_to(site.resolve()))
            if not target.exists() or (
                other and unquote(parts.fragment) not in other.anchors
            ):
                broken.append(f"{path}: {link}")
    assert not broken


NO_TEXT = re.compile(
    r"<(script|style|pre|iframe|code)\b.*?</\1>|<(span|div) class=\"math[^>]*>.*?</\2>"
    r"|\\\[\\begin.*?\\\]|<[^>]*>",
    re.DOTALL,
)
"""Scripts, code, formulas that are drawn, and tags."""


def test_no_formula_or_markup_is_left_as_source(site, pages):
    left = []
    for path in pages:
        if path.parts[0] in ("results", "api") or path.stem == "techniques":
            continue  # numbers of programs and docstrings, which are plain text
        text = NO_TEXT.sub(" ", (site / path).read_text(encoding="utf-8"))
        left += [
            f"{path}: {line.strip()}"
            for line in text.split("\n")
            if re.search(r"\\[a-zA-Z]|\$|\*\*|\]\(|\w\^[\w{(*]", line)
        ]
    assert left == []


def test_links_to_other_sites_are_well_formed(pages):
    outside = {link for page in pages.values() for link in page.links if ":" in link}
    for link in outside:
        parts = urlsplit(link)
        assert parts.scheme == "https", link
        assert re.fullmatch(r"([\w-]+\.)+[a-z]{2,}", parts.netloc), link
        assert not re.search(r"\s", link), link


def test_every_page_is_reached_from_the_first_one(pages):
    seen, left = set(), {Path("index.html")}
    while left:
        path = left.pop()
        seen.add(path)
        inside = (urlsplit(link) for link in pages[path].links if ":" not in link)
        found = {
            Path(*_normal(path.parent / unquote(p.path)).parts)
            for p in inside
            if p.path
        }
        left |= (found & set(pages)) - seen
    made_by_sphinx = {
        Path("genindex.html"),
        Path("py-modindex.html"),
        Path("search.html"),
    }
    assert set(pages) - seen <= made_by_sphinx


def _normal(path):
    parts = []
    for part in path.parts:
        parts = parts[:-1] if part == ".." else [*parts, part]
    return Path(*parts)


def test_site_loads_nothing_from_the_network(site, pages):
    assert not [load for page in pages.values() for load in page.loads if "//" in load]
    sheets = [p.read_text(encoding="utf-8") for p in site.rglob("*.css")]
    outside = re.compile(r"(@import|url\()\s*['\"]?(https?:)?//")
    assert not [sheet for sheet in sheets if outside.search(sheet)]


def test_numbered_formulas_have_one_line(site):
    """Sphinx puts formulas with line breaks into split, where MathJax allows no number."""
    for path in site.rglob("*.html"):
        formulas = re.findall(
            r'class="math[^>]*>(.*?)</div>', path.read_text("utf-8"), re.DOTALL
        )
        assert not [f for f in formulas if "begin{split}" in f and "\\tag" in f], (
            path.name
        )


@pytest.mark.skipif(chromium() is None, reason="needs Chromium")
@pytest.mark.parametrize(
    "page", ["method/algorithm", "method/newton", "notebooks/01_first_solve"]
)
def test_site_works_in_a_browser_without_network(site, page):
    wrong = "mjx-merror, [data-mml-node=merror], [data-mjx-error]"
    with Browser() as browser:
        seen = browser.open(site / f"{page}.html")
        browser.wait_for("document.querySelectorAll('mjx-container').length > 5")
        browser.evaluate("MathJax.startup.promise.then(() => 0)")
        assert browser.evaluate(f"document.querySelectorAll('{wrong}').length") == 0
        assert (seen.requests, seen.errors) == ([], [])


@pytest.mark.skipif(chromium() is None, reason="needs Chromium")
@pytest.mark.parametrize(
    "page", ["believing", "error_bound", "friction", "goal_bound", "hardening"]
)
def test_formulas_fit_the_text(site, page):
    """Pages with long formulas: none is cut at the right end of its column."""
    wide = (
        "[...document.querySelectorAll('article div.math')].filter(e => {"
        " const formula = e.querySelector('mjx-math');"
        " return formula && formula.getBoundingClientRect().right"
        " > e.getBoundingClientRect().right + 2; }).map(e => e.textContent.slice(0, 60))"
    )
    with Browser(1440, 1000) as browser:
        browser.open(site / f"{page}.html")
        browser.wait_for("document.querySelectorAll('mjx-container').length > 5")
        browser.evaluate("MathJax.startup.promise.then(() => 0)")
        assert browser.evaluate(wide) == []


@pytest.mark.skipif(chromium() is None, reason="needs Chromium")
@pytest.mark.parametrize(
    "page",
    ["results/duality", "results/intervals", "results/mutants", "results/table3"],
)
def test_tables_use_the_width_of_a_page_without_contents(site, page):
    cut = (
        "[...document.querySelectorAll('article table')]"
        ".filter(t => t.scrollWidth > t.parentElement.clientWidth + 2).length"
    )
    with Browser(1200, 900) as browser:
        browser.open(site / f"{page}.html")
        assert browser.evaluate(cut) == 0


@pytest.mark.skipif(chromium() is None, reason="needs Chromium")
def test_search_shows_snippets_from_disk(site):
    with Browser() as browser:
        seen = browser.open(site / "search.html", "?q=certificate")
        browser.wait_for(
            "document.querySelectorAll('#search-results p.context').length > 3", 30
        )
        text = browser.evaluate(
            "document.querySelector('#search-results p.context').textContent"
        )
        assert "certificate" in text.lower()
        assert (seen.requests, seen.errors) == ([], [])


@pytest.mark.skipif(chromium() is None, reason="needs Chromium")
@pytest.mark.parametrize("page", ["results/table1", "api/problems"])
def test_pages_fit_a_telephone(site, page):
    with Browser(390, 800) as browser:
        browser.open(site / f"{page}.html")
        assert browser.evaluate("document.documentElement.scrollWidth") <= 390
        cut = (
            "[...document.querySelectorAll('article table, article pre')].filter(e => {"
            " for (let p = e; p && p.tagName !== 'ARTICLE'; p = p.parentElement)"
            " if (['auto', 'scroll'].includes(getComputedStyle(p).overflowX)) return false;"
            " return e.getBoundingClientRect().right > 390; }).length"
        )
        assert browser.evaluate(cut) == 0


def test_site_is_small(site):
    assert sum(p.stat().st_size for p in site.rglob("*") if p.is_file()) < 18e6
