"""Sphinx: the documentation site, built without network by ``make docs``.

The notebooks and the tables of ``results/`` are copied beside the pages before the build.  With
NGEPC_DOCS_EXECUTE=force in the environment, as ``make docs`` has it, the notebooks are run.
"""

import os
import shutil
import sys
from dataclasses import is_dataclass
from pathlib import Path
from types import FunctionType
from typing import get_type_hints

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(ROOT), str(HERE)]

import ngepc  # noqa: E402


def copy_beside(name: str, patterns: tuple[str, ...]) -> None:
    """Copy files of a folder of the repository into a folder of the same name here."""
    target = HERE / name
    shutil.rmtree(target, ignore_errors=True)
    for pattern in patterns:
        for path in sorted((ROOT / name).glob(pattern)):
            copy = target / path.relative_to(ROOT / name)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)


copy_beside("notebooks", ("*.ipynb", "exercises/*.ipynb", "solutions/*.ipynb"))
copy_beside("results", ("*.md", "*/*.md", "*.png"))

project = "ngepc"
author = "the ngepc authors"
release = version = ngepc.__version__
html_title = "ngepc"
smartquotes = False

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "public_names",
    "from_disk",
]
exclude_patterns = ["_build", "gallery/*.py", "**.ipynb_checkpoints"]
suppress_warnings = ["mystnb.unknown_mime_type"]

myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = os.environ.get("NGEPC_DOCS_EXECUTE", "off")
nb_execution_timeout = 300
nb_execution_excludepatterns = ["notebooks/exercises/*"]  # nothing is filled in there
nb_ipywidgets_js = {}  # the views need no widgets, and those would come from the network
nb_mime_priority_overrides = [  # of the laboratory the view that comes with its widget
    ("html", "application/vnd.jupyter.widget-view+json", None)
]
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_attr_annotations = False  # the signature has the types
toc_object_entries = False
maximum_signature_line_length = 88

html_theme = "sphinx_book_theme"
html_context = {"default_mode": "auto"}
html_static_path = ["_static"]
html_css_files = ["ngepc.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "show_toc_level": 2,
    "home_page_in_toc": True,
    "use_download_button": False,
    "use_fullscreen_button": False,
    "navbar_persistent": [],
}


def setup(app: object) -> None:
    """Say of the extension for MathJax what it does not say: pages may be read side by side."""
    app.extensions["sphinx-mathjax-offline"].parallel_read_safe = True
    app.connect("autodoc-before-process-signature", without_checks)


def without_checks(app: object, function: object, bound: bool) -> None:
    """Signatures show the types of fields; their ranges stand in the text beside them."""
    function = getattr(function, "__func__", function)
    if isinstance(function, FunctionType):
        owner = function.__globals__.get(function.__qualname__.rpartition(".")[0])
        fields = get_type_hints(owner) if is_dataclass(owner) else {}
        hints = function.__annotations__ if fields else get_type_hints(function)
        function.__annotations__ = {
            name: fields.get(name, hints[name]) for name in hints
        }
