"""Interactive views of results: in notebooks, and as HTML pages that work without network.

A ``View`` shows itself when it is the last line of a notebook cell; ``save`` writes the same page
to a file, which opens from disk in any browser with WebGL 2; ``page.html#3`` starts at frame 3.
The drawing is NGSolve's webgui, whose script is embedded.
"""

import base64
import gzip
import html
import importlib.util
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.cm import ScalarMappable
from ngsolve import BBND, BND, CF, VOL, CoefficientFunction

from ngepc.checks.arguments import sample
from ngepc.checks.kinds import require_path, require_text
from ngepc.pictures.drawable import (
    Drawable,
    UnitNames,
    fields_of,
    on_one_scale,
    sources_of,
)
from ngepc.pictures.fields import Drawing
from ngepc.pictures.sampling import corners_of, is_curved, obstacle_lines, offset
from ngepc.pictures.style import Picture, png_address, styled
from ngepc.results.records import write_text

EXTRA = 'pip install "ngepc[html]"'
NOISE = 1e-3  # of the yield bound: lower contact pressures are not drawn at full height
LINES = {"obstacle": "#000000", "contact pressure": "#0072B2"}
"""What lines in a view of a plane body are, and their colours."""
PAGE = Template(Path(__file__).with_name("page.html").read_text(encoding="utf-8"))


@dataclass(frozen=True, eq=False)
class View:
    """An HTML page that notebooks show in place."""

    html: str = field(repr=False)

    def _repr_html_(self) -> str:
        style = "width:100%;height:480px;box-sizing:border-box;border:1px solid #8884"
        frame = f'title="interactive view" loading="lazy" style="{style}"'
        return f'<iframe {frame} srcdoc="{html.escape(self.html)}"></iframe>'

    def save(self, path: str | os.PathLike) -> Path:
        """Write the page to ``path``, making its folder; returns the path."""
        path = require_path("path", path)
        write_text(path, self.html)
        return path


@styled
def show(
    source: object,
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    *,
    title: str = "",
    name: str = "",
    deformation_scale: float = 1.0,
    vmin: float | None = None,
    vmax: float | None = None,
    mesh_lines: bool = False,
    units: UnitNames | None = None,
) -> View:
    """The deformed body coloured by a field, to turn and zoom.

    Parameters
    ----------
    source
        Result of a solver, ``Fields``, or a mapping of caption -> either, drawn on one colour
        scale: side by side, or with ``name`` one after the other on a slider.
    field
        Name of a field, 'contact_pressure' (3D), or a coefficient.
    title
        Heading of the page.
    name
        What the slider moves through: 'gamma', 'load step', ...; the captions stand beside it.
    deformation_scale, vmin, vmax, mesh_lines, units
        As in ``plot_field``.

    Returns
    -------
    View
        The page, in 2D with the obstacle and the contact pressure as lines.

    Raises
    ------
    TypeError, ValueError
        For an unknown field, or an argument of the wrong kind.
    ImportError
        If the viewer is not installed; the message says what to install.
    """
    sources = sources_of("source", source)
    require_text("name", name)
    require_text("title", title)
    drawing = Drawing(deformation_scale, units, mesh_lines=mesh_lines)
    viewer = viewer_script()
    what, _, colours = on_one_scale(
        sources.values(), field, drawing.units, (vmin, vmax)
    )
    pairs = zip(sources.values(), what, strict=True)
    peak = pressure_peak(sources.values())
    scenes = [scene_of(one, drawn, colours, drawing, peak) for one, drawn in pairs]
    captions, labels = ([""], list(sources)) if name else (list(sources), [""])
    panels = [scenes] if name else [[scene] for scene in scenes]
    page = {"captions": captions, "labels": labels, "panels": panels}
    data = gzip.compress(json.dumps(page, default=float).encode(), mtime=0)
    legend = Picture(figsize=(3.6, 0.6))
    axes = legend.add_subplot()
    legend.colorbar(colours, cax=axes, orientation="horizontal", label=what[0].label)
    axes.locator_params(nbins=6)
    texts = {"title": html.escape(title), "name": html.escape(name), "viewer": viewer}
    texts |= {
        "legend": png_address(legend, 200),
        "data": base64.b64encode(data).decode(),
    }
    problems = [fields_of(one).problem for one in sources.values()]
    drawn = any(p.N == 2 and p.touching_names for p in problems)
    texts["lines"] = legend_of_lines() if drawn else ""
    return View(PAGE.substitute(texts))


