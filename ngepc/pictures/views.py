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
from matplotlib import colormaps
from matplotlib.colors import to_hex
from ngsolve import CoefficientFunction

from ngepc.checks.kinds import require_instance, require_path, require_text
from ngepc.pictures.drawable import Drawable, require_sources
from ngepc.pictures.sampling import ColourRange
from ngepc.pictures.scenes import EXTRA, ViewOptions, scenes_of
from ngepc.results.records import write_text

PAGE = Template(Path(__file__).with_name("page.html").read_text(encoding="utf-8"))
SLIDER = (
    '<footer><button id="play" title="play">▶</button><label for="slider">{name}</label>'
    '<input type="range" id="slider" min="0" max="{last}" value="0">'
    '<output id="label" for="slider"></output></footer>'
)


@dataclass(frozen=True, eq=False)
class View:
    """A page that notebooks show in place.

    Parameters
    ----------
    html
        The whole page.
    height
        Height of the frame in a notebook (pixels).
    """

    html: str = field(repr=False)
    height: int = 480

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.html)}" loading="lazy" title="interactive view" '
            f'style="width:100%;height:{self.height}px;box-sizing:border-box;'
            'border:1px solid #8884"></iframe>'
        )

    def save(self, path: str | os.PathLike) -> Path:
        """Write the page to ``path``, making its folder; returns the path."""
        path = require_path("path", path)
        write_text(path, self.html)
        return path


def show(
    source: object,
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    options: ViewOptions | None = None,
    title: str = "",
    name: str = "",
) -> View:
    """The deformed body coloured by a field, to turn and zoom.

    Parameters
    ----------
    source
        Result of a solver, ``Fields``, or a mapping of caption -> either, drawn on one colour
        scale: side by side, or with ``name`` one after the other on a slider.
    field
        Name of a field, 'contact_pressure' (3D), or a coefficient.
    options, title
        How it is drawn, heading.
    name
        What the slider moves through: 'gamma', 'load step', ...; the captions stand beside it.

    Raises
    ------
    ImportError
        If the viewer is not installed; the message says what to install.
    """
    sources = source if isinstance(source, Mapping) else {"": source}
    require_sources(sources)
    require_text("title", title)
    require_text("name", name)
    options = ViewOptions() if options is None else options
    require_instance("options", options, ViewOptions, "ViewOptions(...) or None")
    viewer = viewer_script()
    scenes, what, limits = scenes_of(sources, field, options)
    panels = {"": list(scenes.values())} if name else {key: [data] for key, data in scenes.items()}
    labels = list(scenes) if name else [""]
    data = json.dumps({"labels": labels, "panels": list(panels.values())}, default=float)
    places = (
        f"<figure><figcaption>{html.escape(caption)}</figcaption>"
        f'<div class="place" id="place-{number}"></div></figure>'
        for number, caption in enumerate(panels)
    )
    page = PAGE.substitute(
        title=html.escape(title or "ngepc"),
        heading=f"<h1>{html.escape(title)}</h1>" if title else "",
        legend=legend(what, limits),
        figures="".join(places),
        slider=SLIDER.format(name=html.escape(name), last=len(labels) - 1) if name else "",
        data=base64.b64encode(gzip.compress(data.encode(), mtime=0)).decode(),
        viewer=viewer,
    )
    return View(page, options.height)


def legend(what: Drawable, limits: ColourRange) -> str:
    """The colour scale as HTML: label, colours, values at the ends and between."""
    shades = ",".join(map(to_hex, colormaps[what.colormap](np.linspace(0, 1, 10))))
    values = [f"{float(f'{v:.3g}'):g}" for v in np.linspace(limits.least, limits.most, 5)]
    values[0] = "≤ " * limits.below + values[0]
    values[-1] = "≥ " * limits.above + values[-1]
    ticks = "".join(f"<span>{value.replace('-', '−')}</span>" for value in values)
    return (
        f'<div class="legend">{html.escape(what.plain_label)}'
        f'<div class="scale" style="background:linear-gradient(90deg,{shades})"></div>'
        f'<div class="ticks">{ticks}</div></div>'
    )


def viewer_installed() -> bool:
    """Whether the viewer's script is there, so that interactive pages can be made."""
    found = importlib.util.find_spec("webgui_jupyter_widgets")
    return found is not None and found.origin is not None


def viewer_script() -> str:
    """The JavaScript of NGSolve's viewer.

    Raises
    ------
    ImportError
        If it is not installed; the message says what to install.
    """
    if not viewer_installed():
        raise ImportError(f"interactive views need webgui_jupyter_widgets: {EXTRA}")
    origin = importlib.util.find_spec("webgui_jupyter_widgets").origin
    return (Path(origin).parent / "js" / "webgui.js").read_text(encoding="utf-8")
