"""Sphinx extension: a site to be read from disk, search with snippets included, and no larger.

Browsers let a page from disk read no other page, so that Sphinx's search shows titles only.  Here
the texts of the pages come with the search page, as a script.  Of MathJax only what the pages load
is kept.
"""

import html
import json
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx

from ngepc.pictures.views import viewer_installed, viewer_script

FETCH = """
if (location.protocol === "file:") {
  window.fetch = (url) => {
    const text = pages[url.replace(/^\\.\\//, "").replace(/\\.html$/, "")] || "";
    const main = document.createElement("div");
    main.textContent = text;
    return Promise.resolve({ text: () => `<div role="main">${main.innerHTML}</div>` });
  };
}
"""
LOADED = ("tex-chtml.js", "input/tex/extensions", "output/chtml/fonts")
"""What pages load of MathJax: one file, and what it may ask for."""


def with_texts(app: Sphinx, pagename: str, *_: object) -> None:
    """Load the texts in the search page."""
    if pagename == "search":
        app.add_js_file("pages.js")


def text_of(page: nodes.document) -> str:
    """The words of a page, without HTML that notebooks made."""
    for raw in list(page.findall(nodes.raw)):
        raw.parent.remove(raw)
    return " ".join(page.astext().split())


def share_viewer(site: Path, static: Path) -> None:
    """Views bring the viewer's script with them; the pages of a site can share one."""
    if not viewer_installed():
        return
    (static / "webgui.js").write_text(viewer_script(), "utf-8")
    own = html.escape(f"<script>{viewer_script()}</script>")
    for page in site.glob("notebooks/**/*.html"):
        text = page.read_text("utf-8")
        if own in text:
            root = "../" * (len(page.relative_to(site).parts) - 1)
            shared = html.escape(f'<script src="{root}_static/webgui.js"></script>')
            page.write_text(text.replace(own, shared), "utf-8")


def finish(app: Sphinx, exception: Exception | None) -> None:
    """Write the texts, and remove what no page loads."""
    static = Path(app.outdir) / "_static"
    if exception or not static.is_dir():
        return
    texts = {name: text_of(app.env.get_doctree(name)) for name in app.env.found_docs}
    (static / "pages.js").write_text(
        f"const pages = {json.dumps(texts)};{FETCH}", "utf-8"
    )
    share_viewer(Path(app.outdir), static)
    mathjax = static / "mathjax"
    used = {
        p for part in LOADED for p in (mathjax / part, *(mathjax / part).rglob("*"))
    }
    spare = {
        *mathjax.rglob("*"),
        *static.rglob("*.map"),
        *(static / "locales").rglob("*"),
    }
    for path in spare - used:
        if path.is_file():
            path.unlink()


def setup(app: Sphinx) -> dict:
    """Register."""
    app.connect("html-page-context", with_texts)
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True}
