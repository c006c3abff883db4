"""A matplotlib Figure that notebooks show by themselves, and pictures side by side."""

import io
from collections.abc import Callable

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_flag, require_function


class Picture(Figure):
    """A Figure with a PNG representation, so that no pyplot is needed to see it."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=110)
        return stream.getvalue()


def beside(
    *panels: Callable[[Axes], object], width: float = 4.6, height: float = 4.0, three: bool = False
) -> Picture:
    """Pictures side by side, as in the paper's Figures 2, 5 and 6.

    Parameters
    ----------
    panels
        Functions that draw into the axes which they get:
        ``beside(lambda a: plot_field(r, axes=a), lambda a: plot_plastic_zone(r, 0.1, axes=a))``.
    width, height
        Inches of one panel.
    three
        Whether the axes are for 3D bodies.

    Raises
    ------
    TypeError, ValueError
        If there are no panels, or an argument is not legal.
    """
    if not panels:
        raise ValueError("panels=(): at least one panel is needed")
    for number, panel in enumerate(panels):
        require_function(f"panels[{number}]", panel, "axes")
    require_number("width", width, 0, strict=True)
    require_number("height", height, 0, strict=True)
    require_flag("three", three)
    figure = Picture(figsize=(width * len(panels), height), layout="compressed")
    projection = {"projection": "3d"} if three else {}
    every = figure.subplots(1, len(panels), squeeze=False, subplot_kw=projection)[0]
    for draw, axes in zip(panels, every, strict=True):
        draw(axes)
    return figure
