"""Reports: one HTML file with text, tables, pictures and interactive views, for any browser.

Everything is inside the file, so that it opens from disk without network, and prints on A4.
"""

import html
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from ngepc.checks.kinds import require_path, require_text
from ngepc.checks.sentences import counted, in_words
from ngepc.evolution.result import Evolution
from ngepc.model.problem import Problem
from ngepc.pictures.answers import describe_history, describe_result, how_exact
from ngepc.pictures.curves import plot_contact_pressure, plot_curve, plot_history
from ngepc.pictures.drawable import UnitNames, require_units
from ngepc.pictures.fields import plot_field, plot_mesh, plot_plastic_zone
from ngepc.pictures.meshes import axis_names
from ngepc.pictures.quantities import number
from ngepc.pictures.rows import flat_rows
from ngepc.pictures.style import png_address
from ngepc.pictures.wording import describe_problem
from ngepc.results.records import write_text
from ngepc.results.result import Result

WIDEST = 9  # columns that fit a sheet of paper

PAGE = Template("""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>$title</title>
<style>
body { max-width: 60rem; margin: auto; padding: 1.5rem 1rem; font: 16px/1.55 system-ui; }
h2 { font-size: 1.2rem; margin-top: 2.4rem; padding-top: .8rem; border-top: 1px solid #d9dee3; }
.wide { overflow-x: auto; margin: .9rem 0; }
table { border-collapse: collapse; font-size: .88rem; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .8rem; border-bottom: 1px solid #d9dee3; text-align: right; }
.text { text-align: left; }
img { max-width: 100%; }
@page { size: A4; margin: 16mm 14mm; }
@media print {
  body { max-width: none; padding: 0; font-size: 10.5pt; }
  .wide { overflow: visible; break-inside: avoid; }
  table { width: 100%; font-size: 8.5pt; }
  th, td { padding: .15rem .35rem; overflow-wrap: anywhere; min-width: 3em; }
  img { max-height: 94mm; }
  tr, img, h2 { break-inside: avoid; }
  h2 { break-after: avoid; }
  iframe { display: none; }
}
</style></head><body><h1>$title</h1>$content<footer>$footer</footer></body></html>
""")

Section = tuple[str, Sequence[object]]

SHOWN = ("mesh", "material", "kinematics", "order")
"""Fields of a problem that its description has in rows of their own."""


def write_report(
    path: str | os.PathLike,
    title: str,
    *sections: Section | Result | Evolution,
    footer: str = "",
    units: UnitNames | None = None,
) -> Path:
    """Write a report to an HTML file, which prints on A4; returns its path.

    ``write_report("punch.html", "Punch", result)`` is all that is needed: the problem in words, the
    answer and how exact it is, pictures and curves.

    Parameters
    ----------
    path
        The HTML file to write.
    title, footer
        Text at the top and at the bottom; `code` stands between backquotes, also in the contents.
    sections
        A result or a history, which become sections of their own; or pairs (heading, contents),
        where each piece of contents is text, a list of dictionaries, a figure, a ``Problem``, or
        what notebooks show as HTML: a ``View``.
    units
        Names of the units, for tables and pictures.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError
        If a piece is none of these.
    """
    path = require_path("path", path)
    units = require_units("units", units)
    require_text("title", title)
    require_text("footer", footer)
    content = []
    for place, section in enumerate(sections):
        parts = [section]
        if isinstance(section, Result | Evolution):
            parts = standard_sections(section, units)
        for heading, pieces in (section_of(place, part) for part in parts):
            content.append(f"<h2>{html.escape(heading)}</h2>")
            content += [_piece(piece, units) for piece in pieces]
    texts = {
        "title": html.escape(title),
        "footer": _inline(footer),
        "content": "".join(content),
    }
    write_text(path, PAGE.substitute(texts))
    return path


def section_of(place: int, section: object) -> Section:
    """A pair of a heading and contents; TypeError for anything else."""
    pair = isinstance(section, tuple | list) and len(section) == 2
    listed = (
        pair and not isinstance(section[1], str) and isinstance(section[1], Iterable)
    )
    if not listed:
        needed = "a result, a history, or a pair of a heading and a list of contents"
        inner = ", such as its .result" if hasattr(section, "result") else ""
        raise TypeError(
            f"sections[{place}]={in_words(section)}: {needed} is needed{inner}"
        )
    require_text(f"sections[{place}][0]", section[0])
    return section


def standard_sections(source: Result | Evolution, units: UnitNames) -> list[Section]:
    """The sections of a result or a history: the problem, the answer, pictures and curves."""
    if isinstance(source, Evolution):
        return _of_history(source, units)
    message = [source.message] if source.message else []
    drawn = [
        ("The problem", [source.problem, mesh_picture(source.problem, units)]),
        ("The answer", [describe_result(source, units), *message]),
        ("Pictures", list(_pictures(source, units))),
    ]
    if len(source.history.records) > 1:
        drawn.append(("Convergence of the solver", [plot_history(source.history)]))
    return drawn


