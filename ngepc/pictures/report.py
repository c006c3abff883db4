"""Reports: one HTML file with text, tables, pictures and interactive views, for any browser.

Everything is inside the file, so that it opens from disk without network, on a phone, in light
and dark; it is written in one go.
"""

from __future__ import annotations

import html
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import (
    require_instance,
    require_path,
    require_sequence,
    require_text,
)
from ngepc.model.problem import Problem
from ngepc.pictures.page import STYLE, frame
from ngepc.pictures.report_pieces import (
    REPORT_STYLE,
    describe_problem,
    figcaption,
    html_table,
    inline,
)
from ngepc.pictures.views import View, png_address
from ngepc.results.records import write_text

WIDE = 1.9
"""Width over height from which a figure has a row to itself."""


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
        self._add(*(f"<p>{inline(paragraph)}</p>" for paragraph in paragraphs))
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
        self._add(html_table(rows, caption, digits))
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
        self._add(f"{tag}{picture}{figcaption(caption)}</figure>")
        return self

    def add_view(self, view: View, caption: str = "", height: int | None = None) -> Report:
        """Add an interactive view from ``ngepc.pictures.views``."""
        require_instance("view", view, View, "a View of ngepc.pictures.views")
        require_text("caption", caption)
        if height is not None:
            require_number("height", height, 1)
        self._add(
            f"<figure>{frame(view.html, height or view.height)}{figcaption(caption)}</figure>"
        )
        return self

    def add_problem(self, problem: Problem) -> Report:
        """Add a table of the data of a problem."""
        require_instance("problem", problem, Problem, "a Problem")
        return self.add_table(describe_problem(problem), "The problem")

    def html(self, footer: str = "") -> str:
        """The whole page."""
        head = f"<h1>{html.escape(self.title)}</h1>"
        if self.subtitle:
            head += f"<p>{inline(self.subtitle)}</p>"
        parts = "".join(f"<section>{''.join(section)}</section>" for section in self._sections)
        foot = f"<footer>{inline(footer)}</footer>" if footer else ""
        return (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(self.title)}</title><style>{STYLE}{REPORT_STYLE}</style></head>"
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
