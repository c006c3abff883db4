"""Parameters of derivatives: directions in which the data of a problem change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace

import numpy as np

from ngepc.checks.arguments import (
    Coefficient,
    is_number,
    require_coefficient,
    require_field,
    require_in,
)
from ngepc.checks.declared import Declared, Text
from ngepc.checks.kinds import require_instance, require_mapping, require_text
from ngepc.checks.sentences import in_words
from ngepc.discretisation.finer import seen, seen_problem
from ngepc.discretisation.gap_records import nearer_between_nodes
from ngepc.discretisation.loads import applied_forces
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.roller_rows import roller_rows
from ngepc.discretisation.rows import contact_rows
from ngepc.discretisation.supports import Supports
from ngepc.evolution.load_path import scaled
from ngepc.local.system import State
from ngepc.model.checks import check_data
from ngepc.model.data import ProblemData
from ngepc.model.material import Material, split_hardening
from ngepc.model.places import Coulomb, places
from ngepc.model.problem import Problem
from ngepc.sensitivity.equations import Data
from ngepc.sensitivity.law_data import PARTS, PartDatum, is_of_part, part_changes
from ngepc.sensitivity.shape import on_moving_mesh, vertex_motion

MATERIAL = tuple(field.name for field in fields(Material) if field.name not in PARTS)

OF_OVERLAY = ("lame_lambda", "lame_mu")
"""Data of a material with sub-elements, in addition to those of ``Overlay``."""

LOADS = ("traction", "pressure", "body_force")

BY_BOUNDARY = ("traction", "pressure", "gap", "prescribed")
"""Data whose name may be followed by a colon and a boundary: 'gap:top'."""

LEGAL = (
    *MATERIAL,
    *LOADS,
    "gap",
    "prescribed",
    "friction",
    "initial_plastic_strain",
    "initial_strain",
    "shape",
)

COMPLEX = 1e-100  # length of a complex step, whose square underflows


@dataclass(frozen=True, eq=False)
class Direction(Declared):
    """A change of one datum of a problem; derivatives are per unit of it.

    Parameters
    ----------
    datum
        A material constant such as "lame_mu", or "traction", "pressure", "body_force", "gap",
        "prescribed", "friction" (the bound, or Coulomb's coefficient), "initial_plastic_strain",
        "initial_strain".  "law.saturation" is the datum ``saturation`` of the law of hardening,
        "law.stress_there[1]" one value of a table; "rate.overstress", "hill.N",
        "overlay.bounds[0]" are those of the other parts of a material.  If the yield stress of the
        material is that of its law, as in ``Material.with_law``, it changes with the law.  If the
        share of a sub-element grows, the elastic share decreases.
        A boundary may follow a colon: "traction:left", "prescribed:top".  A clamped boundary counts
        as a prescribed one.  "shape" moves the vertices by ``change``, a vector; the mesh must not
        be used elsewhere meanwhile.
    change
        What is added to the datum per unit, in the form that ``Problem`` or ``Material`` takes:
        ``mesh.MaterialCF({"core": 1.0})`` for the constant of one region.  None for the default:
        1 for numbers of the material, the law, friction or an initial strain, and for a gap, which
        moves as a whole; the datum itself for all others, so that the derivative is with respect to
        a factor.  In a history the number of an initial strain is that of ``history.problem``, and
        those of the steps change in proportion.
    """

    datum: Text
    change: object = None

    @property
    def inherited(self) -> bool:
        """Whether later steps of a history take the datum from the step before."""
        return self.datum == "initial_plastic_strain"


Parameters = str | Sequence[str] | Mapping[str, Direction]
"""Names of data with their default change, or any name -> ``Direction``."""


def directions(parameters: Parameters) -> dict[str, Direction]:
    """Name -> direction.

    TypeError, ValueError if a parameter is neither a known name nor a Direction.
    """
    if isinstance(parameters, str):
        parameters = [parameters]
    if isinstance(parameters, list | tuple) and parameters:
        parameters = {
            name: Direction(require_text("parameters", name)) for name in parameters
        }
    require_mapping("parameters", parameters, "names of data, or name -> Direction")
    for name, direction in parameters.items():
        require_instance(f"parameters[{name!r}]", direction, Direction, "a Direction")
        datum, _, boundary = direction.datum.partition(":")
        if datum not in LEGAL and not is_of_part(datum):
            parts = (f"{part}.<datum>" for part in PARTS)
            needed = f"one of {', '.join([*LEGAL, *parts])} is needed"
            raise ValueError(f"parameters={direction.datum!r}: {needed}")
        if boundary and datum not in BY_BOUNDARY:
            raise ValueError(
                f"parameters={direction.datum!r}: only {datum!r} has a derivative"
            )
    return dict(parameters)


def in_step(direction: Direction, problem: Problem, step: Problem) -> Direction:
    """A direction of the problem of a history, in one of its steps.

    The number of an initial strain is that of the problem: numbers of steps, as a load cycle scales
    them, change in proportion.
    """
    known = (problem.initial_strain, step.initial_strain)
    is_default = direction.datum == "initial_strain" and direction.change is None
    if is_default and all(map(is_number, known)) and known[0] != 0:
        return replace(direction, change=known[1] / known[0])
    return direction


def change_in_step(
    state: State, direction: Direction, problem: Problem, number: int
) -> Data | None:
    """The change of the data of a step of the history of a problem, the first being number 0.

    None where the step has no such datum, or inherits it.
    """
    here = state.discrete.problem
    absent = number > 0 if direction.inherited else what_lacks(here, direction)
    return None if absent else changed_data(state, in_step(direction, problem, here))


def changed_data(state: State, direction: Direction) -> Data:
    """The change of the data of a discrete problem per unit of a direction.

    TypeError, ValueError if the problem has no such datum, or the change is not legal for it.
    """
    discrete = state.discrete
    problem = state.discrete.problem
    require_linear(state, direction)
    if is_of_part(direction.datum):
        return part_changes(state, direction.datum, direction.change)
    datum, change = _change(problem, direction)
    if datum in MATERIAL:
        return _material(state, datum, change)
    if datum == "shape":
        motion = vertex_motion(problem, change)
        return on_moving_mesh(state, motion) + Data(shape=motion)
    if datum == "friction":
        require_field(datum, change, problem.mesh, problem.touching_names)
        values = discrete.contact.given_at_rows(problem, change)
        if isinstance(problem.friction, Coulomb):
            return Data(coefficient=values)
        return Data(cap=discrete.rows.weights * values)
    other = ProblemData(
        **problem.given | dict.fromkeys(("clamped", *LOADS)) | {datum: change}
    )
    check_data(other)
    if datum in LOADS:  # forces are linear in a load
        return Data(load=applied_forces(other, discrete.supports.scalar))
    if datum == "initial_strain":
        other = seen_problem(other, discrete.points)
        volume, strain = state.discrete.law.initial_parts(other, discrete.points)
        return Data(volume=-volume, strain=-strain)
    if datum == "initial_plastic_strain":
        return _initial_strain(state, change)
    if datum == "prescribed":
        return _prescribed(state, other, change)
    gaps = np.zeros(len(discrete.contact))
    whole = all(is_number(value) and value == 1 for value in change.values())
    _require_gaps_linear(problem, change)
    moved = 1.0 if whole else contact_rows(other, discrete.supports).gaps
    gaps[discrete.contact.on_obstacles] = moved
    return Data(gaps=gaps)


def require_linear(state: State, direction: Direction) -> None:
    """Refuse changes by which data with projections, see ``discretisation.finer``, do not change.

    A number, a constant on each element and the datum itself change the projection as they change
    the datum.
    """
    discrete = state.discrete
    problem = discrete.problem
    points = discrete.points
    used = seen_problem(problem, points)
    if direction.datum == "shape" and used is not problem:
        raise ValueError(
            "parameters='shape' with data that vary between the integration points: a finer mesh "
            "or data that vary less are needed"
        )
    known = _several(_material_datum(problem, direction.datum))
    for given, change in zip(known, _several(direction.change), strict=False):
        same = change is given or is_polynomial(change, problem.mesh, 0)
        if not same and seen(given, points) is not given:
            raise ValueError(
                f"parameters={direction.datum!r} varies between the integration points: only "
                "changes by a number, by constants on elements or by the datum itself have a "
                "derivative"
            )


def _require_gaps_linear(problem: Problem, change: Mapping) -> None:
    """Refuse changes by which gaps that are lowered between nodes do not change linearly."""
    given = problem.given_gaps
    known = all(is_number(v) or v is given[n] for n, v in change.items())
    if not known and nearer_between_nodes(problem):
        raise ValueError(
            "parameters='gap' with an obstacle that stands nearer between nodes: only changes by a "
            "number or by the gap itself have a derivative"
        )


def _material_datum(problem: ProblemData, datum: str) -> object:
    """The given value of a datum of the material or of the initial strain; None for others."""
    if is_of_part(datum):
        return PartDatum.of(problem.material, datum).value
    if datum in MATERIAL:
        return getattr(problem.material, datum)
    return problem.initial_strain if datum == "initial_strain" else None


def _several(value: object) -> list[object]:
    """The entries of a table, or the value alone."""
    return list(value) if isinstance(value, tuple | list) else [value]


def _prescribed(state: State, other: ProblemData, change: object) -> Data:
    """The change of prescribed displacements, which are those of the data ``other``."""
    discrete = state.discrete
    supports = Supports(other)
    rollers_differ = other.rollers.keys() != discrete.problem.rollers.keys()
    if rollers_differ or supports.values[discrete.free].any():
        raise ValueError(f"prescribed={in_words(change)}: there is no such support")
    gaps = np.zeros(len(discrete.contact))
    for place, moved in roller_rows(other, supports).items():
        gaps[discrete.contact.rollers[place]] = moved.gaps
    return Data(values=supports.values, gaps=gaps)


def _given(problem: Problem, datum: str) -> object:
    """A datum of the problem or its material, None if there is none."""
    given = getattr(problem.material if datum in MATERIAL else problem, datum, None)
    return None if given == {} else given


def what_lacks(problem: Problem, direction: Direction) -> str:
    """Why a problem lacks the datum of a direction, or its boundary; empty if it has it."""
    datum, _, boundary = direction.datum.partition(":")
    given = _given(problem, datum)
    needs_datum = direction.change is None or datum in ("friction", "gap")
    if is_of_part(datum) or datum == "shape":
        return ""
    if given is None and needs_datum:
        loads = ", ".join(name for name in LOADS if _given(problem, name) is not None)
        hint = f", its loads are: {loads}" if datum in LOADS and loads else ""
        return f"parameters={datum!r}: the problem has none{hint}"
    if not boundary:
        return ""
    places_of = _by_place(problem, datum, _default_change(datum, given, direction))
    if boundary in places_of:
        return ""
    legal = ", ".join(sorted(map(str, places_of)))
    return f"parameters='{datum}:{boundary}': one of {legal} is needed"


def _default_change(datum: str, given: object, direction: Direction) -> object:
    """The change of a direction; None is the datum itself, or one."""
    if direction.change is not None:
        return direction.change
    given = given.coefficient if isinstance(given, Coulomb) else given
    return 1.0 if datum == "gap" or is_number(given) else given


def _by_place(problem: Problem, datum: str, change: object) -> dict:
    """A change of a datum that boundaries have, by single boundary or place."""
    if datum == "gap" and not isinstance(change, Mapping):
        change = dict.fromkeys(problem.contact_names, change)
    require_mapping(datum, change, "boundary name -> change")
    return {p: v for key, v in change.items() for p in places(datum, key, problem.mesh)}


def _change(problem: Problem, direction: Direction) -> tuple[str, object]:
    """A datum and its change, by single boundary if it has boundaries; the default for None."""
    if lacks := what_lacks(problem, direction):
        raise ValueError(lacks)
    datum, _, boundary = direction.datum.partition(":")
    change = _default_change(datum, _given(problem, datum), direction)
    if datum not in BY_BOUNDARY:
        return datum, change
    change = _by_place(problem, datum, change)
    change = {boundary: change[boundary]} if boundary else change
    kept = {}
    if datum == "gap":
        kept = dict.fromkeys(problem.contact_names, 0.0)
    if datum == "prescribed":
        kept = dict.fromkeys(problem.clamped_names, (0.0,) * problem.N)
        kept |= scaled(problem.single("prescribed"), 0.0)
    return datum, kept | change


def _initial_strain(state: State, change: Coefficient) -> Data:
    """The change of p_0, and of the initial plastic strains of sub-elements."""
    discrete = state.discrete
    problem = discrete.problem
    initial = discrete.points.at(problem.kinematics.coordinates(change))
    data = Data(initial=initial)
    overlay = problem.material.overlay
    if overlay is not None and problem.initial_hardening is None:
        data["parts"] = np.tile(initial, overlay.count)
    return data


def _material(state: State, datum: str, change: Coefficient) -> Data:
    """The change of the law's data, by a complex step in the material, exact to rounding."""
    problem = state.discrete.problem
    if problem.material.overlay is not None and datum not in OF_OVERLAY:
        legal = ", ".join([*OF_OVERLAY, "overlay.bounds[k]", "overlay.shares[k]"])
        raise ValueError(
            f"parameters={datum!r} with {in_words(problem.material.overlay)}: one of "
            f"{legal} is needed"
        )
    discrete = state.discrete
    points = discrete.points
    require_coefficient(datum, change)
    alpha_1, _ = split_hardening(problem.initial_hardening)
    known = {name: getattr(discrete.law.material, name) for name in MATERIAL}
    change = seen(change, points)
    known |= {"alpha_1": alpha_1 or 0.0, "change": change}
    known = {
        n: v if v is None or is_number(v) else points.at(v) for n, v in known.items()
    }
    require_in(datum, np.reshape(known["change"], (-1, 1)), "the body")
    known[datum] = known[datum] + COMPLEX * 1j * known["change"]
    m = copy(problem.material)
    vars(m).update({name: known[name] for name in MATERIAL}, law=None)
    grows_by_measure = problem.material.hill is not None
    found = {
        "two_mu": 2 * m.lame_mu,
        "bulk": m.lame_lambda + 2 * m.lame_mu / problem.kinematics.size,
        "hardening": m.hardening if grows_by_measure else m.effective_hardening,
        "linear": m.isotropic_hardening if grows_by_measure else 0.0,
        "beta": m.yield_bound(known["alpha_1"]),
        "kinematic": m.hardening,
        "isotropic": m.scalar_growth,
    }
    slopes = {name: np.imag(value) / COMPLEX for name, value in found.items()}
    zero = np.zeros(len(points))
    return Data({name: zero + slope for name, slope in slopes.items() if np.any(slope)})
