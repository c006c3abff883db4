"""The style of all figures: style sheet, colours, and figures that notebooks display.

Where a script has imported ``matplotlib.pyplot``, a new picture is its current figure, so that
``plt.savefig``, ``plt.title`` and ``plt.show`` find it.  No pyplot state is touched in notebooks
and servers.
"""

import base64
import io
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from matplotlib import rc_context, rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import Locator, LogLocator, MaxNLocator, NullFormatter

from ngepc.checks.arguments import require_number
from ngepc.checks.kinds import require_function, require_instance
from ngepc.results.files import replace_contents

RC = rc_params_from_file(
    Path(__file__).with_name("ngepc.mplstyle"), use_default_template=False
)
COLOURS = tuple(entry["color"] for entry in RC["axes.prop_cycle"])
"""Okabe and Ito's colours and a wine red, which people with any colour vision tell apart."""

ELASTIC = "#dfe3e8"
PLASTIC = "#26323f"
CONTACT = "#D55E00"
OUTLINE = "#9aa3ad"
DEFORMED = "#3b4650"
OBSTACLE = "#000000"
GUIDE = "#6b7680"

styled = rc_context(RC)
"""Decorator of functions that draw in the style of ``ngepc.mplstyle``."""


class Picture(Figure):
    """A Figure in this style with a PNG representation, so that no pyplot is needed to see it."""

    __init__ = styled(Figure.__init__)

    @styled
    def add_subplot(self, *arguments: object, **options: object) -> Axes:
        """Axes in this style, also those of ``subplots``."""
        return super().add_subplot(*arguments, **options)

    def like(self, drawn: Figure) -> "Picture":
        """The same figure with the axes of a drawn one, which halves the time of the layout."""
        require_instance("drawn", drawn, Figure, "a Figure")
        self.set_layout_engine("none")
        for own, place in zip(self.axes, drawn.axes, strict=True):
            own.set_position(place.get_position(original=True))
        return self

    def _repr_png_(self) -> bytes:
        return png(self)


def new_picture(**options: object) -> Picture:
    """A picture for the user: pyplot's current figure where the script has imported pyplot.

    Not in threads, in which servers draw, nor in notebooks, which show a picture themselves and
    would show it twice.  ``options`` are those of ``Figure``.
    """
    pyplot = sys.modules.get("matplotlib.pyplot")
    main = threading.current_thread() is threading.main_thread()
    if pyplot is None or not main or in_notebook():
        return Picture(**options)
    return pyplot.figure(FigureClass=Picture, **options)


def require_axes(axes: Axes | None) -> Axes | None:
    """Axes of matplotlib, or None for those of a new figure; TypeError for anything else."""
    if axes is None:
        return None
    return require_instance("axes", axes, Axes, "matplotlib Axes or None")


def in_notebook() -> bool:
    """Whether a kernel of Jupyter runs this."""
    ipython = sys.modules.get("IPython")
    return ipython is not None and hasattr(ipython.get_ipython(), "kernel")


def put_away(figure: Figure) -> None:
    """Take a picture that has been shown or written out of pyplot's list; it stays usable."""
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None and isinstance(figure, Picture):
        pyplot.close(figure)


def png(figure: Figure, dpi: float | str = "figure") -> bytes:
    """A figure as the contents of a PNG file, for pages and notebooks."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi)
    put_away(figure)
    return stream.getvalue()


def png_address(figure: Figure, dpi: float = 120) -> str:
    """A figure as a data address, for the ``src`` of an HTML image."""
    return f"data:image/png;base64,{base64.b64encode(png(figure, dpi)).decode()}"


def line_style(index: int, count: int) -> dict:
    """Colour and marker of the curve number ``index`` with ``count`` points."""
    colour = COLOURS[index % len(COLOURS)]
    marker = "os^Dv<>P"[index % 8]
    return {"color": colour, "marker": marker, "markevery": max(1, count // 20)}


@styled
def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of its suffix (png, pdf, svg), making its folder."""
    stream = io.BytesIO()
    figure.savefig(stream, format=path.suffix[1:] or None)
    put_away(figure)
    replace_contents(path, stream.getvalue())
    return path


@styled
def beside(
    *panels: Callable[[Axes], object], width: float = 4.6, height: float = 4.0
) -> Picture:
    """Pictures side by side, as in the paper's Figures 2, 5 and 6, of ``width`` times ``height``.

    Each panel is a function that draws into the axes which it gets:
    ``beside(lambda a: plot_field(r, axes=a), lambda a: plot_plastic_zone(r, 0.1, axes=a))``.
    """
    if not panels:
        raise ValueError("panels=(): at least one panel is needed")
    for number, panel in enumerate(panels):
        require_function(f"panels[{number}]", panel, "axes")
    require_number("width", width, 0, strict=True)
    require_number("height", height, 0, strict=True)
    figure = new_picture(figsize=(width * len(panels), height), layout="compressed")
    for axes, draw in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        draw(axes)
    return figure


def counts_along(axes: Axes, label: str) -> None:
    """A logarithmic axis of numbers of nodes or unknowns below what has been drawn.

    Its ticks are whole numbers, and less than a decade has some, too.
    """
    axes.set(xscale="log", xlabel=label)
    least, most = axes.get_xlim()
    ticks: Locator = LogLocator(subs=(1, 2, 5))
    if most < 10 * least:
        ticks = MaxNLocator(5, integer=True)
    axes.xaxis.set_major_locator(ticks)
    axes.xaxis.set_major_formatter("{x:,.0f}")
    axes.xaxis.set_minor_formatter(NullFormatter())
