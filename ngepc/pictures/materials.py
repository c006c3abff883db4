"""The stress-strain curve of a material, as of a bar that is pulled and pushed."""

from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ngepc.checks.arguments import is_number, require_number
from ngepc.checks.kinds import require_instance, require_mapping
from ngepc.evolution.material_point import material_point
from ngepc.model.material import Material
from ngepc.pictures.drawable import UnitNames, require_units
from ngepc.pictures.style import COLOURS, GUIDE, Picture, styled

BEYOND = 10.0  # largest strain of a picture over that at which a bar yields
STEPS = 100  # of each of the three ways


@styled
def plot_material(
    materials: Material | Mapping[str, Material],
    strain: float | None = None,
    *,
    units: UnitNames | None = None,
    axes: Axes | None = None,
) -> Figure:
    """The stress of a bar that is pulled, pushed as far, and pulled again.

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
    strain = _default_strain(*given.values()) if strain is None else strain
    require_number("strain", strain, 0, strict=True)
    axes = Picture(figsize=(5.6, 3.6)).subplots() if axes is None else axes
    require_instance("axes", axes, Axes, "matplotlib Axes or None")
    for index, (label, material) in enumerate(given.items()):
        colour = COLOURS[index % len(COLOURS)]
        path = [strain, -strain, strain]
        bar = material_point(material, strain={"xx": path}, steps=STEPS)
        e = [0.0, *bar.strain[:, 0, 0]]
        stress = [0.0, *bar.stress[:, 0, 0]]
        loaded = slice(0, STEPS + 1)
        axes.plot(e[loaded], stress[loaded], color=colour, label=label or None)
        axes.plot(e[STEPS:], stress[STEPS:], color=colour, linewidth=0.7)
    axes.axhline(0.0, color=GUIDE, linewidth=0.6)
    axes.axvline(0.0, color=GUIDE, linewidth=0.6)
    axes.set_xlabel("axial strain")
    axes.set_ylabel(f"axial stress{units.of('stress')}")
    if any(given):
        axes.legend()
    return axes.figure


def _default_strain(first: Material, *_: Material) -> float:
    """Ten times the strain at which a bar of the first material yields."""
    yields = first.tensile_yield_stress / first.young
    if not is_number(yields):
        raise ValueError("strain=None: a number is needed where data are coefficients")
    return BEYOND * yields
