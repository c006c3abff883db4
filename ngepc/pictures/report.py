"""Reports: one HTML file with text, tables, pictures and interactive views, for any browser.

Everything is inside the file, so that it opens from disk without network; it is written in one go.
"""

import html
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from string import Template

from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import is_number
from ngepc.checks.kinds import require_path, require_text
from ngepc.model.kinematics import TWO_DIMENSIONAL
from ngepc.model.problem import Problem
from ngepc.pictures.curves import plot_contact_pressure, plot_history
from ngepc.pictures.drawable import PLAIN, UnitNames, require_units
from ngepc.pictures.fields import plot_field, plot_plastic_zone
from ngepc.pictures.style import png_address
from ngepc.results.records import write_text

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
</style></head><body><h1>$title</h1>$content<footer>$footer</footer></body></html>
""")

Section = tuple[str, Sequence[object]]

SHOWN = ("mesh", "material", "kinematics", "order")
"""Fields of a problem that its description has in rows of their own."""


def write_report(
    path: str | os.PathLike,
    title: str,
    *sections: Section,
    footer: str = "",
    units: UnitNames | None = None,
) -> Path:
    """Write a report from sections to an HTML file; returns its path.

    Parameters
    ----------
    path
        The HTML file to write.
    title, footer
        Text at the top and at the bottom; `code` stands between backquotes, also in the contents.
    sections
        Pairs (heading, contents); each piece of contents is text, a list of dictionaries, a
        figure, a ``Problem``, or what notebooks show as HTML: a result, a ``View``.
    units
        Names of the units of the data of problems; None for none.

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
    content = []
    require_text("title", title)
    require_text("footer", footer)
    units = require_units("units", units)
    for number, section in enumerate(sections):
        pair = isinstance(section, tuple | list) and len(section) == 2
        if (
            not pair
            or isinstance(section[1], str)
            or not isinstance(section[1], Iterable)
        ):
            needed = "a pair of a heading and a list of contents is needed"
            raise TypeError(f"sections[{number}]={section!r}: {needed}")
        require_text(f"sections[{number}][0]", section[0])
        content.append(f"<h2>{html.escape(section[0])}</h2>")
        content += [_piece(piece, units) for piece in section[1]]
    texts = {
        "title": html.escape(title),
        "footer": _inline(footer),
        "content": "".join(content),
    }
    write_text(path, PAGE.substitute(texts))
    return path


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
        return html_table(piece)
    needed = "text, a list of dictionaries, a figure, a view or a problem"
    raise TypeError(f"contents {piece!r}: {needed} is needed")


def _inline(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


def html_table(rows: Sequence[Mapping[str, object]]) -> str:
    """A table whose columns are the keys in order of appearance, numbers with four digits."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [""]
    for column in columns:
        words = all(isinstance(row.get(column), str) for row in rows)
        kind = ' class="text"' if words else ""
        lines[0] += f"<th{kind}>{html.escape(str(column))}</th>"
    for row in rows:
        cells = []
        for value in map(row.get, columns):
            shown = (
                f"{value:.4g}".replace("-", "−") if isinstance(value, float) else value
            )
            kind = ' class="text"' if isinstance(value, str) else ""
            cells.append(
                f"<td{kind}>{'' if shown is None else html.escape(str(shown))}</td>"
            )
        lines.append("".join(cells))
    return f'<div class="wide"><table><tr>{"</tr><tr>".join(lines)}</tr></table></div>'


def describe_problem(
    problem: Problem, units: UnitNames = PLAIN
) -> list[dict[str, str]]:
    """The data that a problem is given as rows 'what', 'value', for a table.

    ``units`` are the names of the units of stresses.
    """
    size = f"{problem.mesh.nv} nodes, {problem.mesh.ne} elements"
    rows = {"body": f"{size}, order {problem.order}, {problem.kinematics.name}"}
    rows |= {
        what: _said(value)
        for what, value in _material_rows(problem, units).items()
        if value is not None
    }
    for field in fields(problem):
        value = getattr(problem, field.name)
        if value is not None and field.name not in SHOWN:
            rows[field.name.replace("_", " ")] = _said(value)
    return [{"what": key, "value": value} for key, value in rows.items()]


def _material_rows(problem: Problem, units: UnitNames) -> dict[str, object]:
    """Young's modulus and so on, then what the material was given."""
    material = problem.material
    stress = units.of("stress")
    given = material.data_sheet
    rows = {}
    if problem.kinematics is not TWO_DIMENSIONAL:
        rows |= {
            f"Young's modulus E{stress}": material.young,
            "Poisson's ratio nu": material.poisson,
            f"yield stress R of a bar{stress}": material.tensile_yield_stress,
        }
    if given:
        known = ("young", "poisson", "yield_stress")
        later = {name: value for name, value in given.items() if name not in known}
    else:
        later = {
            field.name: getattr(material, field.name) for field in fields(material)
        }
    return rows | {name.replace("_", " "): value for name, value in later.items()}


def _said(value: object) -> str:
    """A datum, by place and component, in words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{place}: {_said(there)}" for place, there in value.items())
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_said, value))})"
    shown = "varies" if isinstance(value, CoefficientFunction) else value
    return f"{value:g}" if is_number(value) else str(shown)
