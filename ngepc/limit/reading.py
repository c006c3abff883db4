"""From a problem to the data of its limit load; checks of what limit loads cover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from ngsolve import CF, VOL, CoefficientFunction, IntegrationRule

from ngepc.bounds.boundary import OuterFacets
from ngepc.bounds.coverage import varies_inside
from ngepc.bounds.hexahedra import check_hexahedra
from ngepc.bounds.simplices import Simplices
from ngepc.checks.arguments import ELEMENT_TYPES, Coefficient
from ngepc.checks.sentences import in_words
from ngepc.limit.data import GROWS, STAYS, LimitData
from ngepc.model.data import as_scalar
from ngepc.model.elements import regions_of
from ngepc.model.features import BASIC_FEATURES, require_covered
from ngepc.model.places import Roller
from ngepc.model.problem import Problem

BODY_FORCE = "body_force"
"""The name of the body force in ``growing``."""

COVERS = BASIC_FEATURES | {
    "contact at a clamp",
    "friction",
    "hardening law",
    "held by contact",
    "hexahedra",
    "order 2",
    "plane stress",
    "quadrilaterals",
    "rollers",
}
"""Features of a problem that limit loads cover; hardening is neglected."""

CLOSED = 1e-12
"""A gap below this fraction of the extent of the body counts as closed."""


def check_limit_problem(problem: Problem, what: str, advice: str = "") -> None:
    """Refuse what limit loads do not cover with a ValueError that names the argument.

    ``advice`` is what to do instead.
    """
    require_covered(problem, what, COVERS, advice)
    check_hexahedra(problem.mesh)
    if problem.initial_displacement is not None:
        raise ValueError(
            f"initial_displacement: {what} does not depend on it; leave it out"
        )
    constant = {"yield_stress": problem.material.yield_stress, BODY_FORCE: problem.f}
    for name, value in constant.items():
        if isinstance(value, CoefficientFunction) and varies_inside(problem, value):
            raise ValueError(
                f"{name} varies inside elements: {what} needs one value on each element"
            )


def growing_names(problem: Problem, growing: Sequence[str] | None) -> tuple[str, ...]:
    """The loads that grow, by name: all tractions, pressures and body forces for None.

    If there are none, the supports that move.
    """
    loads = list(problem.tractions)
    if problem.body_force is not None:
        loads.append(BODY_FORCE)
    moving = moving_supports(problem)
    if growing is None:
        growing = loads or moving
        if not growing:
            raise ValueError(
                "the problem has no load: a limit load needs tractions, pressures, a body force,"
                " or a support with a displacement other than zero"
            )
    if isinstance(growing, str | bytes) or not isinstance(growing, Sequence):
        raise TypeError(
            f"growing={in_words(growing)}: a sequence of names of loads is needed"
        )
    asked = f"growing={in_words(growing)}: "
    for name in growing:
        if name not in (*loads, *moving):
            legal = ", ".join(map(repr, (*loads, *moving)))
            raise ValueError(
                f"{asked}there is no load {name!r}; one of {legal} is needed"
            )
    if not growing:
        raise ValueError(f"{asked}at least one name is needed")
    if {*growing} & {*loads} and {*growing} - {*loads}:
        raise ValueError(
            f"{asked}either forces or supports that move are needed, not both"
        )
    return tuple(growing)


def moving_supports(problem: Problem) -> list[str]:
    """Names of the supports with a displacement other than zero."""
    supports = problem.single("prescribed").items()
    return [name for name, given in supports if _moves(given)]


def _moves(given: Sequence[Coefficient | None] | Roller) -> bool:
    """Whether a prescribed displacement is other than zero."""
    values = [given.value] if isinstance(given, Roller) else given
    numbers = [0.0 if value is None else value for value in values]
    return any(isinstance(v, CoefficientFunction) or v != 0 for v in numbers)


def limit_data(problem: Problem, growing: tuple[str, ...]) -> LimitData:
    """The data on the mesh of a problem, with the loads that grow by name."""
    cells = Simplices.of(problem.mesh)
    facets = OuterFacets(problem.mesh, cells)
    moves = not {*growing} & {*problem.tractions, BODY_FORCE}
    force = np.zeros((2, len(cells.nodes), cells.N))
    if problem.f is not None:
        kind = GROWS if BODY_FORCE in growing else STAYS
        force[kind] = _on_cells(problem, problem.f)
    supports = _supports(problem, facets, growing if moves else ())
    obstacles = _obstacles(problem, facets, supports)
    side = np.full(len(cells.facets), -1)
    side[facets.facet] = regions_of(problem.mesh, cells.N - 1)
    return LimitData(
        cells=cells,
        region=regions_of(problem.mesh, cells.N),
        side=np.where(cells.outer, side, -1),
        bound=_on_cells(problem, as_scalar(problem.material.yield_stress))[:, 0],
        force=force,
        traction=_tractions(problem, facets, growing),
        **supports,
        **obstacles,
        moves=moves,
    )


def _on_cells(problem: Problem, value: CoefficientFunction) -> np.ndarray:
    """Values of a coefficient that is constant on cells, (nc, components)."""
    rules = {shape: IntegrationRule(shape, 1) for shape in ELEMENT_TYPES[problem.N]}
    points = problem.mesh.MapToAllElements(rules, VOL)
    return np.asarray(value(points), dtype=float).reshape(problem.mesh.ne, -1)


def _tractions(
    problem: Problem, facets: OuterFacets, growing: tuple[str, ...]
) -> np.ndarray:
    """Tractions at the vertices of facets, (2, nf, N, N)."""
    N = problem.N
    result = np.zeros((2, len(facets.cells.facets), N, N))
    for name, g in problem.tractions.items():
        argument = f"traction[{name!r}]"
        on = facets.on((name,), argument)
        whole = problem.mesh.BoundaryCF({name: g}, default=CF((0.0,) * N))
        values = facets.affine(argument, whole, on)
        kind = GROWS if name in growing else STAYS
        result[kind, facets.facet[on]] = facets.at_vertices(values, on)
    return result


def _supports(
    problem: Problem, facets: OuterFacets, moving: tuple[str, ...]
) -> dict[str, np.ndarray]:
    """Frames of facets, numbers of held rows of the frames, and prescribed velocities."""
    cells = facets.cells
    N = cells.N
    count = len(cells.facets)
    frame = np.tile(np.eye(N), (count, 1, 1))
    held = np.zeros(count, dtype=int)
    motion = np.zeros((count, N, N))
    each: Mapping = dict.fromkeys(problem.clamped_names, (0.0,) * N)
    for name, given in (each | problem.single("prescribed")).items():
        on = facets.on((name,), f"support {name!r}")
        numbers = facets.facet[on]
        directions, values = _directions(given, cells.normal[numbers])
        held[numbers] = directions.shape[1]
        frame[numbers] = completed_frame(directions)
        for i, value in enumerate(values if name in moving else ()):
            speeds = facets.affine(f"prescribed[{name!r}]", value, on)
            speeds = facets.at_vertices(speeds, on)
            motion[numbers] += speeds * directions[:, i, None]
    return {"frame": frame, "held": held, "motion": motion}


def _directions(
    given: Sequence[Coefficient | None] | Roller, normals: np.ndarray
) -> tuple[np.ndarray, list[Coefficient]]:
    """Orthonormal directions (k, held, N) along which facets are held, and displacements."""
    N = normals.shape[1]
    if isinstance(given, Roller):
        along = normals if given.direction is None else np.array(given.direction)
        return np.broadcast_to(along, normals.shape)[:, None], [given.value]
    axes = [i for i, value in enumerate(given) if value is not None]
    directions = np.tile(np.eye(N)[axes], (len(normals), 1, 1))
    return directions, [given[i] for i in axes]


def completed_frame(directions: np.ndarray) -> np.ndarray:
    """Orthonormal rows (k, N, N) that begin with the given ones, (k, m, N)."""
    count, given, N = directions.shape
    frame = np.tile(np.eye(N), (count, 1, 1))
    if given:
        _, _, rows = np.linalg.svd(directions, full_matrices=True)
        frame[:, :given] = directions
        frame[:, given:] = rows[:, given:]
    return frame


def _obstacles(
    problem: Problem, facets: OuterFacets, supports: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Which facets an obstacle touches, and the bound of friction at their vertices.

    Their frames begin with the normal.
    """
    cells = facets.cells
    contact = np.zeros(len(cells.facets), dtype=bool)
    friction = np.zeros((len(cells.facets), cells.N))
    on = facets.on(problem.contact_names, f"contact={in_words(problem.contact)}")
    numbers = facets.facet[on]
    contact[numbers] = True
    if supports["held"][numbers].any():
        raise ValueError(
            f"contact={in_words(problem.contact)}: a limit load needs no support on "
            "the same boundary"
        )
    supports["frame"][numbers] = completed_frame(cells.normal[numbers][:, None])
    gap = facets.values(problem.psi, on)
    if np.abs(gap).max(initial=0.0) > CLOSED * np.ptp(cells.points, axis=0).max():
        raise ValueError(
            f"gap={in_words(problem.gap)}: a limit load needs obstacles that touch, "
            "with a gap of zero"
        )
    if problem.friction is not None:
        values = facets.affine("friction", problem.friction, on)
        friction[numbers] = facets.at_vertices(values, on)[:, :, 0]
    return {"contact": contact, "friction": friction}
