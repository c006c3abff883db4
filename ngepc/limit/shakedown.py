"""Shakedown: the largest factor of loads that vary below which plastic flow stops, bracketed.

Loads that vary within a set, in any order and any number of times, are safe for the factor alpha if
some residual stress, added to the elastic stresses of alpha times each load, satisfies the yield
condition (Melan 1938); it suffices to check the vertices of the set.  Cycles of plastic strain
whose sum is compatible bound alpha from above (Koiter 1956).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from ngsolve import CF, CoefficientFunction, GridFunction

from ngepc.bounds.counterpart import problem_on_simplices
from ngepc.bounds.sizes import power_of_two
from ngepc.checks.arguments import require_number
from ngepc.checks.sentences import in_words, outward
from ngepc.limit.bisection import singular_points
from ngepc.limit.bracket import MeshBracket, carried_stress
from ngepc.limit.cycles import alternating_bound, cycle_bracket_on
from ngepc.limit.data import LimitData
from ngepc.limit.elastic import EXACT, INITIAL_STRAIN, elastic_stress, without_loads
from ngepc.limit.fields import stress_function, velocity_function
from ngepc.limit.load import FIRST, Search, check_search, limit_load
from ngepc.limit.outcome import Bracketed, LimitRecord, LimitStatus, strongest
from ngepc.limit.reading import (
    BODY_FORCE,
    COVERS,
    check_limit_problem,
    limit_data,
    moving_supports,
)
from ngepc.limit.yielding import CYCLIC_SHAPES, YieldShape
from ngepc.linalg.conic import ConicAccuracy
from ngepc.model.features import require_covered
from ngepc.model.problem import Problem

Ranges = Mapping[str, tuple[float, float]]
"""Name of a load -> its smallest and largest factor."""

Vertices = Sequence[Mapping[str, float]]
"""For each vertex the factors of loads by name."""

SHAKEDOWN_COVERS = (COVERS | {"initial strain"}) - {
    "contact at a clamp",
    "friction",
    "held by contact",
    "hexahedra",
    "obstacle",
    "solid",
}
"""Features of a problem that shakedown loads cover."""

GUARANTEED = (
    "The elastic stresses are exact, up to rounding: the bounds are guaranteed."
)
ESTIMATED = (
    "This is an estimate: the elastic stresses were computed on the mesh of the problem, and the"
    " bounds are those for these stresses."
)
COLLAPSES = (
    "The guaranteed bounds of the limit load of one vertex are below this estimate and take its"
    " place: the mesh of the problem is too coarse for the elastic stresses."
)
SAFE = "No factor is too large: the loads that vary cause no stresses that make the material yield."
ALTERNATES = "Above the upper bound plastic strains alternate at a point."
GROWS = (
    "Above the upper bound plastic strains grow in each cycle, or the body collapses."
)


@dataclass(frozen=True, eq=False)
class ShakedownLoad(Bracketed):
    """The result of ``shakedown_load``.

    Parameters
    ----------
    problem
        The problem.
    vertices
        Factors of the loads that vary, by name, for each vertex.
    lower, upper
        Below the factor ``lower`` the body shakes down, above ``upper`` it does not.
    alternating
        The factor above which plastic strains alternate at some point, an upper bound.
    exact
        Whether the elastic stresses are exact and the bounds guaranteed.
    collapses
        Whether guaranteed bounds of a limit load contradicted an estimate and took its place.
    status
        How the search ended.
    records
        One for each mesh.
    last
        Residual stress and mechanism of the last mesh, as arrays, in units of the extent of the
        body and of the largest yield bound, as powers of two.
    """

    problem: Problem
    vertices: tuple[Mapping[str, float], ...]
    lower: float
    upper: float
    alternating: float
    exact: bool
    collapses: bool
    status: LimitStatus
    records: list[LimitRecord]
    last: MeshBracket

    @property
    def alternates(self) -> bool:
        """Whether the upper bound is that of alternating plasticity."""
        return self.upper == self.alternating

    @property
    def message(self) -> str:
        """How the search ended, whether the bounds are guaranteed, and what happens above them."""
        worth = GUARANTEED if self.exact else ESTIMATED
        if self.status is LimitStatus.UNLIMITED:
            return f"{SAFE} {worth}"
        if self.collapses:
            return f"{self.status.value} {worth} {COLLAPSES}"
        if not math.isfinite(self.relative_width):
            return f"{self.status.value} {worth}"
        beyond = ALTERNATES if self.alternates else GROWS
        return f"{self.status.value} {worth} {beyond}"

    @cached_property
    def residual_stress(self) -> CoefficientFunction | None:
        """The residual stress of the lower bound, an N x N tensor on ``mesh`` (stress).

        It is in equilibrium with the constant loads.
        """
        if self.last.stress is None:
            return None
        unit = strongest(self.problem)
        data = self.last.data
        return stress_function(self.mesh, data, self.last.shape, self.last.stress, unit)

    @cached_property
    def mechanism(self) -> GridFunction | None:
        """The displacement that each cycle adds, on ``mesh``, scaled to a largest value of one.

        None for alternating plasticity, where a cycle adds nothing.
        """
        found = self.last.mechanism
        if found is None or self.alternates:
            return None
        return velocity_function(self.mesh, self.last.data, found)

    def __repr__(self) -> str:
        bracket = ", ".join(outward(self.lower, self.upper))
        worth = "guaranteed" if self.exact else "estimate"
        return (
            f"<ShakedownLoad: load factor in [{bracket}], {worth}, {self.status.label}>"
        )


def shakedown_load(
    problem: Problem,
    vertices: Ranges | Vertices,
    relative_width: float = 0.01,
    *,
    max_cells: int | None = None,
    monitor: Callable[[LimitRecord], None] | None = None,
) -> ShakedownLoad:
    """The factor of loads that vary below which a perfectly plastic body shakes down.

    The loads vary in any order within the convex hull of some vertices.  Below the factor plastic
    flow comes to rest; above it strains alternate (fatigue) or grow in each cycle (ratchetting).
    The bounds are guaranteed where the elastic stresses are affine on the triangles of the mesh:
    displacements of degree two then give them exactly, which is checked.  Elsewhere the result is
    an estimate and says so; a finer mesh of the problem has better elastic stresses.  No body
    shakes down above its limit load: where the estimate lies above guaranteed bounds of the limit
    load of a vertex, these are returned instead.

    Parameters
    ----------
    problem
        Loads, supports, elasticity and strength; the elastic stresses are computed on its mesh.
        Hardening is neglected.
    vertices
        Either the range of each load that varies, independently of the others,
        {'top': (0, 1), 'right': (-1, 1)}, or a sequence with the factors of the loads at each
        vertex, [{}, {'top': 1}, {'top': 1, 'initial_strain': 1}], where a missing load is zero.
        Loads are boundaries with a traction or pressure, 'body_force', 'initial_strain', and
        boundaries whose prescribed displacement is other than zero.  A load that no vertex names
        is constant, and the factor does not multiply it.
    relative_width
        (upper - lower) / lower that is wanted, > 0.
    max_cells
        No mesh gets more elements; None for 10 000 triangles.
    monitor
        Called with the record of each mesh; raising StopIteration ends the run.

    Raises
    ------
    TypeError, ValueError
        For arguments that are not legal, and problems that are not covered.
    ImportError
        If Clarabel, the solver of conic programs, is not installed.
    """
    check_search(problem, relative_width, max_cells, monitor)
    require_covered(problem, "a shakedown load", SHAKEDOWN_COVERS)
    check_limit_problem(problem.changed(initial_strain=None), "a shakedown load")
    problem = problem_on_simplices(problem)
    corners = checked_vertices(problem, vertices)
    search = CycleSearch(problem, corners)
    status = search.run(relative_width, max_cells, monitor)
    bounds = (search.lower * search.unit, search.upper * search.unit)
    collapse = (math.inf, math.inf)
    if not search.exact:
        collapse = collapse_bounds(problem, corners, relative_width, max_cells)
    return ShakedownLoad(
        problem,
        corners,
        min(bounds[0], collapse[0]) if bounds[1] > collapse[1] else bounds[0],
        min(bounds[1], collapse[1]),
        search.alternating * search.unit,
        search.exact,
        bounds[1] > collapse[1],
        status,
        search.records,
        search.last,
    )


def collapse_bounds(
    problem: Problem,
    vertices: Sequence[Mapping[str, float]],
    relative_width: float,
    max_cells: int | None,
) -> tuple[float, float]:
    """Guaranteed bounds of the smallest limit load of the vertices, infinite without forces."""
    varying = {name for corner in vertices for name in corner}
    forces = {*problem.tractions}
    if problem.body_force is not None:
        forces.add(BODY_FORCE)
    lower = math.inf
    upper = math.inf
    for corner in vertices:
        acting = [name for name in forces if corner.get(name, 0.0) != 0]
        if not acting:
            continue
        alone = without_loads(problem, [*(varying - {*acting}), INITIAL_STRAIN])
        loaded = multiplied(alone, {name: corner[name] for name in acting})
        found = limit_load(loaded, relative_width, sorted(acting), max_cells=max_cells)
        lower = min(lower, found.lower)
        upper = min(upper, found.upper)
    return lower, upper


def multiplied(problem: Problem, factors: Mapping[str, float]) -> Problem:
    """The problem with the loads of these names multiplied by factors."""
    changed = {}
    for field in ("traction", "pressure"):
        given = problem.single(field).items()
        changed[field] = {name: CF(g) * factors.get(name, 1.0) for name, g in given}
    if BODY_FORCE in factors:
        changed[BODY_FORCE] = CF(problem.body_force) * factors[BODY_FORCE]
    return problem.changed(**changed)


def checked_vertices(
    problem: Problem, vertices: Ranges | Vertices
) -> tuple[Mapping[str, float], ...]:
    """The factors of each vertex; TypeError or ValueError where they are not legal."""
    if isinstance(vertices, Mapping):
        vertices = vertices_of_box(vertices)
    if isinstance(vertices, str | bytes) or not isinstance(vertices, Sequence):
        raise TypeError(
            f"vertices={in_words(vertices)}: ranges of loads, or a sequence of "
            "factors of loads, are needed"
        )
    legal = names_of_loads(problem)
    for number, corner in enumerate(vertices):
        check_corner(f"vertices[{number}]", corner, legal)
    if not any(factor != 0 for corner in vertices for factor in corner.values()):
        raise ValueError(
            f"vertices={in_words(vertices)}: a load with a factor is needed"
        )
    distinct: list[Mapping[str, float]] = []
    for corner in vertices:
        if corner not in distinct:
            distinct.append(dict(corner))
    return tuple(distinct)


def vertices_of_box(ranges: Ranges) -> list[dict[str, float]]:
    """The corners of the box of all factors within these ranges."""
    for name, ends in ranges.items():
        if not isinstance(ends, tuple | list) or len(ends) != 2:
            raise TypeError(
                f"vertices[{name!r}]={in_words(ends)}: the smallest and the "
                "largest factor are needed"
            )
    return [
        dict(zip(ranges, corner, strict=True)) for corner in product(*ranges.values())
    ]


def check_corner(argument: str, corner: object, legal: Sequence[str]) -> None:
    """Check the factors of one vertex, the value of ``argument``."""
    if not isinstance(corner, Mapping):
        raise TypeError(
            f"{argument}={in_words(corner)}: a mapping of names of loads "
            "to factors is needed"
        )
    for name, factor in corner.items():
        if name not in legal:
            raise ValueError(
                f"{argument}: there is no load {name!r}; one of"
                f" {', '.join(map(repr, legal))} is needed"
            )
        require_number(f"{argument}[{name!r}]", factor)


def names_of_loads(problem: Problem) -> tuple[str, ...]:
    """The names that vertices may use."""
    names = [*problem.tractions]
    for field in (BODY_FORCE, INITIAL_STRAIN):
        if getattr(problem, field) is not None:
            names.append(field)
    return (*names, *moving_supports(problem))


class CycleSearch(Search):
    """The loop over meshes for loads that vary."""

    def __init__(
        self, problem: Problem, vertices: Sequence[Mapping[str, float]]
    ) -> None:
        shape: YieldShape = CYCLIC_SHAPES[problem.kinematics.name]
        names = sorted({name for corner in vertices for name in corner})
        constant = without_loads(problem, names)
        data = replace(limit_data(constant, ()), moves=False)
        super().__init__(problem.mesh, data, shape)
        loads = names_of_loads(problem)
        found = [elastic_stress(problem, shape, name, loads) for name in names]
        factors = np.array(
            [[corner.get(name, 0.0) for name in names] for corner in vertices]
        )
        residuals = factors @ np.stack([rest for _, rest, _ in found])
        elastic = np.tensordot(factors, np.stack([a for a, _, _ in found]), axes=1)
        self.loads = [data for _, _, data in found]
        self.exact = bool(np.abs(residuals).max() <= EXACT * np.abs(elastic).max())
        size = power_of_two(float(np.abs(elastic[..., shape.free :]).max()))
        self.unit = power_of_two(float(data.bound.max())) / size
        self.elastic = elastic / size
        self.alternating = alternating_bound(self.data, shape, self.elastic)
        self.upper = self.alternating

    def accuracy(self) -> ConicAccuracy:
        """A gap of at most that of the first mesh, as lower bounds may reach alternation at once.

        With the larger residuals of limit loads brackets do not close: that of a plate with a hole
        is wider on 5,000 elements than else on 245.
        """
        return ConicAccuracy(min(FIRST, self.gap()))

    def solved(self, accuracy: ConicAccuracy) -> tuple[MeshBracket, np.ndarray | None]:
        """Both bounds on the mesh, and the admissible stress that the lower bound starts from."""
        return cycle_bracket_on(
            self.data, self.shape, self.elastic, self.centre, accuracy
        )

    def carry(self, data: LimitData, parents: np.ndarray) -> None:
        """Transfer the data, the admissible stress and the elastic stresses to finer cells."""
        self.elastic = np.stack(
            [carried_stress(self.data, data, parents, part) for part in self.elastic]
        )
        self.loads = [load.on(data.cells, parents) for load in self.loads]
        super().carry(data, parents)

    def singular(self) -> np.ndarray:
        """Boundary vertices, as booleans, around which the stresses of some load jump."""
        return np.any([singular_points(load) for load in self.loads], axis=0)
