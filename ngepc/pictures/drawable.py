"""Fields of a solution that can be drawn, by name, with symbols and units.

Shared by matplotlib figures, webgui views and VTU files.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import boundary_names, require_covering
from ngepc.checks.declared import Declared, Text
from ngepc.checks.kinds import require_instance, require_mapping
from ngepc.checks.sentences import in_words
from ngepc.pictures.cutting import Part, elements_of, part_of
from ngepc.pictures.sampling import Corners, Ends, colour_scale, visible
from ngepc.results.fields import Fields, frobenius

SIGNED = "RdBu_r"
"""Diverging colours for components of vectors and matrices."""
KINDS = {
    "equivalent_plastic_strain": ("|p|_F", "plastic strain", "1", "YlGnBu"),
    "accumulated_plastic_strain": (
        r"\bar p",
        "accumulated plastic strain",
        "1",
        "YlGnBu",
    ),
    "von_mises": (r"\sigma_\mathrm{vM}", "von Mises stress", "stress", "viridis"),
    "yield_function": (r"\phi", "yield function", "stress", "cividis"),
    "displacement": ("u", "displacement", "length", "viridis"),
    "stress": (r"\sigma", "stress", "stress", "viridis"),
    "deviatoric_stress": (
        r"\mathrm{dev}\,\sigma",
        "deviatoric stress",
        "stress",
        "viridis",
    ),
    "plastic_strain": ("p", "plastic strain", "1", "YlGnBu"),
    "strain": (r"\varepsilon", "strain", "1", "viridis"),
    "back_stress": (r"\alpha_2", "back stress", "stress", "viridis"),
    "hardening_variable": (r"\alpha_1", "hardening variable", "1", "viridis"),
}
"""Field of the body that can be drawn -> symbol, title, unit (or 'length', 'stress'), colours.

