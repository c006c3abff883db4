"""What can be drawn of a solution: fields by name, their symbols and units.

Shared by matplotlib figures, webgui views and VTU files; imports none of them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from ngsolve import CoefficientFunction, InnerProduct, sqrt

from ngepc.checks.kinds import require_instance, require_mapping, require_text
from ngepc.results.fields import Fields

AXES = "xyz"


@dataclass(frozen=True)
class UnitNames:
    """Names of the units on axes and colour bars; the data themselves are never converted."""

    length: str = "length"
    stress: str = "stress"

    def __post_init__(self) -> None:
        require_text("length", self.length)
        require_text("stress", self.stress)

    def of(self, quantity: str) -> str:
        """The unit of 'length', 'stress' or '1'."""
        return getattr(self, quantity, quantity)


@dataclass(frozen=True)
class FieldKind:
    """A field that has a name: its symbol (mathematics, plain text), title, unit, rank, colours."""

    symbol: str
    plain: str
    title: str
    quantity: str = "stress"
    rank: int = 0
    colormap: str = "viridis"


KINDS = {
    "equivalent_plastic_strain": FieldKind(r"|p|_F", "|p|", "plastic strain", "1", 0, "YlGnBu"),
    "accumulated_plastic_strain": FieldKind(
        r"\bar p", "p̄", "accumulated plastic strain", "1", 0, "YlGnBu"
    ),
    "von_mises": FieldKind(r"\sigma_\mathrm{vM}", "σ_vM", "von Mises stress"),
    "yield_function": FieldKind(r"\phi", "φ", "yield function", colormap="cividis"),
    "displacement": FieldKind("u", "u", "displacement", "length", 1),
    "stress": FieldKind(r"\sigma", "σ", "stress", rank=2),
    "deviatoric_stress": FieldKind(r"\mathrm{dev}\,\sigma", "dev σ", "deviatoric stress", rank=2),
    "plastic_strain": FieldKind("p", "p", "plastic strain", "1", 2, "YlGnBu"),
    "strain": FieldKind(r"\varepsilon", "ε", "strain", "1", 2),
    "back_stress": FieldKind(r"\alpha_2", "α₂", "back stress", rank=2),
    "hardening_variable": FieldKind(r"\alpha_1", "α₁", "hardening variable", "1"),
}
"""Fields of the body that can be drawn by name, with 'stress_xy' for single components."""


@dataclass(frozen=True, eq=False)
class Drawable:
    """A scalar coefficient with its label, with and without mathematics, and its colour map.

    ``signed`` says whether both signs are equally welcome (components of vectors and matrices).
    """

    coefficient: CoefficientFunction
    label: str
    plain_label: str
    signed: bool = False
    colormap: str = "viridis"


def unit_names(units: UnitNames | None) -> UnitNames:
    """The names of the units, the plain ones for None; TypeError for anything else."""
    units = UnitNames() if units is None else units
    require_instance("units", units, UnitNames, "UnitNames(...) or None")
    return units


def drawable(
    source: object, field: str | CoefficientFunction, units: UnitNames | None = None
) -> Drawable:
    """The field called ``field`` of a result or of recovered ``Fields``, or a coefficient.

    Vectors and matrices are drawn by their Euclidean and Frobenius norms, their components by
    names such as 'displacement_x' and 'stress_xy'.
    """
    units = unit_names(units)
    if isinstance(field, CoefficientFunction):
        return Drawable(scalar(field), "value", "value")
    if not isinstance(field, str):
        raise TypeError(f"field={field!r}: the name of a field or a CoefficientFunction is needed")
    match = re.fullmatch(r"(.+)_([xyz]{1,2})", field)
    name, component = match.groups() if match else (field, "")
    if name not in KINDS:
        raise ValueError(
            f"field={field!r}: the fields are {', '.join(KINDS)}, "
            "and components such as displacement_x and stress_xy"
        )
    kind, coefficient = KINDS[name], field_of(source, name)
    symbol, plain = kind.symbol, kind.plain
    if component:
        coefficient = _component(field, coefficient, component, kind.rank)
        symbol, plain = f"{symbol}_{{{component}}}", f"{plain}_{component}"
    elif kind.rank:
        coefficient = scalar(coefficient)
        symbol, plain = f"|{symbol}|" + "_F" * (kind.rank == 2), f"|{plain}|"
    unit = units.of(kind.quantity)
    label, plain = f"{kind.title} ${symbol}$ ({unit})", f"{kind.title} {plain} ({unit})"
    colormap = "RdBu_r" if component else kind.colormap
    return Drawable(coefficient, label, plain, bool(component), colormap)


def _component(
    field: str, coefficient: CoefficientFunction, component: str, rank: int
) -> CoefficientFunction:
    index = [AXES.index(letter) for letter in component]
    if len(index) != rank or max(index) >= coefficient.dims[0]:
        raise ValueError(
            f"field={field!r}: {rank} of the letters {AXES[: coefficient.dims[0]]!r} name a "
            "component of this field"
            if rank
            else f"field={field!r}: this field is a scalar and has no components"
        )
    return coefficient[tuple(index)] if rank == 2 else coefficient[index[0]]


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


def method_label(source: object) -> str:
    """What solved it, for titles: 'gamma = 1e+04'; empty for solutions of the problem itself."""
    label = getattr(source, "method_label", "")
    return label if isinstance(label, str) and label != "exact" else ""


def scalar(coefficient: CoefficientFunction) -> CoefficientFunction:
    """A scalar as it is; the Euclidean or Frobenius norm of anything else."""
    if coefficient.dim == 1:
        return coefficient
    return sqrt(InnerProduct(coefficient, coefficient))
