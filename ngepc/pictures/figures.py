"""The standard set of figures of one result, as PNG files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from ngepc.pictures.curves import plot_contact_pressure, plot_history
from ngepc.pictures.fields import (
    plot_field,
    plot_plastic_zone,
    plot_yield_function,
)

THRESHOLDS = {"lshape": 0.1, "wrench": 1e-2}
"""The |p|_F above which the paper's Figures 2 and 6 show the plastic zone."""

DPI = 150


def write_figures(name: str, result: object, folder: Path) -> list[Path]:
    """Deformed body with |p|_F, yield function, plastic zone, pressure, residual history.

    Parameters
    ----------
    name
        Name of the example, which sets the threshold of the plastic zone.
    result
        A result of any solver.
    folder
        Made if missing.
    """
    threshold = THRESHOLDS[name]
    figures = {
        "plastic_strain": plot_field(result, "equivalent_plastic_strain"),
        "yield_function": plot_yield_function(result),
        "plastic_zone": plot_plastic_zone(result, threshold),
        "residuals": plot_history(result.history),
    }
    if result.problem.contact_names:
        figures["contact_pressure"] = plot_contact_pressure(result)
    return [save(figure, folder / f"{name}_{what}.png") for what, figure in figures.items()]


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, making its folder; returns the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)
    return path
