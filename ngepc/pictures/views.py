"""Interactive views of results: in notebooks, and as HTML pages that work without network.

A ``View`` shows itself when it is the last line of a notebook cell; ``save`` writes the same page
to a file, which opens from disk in any browser with WebGL 2; ``page.html#3`` starts at frame 3.
The drawing is NGSolve's webgui, whose script is embedded.
"""

from __future__ import annotations

import base64
import gzip
import html
import importlib.util
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.cm import ScalarMappable
from ngsolve import BBND, BND, CF, VOL, CoefficientFunction, Integrate

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_flag, require_path, require_text
from ngepc.model.problem import as_scalar
from ngepc.pictures.drawable import UnitNames, drawable, fields_of, require_sources
from ngepc.pictures.sampling import (
    boundary_corners,
    colour_scale,
    is_curved,
    obstacle_lines,
    offset,
    sample_corners,
)
from ngepc.pictures.style import Picture, png_address, styled
from ngepc.results.records import write_text

EXTRA = 'pip install "ngepc[html]"'
NOISE = 1e-3
"""Contact pressures below this part of the yield bound are not drawn."""
PAGE = Template(Path(__file__).with_name("page.html").read_text(encoding="utf-8"))
SLIDER = (
    '<footer><button id="play" title="play">▶</button><label for="slider">{name}</label>'
    '<input type="range" id="slider" min="0" max="{last}" value="0">'
    '<output id="label" for="slider"></output></footer>'
)
FRAME = (
    '<iframe srcdoc="{page}" loading="lazy" title="interactive view" style="width:100%;'
    'height:{height}px;box-sizing:border-box;border:1px solid #8884"></iframe>'
)
FIGURE = '<figure><figcaption>{}</figcaption><div class="place" id="place-{}"></div></figure>'


@dataclass(frozen=True, eq=False)
class View:
    """An HTML page that notebooks show in place, in a frame of a ``height`` in pixels."""

    html: str = field(repr=False)
    height: int = 480

    def _repr_html_(self) -> str:
        return FRAME.format(page=html.escape(self.html), height=self.height)

    def save(self, path: str | os.PathLike) -> Path:
        """Write the page to ``path``, making its folder; returns the path."""
        path = require_path("path", path)
        write_text(path, self.html)
        return path


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
    height: int = 480,
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
    height
        Height of the frame in a notebook (pixels).

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
    sources = source if isinstance(source, Mapping) else {"": source}
    require_sources(sources)
    require_text("title", title)
    require_text("name", name)
    require_number("deformation_scale", deformation_scale, 0.0)
    require_number("height", height, 100)
    require_flag("mesh_lines", mesh_lines)
    what = {key: drawable(s, field, units) for key, s in sources.items()}
    first = next(iter(what.values()))
    viewer = viewer_script()
    samples = [
        sample_corners(fields_of(sources[key]), drawn.region, drawn.coefficient)
        for key, drawn in what.items()
    ]
    limits = colour_scale(*samples, vmin=vmin, vmax=vmax, symmetric=first.signed)
    colours, peak = ScalarMappable(limits, first.colormap), _peak(sources.values())
    scenes = {
        key: scene_data(s, what[key].coefficient, colours, deformation_scale, mesh_lines, peak)
        for key, s in sources.items()
    }
    panels = {"": list(scenes.values())} if name else {key: [data] for key, data in scenes.items()}
    labels = list(scenes) if name else [""]
    data = json.dumps({"labels": labels, "panels": list(panels.values())}, default=float)
    page = PAGE.substitute(
        title=html.escape(title or "ngepc"),
        heading=f"<h1>{html.escape(title)}</h1>" if title else "",
        legend=legend(colours, first.label),
        figures="".join(FIGURE.format(html.escape(c), n) for n, c in enumerate(panels)),
        slider=SLIDER.format(name=html.escape(name), last=len(labels) - 1) if name else "",
        data=base64.b64encode(gzip.compress(data.encode(), mtime=0)).decode(),
        viewer=viewer,
    )
    return View(page, height)


