"""Reports: one HTML file with text, tables, pictures and interactive views, for any browser.

Everything is inside the file, so that it opens from disk without network, on a phone, in light
and dark; it is written in one go.
"""

from __future__ import annotations

import html
import math
import numbers
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ngepc.checks.arguments import is_number, require_integer, require_number
from ngepc.checks.kinds import (
    require_instance,
    require_path,
    require_sequence,
    require_text,
)
from ngepc.plotting.page import STYLE, frame
from ngepc.plotting.views import View, png_address
from ngepc.problem import Problem
from ngepc.storage.records import write_text

WIDE = 1.9
"""Width over height from which a figure has a row to itself."""

_REPORT_STYLE = """
body { padding: 1.5rem 1rem 4rem; }
body > * { max-width: 60rem; margin-left: auto; margin-right: auto; }
h1 { font-size: 1.7rem; line-height: 1.2; margin-bottom: .3rem; }
h2 { font-size: 1.2rem; margin-top: 2.4rem; padding-top: .8rem; border-top: 1px solid var(--line); }
p { max-width: 44rem; margin: .6rem auto .6rem 0; }
section > p:first-of-type { margin-top: .4rem; }
.wide { overflow-x: auto; margin: .9rem 0; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); padding-bottom: .35rem; font-size: .88rem; }
th, td { padding: .28rem .8rem; border-bottom: 1px solid var(--line); text-align: right;
         white-space: nowrap; }
th { font-weight: 600; border-bottom-color: var(--soft); }
td.text, th.text { text-align: left; }
td.text { white-space: normal; }
figure { margin: 1rem 0; }
figure.half { display: inline-block; vertical-align: top; width: calc(50% - .6rem);
              min-width: 20rem; margin-right: .5rem; }
@media (max-width: 44rem) { figure.half { width: 100%; } }
figure img { max-width: 100%; height: auto; background: #fff; border-radius: 4px; display: block; }
figcaption, footer { color: var(--soft); font-size: .88rem; }
figcaption { padding-top: .3rem; }
code, pre { font: .86rem/1.45 ui-monospace, Menlo, Consolas, monospace; }
pre { overflow-x: auto; padding: .7rem .9rem; border: 1px solid var(--line); border-radius: 4px; }
footer { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: .7rem; }
@media print { iframe { display: none; } }
"""


class Report:
    """A report that is put together piece by piece and then written.

    Parameters
    ----------
    title
        Heading.
    subtitle
        Line below it.
    """

    def __init__(self, title: str, subtitle: str = "") -> None:
        require_text("title", title)
        require_text("subtitle", subtitle)
        self.title, self.subtitle = title, subtitle
        self._sections: list[list[str]] = [[]]

    def add_section(self, heading: str) -> Report:
        """Begin a new section; returns the report, as all these methods do."""
        require_text("heading", heading)
        self._sections.append([f"<h2>{html.escape(heading)}</h2>"])
        return self

    def add_text(self, *paragraphs: str) -> Report:
        """Add paragraphs of plain text; `code` stands between backquotes."""
        for number, paragraph in enumerate(paragraphs):
            require_text(f"paragraphs[{number}]", paragraph)
        self._add(*(f"<p>{_inline(paragraph)}</p>" for paragraph in paragraphs))
        return self

    def add_code(self, text: str) -> Report:
        """Add preformatted text, such as a command."""
        require_text("text", text)
        self._add(f"<pre>{html.escape(text)}</pre>")
        return self

    def add_table(
        self, rows: Iterable[Mapping[str, object]], caption: str = "", digits: int = 4
    ) -> Report:
        """Add a table.

        Parameters
        ----------
        rows
            Dictionaries; the columns are the keys in order of appearance, missing values empty.
        caption
            Text above.
        digits
            Significant digits of numbers that are not integers.

        Raises
        ------
        ValueError
            If there are no rows.
        """
        require_text("caption", caption)
        require_integer("digits", digits, 1, 17)
        rows = rows if hasattr(rows, "__len__") or not hasattr(rows, "__iter__") else list(rows)
        require_sequence("rows", rows, "mappings")
        if len(rows) == 0:
            raise ValueError(f"rows={rows!r}: at least one row is needed")
        for number_of_row, row in enumerate(rows):
            require_instance(f"rows[{number_of_row}]", row, Mapping, "a mapping")
        columns = list(dict.fromkeys(key for row in rows for key in row))
        text = {c for c in columns if any(isinstance(row.get(c), str) for row in rows)}
        head = "".join(_cell("th", html.escape(str(c)), c in text) for c in columns)
        body = "".join(
            "<tr>"
            + "".join(
                _cell("td", html.escape(number(row.get(c), digits)), c in text) for c in columns
            )
            + "</tr>"
            for row in rows
        )
        title = f"<caption>{_inline(caption)}</caption>" if caption else ""
        self._add(
            f'<div class="wide"><table>{title}<thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )
        return self

    def add_figure(self, figure: Figure | str | os.PathLike, caption: str = "") -> Report:
        """Add a matplotlib figure, or a picture from a PNG file.

        Figures that are not wide stand two in a row where there is room.

        Raises
        ------
        OSError
            If the file cannot be read.
        """
        require_text("caption", caption)
        address = png_address(
            figure if isinstance(figure, Figure) else require_path("figure", figure)
        )
        half = isinstance(figure, Figure) and np.divide(*figure.get_size_inches()) < WIDE
        tag = '<figure class="half">' if half else "<figure>"
        picture = f'<img src="{address}" alt="{html.escape(caption or "figure")}">'
        self._add(f"{tag}{picture}{_caption(caption)}</figure>")
        return self

    def add_view(self, view: View, caption: str = "", height: int | None = None) -> Report:
        """Add an interactive view from ``ngepc.plotting.views``."""
        require_instance("view", view, View, "a View of ngepc.plotting.views")
        require_text("caption", caption)
        if height is not None:
            require_number("height", height, 1)
        self._add(f"<figure>{frame(view.html, height or view.height)}{_caption(caption)}</figure>")
        return self

    def add_problem(self, problem: Problem) -> Report:
        """Add a table of the data of a problem."""
        require_instance("problem", problem, Problem, "a Problem")
        return self.add_table(describe_problem(problem), "The problem")

    def html(self, footer: str = "") -> str:
        """The whole page."""
        head = f"<h1>{html.escape(self.title)}</h1>"
        if self.subtitle:
            head += f"<p>{_inline(self.subtitle)}</p>"
        parts = "".join(f"<section>{''.join(section)}</section>" for section in self._sections)
        foot = f"<footer>{_inline(footer)}</footer>" if footer else ""
        return (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(self.title)}</title><style>{STYLE}{_REPORT_STYLE}</style></head>"
            f"<body><header>{head}</header>{parts}{foot}</body></html>\n"
        )

    def write(self, path: str | os.PathLike, footer: str = "") -> Path:
        """Write the report in one go; returns the path."""
        path = require_path("path", path)
        write_text(path, self.html(footer))
        return path

    def _add(self, *pieces: str) -> None:
        self._sections[-1].extend(pieces)


