"""What reports are made of: their style, tables and captions as HTML, a problem as a table."""

from __future__ import annotations

import html
import math
import numbers
import re
from collections.abc import Mapping, Sequence

from ngepc.checks.arguments import is_number
from ngepc.model.problem import Problem

REPORT_STYLE = """
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


def html_table(rows: Sequence[Mapping[str, object]], caption: str, digits: int) -> str:
    """A table whose columns are the keys in order of appearance; arguments as in ``add_table``."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    text = {c for c in columns if any(isinstance(row.get(c), str) for row in rows)}
    lines = [
        "".join(_cell("td", html.escape(number(row.get(c), digits)), c in text) for c in columns)
        for row in rows
    ]
    head = "".join(_cell("th", html.escape(str(c)), c in text) for c in columns)
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    title = f"<caption>{inline(caption)}</caption>" if caption else ""
    return (
        f'<div class="wide"><table>{title}<thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


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


def figcaption(caption: str) -> str:
    """The caption of a figure, nothing for an empty one."""
    return f"<figcaption>{inline(caption)}</figcaption>" if caption else ""


def inline(text: str) -> str:
    """Plain text as HTML; `code` stands between backquotes."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))


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
