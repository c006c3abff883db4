"""Webgui data of results: the deformed body coloured by a field, obstacle and pressure lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from ngsolve import CF, CoefficientFunction, Integrate, Region

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_flag
from ngepc.model.problem import as_scalar
from ngepc.pictures.curves import pressure_curves
from ngepc.pictures.drawable import Drawable, UnitNames, drawable, fields_of, unit_names
from ngepc.pictures.sampling import (
    ColourRange,
    boundary_corners,
    colour_range,
    obstacle_lines,
    offset,
    pressure_on_boundary,
    sample_corners,
    visible,
)

EXTRA = 'pip install "ngepc[html]"'
NOISE = 1e-3
"""Contact pressures below this part of the yield bound are not drawn."""


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """How scenes are drawn.

    Parameters
    ----------
    deformation_scale
        Factor >= 0 on the displacement; 0 draws the body before the deformation.
    vmin, vmax
        Ends of the colour scale; by default as in ``plot_field``.
    mesh_lines
        Whether to draw the edges of the elements.
    contact_lines
        In 2D: whether to draw the obstacle and the contact pressure as lines.
    units
        Names of the units in captions.
    height
        Height of the frame in a notebook (pixels).
    """

    deformation_scale: float = 1.0
    vmin: float | None = None
    vmax: float | None = None
    mesh_lines: bool = False
    contact_lines: bool = True
    units: UnitNames | None = None
    height: int = 480

    def __post_init__(self) -> None:
        require_number("deformation_scale", self.deformation_scale, 0.0)
        require_number("height", self.height, 100)
        require_flag("mesh_lines", self.mesh_lines)
        require_flag("contact_lines", self.contact_lines)
        unit_names(self.units)
        for name in ("vmin", "vmax"):
            require_number(name, 0.0 if getattr(self, name) is None else getattr(self, name))


def scenes_of(
    sources: Mapping[str, object], field: str | CoefficientFunction, options: ViewOptions
) -> tuple[dict[str, dict], Drawable, ColourRange]:
    """Webgui data of each source on one colour scale, and what that scale is."""
    drawn = {key: _drawn(source, field, options) for key, source in sources.items()}
    samples = [sample_corners(fields_of(s), *drawn[key][1:]) for key, s in sources.items()]
    what, *_ = next(iter(drawn.values()))
    limits = colour_range(*samples, vmin=options.vmin, vmax=options.vmax, symmetric=what.signed)
    colours = colormaps[what.colormap](np.linspace(0.0, 1.0, 64))[:, :3].tolist()
    peak = _peak(sources)
    scenes = {
        key: scene_data(source, drawn[key][2], limits, options, peak) | {"colors": colours}
        for key, source in sources.items()
    }
    return scenes, what, limits


def _drawn(
    source: object, field: str | CoefficientFunction, options: ViewOptions
) -> tuple[Drawable, Region, CoefficientFunction]:
    """What is drawn of a source, where, and its values there."""
    problem = fields_of(source).problem
    if not isinstance(field, str) or field != "contact_pressure":
        what = drawable(source, field, options.units)
        return what, *visible(problem.mesh, what.coefficient)
    if not problem.touching_names or problem.N == 2:
        raise ValueError("field='contact_pressure': a solid with a contact boundary is needed")
    label = f"contact pressure ({unit_names(options.units).stress})"
    what = Drawable(pressure_on_boundary(source), label, label, colormap="YlGnBu")
    return what, problem.mesh.Boundaries(".*"), what.coefficient


def scene_data(
    source: object,
    coefficient: CoefficientFunction,
    limits: ColourRange,
    options: ViewOptions,
    peak: float = 0.0,
) -> dict:
    """What webgui needs to draw a scalar on the deformed body, ready for JSON.

    ``peak`` is the contact pressure drawn at full height in 2D, 0 for none.
    """
    fields = fields_of(source)
    problem = fields.problem
    deformation = options.deformation_scale * fields.displacement
    if problem.N == 2:
        deformation = CF((deformation[0], deformation[1], 0.0))
    curved = max(problem.mesh.GetCurveOrder(), fields.displacement.space.globalorder) > 1
    drawing = {
        "order": 2 if curved else 1,
        "draw_vol": False,
        "draw_surf": True,
        "nodal_p1": False,
        "interpolate_multidim": False,
        "animate": False,
        "deformation": deformation,
        "scale": 1.0,
        "min": limits.least,
        "max": limits.most,
        "autoscale": False,
        "objects": _contact_lines(source, options, peak),
        "settings": _settings(problem.N, options),
    }
    kind = webgui_scene()
    scene = kind.__new__(kind)  # its constructor makes a widget, which keeps a second copy
    vars(scene).update(obj=coefficient, args=[problem.mesh], kwargs=drawing, encoding="b64")
    return scene.GetData()


def _settings(N: int, options: ViewOptions) -> dict:
    ambient = 1.0 if N == 2 else 0.65
    light = {"ambient": ambient, "diffuse": 1.0 - ambient, "shininess": 10, "specularity": 0.0}
    camera = {} if N == 2 else {"camera": {"euler_angles": [-65.0, 0.0, -30.0]}}
    objects = {"Wireframe": options.mesh_lines, "Edges": True, "Colorbar": False}
    return {"Objects": objects, "Colormap": {"ncolors": 64}, "Light": light, **camera}


def webgui_scene() -> type:
    """NGSolve's scene for browsers, imported without its change of numpy's error state."""
    with np.errstate():
        from ngsolve.webgui import WebGLScene
    return WebGLScene


def _contact_lines(source: object, options: ViewOptions, peak: float) -> list[dict]:
    """The obstacle and the pressure curve over the deformed contact boundary of a 2D body.

    Every scene of a slider has the same lines: webgui keeps the list of the first one.
    """
    fields = fields_of(source)
    problem = fields.problem
    if problem.N != 2 or not problem.touching_names or not options.contact_lines:
        return []
    scale, pressure = options.deformation_scale, getattr(source, "contact_pressure", None)
    extent = np.ptp(boundary_corners(fields).points.reshape(-1, 2), axis=0).max()
    height = CF(0.0) if pressure is None or peak <= 0 else 0.15 * extent / peak * pressure
    pushed = offset(fields, problem.touching_names, height, scale)
    lines = {"obstacle": ("#000000", obstacle_lines(fields, scale))}
    lines["contact pressure"] = ("#0072B2", pushed)
    in_space = {n: np.pad(s, ((0, 0), (0, 0), (0, 1))).ravel() for n, (_, s) in lines.items()}
    return [
        {"type": "lines", "name": n, "color": lines[n][0], "position": points.tolist()}
        for n, points in in_space.items()
    ]


def _peak(sources: Mapping[str, object]) -> float:
    """Greatest contact pressure of all two-dimensional sources, 0 if there is none to speak of."""
    greatest = bound = 0.0
    for source in sources.values():
        problem = fields_of(source).problem
        touches = hasattr(source, "contact_pressure") and problem.touching_names
        if problem.N != 2 or not touches:
            continue
        greatest = max(greatest, *(float(p.max()) for _, p in pressure_curves(source)))
        mesh = problem.mesh
        bound = max(bound, Integrate(as_scalar(problem.beta), mesh) / Integrate(1.0, mesh))
    return greatest if greatest > NOISE * bound else 0.0
