"""The stress-strain curve of a material, as of a bar that is pulled and pushed."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ngepc.checks.arguments import is_number, require_number
from ngepc.checks.kinds import require_instance, require_mapping
from ngepc.evolution.material_point import material_point, value_in_the_middle
from ngepc.model.material import Material
from ngepc.model.viscosity import SLOWEST
from ngepc.pictures.drawable import UnitNames, require_units
from ngepc.pictures.style import COLOURS, GUIDE, new_picture, require_axes, styled

BEYOND = 10.0  # largest strain of a picture over that at which a bar yields
STEPS = 60  # of each of the five ways, all of the same length
OVERSTRESSES = (0.1, 0.3, 1.0)  # of a material with a rate, over its yield stress


@styled
def plot_material(
    materials: Material | Mapping[str, Material],
    strain: float | None = None,
    *,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The stress of a bar that is pulled, pushed as far, and pulled again.

    A material with a rate has three curves, each at a constant rate of strain that the legend
    shows: those at which the overstress is 0.1, 0.3 and 1 times the yield stress, rounded to one
    digit.  ``material_point`` has curves at other rates, and relaxation.

    Parameters
    ----------
    materials
        A material, or label -> material; of coefficients the value at the middle of the unit cube
        counts.
    strain
        The largest axial strain (1); None for ten times that at which the first bar yields.
    units
        Names of the units.
    axes
        What to draw into, by default those of a new figure.

    Returns
    -------
    Figure
        Axial stress over axial strain; the way back is thinner.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal, or ``strain`` is missing where data are coefficients.
    """
    given = {"": materials} if isinstance(materials, Material) else materials
    require_mapping("materials", given, "label -> Material, or a Material")
    for label, material in given.items():
        require_instance(f"materials[{label!r}]", material, Material, "a Material")
    units = require_units("units", units)
    axes = require_axes(axes)
    strain = _default_strain(*given.values()) if strain is None else strain
    require_number("strain", strain, 0, strict=True)
    bars = [
        (title, material, rate)
        for label, material in given.items()
        for title, rate in _rates_of_strain(label, material)
    ]
    path = [strain, 0.0, -strain, 0.0, strain]
    curves = []
    for _, material, rate in bars:
        duration = None if rate is None else strain / rate
        bar = material_point(
            material, strain={"xx": path}, steps=STEPS, duration=duration
        )
        curves.append(bar.curve("xx"))
    axes = new_picture(figsize=(5.6, 3.6)).subplots() if axes is None else axes
    for index, (e, stress) in enumerate(curves):
        colour = COLOURS[index % len(COLOURS)]
        title = bars[index][0]
        loaded = slice(0, STEPS + 1)
        axes.plot(e[loaded], stress[loaded], color=colour, label=title or None)
        axes.plot(e[STEPS:], stress[STEPS:], color=colour, linewidth=0.7)
    axes.axhline(0.0, color=GUIDE, linewidth=0.6)
    axes.axvline(0.0, color=GUIDE, linewidth=0.6)
    axes.set_xlabel("axial strain")
    axes.set_ylabel(f"axial stress{units.of('stress')}")
    if any(title for title, _, _ in bars):
        rated = any(rate is not None for _, _, rate in bars)
        axes.legend(title="rates of strain, per unit of time" if rated else None)
    return axes.figure


def _default_strain(first: Material, *_: Material) -> float:
    """Ten times the strain at which a bar of the first material yields."""
    yields = first.tensile_yield_stress / first.young
    if not is_number(yields):
        raise ValueError("strain=None: a number is needed where data are coefficients")
    return BEYOND * yields


def _rates_of_strain(label: str, material: Material) -> list[tuple[str, float | None]]:
    """Entry of the legend and rate of strain of each bar; None for a material without a rate."""
    if material.rate is None:
        return [(label, None)]
    law = material.rate.at(value_in_the_middle)
    yields = value_in_the_middle(material.tensile_yield_stress)
    exact = (max(float(law.rate(part * yields)), SLOWEST) for part in OVERSTRESSES)
    rates = [float(f"{rate:.0e}") for rate in exact]
    prefix = f"{label}, " if label else ""
    return [(f"{prefix}rate {rate:g}", rate) for rate in rates]