def legend_of_lines() -> str:
    """What the lines beside a plane body are, as HTML."""
    parts = [f'<b style="color:{c}">—</b> {name}' for name, c in LINES.items()]
    return " &ensp; ".join(parts)


def scene_of(
    source: object,
    drawn: Drawable,
    colours: ScalarMappable,
    drawing: Drawing,
    peak: float,
) -> dict:
    """What webgui needs to draw a scalar on the deformed body, ready for JSON.

    In 2D the obstacle and the contact pressure over the deformed boundary are lines, ``peak`` is
    drawn 0.15 times as high as the body is large.  Every scene of a slider has the same lines:
    webgui keeps the list of the first one.
    """
    fields = fields_of(source)
    scale = drawing.deformation_scale
    lines = []
    names = fields.problem.touching_names
    plane = fields.problem.N == 2
    if plane and names:
        extent = np.ptp(
            corners_of(fields, where=".*").points.reshape(-1, 2), axis=0
        ).max()
        height = 0.15 * extent / peak * getattr(source, "contact_pressure", CF(0.0))
        lines = [
            ("obstacle", obstacle_lines(fields, scale)),
            ("contact pressure", offset(fields, names, height, scale)),
        ]
    ambient = 1.0 if plane else 0.65
    settings = {
        "Objects": {"Wireframe": drawing.mesh_lines, "Edges": True, "Colorbar": False},
        "Colormap": {"ncolors": 64},
        "Light": {
            "ambient": ambient,
            "diffuse": 1 - ambient,
            "shininess": 10,
            "specularity": 0.0,
        },
    }
    if not plane:
        settings["camera"] = {"euler_angles": [-65.0, 0.0, -30.0]}
    with np.errstate():  # its import changes numpy's error state
        from ngsolve.webgui import BuildRenderData
    data = BuildRenderData(
        fields.problem.mesh,
        drawn.coefficient,
        order=2 if is_curved(fields) else 1,
        draw_vol=False,
        deformation=scale * fields.displacement,
        regions={kind: kind for kind in (VOL, BND, BBND)},
        objects=[
            {"type": "lines", "name": name, "color": LINES[name],
             "position": np.pad(segments, ((0, 0), (0, 0), (0, 1))).ravel().tolist()}
            for name, segments in lines
        ],
        settings=settings,
    )  # fmt: skip
    limits = {
        "funcmin": colours.norm.vmin,
        "funcmax": colours.norm.vmax,
        "autoscale": False,
    }
    colors = colours.cmap(np.linspace(0.0, 1.0, 64))[:, :3].tolist()
    return data | limits | {"deformation_scale": 1.0, "colors": colors}


def pressure_peak(sources: Iterable[object]) -> float:
    """Greatest contact pressure of the sources, not below ``NOISE`` of the yield bound."""
    peaks = []
    for source in sources:
        problem = fields_of(source).problem
        if problem.touching_names and hasattr(source, "contact_pressure"):
            where = "|".join(problem.touching_names)
            touching = corners_of(fields_of(source), source.contact_pressure, where)
            peaks += [
                touching.values.max(),
                NOISE * sample(problem.beta, problem.mesh).mean(),
            ]
    return float(max(peaks, default=1.0))


def viewer_installed() -> bool:
    """Whether the viewer's script is there, so that interactive pages can be made."""
    found = importlib.util.find_spec("webgui_jupyter_widgets")
    return found is not None and found.origin is not None


def viewer_script() -> str:
    """The JavaScript of NGSolve's viewer; ImportError says what to install where it is missing."""
    if not viewer_installed():
        raise ImportError(f"interactive views need webgui_jupyter_widgets: {EXTRA}")
    origin = importlib.util.find_spec("webgui_jupyter_widgets").origin
    return (Path(origin).parent / "js" / "webgui.js").read_text(encoding="utf-8")
