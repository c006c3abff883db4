"""What the scripts of the gallery share: their command line, their way to check and to save."""

from argparse import ArgumentParser
from collections.abc import Callable
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from netgen.meshing import SetMessageImportance


def run(main: Callable[[Path, bool], str]) -> None:
    """Run a script: ``python NAME.py [--out DIR] [--coarse]``, one line of numbers, one picture."""
    parser = ArgumentParser(description=main.__doc__)
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder for the picture"
    )
    parser.add_argument(
        "--coarse", action="store_true", help="coarse meshes, a few seconds"
    )
    arguments = parser.parse_args()
    SetMessageImportance(0)
    print(main(arguments.out, arguments.coarse))


def check(name: str, value: float, exact: float, relative: float) -> str:
    """The text 'name value (exact exact)'; an AssertionError where they differ by more."""
    text = f"{name} {value:.5g} ({exact:.5g})"
    assert abs(value - exact) <= relative * abs(exact), (
        f"{text}: more than {relative:.1%} apart"
    )
    return text


def save(figure: Figure, out: Path, name: str) -> None:
    """Write ``out``/``name``.png."""
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / f"{name}.png", dpi=120)


def plain(axes: Axes, x: str, y: str) -> Axes:
    """Axes for curves, with their labels."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="#e3e6ea", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    return axes
