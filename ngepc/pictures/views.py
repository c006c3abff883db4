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
) -> View:
    """The deformed body coloured by a field, to turn and zoom in a notebook.

    Parameters
    ----------
    source
        Result of a solver, or ``Fields``.
    field
        Name of a field, 'contact_pressure' (3D), or a coefficient.
    options, title
        How it is drawn, heading.

    Raises
    ------
    ImportError
        If the viewer is not installed; the message says what to install.
    """
    return compare({"": source}, field, options, title)


def compare(
    sources: Mapping[str, object],
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    options: ViewOptions | None = None,
    title: str = "",
) -> View:
    """Several results side by side on one colour scale; ``sources`` maps captions to results."""
    options = checked(sources, options, title=title)
    scenes, what, limits = scenes_of(sources, field, options)
    panels = {name: [data] for name, data in scenes.items()}
    return View(_page(title, legend(what, limits), panels), options.height)


def slide(
    sources: Mapping[str, object],
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    options: ViewOptions | None = None,
    title: str = "",
    name: str = "",
) -> View:
    """One scene with a slider through results: over gamma, load steps or Newton iterates.

    ``sources`` maps the text beside the slider to results, in the order of the slider; ``name`` is
    what it moves through, such as 'gamma'.
    """
    options = checked(sources, options, title=title, name=name)
    scenes, what, limits = scenes_of(sources, field, options)
    panels = {"": list(scenes.values())}
    return View(_page(title, legend(what, limits), panels, list(scenes), name), options.height)


def checked(sources: object, options: ViewOptions | None, **texts: object) -> ViewOptions:
    """The options, the defaults for None, after a look at the other arguments of a view."""
    require_sources(sources)
    for name, text in texts.items():
        require_text(name, text)
    return _options(options)


def _options(options: ViewOptions | None) -> ViewOptions:
    options = ViewOptions() if options is None else options
    require_instance("options", options, ViewOptions, "ViewOptions(...) or None")
    return options


def legend(what: Drawable, limits: ColourRange) -> str:
    """The colour scale as HTML: label, colours, values at the ends and between."""
    shades = ",".join(map(to_hex, colormaps[what.colormap](np.linspace(0, 1, 10))))
    values = [f"{float(f'{v:.3g}'):g}" for v in np.linspace(limits.least, limits.most, 5)]
    values[0] = ("≤ " if limits.below else "") + values[0]
    values[-1] = ("≥ " if limits.above else "") + values[-1]
    ticks = "".join(f"<span>{value.replace('-', '−')}</span>" for value in values)
    return (
        f'<div class="legend">{html.escape(what.plain_label)}'
        f'<div class="scale" style="background:linear-gradient(90deg,{shades})"></div>'
        f'<div class="ticks">{ticks}</div></div>'
    )


def _page(
    title: str,
    scale: str,
    panels: Mapping[str, list[dict]],
    labels: list[str] | None = None,
    name: str = "",
) -> str:
    """The HTML of panels side by side (caption -> frames), with a slider for several labels."""
    labels = [""] if labels is None else labels
    data = json.dumps({"labels": labels, "panels": list(panels.values())}, default=float)
    packed = base64.b64encode(gzip.compress(data.encode(), mtime=0)).decode()
    figures = (
        f'<figure><figcaption>{html.escape(caption)}</figcaption><div class="place" '
        f'id="place-{k}"></div></figure>'
        for k, caption in enumerate(panels)
    )
    many = len(labels) > 1
    return PAGE.substitute(
        title=html.escape(title or "ngepc"),
        heading=f"<h1>{html.escape(title)}</h1>" if title else "",
        legend=scale,
        figures="".join(figures),
        slider=SLIDER.format(name=html.escape(name), last=len(labels) - 1) if many else "",
        data=packed,
        viewer=viewer_script(),
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
        raise ImportError(
            "interactive views need the package webgui_jupyter_widgets, which brings NGSolve's "
            f"viewer for offline use: {EXTRA}"
        )
    origin = importlib.util.find_spec("webgui_jupyter_widgets").origin
    return (Path(origin).parent / "js" / "webgui.js").read_text(encoding="utf-8")
