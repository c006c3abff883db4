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

from ngepc.plotting.page import Panel, frame, page
from ngepc.plotting.page import viewer_installed as viewer_installed
from ngepc.plotting.scenes import ViewOptions as ViewOptions
from ngepc.plotting.scenes import scenes_of
from ngepc.storage.records import write_text


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
        write_text(Path(path), self.html)
        return Path(path)


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
    options = options or ViewOptions()
    scenes, legend = scenes_of(sources, field, options)
    panels = [Panel("scene", caption, [data]) for caption, data in scenes.items()]
    return View(page(title, panels, legend=legend), options.height)


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
    options = options or ViewOptions()
    scenes, legend = scenes_of(sources, field, options)
    panel = Panel("scene", "", list(scenes.values()))
    return View(page(title, [panel], list(scenes), name, legend), options.height)


def slide_figures(
    figures: Mapping[str, Figure | Sequence[Figure]], title: str = "", name: str = ""
) -> View:
    """A slider through matplotlib figures (one or several side by side); needs no viewer."""
    rows = [[f] if isinstance(f, Figure) else list(f) for f in figures.values()]
    if not rows or len({len(row) for row in rows}) != 1:
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
    """
    options = options or ViewOptions()
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