@styled
def legend(colours: ScalarMappable, label: str) -> str:
    """The colour scale as an image of HTML."""
    figure = Picture(figsize=(3.6, 0.6))
    figure.colorbar(colours, cax=figure.add_subplot(), orientation="horizontal", label=label)
    return f'<img class="legend" src="{png_address(figure, 200)}" alt="colour scale">'


def scene_data(
    source: object,
    coefficient: CoefficientFunction,
    colours: ScalarMappable,
    scale: float,
    mesh_lines: bool,
    peak: float,
) -> dict:
    """What webgui needs to draw a scalar on the body deformed by ``scale`` u, ready for JSON.

    ``peak`` is the contact pressure drawn at full height in 2D, 0 for none.
    """
    fields = fields_of(source)
    mesh, plane = fields.problem.mesh, fields.problem.N == 2
    ambient = 1.0 if plane else 0.65
    light = {"ambient": ambient, "diffuse": 1.0 - ambient, "shininess": 10, "specularity": 0.0}
    objects = {"Wireframe": mesh_lines, "Edges": True, "Colorbar": False}
    settings = {"Objects": objects, "Colormap": {"ncolors": 64}, "Light": light}
    if not plane:
        settings["camera"] = {"euler_angles": [-65.0, 0.0, -30.0]}
    with np.errstate():  # its import changes numpy's error state
        from ngsolve.webgui import BuildRenderData
    return BuildRenderData(
        mesh,
        coefficient,
        order=2 if is_curved(fields) else 1,
        draw_vol=False,
        deformation=scale * fields.displacement,
        regions={kind: kind for kind in (VOL, BND, BBND)},
        objects=_contact_lines(source, scale, peak),
        settings=settings,
    ) | {
        "funcmin": colours.norm.vmin,
        "funcmax": colours.norm.vmax,
        "autoscale": False,
        "deformation_scale": 1.0,
        "colors": colours.cmap(np.linspace(0.0, 1.0, 64))[:, :3].tolist(),
    }


def _contact_lines(source: object, scale: float, peak: float) -> list[dict]:
    """The obstacle and the pressure curve over the deformed contact boundary of a 2D body.

    Every scene of a slider has the same lines: webgui keeps the list of the first one.
    """
    fields = fields_of(source)
    problem = fields.problem
    if problem.N != 2 or not problem.touching_names:
        return []
    pressure = getattr(source, "contact_pressure", None)
    extent = np.ptp(boundary_corners(fields).points.reshape(-1, 2), axis=0).max()
    height = CF(0.0) if pressure is None or peak <= 0 else 0.15 * extent / peak * pressure
    pushed = offset(fields, problem.touching_names, height, scale)
    lines = [
        ("obstacle", "#000000", obstacle_lines(fields, scale)),
        ("contact pressure", "#0072B2", pushed),
    ]
    return [
        {"type": "lines", "name": name, "color": colour,
         "position": np.pad(segments, ((0, 0), (0, 0), (0, 1))).ravel().tolist()}
        for name, colour, segments in lines
    ]  # fmt: skip


def _peak(sources: Mapping[str, object]) -> float:
    """Greatest contact pressure of all two-dimensional sources, 0 if there is none to speak of."""
    greatest = bound = 0.0
    for source in sources:
        fields = fields_of(source)
        problem, mesh = fields.problem, fields.problem.mesh
        if problem.N == 2 and problem.touching_names and hasattr(source, "contact_pressure"):
            touching = problem.touching_names, source.contact_pressure
            greatest = max(greatest, boundary_corners(fields, *touching).values.max())
            bound = max(bound, Integrate(as_scalar(problem.beta), mesh) / Integrate(1.0, mesh))
    return float(greatest) if greatest > NOISE * bound else 0.0


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
