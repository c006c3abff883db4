"""Interactive views of results: in notebooks, and as HTML pages that work without network.

A ``View`` shows itself when it is the last line of a notebook cell; ``save`` writes the same page
to a file.  The drawing is NGSolve's webgui (extra ``notebook``).
"""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from matplotlib.figure import Figure
from ngsolve import CoefficientFunction

from ngepc.checks.kinds import (
    require_flag,
    require_instance,
    require_mapping,
    require_path,
    require_text,
)
from ngepc.pictures.drawable import require_sources
from ngepc.pictures.page import Panel, frame, page
from ngepc.pictures.page import viewer_installed as viewer_installed
from ngepc.pictures.scenes import ViewOptions as ViewOptions
from ngepc.pictures.scenes import scenes_of
from ngepc.results.records import write_text


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

    html: str
    height: int = 480

    def _repr_html_(self) -> str:
        return frame(self.html, self.height)

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

    Raises
    ------
    ImportError
        If the viewer is not installed; the message says what to install.
    TypeError, ValueError
        For an unknown field.
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
    scenes, legend = scenes_of(sources, field, options)
    panels = [Panel("scene", caption, [data]) for caption, data in scenes.items()]
    return View(page(title, panels, legend=legend), options.height)


def checked(sources: object, options: ViewOptions | None, **texts: object) -> ViewOptions:
    """The options, the defaults for None, after a look at the other arguments of a view."""
    require_sources(sources)
    for name, text in texts.items():
        require_text(name, text)
    options = ViewOptions() if options is None else options
    require_instance("options", options, ViewOptions, "ViewOptions(...) or None")
    return options


def slide(
    sources: Mapping[str, object],
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    options: ViewOptions | None = None,
    title: str = "",
    name: str = "",
) -> View:
    """One scene with a slider through results: over gamma, load steps or Newton iterates.

    Parameters
    ----------
    sources
        Text beside the slider -> result, in the order of the slider.
    name
        What the slider moves through, such as 'gamma'.
    """
    options = checked(sources, options, title=title, name=name)
    scenes, legend = scenes_of(sources, field, options)
    panel = Panel("scene", "", list(scenes.values()))
    return View(page(title, [panel], list(scenes), name, legend), options.height)


def slide_figures(
    figures: Mapping[str, Figure | Sequence[Figure]], title: str = "", name: str = ""
) -> View:
    """A slider through matplotlib figures (one or several side by side); needs no viewer."""
    require_mapping("figures", figures, "label -> figure")
    require_text("title", title)
    require_text("name", name)
    rows = [list(f) if isinstance(f, Sequence) else [f] for f in figures.values()]
    for label, row in zip(figures, rows, strict=True):
        for figure in row:
            require_instance(f"figures[{label!r}]", figure, Figure, "a matplotlib Figure")
    if len({len(row) for row in rows}) != 1:
        raise ValueError(
            f"figures={list(figures)!r}: the same number of figures for each label is needed"
        )
    panels = [
        Panel("image", "", [png_address(figure) for figure in column])
        for column in zip(*rows, strict=True)
    ]
    return View(page(title, panels, list(figures), name))


def export_html(
    source: object,
    path: str | os.PathLike,
    field: str | CoefficientFunction = "equivalent_plastic_strain",
    deformation: bool = True,
    *,
    title: str = "",
    options: ViewOptions | None = None,
) -> Path:
    """Write an interactive page of a result that opens from disk without network.

    Parameters
    ----------
    source
        Result of a solver, ``Fields``, or a mapping of slider label -> either.
    path
        The file to write; its folder is made.
    field, title, options
        As in ``show``.
    deformation
        Whether to draw the deformed body.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ImportError
        If the viewer is not installed; the message says what to install.
    TypeError, ValueError
        If an argument is not legal.
    """
    path = require_path("path", path)
    require_flag("deformation", deformation)
    options = ViewOptions() if options is None else options
    require_instance("options", options, ViewOptions, "ViewOptions(...) or None")
    if not deformation:
        options = replace(options, deformation_scale=0.0)
    draw = slide if isinstance(source, Mapping) else show
    return draw(source, field, options, title).save(path)


def png_address(figure: Figure | Path, dpi: int = 120) -> str:
    """A figure or a PNG file as a data address, for the ``src`` of an HTML image.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    stream = io.BytesIO()
    if isinstance(figure, Figure):
        figure.savefig(stream, format="png", dpi=dpi)
    else:
        stream.write(figure.read_bytes())
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode("ascii")