Section = tuple[str, Sequence[object]]
"""Heading and contents: text, figures, views, problems and lists of dictionaries (tables)."""


def write_report(
    path: str | os.PathLike, title: str, *sections: Section, subtitle: str = "", footer: str = ""
) -> Path:
    """Write a report from sections.

    Parameters
    ----------
    path
        The HTML file to write.
    title, subtitle, footer
        Text at the top and at the bottom.
    sections
        Pairs (heading, contents); each piece of contents is text, a list of dictionaries, a
        figure, the path of a PNG file, a ``View`` or a ``Problem``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError, ValueError
        If a piece is none of these, or another argument is not legal.
    """
    path, report = require_path("path", path), Report(title, subtitle)
    require_text("footer", footer)
    for number, section in enumerate(sections):
        heading, contents = _section(number, section)
        report.add_section(heading)
        for piece in contents:
            _add_piece(report, piece)
    return report.write(path, footer)


def _section(number: int, section: object) -> tuple[str, Iterable]:
    """The heading and the contents of a section."""
    pair = isinstance(section, tuple | list) and len(section) == 2
    if not pair or isinstance(section[1], str) or not isinstance(section[1], Iterable):
        raise TypeError(
            f"sections[{number}]={section!r}: a pair of a heading and a list of contents is needed"
        )
    require_text(f"sections[{number}][0]", section[0])
    return section


def _add_piece(report: Report, piece: object) -> None:
    if isinstance(piece, str):
        report.add_text(piece)
    elif isinstance(piece, Figure | os.PathLike):
        report.add_figure(piece)
    elif isinstance(piece, View):
        report.add_view(piece)
    elif isinstance(piece, Problem):
        report.add_problem(piece)
    elif isinstance(piece, Sequence) and all(isinstance(row, Mapping) for row in piece):
        report.add_table(piece)
    else:
        raise TypeError(
            f"contents {piece!r}: text, a list of dictionaries, a figure, a view or a problem is "
            "needed"
        )


def describe_problem(problem: Problem) -> list[dict[str, str]]:
    """The data of a problem as rows 'what', 'value', for a table."""
    mesh, m = problem.mesh, problem.material
    rows = {
        "body": f"{problem.N} dimensions, {mesh.nv} nodes, {mesh.ne} elements",
        "elasticity": f"mu_1 = {_data(m.lame_lambda)}, mu_2 = {_data(m.lame_mu)}",
        "yield stress": _data(m.yield_stress),
        "hardening": f"kinematic {_data(m.hardening)}, isotropic H = {_data(m.hardening_modulus)}, "
        f"k_1 = {_data(m.hardening_stiffness)}",
        "clamped": ", ".join(problem.clamped_names),
        "loaded": ", ".join(problem.tractions),
        "contact": ", ".join(problem.contact_names),
        "gap": _data(problem.gap) if is_number(problem.gap) or problem.gap is None else "varies",
    }
    return [{"what": key, "value": value or "none"} for key, value in rows.items()]


def _data(value: object) -> str:
    if value is None:
        return "none"
    return f"{value:g}" if is_number(value) else "varies"


def number(value: object, digits: int = 4) -> str:
    """A table entry: integers in full, other numbers with ``digits`` significant digits."""
    if value is None:
        return ""
    if isinstance(value, bool | str) or not isinstance(value, numbers.Real):
        return str(value)
    if isinstance(value, numbers.Integral):
        return str(int(value))
    text = f"{float(value):.{digits}g}" if math.isfinite(value) else str(float(value))
    return text.replace("-", "\N{MINUS SIGN}")


def _cell(tag: str, content: str, text: bool) -> str:
    return f'<{tag} class="text">{content}</{tag}>' if text else f"<{tag}>{content}</{tag}>"


def _caption(caption: str) -> str:
    return f"<figcaption>{_inline(caption)}</figcaption>" if caption else ""


def _inline(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))
