"""Sphinx extension: a site to be read from disk, search with snippets included, and no larger.

Browsers let a page from disk read no other page, so that Sphinx's search shows titles only.  Here
the texts of the pages come with the search page, as a script.  Of MathJax only what the pages load
is kept.
"""

import json
import shutil
from pathlib import Path

from sphinx.application import Sphinx

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
NEVER_LOADED = ("mathjax/sre", "mathjax/a11y", "mathjax/output/svg")


def with_texts(app: Sphinx, pagename: str, *_: object) -> None:
    """Load the texts in the search page."""
    if pagename == "search":
        app.add_js_file("pages.js")


def finish(app: Sphinx, exception: Exception | None) -> None:
    """Write the texts, and remove scripts that nothing loads."""
    static = Path(app.outdir) / "_static"
    if exception or not static.is_dir():
        return
    texts = {name: app.env.get_doctree(name).astext() for name in app.env.found_docs}
    texts = {name: " ".join(text.split()) for name, text in texts.items()}
    (static / "pages.js").write_text(f"const pages = {json.dumps(texts)};{FETCH}", "utf-8")
    for folder in NEVER_LOADED:
        shutil.rmtree(static / folder, ignore_errors=True)
    unused = {*static.glob("mathjax/*.js"), *static.rglob("*.map")}
    for script in unused - {static / "mathjax" / "tex-chtml.js"}:
        script.unlink()


def setup(app: Sphinx) -> dict:
    """Register."""
    app.connect("html-page-context", with_texts)
    app.connect("build-finished", finish)
    return {"parallel_read_safe": True}
