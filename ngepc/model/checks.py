"""Checks of the loads, supports, contact and history of a problem, before any work is done.

NGSolve accepts misspelt boundaries, singular supports and NaN without a message. Here each is an
error that names the argument, its value and what is legal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import product

import numpy as np
from ngsolve import CoefficientFunction

from ngepc.checks.arguments import (
    boundary_names,
    is_number,
    require_coefficient,
    require_components,
    require_field,
    require_in,
    require_number,
    require_points,
    sample,
)
from ngepc.checks.coefficients import foreign_meshes
from ngepc.checks.kinds import require_instance
from ngepc.checks.sentences import in_words
from ngepc.model.data import ACTING, HISTORY, Components, ProblemData, same_fields
from ngepc.model.elements import corner_vertices, plastic_points, vertex_coordinates
from ngepc.model.features import (
    BASIC_FEATURES,
    ELEMENT_FEATURES,
    HISTORY_FEATURES,
    KINEMATICS_FEATURES,
    LAW_FEATURES,
    require_covered,
)
from ngepc.model.material import is_vector, split_hardening
from ngepc.model.material_checks import check_material
from ngepc.model.places import Coulomb, Place, Roller, places, values_at, vertices_at
from ngepc.model.support import (
    check_held,
    check_motions,
    held_directions,
    pressed_names,
)

SHARED_MESH_COVERS = (
    BASIC_FEATURES
    | HISTORY_FEATURES
    | KINEMATICS_FEATURES
    | ELEMENT_FEATURES
    | LAW_FEATURES
    | {"Coulomb friction", "contact at a clamp", "friction", "shared mesh", "springs"}
)
"""Features that are covered on a mesh whose parts belong to several processes."""


def check_problem(problem: ProblemData, before: ProblemData | None = None) -> None:
    """Raise TypeError or ValueError for the first thing that is wrong with ``problem``.

    A check is skipped if its fields are the same objects as in the legal problem ``before``.
    """

    def differ(*fields: str) -> bool:
        """Whether one of some fields is not that of the problem before."""
        return before is None or not same_fields(problem, before, *fields)

    if differ("mesh", "kinematics", "material"):
        problem.processes.together(partial(check_material, problem))
    problem.processes.together(partial(check_data, problem, differ))
    if differ("mesh", "kinematics", "clamped", "prescribed", "contact", "gap"):
        check_held(problem)
    moves = differ("mesh", "kinematics", "clamped", "contact", "springs")
    moves = moves or pressed_names(problem) != pressed_names(before)
    if moves or held_directions(problem) != held_directions(before):
        check_motions(problem)


def everything(*fields: str) -> bool:
    """All fields count as changed."""
    return True


def check_data(problem: ProblemData, differ: Callable[..., bool] = everything) -> None:
    """Check all data except the material, on the part of the mesh of this process.

    ``differ(*names)`` is true if one of these fields has changed since it was checked.
    """
    if differ("mesh", "clamped", "contact", *ACTING):
        check_places(problem)
    for argument in ACTING:
        if differ("mesh", argument):
            for place, value in problem.single(argument).items():
                check_acting(problem, argument, place, value)
    if differ("mesh", "contact", "gap"):
        check_contact(problem)
    if differ("mesh", "contact", "friction", "initial_displacement"):
        check_friction(problem)
    for name, where in {
        "body_force": None,
        "initial_displacement": problem.touching_names,
    }.items():
        given = getattr(problem, name)
        if given is not None and differ("mesh", "contact", name):
            given = require_components(name, given, problem.N)
            require_field(name, given, problem.mesh, where, shapes=[(problem.N,)])
    if differ("mesh", "kinematics", "order", *HISTORY):
        check_history(problem)
    if problem.duration is not None:
        require_number("duration", problem.duration, 0, strict=True)
    if problem.processes.size > 1:
        require_covered(problem, "a mesh that processes share", SHARED_MESH_COVERS)


def check_places(problem: ProblemData) -> None:
    """Every load and support acts on an existing place, once, and not on clamps or contact."""
    named = {"contact": problem.contact_names}
    for argument in ACTING:
        given = getattr(problem, argument)
        legal = boundary_names if argument == "pressure" else places
        if given is not None:
            require_instance(
                argument, given, Mapping, "a mapping of boundary name -> value"
            )
        named[argument] = [
            p for key in given or {} for p in legal(argument, key, problem.mesh)
        ]
    for argument, keys in named.items():
        twice = sorted({str(place) for place in keys if keys.count(place) > 1})
        if twice:
            raise ValueError(f"{argument} names {', '.join(twice)} more than once")
        both = ", ".join(sorted(set(problem.clamped_names) & set(keys)))
        if both:
            raise ValueError(
                f"{argument} and clamped overlap in {both}: a clamped boundary carries nothing else"
            )


def check_acting(
    problem: ProblemData, argument: str, place: Place, value: object
) -> None:
    """One load, given displacement or spring; a load may have a pole at a vertex."""
    mesh = problem.mesh
    N = problem.N
    name = f"{argument}[{place!r}]"
    several = isinstance(value, Components)
    on_boundary = isinstance(place, str)
    load = argument in ("traction", "pressure")
    shape = ()
    values = [value]
    least = -np.inf
    if argument == "traction":
        shape = (N,)
        values = [require_components(name, value, N)]
    elif argument == "prescribed":
        values = _prescribed(problem, name, place, value)
    elif argument == "springs":
        values = list(value) if several else [value]
        least = 0.0
        if len(values) != N and (several or not on_boundary):
            raise ValueError(f"{name}={in_words(value)}: {N} numbers are needed")
    for one in values:
        if on_boundary:
            how = {"corners": not load, "shapes": [shape], "least": least}
            require_field(name, one, mesh, [place], **how)
        else:
            require_coefficient(name, one, [shape])
            points = vertex_coordinates(mesh)[vertices_at(place, mesh)]
            for other in foreign_meshes(name, one, mesh):
                require_points(name, other, points, repr(place))
            require_in(name, values_at(one, mesh, place)[1], repr(place), least)


def _prescribed(problem: ProblemData, name: str, place: Place, given: object) -> list:
    """The values of N components, some of them None, or of a displacement along a direction."""
    N = problem.N
    direction = getattr(given, "direction", None)
    if isinstance(given, Roller):
        if direction is None and not isinstance(place, str):
            raise ValueError(
                f"{name}=Roller(): a direction is needed, only boundaries have one"
            )
        if direction is not None and len(direction) != N:
            raise ValueError(f"{name}: direction={direction!r}: {N} numbers are needed")
        return [given.value]
    if not isinstance(given, Components) or len(given) != N:
        raise ValueError(
            f"{name}={in_words(given)}: {N} components are needed, None for a free one"
        )
    values = [component for component in given if component is not None]
    if place in problem.loads and len(values) == N:
        raise ValueError(
            f"traction and prescribed overlap in {place}: all components are held"
        )
    return values


def check_contact(problem: ProblemData) -> None:
    """Contact pairs have two boundaries; a rigid obstacle has a finite gap, and only it has one."""
    check_contact_pairs(problem)
    check_obstacles(problem)


def check_contact_pairs(problem: ProblemData) -> None:
    """The two boundaries of a pair are different, meet no obstacle, and share no nodes."""
    mesh = problem.mesh
    names = problem.contact_names
    met: set[frozenset[str]] = set()
    for pair in problem.contact_pairs:
        one, two = (
            boundary_names("contact", n, mesh) for n in (pair.first, pair.second)
        )
        if {*one} & {*two} or {*one, *two} & {*names}:
            needed = "two different boundaries are needed, and no obstacle on them"
            raise ValueError(f"contact={in_words(pair)}: {needed}")
        if np.intersect1d(corner_vertices(mesh, one), corner_vertices(mesh, two)).size:
            raise ValueError(
                f"contact={in_words(pair)}: the bodies share nodes; mesh them without Glue"
            )
        both = {frozenset(meeting) for meeting in product(one, two)}
        if both & met:
            raise ValueError(
                f"contact={in_words(pair)}: another pair has these boundaries, name them once"
            )
        met |= both


def check_obstacles(problem: ProblemData) -> None:
    """Boundaries that may touch an obstacle, and no others, have a finite gap."""
    names = problem.contact_names
    given = problem.gap
    if names and given is None:
        raise ValueError(
            f"contact={in_words(problem.contact)} needs a gap to rigid obstacles: a number or a "
            "coefficient; contact of two bodies is contact=Contact(first, second)"
        )
    if given is not None and not names:
        needed = "name the contact boundary too, or leave gap out"
        if problem.contact_pairs:
            needed = "leave it out, that of two bodies is the distance between them"
        raise ValueError(f"gap={in_words(given)}: {needed}")
    several = isinstance(given, Mapping)
    if several:
        named = [n for key in given for n in boundary_names("gap", key, problem.mesh)]
        if sorted(named) != sorted(names):
            wrong = sorted(map(str, given))
            raise ValueError(
                f"gap names {wrong}: the contact boundaries are {sorted(names)}, each of them once"
            )
    for name, gap in problem.given_gaps.items():
        argument = f"gap[{name!r}]" if several else "gap"
        if hasattr(gap, "gap"):
            needed = "the gap to this obstacle is needed, obstacle.gap(mesh)"
            raise TypeError(f"{argument}={in_words(gap)}: {needed}")
        require_field(argument, gap, problem.mesh, [name], corners=True)


def check_friction(problem: ProblemData) -> None:
    """A finite friction law >= 0, none without contact; no u_0 without friction."""
    value = problem.friction
    name = "friction"
    if value is None and problem.initial_displacement is not None:
        raise ValueError(
            "initial_displacement matters for friction alone: give friction too"
        )
    if value is not None and problem.contact is None:
        raise ValueError(
            f"friction={in_words(value)}: name the contact boundary too, or leave it out"
        )
    if value is None:
        return
    if isinstance(value, Coulomb) and type(value) is not Coulomb:
        raise TypeError(
            f"friction={in_words(value)}: Coulomb(mu, limit=F) itself is needed; a "
            "subclass of Coulomb "
            "would not change the law that is solved"
        )
    given = {name: value}
    if isinstance(value, Coulomb):
        given = {"friction.coefficient": value.coefficient}
        if value.limit is not None:
            given["friction.limit"] = value.limit
    elif not (is_number(value) or isinstance(value, CoefficientFunction)):
        raise TypeError(
            f"{name}={in_words(value)}: a number or a CoefficientFunction is needed, "
            "Tresca's bound F (stress), or Coulomb(mu); mesh.BoundaryCF({boundary: value}) has "
            "values of its own for each boundary"
        )
    for name, field in given.items():
        require_field(name, field, problem.mesh, problem.touching_names, least=0)


def check_history(problem: ProblemData) -> None:
    """Initial plastic strain symmetric and trace-free, initial hardening of the right kind."""
    N = problem.kinematics.size
    hardening = problem.initial_hardening
    if problem.initial_plastic_strain is not None:
        name = "initial_plastic_strain"
        p = _symmetric(name, problem.initial_plastic_strain, problem)
        trace = np.abs(np.trace(p, axis1=1, axis2=2)).max()
        if trace > 1e-10 * max(np.abs(p).max(), 1e-300):
            raise ValueError(
                f"{name} has trace up to {trace:g}: plastic strains are trace-free"
            )
    if problem.initial_strain is not None:
        require_coefficient("initial_strain", problem.initial_strain, [(), (N, N)])
        _symmetric("initial_strain", problem.eps_0, problem)
    overlay = problem.material.overlay
    if overlay is not None and hardening is not None:
        count = overlay.count * problem.kinematics.d
        require_field("initial_hardening", hardening, problem.mesh, shapes=[(count,)])
    no_pair = isinstance(hardening, tuple) and len(hardening) != 2
    if no_pair or (overlay is None and is_vector(hardening)):
        legal = f"a scalar, an {N} x {N} coefficient or the pair of both is needed"
        raise ValueError(f"initial_hardening={in_words(hardening)}: {legal}")
    scalar, back_stress = split_hardening(hardening)
    scalars = {
        "initial_hardening": scalar,
        "initial_accumulated": problem.initial_accumulated,
    }
    for name, value in scalars.items():
        if value is not None:
            require_field(name, value, problem.mesh)
            # history variables may be smaller between the points than at the points
            rules = plastic_points(problem.mesh, problem.order)
            values = sample(value, problem.mesh, rules=rules)
            size = np.abs(values)
            seen = np.where(size > 1e-14 * size.max(), values, 0.0)
            require_in(name, seen, "the body", least=0)
    if back_stress is not None:
        _symmetric("initial_hardening", back_stress, problem)


def _symmetric(
    name: str, value: CoefficientFunction, problem: ProblemData
) -> np.ndarray:
    """The samples of a symmetric tensor, shape (points, size, size)."""
    N = problem.kinematics.size
    A = require_field(name, value, problem.mesh, shapes=[(N, N)]).reshape(-1, N, N)
    if np.abs(A - A.transpose(0, 2, 1)).max() > 1e-10 * np.abs(A).max():
        raise ValueError(f"{name} is not symmetric")
    return A
