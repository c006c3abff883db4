"""What can be drawn of a solution: fields by name, their symbols and units, where they live.

Shared by matplotlib figures, webgui views and VTU files.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated

from matplotlib.cm import ScalarMappable
from ngsolve import CoefficientFunction, InnerProduct, Region, sqrt

from ngepc.checks.declared import Check, Declared, Text
from ngepc.checks.kinds import require_instance, require_mapping
from ngepc.pictures.sampling import Corners, colour_scale, sample_corners, visible
from ngepc.results.fields import Fields

AXES = "xyz"


@dataclass(frozen=True)
class UnitNames(Declared):
    """Names of the units on axes and colour bars; the data themselves are never converted."""

    length: Text = "length"
    stress: Text = "stress"


@dataclass(frozen=True)
class FieldKind:
    """A field that has a name: its symbol, title, unit ('length', 'stress' or '1'), colours."""

    symbol: str
    title: str
    quantity: str = "stress"
    colormap: str = "viridis"


KINDS = {
    "equivalent_plastic_strain": FieldKind("|p|_F", "plastic strain", "1", "YlGnBu"),
    "accumulated_plastic_strain": FieldKind(r"\bar p", "accumulated plastic strain", "1", "YlGnBu"),
    "von_mises": FieldKind(r"\sigma_\mathrm{vM}", "von Mises stress"),
    "yield_function": FieldKind(r"\phi", "yield function", colormap="cividis"),
    "displacement": FieldKind("u", "displacement", "length"),
    "stress": FieldKind(r"\sigma", "stress"),
    "deviatoric_stress": FieldKind(r"\mathrm{dev}\,\sigma", "deviatoric stress"),
    "plastic_strain": FieldKind("p", "plastic strain", "1", "YlGnBu"),
    "strain": FieldKind(r"\varepsilon", "strain", "1"),
    "back_stress": FieldKind(r"\alpha_2", "back stress"),
    "hardening_variable": FieldKind(r"\alpha_1", "hardening variable", "1"),
}
"""Fields of the body that can be drawn by name, with 'stress_xy' for single components."""


@dataclass(frozen=True, eq=False)
class Drawable:
    """A scalar coefficient on the region where it is drawn, its label, and its colour map.

    ``signed`` says whether both signs are equally welcome (components of vectors and matrices).
    """

    region: Region
    coefficient: CoefficientFunction
    label: str = "value"
    signed: bool = False
    colormap: str = "viridis"


PLAIN = UnitNames()


def require_units(name: str, units: UnitNames | None) -> UnitNames:
    """The names of the units, the plain ones for None; TypeError for anything else."""
    units = PLAIN if units is None else units
    return require_instance(name, units, UnitNames, "UnitNames(...) or None")


Units = Annotated[UnitNames | None, Check(require_units)]


def drawable(
    source: object, field: str | CoefficientFunction, units: UnitNames | None = None
) -> Drawable:
    """The field called ``field`` of a result or of recovered ``Fields``, or a coefficient.

    Vectors and matrices are drawn by their Euclidean and Frobenius norms, their components by
    names such as 'displacement_x' and 'stress_xy'; of solids also their 'contact_pressure'.
    """
    units, problem = require_units("units", units), fields_of(source).problem
    if isinstance(field, CoefficientFunction):
        return Drawable(*visible(problem.mesh, norm_of(field)))
    if not isinstance(field, str):
        raise TypeError(f"field={field!r}: the name of a field or a CoefficientFunction is needed")
    if field == "contact_pressure":
        return _pressure(source, f"contact pressure ({units.stress})")
    match = re.fullmatch(r"(.+)_([xyz]{1,2})", field)
    name, component = match.groups() if match else (field, "")
    if name not in KINDS:
        raise ValueError(
            f"field={field!r}: the fields are {', '.join(KINDS)}, "
            "and components such as displacement_x and stress_xy"
        )
    kind, coefficient = KINDS[name], field_of(source, name)
    symbol, rank = kind.symbol, len(coefficient.dims) if coefficient.dim > 1 else 0
    if component:
        coefficient = _component(field, coefficient, component, rank)
        symbol = f"{symbol}_{{{component}}}"
    elif rank:
        coefficient, symbol = norm_of(coefficient), f"|{symbol}|" + "_F" * (rank == 2)
    label = f"{kind.title} ${symbol}$ ({getattr(units, kind.quantity, kind.quantity)})"
    colormap = "RdBu_r" if component else kind.colormap
    return Drawable(*visible(problem.mesh, coefficient), label, bool(component), colormap)


def on_one_scale(
    sources: Collection[object],
    field: str | CoefficientFunction,
    units: UnitNames | None,
    ends: tuple[float | None, float | None],
) -> tuple[list[Drawable], list[Corners], ScalarMappable]:
    """What is drawn of each source, its values, and colours for all of them."""
    what = [drawable(source, field, units) for source in sources]
    corners = [
        sample_corners(fields_of(source), drawn.region, drawn.coefficient)
        for source, drawn in zip(sources, what, strict=True)
    ]
    limits = colour_scale(*corners, ends=ends, symmetric=what[0].signed)
    return what, corners, ScalarMappable(limits, what[0].colormap)


def _component(
    field: str, coefficient: CoefficientFunction, component: str, rank: int
) -> CoefficientFunction:
    """A component by the letters of its axes."""
    if not rank:
        raise ValueError(f"field={field!r}: this field is a scalar and has no components")
    index, size = [AXES.index(letter) for letter in component], coefficient.dims[0]
    if len(index) != rank or max(index) >= size:
        raise ValueError(
            f"field={field!r}: {rank} of the letters {AXES[:size]!r} name a component of this field"
        )
    return coefficient[tuple(index)] if rank == 2 else coefficient[index[0]]


def _pressure(source: object, label: str) -> Drawable:
    """The contact pressure on the surface of a solid."""
    problem = fields_of(source).problem
    if not problem.touching_names or problem.N == 2:
        raise ValueError("field='contact_pressure': a solid with a contact boundary is needed")
    region, pressure = problem.mesh.Boundaries(".*"), pressure_on_boundary(source)
    return Drawable(region, pressure, label, colormap="YlGnBu")


def pressure_on_boundary(source: object) -> CoefficientFunction:
    """The contact pressure of a result on the whole boundary, zero where nothing touches."""
    problem = fields_of(source).problem
    pressures = dict.fromkeys(problem.touching_names, field_of(source, "contact_pressure"))
    return problem.mesh.BoundaryCF(pressures, default=0.0)


def fields_of(source: object, name: str = "source") -> Fields:
    """The recovered fields of a result, or ``source`` itself if it is ``Fields``.

    ``name`` is what the TypeError for anything else calls it.
    """
    fields = source if isinstance(source, Fields) else getattr(source, "fields", None)
    if not isinstance(fields, Fields):
        raise TypeError(f"{name}={source!r}: the result of a solver or its Fields are needed")
    return fields


def require_sources(sources: object) -> None:
    """Accept a mapping of text -> result or ``Fields``, with at least one entry."""
    require_mapping("sources", sources, "text -> result")
    for label, source in sources.items():
        fields_of(source, f"sources[{label!r}]")


def field_of(source: object, name: str) -> CoefficientFunction:
    """A field by name: the solver's own approximation where it has one, else the recovered one."""
    for owner in (source, fields_of(source)):
        found = getattr(owner, name, None)
        if isinstance(found, CoefficientFunction):
            return found
    raise ValueError(f"field={name!r}: this result has no such field")


def norm_of(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A scalar as it is; the Euclidean or Frobenius norm of anything else."""
    if coefficient.dim == 1:
        return coefficient
    return sqrt(InnerProduct(coefficient, coefficient))