Single components have names such as 'stress_xy'.
"""


NEVER_NEGATIVE = (
    "equivalent_plastic_strain",
    "accumulated_plastic_strain",
    "von_mises",
)


@dataclass(frozen=True)
class UnitNames(Declared):
    """Names of the units on axes and colour bars; the data themselves are never converted.

    Parameters
    ----------
    length, stress
        'mm' and 'MPa', for example; labels have no units where they are empty.
    """

    length: Text = ""
    stress: Text = ""

    def of(self, kind: str) -> str:
        """The unit for a label: ' (mm)'; empty for pure numbers and units without a name."""
        unit = getattr(self, kind, "")
        return f" ({unit})" if unit else ""


PLAIN = UnitNames()
WHOLE = Part()


def require_units(name: str, units: UnitNames | None) -> UnitNames:
    """The names of the units, the plain ones for None; TypeError for anything else."""
    units = PLAIN if units is None else units
    return require_instance(name, units, UnitNames, "UnitNames(...) or None")


class Drawable(NamedTuple):
    """A scalar coefficient on the body, in 3D on its surface, its label, and its colour map.

    ``inside`` is the coefficient in the body, None for what is on boundaries alone.
    """

    coefficient: CoefficientFunction
    label: str = "value"
    colormap: str = "viridis"
    inside: CoefficientFunction | None = None


def drawable(
    source: object, field: str | CoefficientFunction, units: UnitNames = PLAIN
) -> Drawable:
    """The field called ``field`` of a result or of recovered ``Fields``, or a coefficient.

    Vectors and matrices are drawn by their Euclidean and Frobenius norms, their components by
    names such as 'displacement_x' and 'stress_xy' (of bodies of revolution x is the radius, y the
    axis, z the circumference); of solids also their 'contact_pressure'.
    """
    fields = fields_of(source)
    if isinstance(field, CoefficientFunction):
        require_covering("field", field, fields.problem.mesh)
        scalar = field if field.dim == 1 else frobenius(field)
        return Drawable(visible(fields, scalar), inside=scalar)
    if not isinstance(field, str):
        raise TypeError(
            f"field={in_words(field)}: the name of a field or a CoefficientFunction is needed"
        )
    if field == "contact_pressure":
        return _drawable_pressure(source, fields, units)
    match = re.fullmatch(r"(.+)_([xyz]{1,2})", field)
    name, letters = match.groups() if match else (field, "")
    if name not in KINDS:
        raise ValueError(
            f"field={in_words(field)}: the fields are {', '.join(KINDS)}, "
            "and components such as displacement_x and stress_xy"
        )
    symbol, title, unit, colormap = KINDS[name]
    coefficient = field_of(source, name)
    rank = len(coefficient.dims) if coefficient.dim > 1 else 0
    if letters:
        coefficient = _component(field, coefficient, letters, rank)
        names = dict(zip("xyz", fields.problem.kinematics.directions, strict=True))
        symbol = f"{symbol}_{{{''.join(names[letter] for letter in letters)}}}"
        colormap = SIGNED
    elif rank:
        coefficient = frobenius(coefficient)
        symbol = f"|{symbol}|" + "_F" * (rank == 2)
    label = f"{title} ${symbol}${units.of(unit)}"
    return Drawable(visible(fields, coefficient), label, colormap, coefficient)


def _drawable_pressure(source: object, fields: Fields, units: UnitNames) -> Drawable:
    """The contact pressure of a solid on its boundary."""
    if not fields.problem.touching_names or fields.problem.N == 2:
        plane = "that of plane bodies is drawn by plot_contact_pressure"
        needed = f"a solid with a contact boundary is needed; {plane}"
        raise ValueError(f"field='contact_pressure': {needed}")
    label = f"contact pressure{units.of('stress')}"
    return Drawable(pressure_on_boundary(source), label, "YlGnBu")


def _require_touching(fields: Fields, part: Part) -> None:
    """ValueError if the part has none of the boundaries on which the pressure is known."""
    mesh = fields.problem.mesh
    part = part.checked(mesh)
    known = fields.problem.touching_names
    if part.boundary is not None:
        drawn = boundary_names("boundary", part.boundary, mesh)
        touches = not set(drawn).isdisjoint(known)
    elif part.body is not None:
        everywhere = "|".join(map(re.escape, known))
        touches = elements_of(mesh, part.body, everywhere).any()
    else:
        return
    if not touches:
        raise ValueError(
            "field='contact_pressure': it is known on the contact boundary, the first one of "
            f"two bodies: {', '.join(map(repr, known))}"
        )


def _component(
    field: str, coefficient: CoefficientFunction, letters: str, rank: int
) -> CoefficientFunction:
    """The component of a vector or a tensor that the letters at the end of ``field`` name."""
    if not rank:
        raise ValueError(
            f"field={in_words(field)}: this field is a scalar and has no components"
        )
    axes = "xyz"[: coefficient.dims[0]]
    if len(letters) != rank or not set(letters) <= set(axes):
        needed = f"{rank} of the letters {axes!r} name a component of this field"
        raise ValueError(f"field={in_words(field)}: {needed}")
    index = tuple(map(axes.index, letters))
    return coefficient[index if rank == 2 else index[0]]


def on_one_scale(
    sources: Collection[object],
    field: str | CoefficientFunction,
    units: UnitNames,
    ends: Ends,
    part: Part = WHOLE,
    cmap: str | Colormap | None = None,
) -> tuple[list[Drawable], list[Corners], ScalarMappable]:
    """The drawn coefficient of each source, its values, and colours for all of them."""
    what = [drawable(source, field, units) for source in sources]
    if isinstance(field, str) and field == "contact_pressure":
        for source in sources:
            _require_touching(fields_of(source), part)
    pairs = zip(sources, what, strict=True)
    colormap = what[0].colormap
    corners = [
        part_of(fields_of(source), drawn.coefficient, drawn.inside, part)
        for source, drawn in pairs
    ]
    if (
        isinstance(field, str) and field in NEVER_NEGATIVE
    ):  # linear in each element, values at corners may undershoot
        corners = [
            replace(sampled, values=np.maximum(sampled.values, 0.0))
            for sampled in corners
        ]
        ends = (0.0 if ends[0] is None else ends[0], ends[1])
    limits = colour_scale(*corners, ends=ends, symmetric=colormap == SIGNED)
    return what, corners, ScalarMappable(limits, require_colours(cmap) or colormap)


def require_colours(cmap: str | Colormap | None) -> Colormap | None:
    """A colour map of matplotlib by its name; ValueError if there is none."""
    if cmap is None or isinstance(cmap, Colormap):
        return cmap
    if not isinstance(cmap, str) or cmap not in colormaps:
        raise ValueError(
            f"cmap={cmap!r}: the name of a colour map of matplotlib is needed"
        )
    return colormaps[cmap]


def pressure_on_boundary(source: object) -> CoefficientFunction:
    """The contact pressure of a result on the whole boundary, zero where nothing touches."""
    problem = fields_of(source).problem
    pressures = dict.fromkeys(
        problem.touching_names, field_of(source, "contact_pressure")
    )
    return problem.mesh.BoundaryCF(pressures, default=0.0)


def fields_of(source: object, name: str = "source", others: str = "") -> Fields:
    """The recovered fields of a result, or ``source`` itself if it is ``Fields``."""
    fields = source if isinstance(source, Fields) else getattr(source, "fields", None)
    if not isinstance(fields, Fields):
        inner = ", such as its .result" if hasattr(source, "result") else ""
        if hasattr(source, "steps"):
            inner = ", such as .steps[-1], the last step"
        raise TypeError(
            f"{name}={in_words(source)}: {others}the result of a solver or its Fields are "
            f"needed{inner}"
        )
    return fields


def sources_of(name: str, source: object, caption: str = "") -> Mapping[str, object]:
    """``source``, text -> result or ``Fields``, or one of these under its caption; checked."""
    several = isinstance(source, Mapping)
    sources = source if several else {caption: source}
    require_mapping(name, sources, "text -> result")
    for label, one in sources.items():
        fields_of(one, f"{name}[{label!r}]" if several else name)
    return sources


def field_of(source: object, name: str) -> CoefficientFunction:
    """A field by name: the solver's own approximation where it has one, else the recovered one."""
    for owner in (source, fields_of(source)):
        found = getattr(owner, name, None)
        if isinstance(found, CoefficientFunction):
            return found
    reason = "this result has no such field"
    if isinstance(source, Fields):
        reason = (
            "Fields have no such field; draw the result or the step (.steps[-1]) itself"
        )
    raise ValueError(f"field={name!r}: {reason}")
