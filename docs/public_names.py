"""Sphinx extension: the directive ``public-names``, and docstrings that are plain text.

``.. public-names:: ngepc`` documents the names of the package that it lists; without a list those
that no page of ``api/`` lists.  With another module as its argument: what is defined in it,
or offered by that package, without a leading underscore.
"""

import importlib
import inspect
import re
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.application import Sphinx

import ngepc

COLON = "\ue000"  # stands for a colon until napoleon is done
MARKUP = re.compile(r"(``.+?``|:\w+:`.+?`)")
OUTSIDE = re.compile(r"\]\(\.\./((?:\.\./)*(?:results|notebooks)/)")
"""Links of pages to the folders that the build copies beside them."""


def names_of(module: str) -> list[str]:
    """The documented names of a module; checks of arguments are none."""
    if module == "ngepc":
        pages = (Path(__file__).parent / "api").glob("*.md")
        listed = {
            line.strip()
            for page in pages
            for line in page.read_text("utf-8").split("\n")
        }
        return [name for name in ngepc.__all__ if name not in listed and name[0] != "_"]
    home = importlib.import_module(module)
    inside = (module, f"{module}.") if hasattr(home, "__path__") else (module,)
    return [
        name
        for name, value in vars(home).items()
        if not name.startswith(("_", "check", "require_"))
        and (inspect.isclass(value) or inspect.isfunction(value))
        and (value.__module__ == module or value.__module__.startswith(inside[1:]))
    ]


def overview(names: list[str]) -> list[str]:
    """A definition list: each name, linked, with the first paragraph of its docstring."""
    lines = [".. container:: overview", ""]
    for name in names:
        summary = " ".join(
            inspect.getdoc(getattr(ngepc, name)).split("\n\n")[0].split()
        )
        lines += [
            f"   :py:obj:`{name} <ngepc.{name}>`",
            f"      {without_markup(summary)}",
            "",
        ]
    return lines


class PublicNames(Directive):
    """Autodoc entries for public names: all of a module, or those listed, with an overview."""

    required_arguments, has_content = 1, True

    def run(self) -> list[nodes.Node]:
        """The entries."""
        module = self.arguments[0]
        home = importlib.import_module(module)
        listed = [line.strip() for line in self.content]
        lines = overview(listed) if listed else []
        for name in listed or names_of(module):
            kind = "class" if inspect.isclass(getattr(home, name)) else "function"
            lines += [f".. auto{kind}:: {module}.{name}"]
            if kind == "class":
                lines += ["   :members:", "   :exclude-members: set"]
            lines += [""]
        container = nodes.container()
        self.state.nested_parse(StringList(lines, source="public-names"), 0, container)
        return container.children


def plain_text(app, what, name, obj, options, lines: list[str]) -> None:
    """Keep |q|, x*, u_ and the like from being read as markup."""
    lines[:] = [without_markup(line) for line in lines]
    if what in ("property", "attribute") and lines:
        lines[0] = lines[0].replace(":", COLON)


def colons_back(app, what, name, obj, options, lines: list[str]) -> None:
    """Undo what kept napoleon from taking the words before a colon for a type."""
    lines[:] = [line.replace(COLON, ":") for line in lines]


def without_markup(line: str) -> str:
    """The line with what would be read as markup escaped, but for code and roles."""
    parts = MARKUP.split(line)
    for k in range(0, len(parts), 2):
        text = re.sub(r"([|*`])", r"\\\1", parts[k])
        parts[k] = re.sub(r"(?<=\w)_(?=\W|$)", r"\\_", text)
    return re.sub(r"(?<=\w``)(?=\w)", r"\\ ", "".join(parts))


def list_notes(app: Sphinx, docname: str, source: list[str]) -> None:
    """Complete the lists of notes.md and tables.md by pages not listed."""
    listed = re.compile(r"^(?:.* <)?([\w/.]+)>?$", re.MULTILINE)
    if docname in ("notes", "tables"):
        app.env.note_reread()  # it depends on which pages there are
        folder = "results/" if docname == "tables" else ""
        home = Path(app.srcdir)
        texts = [page.read_text(encoding="utf-8") for page in home.glob("*.md")]
        known = {name for text in texts for name in listed.findall(text)} | {"index"}
        pages = {f"{folder}{page.stem}" for page in (home / folder).glob("*.md")}
        source[0] += "\n".join(sorted(pages - known)) + "\n```\n"


def mend_links(app: Sphinx, docname: str, source: list[str]) -> None:
    """Lead links that leave this folder, as GitHub needs them, to the copies in it."""
    if not docname.startswith(("results/", "notebooks/")):
        source[0] = OUTSIDE.sub(r"](\1", source[0])


def setup(app: Sphinx) -> dict:
    """Register."""
    app.connect("source-read", list_notes)
    app.connect("source-read", mend_links)
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-docstring", plain_text, priority=400)
    app.connect("autodoc-process-docstring", colons_back, priority=600)
    return {"parallel_read_safe": True}
