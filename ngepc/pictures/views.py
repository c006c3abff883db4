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
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import NamedTuple

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, to_hex
from ngsolve import BBND, BND, CF, VOL, CoefficientFunction, Mesh

from ngepc.checks.arguments import sample
from ngepc.checks.kinds import require_path, require_text
from ngepc.model.elements import vertex_coordinates
from ngepc.model.problem import Problem
from ngepc.pictures.cutting import Part, Plane
from ngepc.pictures.drawable import (
    Drawable,
    UnitNames,
    fields_of,
    on_one_scale,
    sources_of,
)
from ngepc.pictures.fields import Drawing
from ngepc.pictures.meshes import (
    UndeformedMesh,
    axis_names,
    body_colours,
    boundary_colours,
    drawn_mesh,
    is_mesh,
    legend_of_names,
    numbered,
)
from ngepc.pictures.sampling import (
    Corners,
    corners_of,
    is_curved,
    obstacle_lines,
    offset,
)
from ngepc.pictures.style import Picture, png_address, styled
from ngepc.results.fields import Fields
from ngepc.results.records import write_text

EXTRA = 'pip install "ngepc[html]"'
NOISE = 1e-3  # of the yield bound: lower contact pressures are not drawn at full height
LINES = {"obstacle": "#000000", "contact pressure": "#0072B2"}
"""Names and colours of lines in a view of a plane body."""
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
    body: str | None = None,
    boundary: str | None = None,
    cut: Plane | None = None,
    cmap: str | Colormap | None = None,
) -> View:
    """The deformed body coloured by a field, or a mesh with the names of its boundaries.

    Parameters
    ----------
    source
        A mesh or a ``Problem``, drawn before the deformation in the colours of its boundaries and
        bodies (then only ``title`` is used); or the result of a solver, ``Fields``, or a mapping
        of caption -> either, drawn on one colour scale: side by side, or with ``name`` one
        after the other on a slider.
    field
        Name of a field, 'contact_pressure' (3D), or a coefficient.
    title
        Heading of the page.
    name
        What the slider moves through: 'gamma', 'load step', ...; the captions stand beside it.
    deformation_scale, vmin, vmax, mesh_lines, units, body, boundary, cut, cmap
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
    require_text("name", name)
    require_text("title", title)
    if is_mesh(source):
        return _names_of(source, title)
    sources = sources_of("source", source)
    drawing = Drawing(deformation_scale, units, mesh_lines=mesh_lines)
    viewer_script()
    part = Part(body, boundary, cut)
    what, corners, colours = on_one_scale(
        sources.values(), field, drawing.units, (vmin, vmax), part, cmap
    )
    lines = lines_of(sources.values())
    shown = corners if not part.whole else [None] * len(sources)
    each = zip(sources.values(), what, shown, strict=True)
    scenes = [scene_of(*one, colours, drawing, lines) for one in each]
    captions, labels = ([""], list(sources)) if name else (list(sources), [""])
    panels = [scenes] if name else [[scene] for scene in scenes]
    bar = Picture(figsize=(3.6, 0.6))
    axes = bar.add_subplot()
    bar.colorbar(colours, cax=axes, orientation="horizontal", label=what[0].label)
    axes.locator_params(nbins=6)
    image = f'<img class="legend" src="{png_address(bar, 200)}" alt="colour scale">'
    contents = {"captions": captions, "labels": labels, "panels": panels}
    legend = legend_of_lines(lines)
    return _page(contents, drawing.caption(title), name, image, legend)


def _page(contents: dict, title: str, name: str, legend: str, lines: str) -> View:
    """The page with scenes, a legend of colours and one of lines."""
    data = gzip.compress(json.dumps(contents, default=float).encode(), mtime=0)
    texts = {
        "title": html.escape(title),
        "name": html.escape(name),
        "viewer": viewer_script(),
        "data": base64.b64encode(data).decode(),
        "legend": legend,
        "lines": lines,
    }
    return View(PAGE.substitute(texts))


def _names_of(source: Mesh | Problem, title: str) -> View:
    """A mesh in the colours of its boundaries and bodies."""
    mesh = drawn_mesh(source)
    plane = mesh.dim == 2
    colours = body_colours(mesh) if plane else boundary_colours(mesh)
    number = numbered(list(colours), "body" if plane else "boundary", mesh)
    lines = []
    for name, colour in boundary_colours(mesh).items() if plane else ():
        segments = corners_of(UndeformedMesh(mesh), where=name).points
        lines.append((name, to_hex(colour), segments))
    with np.errstate():
        from ngsolve.webgui import BuildRenderData
    data = BuildRenderData(
        mesh,
        number,
        order=2 if mesh.GetCurveOrder() > 1 else 1,
        draw_vol=False,
        regions={kind: kind for kind in (VOL, BND, BBND)},
        objects=webgui_lines(lines),
        settings=webgui_settings(axis_names(source), wireframe=True, edges=not plane),
    )
    table = list(colours.values())
    each = [table[k * len(table) // 64] for k in range(64)]
    data |= {"colors": each, "autoscale": False}
    data |= {"funcmin": -0.5, "funcmax": len(table) - 0.5}
    contents = {"captions": [""], "labels": [""], "panels": [[data]]}
    return _page(contents, title, "", "", legend_of_names(source))


def webgui_lines(lines: Iterable[tuple[str, str, np.ndarray]]) -> list[dict]:
    """Named and coloured segments in the plane, for webgui."""
    return [
        {
            "type": "lines",
            "name": name,
            "color": colour,
            "position": np.pad(segments, ((0, 0), (0, 0), (0, 1))).ravel().tolist(),
        }
        for name, colour, segments in lines
    ]


def webgui_settings(axes: tuple[str, ...], wireframe: bool, edges: bool = True) -> dict:
    """Settings of webgui: without its own colour bar, plane bodies without shadows."""
    plane = len(axes) == 2
    ambient = 1.0 if plane else 0.65
    light = {"ambient": ambient, "diffuse": 1 - ambient}
    settings = {
        "axes_labels": [*axes, ""][:3],
        "Objects": {"Wireframe": wireframe, "Edges": edges, "Colorbar": False},
        "Colormap": {"ncolors": 64},
        "Light": light | {"shininess": 10, "specularity": 0.0},
    }
    if not plane:
        settings["camera"] = {"euler_angles": [-65.0, 0.0, -30.0]}
    return settings


class Lines(NamedTuple):
    """Names of the lines beside a plane body, and the pressure (stress) at full height."""

    names: tuple[str, ...]
    peak: float


def lines_of(sources: Collection[object]) -> Lines:
    """The lines that pictures of these sources have.

    Two bodies have no obstacle, ``Fields`` have no contact pressure.
    """
    problems = [fields_of(one).problem for one in sources]
    drawn = {
        "obstacle": any(p.N == 2 and p.contact_names for p in problems),
        "contact pressure": any(
            p.N == 2 and p.touching_names and hasattr(one, "contact_pressure")
            for p, one in zip(problems, sources, strict=True)
        ),
    }
    return Lines(tuple(n for n in LINES if drawn[n]), pressure_peak(sources))


def legend_of_lines(lines: Lines) -> str:
    """The legend of the lines beside a plane body, as HTML."""
    parts = [f'<b style="color:{LINES[n]}">—</b> {n}' for n in lines.names]
    return " &ensp; ".join(parts)


def scene_of(
    source: object,
    drawn: Drawable,
    corners: Corners | None,
    colours: ScalarMappable,
    drawing: Drawing,
    lines: Lines,
    outline: Corners | None = None,
) -> dict:
    """The data with which webgui draws a scalar on the deformed body, for JSON.

    In 2D the obstacle and the contact pressure over the deformed boundary are ``lines``, the peak
    is drawn 0.15 times as high as the body is large.  ``corners`` are triangles to draw in place of
    the whole body, and ``outline`` the segments around them.  Every scene of a slider has the same
    lines: webgui keeps the list of the first one.
    """
    fields = fields_of(source)
    scale = drawing.deformation_scale
    segments = {
        "obstacle": lambda: obstacle_lines(fields, scale),
        "contact pressure": lambda: _pressure_line(source, lines.peak, scale),
    }
    objects = webgui_lines((n, LINES[n], segments[n]()) for n in lines.names)
    settings = webgui_settings(axis_names(fields.problem), drawing.mesh_lines)
    if corners is None:
        data = _whole_body(fields, drawn, scale, objects, settings)
    else:
        data = triangles(corners, scale, outline)
        data |= {"mesh_dim": fields.problem.N, "objects": objects}
        data |= {"gui_settings": settings}
    limits = {
        "funcmin": colours.norm.vmin,
        "funcmax": colours.norm.vmax,
        "autoscale": False,
    }
    colors = colours.cmap(np.linspace(0.0, 1.0, 64))[:, :3].tolist()
    return data | limits | {"deformation_scale": 1.0, "colors": colors}


def _pressure_line(source: object, peak: float, scale: float) -> np.ndarray:
    """Segments of the contact pressure over the deformed boundary; none without contact."""
    fields = fields_of(source)
    names = fields.problem.touching_names
    if not names:
        return np.empty((0, 2, 2))
    extent = np.ptp(vertex_coordinates(fields.problem.mesh), axis=0).max()
    height = 0.15 * extent / peak * getattr(source, "contact_pressure", CF(0.0))
    return offset(fields, names, height, scale)


def _whole_body(
    fields: Fields, drawn: Drawable, scale: float, objects: list[dict], settings: dict
) -> dict:
    """The data with which webgui draws the elements of a mesh."""
    with np.errstate():  # its import changes numpy's error state
        from ngsolve.webgui import BuildRenderData
    return BuildRenderData(
        fields.problem.mesh,
        drawn.coefficient,
        order=2 if is_curved(fields) else 1,
        draw_vol=False,
        deformation=scale * fields.displacement,
        regions={kind: kind for kind in (VOL, BND, BBND)},
        objects=objects,
        settings=settings,
    )


def triangles(corners: Corners, scale: float, outline: Corners | None = None) -> dict:
    """The data with which webgui draws triangles, and segments of an outline, for a mesh."""
    places = _positions(corners, scale)
    values = corners.values[..., None]
    low = places.min(axis=(0, 1))
    high = places.max(axis=(0, 1))
    ends = np.zeros((0, 2, 3)) if outline is None else _positions(outline, scale)
    return {
        "order2d": 1,
        "draw_surf": True,
        "draw_vol": False,
        "funcdim": 1,
        "show_wireframe": False,
        "show_mesh": True,
        "Bezier_trig_points": _encoded(np.concatenate([places, values], axis=2)),
        "Bezier_points": [],
        "edges": _encoded(np.pad(ends, ((0, 0), (0, 0), (0, 1)))),
        "mesh_center": (0.5 * (low + high)).tolist(),
        "mesh_radius": float(np.linalg.norm(high - low) / 2),
    }


def _positions(corners: Corners, scale: float) -> np.ndarray:
    """Deformed positions with three coordinates each."""
    points = corners.deformed(scale)
    return np.pad(points, ((0, 0), (0, 0), (0, 3 - points.shape[2])))


def _encoded(pieces: np.ndarray) -> list[str]:
    """The first corner of all pieces, the second one, and so on, as webgui reads them."""
    with np.errstate():
        from ngsolve.webgui import encodeData
    corners = np.ascontiguousarray(pieces.swapaxes(0, 1), dtype=np.float32)
    return [encodeData(corner, dtype=np.float32) for corner in corners]


def pressure_peak(sources: Iterable[object]) -> float:
    """Greatest contact pressure of the sources, not below ``NOISE`` of the yield bound.

    Its absolute value: a regularised state has pressures of either sign.
    """
    peaks = []
    for source in sources:
        problem = fields_of(source).problem
        if problem.touching_names and hasattr(source, "contact_pressure"):
            where = "|".join(problem.touching_names)
            touching = corners_of(fields_of(source), source.contact_pressure, where)
            peaks += [
                np.abs(touching.values).max(),
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