def _of_history(history: Evolution, units: UnitNames) -> list[Section]:
    """The sections of a history: its steps in a table, curves, the last step in pictures."""
    summary = (
        f"{counted(len(history.steps), 'step')}: {history.status}. {history.message}"
    )
    mesh = mesh_picture(history.problem, units)
    sections = [("The problem", [history.problem, mesh])]
    steps = [summary.strip(), describe_history(history, units)]
    sections.append(("The steps", steps))
    if not history.steps:
        return sections
    error = how_exact(history.steps[-1].solution)
    steps.append(f"Error of the mesh in the last step: {error}.")
    touches = history.problem.touching_names
    force = "contact_force" if touches else "reaction_y"
    columns = [force, "max_plastic_strain"]
    columns += ["max_contact_pressure"] if touches else []
    curves = [plot_curve(history, "time", name, units=units) for name in columns]
    sections.append(("Curves", curves))
    last = history.steps[-1]
    heading = f"The last step, time {last.record.time:g}"
    return [*sections, (heading, list(_pictures(last, units)))]


def mesh_picture(problem: Problem, units: UnitNames) -> Figure:
    """The mesh with the names of its boundaries, and the unit of length in the plane."""
    figure = plot_mesh(problem)
    if problem.N == 2:
        axes = figure.axes[0]
        first, second = axis_names(problem)
        axes.set_xlabel(f"{first}{units.of('length')}")
        axes.set_ylabel(f"{second}{units.of('length')}")
    return figure


def _pictures(source: object, units: UnitNames) -> Iterator[Figure]:
    """The stress, the plastic strain and the contact pressure."""
    yield plot_field(source, "von_mises", units=units)
    yield plot_field(source, "accumulated_plastic_strain", units=units)
    problem = source.problem
    if not problem.touching_names or not hasattr(source, "contact_pressure"):
        return
    if problem.N == 2:
        yield plot_contact_pressure(source, units=units)
    else:
        names = "|".join(problem.touching_names)
        yield plot_field(source, "contact_pressure", boundary=names, units=units)


def standard_figures(result: object, threshold: float = 0.0) -> dict[str, Figure]:
    """Name -> figure: |p|_F, yield function, where |p|_F > ``threshold``, pressure, residuals."""
    figures = {
        "plastic_strain": plot_field(result, "equivalent_plastic_strain"),
        "yield_function": plot_field(result, "yield_function"),
        "plastic_zone": plot_plastic_zone(result, threshold),
    }
    if result.problem.touching_names and result.problem.N == 2:
        figures["contact_pressure"] = plot_contact_pressure(result)
    return figures | {"residuals": plot_history(result.history)}


def _piece(piece: object, units: UnitNames) -> str:
    """A piece of contents as HTML."""
    if isinstance(piece, str):
        return f"<p>{_inline(piece)}</p>"
    if isinstance(piece, Figure):
        return f'<p><img src="{png_address(piece)}" alt="figure"></p>'
    if hasattr(piece, "_repr_html_"):
        return piece._repr_html_()
    piece = describe_problem(piece, units) if isinstance(piece, Problem) else piece
    if (
        isinstance(piece, Sequence)
        and piece
        and all(isinstance(row, Mapping) for row in piece)
    ):
        return "".join(map(html_table, narrow(flat_rows(piece))))
    needed = "text, a list of dictionaries, a figure, a view or a problem"
    raise TypeError(f"contents {in_words(piece)}: {needed} is needed")


def narrow(rows: Sequence[Mapping[str, object]]) -> list[list[dict]]:
    """A wide table as several of at most ``WIDEST`` columns, each with the first column."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    if len(columns) <= WIDEST:
        return [list(rows)]
    first, *others = columns
    chunks = [others[k : k + WIDEST - 1] for k in range(0, len(others), WIDEST - 1)]
    return [
        [{k: row[k] for k in (first, *chunk) if k in row} for row in rows]
        for chunk in chunks
    ]


def _inline(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


def html_table(rows: Sequence[Mapping[str, object]]) -> str:
    """A table whose columns are the keys in order of appearance, numbers with four digits."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    kinds = {}
    lines = [""]
    for column in columns:
        entries = [row[column] for row in rows if row.get(column) is not None]
        words = all(isinstance(entry, str) for entry in entries)
        kinds[column] = ' class="text"' if words else ""
        lines[0] += f"<th{kinds[column]}>{html.escape(str(column))}</th>"
    for row in rows:
        cells = []
        for column in columns:
            value = row.get(column)
            shown = number(value, digits=4) if isinstance(value, float) else value
            cells.append(
                f"<td{kinds[column]}>{'' if shown is None else html.escape(str(shown))}</td>"
            )
        lines.append("".join(cells))
    head = f"<thead><tr>{lines[0]}</tr></thead>"
    body = f"<tbody><tr>{'</tr><tr>'.join(lines[1:])}</tr></tbody>"
    return f'<div class="wide"><table>{head}{body}</table></div>'
