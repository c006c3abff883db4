"""Checks of the data of a problem, made before any work is done.

NGSolve accepts misspelt boundaries, singular supports and NaN without a message. Here each is an
error that names the argument, its value and what is legal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import product

import numpy as np
from ngsolve import CF, CoefficientFunction, Det, Mesh, specialcf, x, y, z

from ngepc.checks.arguments import (
    boundary_names,
    corner_rules,
    is_number,
    require_coefficient,
    require_components,
    require_datum,
    require_field,
    require_in,
    require_number,
    require_points,
    sample,
)
from ngepc.checks.coefficients import foreign_meshes
from ngepc.checks.declared import declared_checks
from ngepc.checks.kinds import require_instance, require_mesh
from ngepc.checks.sentences import counted, in_words
from ngepc.model.data import (
    ACTING,
    HISTORY,
    Components,
    ProblemData,
    as_scalar,
    same_fields,
)
from ngepc.model.elements import (
    SHAPES,
    corner_vertices,
    element_nodes,
    has_more_corners,
    is_straight,
    plastic_points,
    vertex_coordinates,
)
from ngepc.model.features import (
    BASIC_FEATURES,
    ELEMENT_FEATURES,
    HISTORY_FEATURES,
    KINEMATICS_FEATURES,
    LAW_FEATURES,
    require_covered,
)
from ngepc.model.hardening import check_law
from ngepc.model.kinematics import TWO_DIMENSIONAL
from ngepc.model.material import Material, is_vector, split_hardening
from ngepc.model.places import Coulomb, Place, Roller, places, values_at, vertices_at
from ngepc.model.support import (
    check_held,
    check_motions,
    held_directions,
    pressed_names,
)
from ngepc.model.viscosity import check_rate

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


def check_mesh(mesh: Mesh) -> None:
    """A mesh in two or three dimensions with elements of positive size, all oriented alike."""
    require_mesh("mesh", mesh)
    if mesh.comm.size > 1:
        raise ValueError(
            f"mesh is on {mesh.comm.size} processes: ngepc.distribute is needed"
        )
    nodes = element_nodes(mesh)
    if len(nodes) == 0:
        raise ValueError("mesh has no elements: a mesh of the body is needed")
    if (nodes[:, 2**mesh.dim :] >= 0).any():
        raise ValueError(
            "mesh has elements of second order: leave SecondOrder() out, take mesh.Curve()"
        )
    strange = set((nodes >= 0).sum(axis=1).tolist()) - {
        k for N, k in SHAPES if mesh.dim == N
    }
    if strange:
        legal = "triangles, quadrilaterals, tetrahedra, prisms or hexahedra are needed"
        raise ValueError(
            f"mesh has elements with {counted(min(strange), 'corner')}: {legal}"
        )
    determinant = Det(specialcf.JacobianMatrix(mesh.dim))
    size = sample(determinant, mesh)
    if not np.isfinite(size).all() or np.abs(size).min() <= 1e-14 * np.abs(size).max():
        raise ValueError("mesh has degenerate elements (zero area or volume)")
    if (nodes[:, 2**mesh.dim - 1] >= 0).any():
        corner = sample(determinant, mesh, rules=corner_rules(mesh.dim))
        size = np.append(size, corner[np.abs(corner) > 1e-12 * np.abs(size).max()])
    if size.min() < 0 < size.max():
        raise ValueError(
            "mesh has inverted elements (Jacobian determinants of both signs)"
        )
    if is_straight(mesh) and has_more_corners(mesh):
        check_corners(mesh, nodes)


def check_corners(mesh: Mesh, nodes: np.ndarray) -> None:
    """Refuse elements that NGSolve maps by affine functions, but whose corners are elsewhere.

    ``nodes`` are those of ``element_nodes``.  Elements of structured meshes are marked as
    parallelograms, which they no longer are after vertices were moved.
    """
    mapped = sample(CF((x, y, z)[: mesh.dim]), mesh, rules=corner_rules(mesh.dim))
    places = vertex_coordinates(mesh)
    defect = np.abs(mapped - places[nodes[nodes >= 0]]).max()
    if defect > 1e-9 * np.ptp(places, axis=0).max():
        raise ValueError(
            "mesh has elements that are marked as parallelograms, but are none: set "
            "curved=True for its Netgen elements when their vertices were moved"
        )


def check_material(problem: ProblemData) -> None:
    """Elliptic elasticity, positive yield stress and hardening everywhere; radii x >= 0."""
    material = problem.material
    mesh = problem.mesh
    N = problem.kinematics.size
    require_instance("material", material, Material, "a Material")
    for name, check in declared_checks(Material).items():
        if check.func is require_datum:
            require_field(name, getattr(material, name), mesh, **check.keywords)
    bulk = N * material.lame_lambda + 2 * material.lame_mu
    bulk = require_in(
        f"{N} lame_lambda + 2 lame_mu", sample(bulk, mesh), "the body"
    ).min()
    if bulk <= 0:
        raise ValueError(
            f"lame_lambda={in_words(material.lame_lambda)}: the elasticity is not elliptic, "
            f"{N} lambda + 2 mu falls to {bulk:g}, > 0 is needed for {N} x {N} tensors"
        )
    if material.data_sheet and problem.kinematics is TWO_DIMENSIONAL:
        needed = "its factors are those of three dimensions, Material.kinematic or"
        raise ValueError(
            f'kinematics="two-dimensional" with {in_words(material)}: {needed} '
            "Material.isotropic is needed"
        )
    if material.law is not None:
        check_law(material.law, mesh)
    if material.rate is not None:
        check_rate(material.rate, mesh)
    if material.hill is not None:
        check_hill(problem)
    if material.overlay is not None:
        check_overlay(problem)
    name = "the hardening h = k + (H sigma_y)^2 k_1"
    h = require_in(name, sample(material.effective_hardening, mesh), "the body").min()
    if h <= 0 and material.law is None and material.overlay is None:
        raise ValueError(
            f"{name} falls to {h:g}: > 0 is needed, "
            "the method is for hardening plasticity (perfect plasticity is a Tabulated law)"
        )
    radii = np.asarray(mesh.ngmesh.Coordinates())[:, 0]
    if problem.kinematics.hoop and radii.min() < -1e-12 * np.abs(radii).max():
        reach = f"the mesh reaches to x = {radii.min():g}, radii x >= 0 are needed"
        raise ValueError(f'kinematics="axisymmetric": {reach}')


def check_hill(problem: ProblemData) -> None:
    """Anisotropic yield, of a body in three dimensions."""
    material = problem.material
    if problem.kinematics is TWO_DIMENSIONAL:
        raise ValueError(
            f'kinematics="two-dimensional" with hill={in_words(material.hill)}: '
            "another kinematics is needed, the ellipsoid has three axes"
        )
    for name in ("F", "G", "H", "L", "M", "N", "angle"):
        require_field(f"hill.{name}", getattr(material.hill, name), problem.mesh)
    basis = problem.kinematics.basis
    fields = [
        getattr(material.hill, n) for n in ("F", "G", "H", "L", "M", "N", "angle")
    ]
    samples = np.broadcast_arrays(*(sample(f, problem.mesh)[:, 0] for f in fields))
    values = dict(zip(map(id, fields), samples, strict=True))
    material.hill.form(basis, lambda datum: values[id(datum)])


def check_overlay(problem: ProblemData) -> None:
    """Sub-elements without other hardening, of a body in three dimensions."""
    material = problem.material
    overlay = material.overlay
    if problem.kinematics is TWO_DIMENSIONAL:
        raise ValueError(
            f'kinematics="two-dimensional" with overlay={in_words(overlay)}: '
            "another kinematics is needed, the curve is that of a bar in three dimensions"
        )
    for name in ("hardening", "hardening_modulus", "law", "rate", "hill"):
        value = getattr(material, name)
        absent = value is None or (is_number(value) and value == 0)
        if not absent:
            raise ValueError(
                f"{name}={in_words(value)} with overlay={in_words(overlay)}: leave one of them out"
            )
    first = sample(as_scalar(material.yield_stress), problem.mesh)
    if not np.allclose(first, overlay.bounds[0], rtol=1e-12):
        raise ValueError(
            f"yield_stress={in_words(material.yield_stress)} with "
            f"overlay={in_words(overlay)}: the first bound, "
            f"{overlay.bounds[0]:g}, is needed"
        )


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
    mesh = problem.mesh
    names = problem.contact_names
    given = problem.gap
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
    if several and set(given) != set(names):
        wrong = sorted(map(str, given))
        raise ValueError(
            f"gap names {wrong}: the contact boundaries are {sorted(names)}"
        )
    for name in names:
        argument, gap = (f"gap[{name!r}]", given[name]) if several else ("gap", given)
        if hasattr(gap, "gap"):
            needed = "the gap to this obstacle is needed, obstacle.gap(mesh)"
            raise TypeError(f"{argument}={in_words(gap)}: {needed}")
        require_field(argument, gap, mesh, [name], corners=True)


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
            "Tresca's bound F, "
            "or Coulomb(mu)"
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
