"""Limit loads: guaranteed lower and upper bounds, on adaptively refined meshes."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence

import numpy as np
from ngsolve import Mesh

from ngepc.bounds.copies import bisected
from ngepc.bounds.counterpart import problem_on_simplices
from ngepc.bounds.simplices import Simplices, marked
from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.kinds import require_function, require_instance
from ngepc.checks.sentences import in_words
from ngepc.limit.bisection import (
    bisected_cells,
    fan_cells,
    singular_points,
    split_corners,
)
from ngepc.limit.bracket import MeshBracket, bracket_on, carried_centre
from ngepc.limit.data import GROWS, LimitData
from ngepc.limit.fields import mesh_of
from ngepc.limit.outcome import LimitLoad, LimitRecord, LimitStatus, width_of
from ngepc.limit.reading import check_limit_problem, growing_names, limit_data
from ngepc.limit.rigid import moves_freely
from ngepc.limit.yielding import SHAPES, YieldShape
from ngepc.linalg.blas import one_blas_thread
from ngepc.linalg.conic import ConicAccuracy
from ngepc.model.problem import Problem

log = logging.getLogger(__name__)

MARKING = 0.5
"""Cells with this share of the gap are cut."""

ENOUGH = 0.8
"""Largest share of the gap in the cells that are cut for the last mesh."""

AIM = 0.9
"""The last mesh aims at this fraction of the tolerance."""

EXPECTED = 0.7
"""Expected relative decrease of the gap in cells that are cut."""

MAX_CELLS = {2: 10_000, 3: 2_000}
"""Default of the largest number of cells in the plane and in space, one to three minutes."""

FINISHED = 1.5
"""Velocities of the last degree are used once the width is this multiple of the tolerance."""

LEAST = 0.25
"""Smallest share of the gap in the cells that are cut."""

PRECISE = 3e-3
"""Gap of the conic programs over that of the bounds of the mesh before, or the requested one."""

FIRST = 1e-5
"""The same of the first mesh, without units: where its fields are exact it is the last one."""

RESIDUALS = 1e-6
"""Of the conditions of these programs: what is left is removed from stresses and mechanisms."""

REFINEMENT = 1e-2
"""Residuals of their linear systems over the gap; down to Clarabel's 1e-13 takes twice the time."""

REGULARISATION = 1e-7
"""Of their pivots.  With Clarabel's 1e-8 programs of solids end in 'NumericalError'."""

NOTHING = 1e-6
"""A smaller lower/upper ratio indicates loads that are incompatible at the edges of a solid."""

FOLLOWED = (
    "; without hardening evolve(problem, load_cycle(problem, [1.0], steps=10)) ends near it, if "
    "the loads are beyond it"
)
"""What is advised where a limit load is refused."""


@one_blas_thread
def limit_load(
    problem: Problem,
    relative_width: float = 0.01,
    growing: Sequence[str] | None = None,
    *,
    max_cells: int | None = None,
    monitor: Callable[[LimitRecord], None] | None = None,
) -> LimitLoad:
    """The load factor at which a perfectly plastic body collapses, between guaranteed bounds.

    The body carries the constant loads plus a factor times the growing loads if and only if some
    stress in equilibrium with them nowhere exceeds the yield bound (lower bound theorem).  It
    collapses if the power of the loads exceeds the dissipation for some velocity (upper bound
    theorem).

    Parameters
    ----------
    problem
        Loads, supports, strength, obstacles that touch; its mesh is where refinement starts.
        Quadrilaterals and hexahedra are cut into triangles and tetrahedra first.  Hardening,
        elasticity and ``order`` are ignored.
    relative_width
        (upper - lower) / lower that is wanted, > 0.
    growing
        Names of the loads that grow: boundaries with a traction or pressure, 'body_force', or
        boundaries whose prescribed displacement is other than zero; the others stay as they are.
        None for all tractions, pressures and body forces, without any all supports that move.
    max_cells
        No mesh gets more elements; None for 10 000 triangles or 2 000 tetrahedra.
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
    check_limit_problem(problem, "a limit load", FOLLOWED)
    problem = problem_on_simplices(problem)
    names = growing_names(problem, growing)
    shape = SHAPES[problem.kinematics.name]
    data = limit_data(problem, names)
    check_grows(data, names)
    search = Search(problem.mesh, data, shape)
    status = search.run(relative_width, max_cells, monitor)
    bounds = (search.lower * search.unit, search.upper * search.unit)
    return LimitLoad(problem, names, *bounds, status, search.records, search.last)


def check_search(
    problem: object, relative_width: object, max_cells: object, monitor: object
) -> None:
    """Check the arguments that limit loads and shakedown loads share."""
    require_instance("problem", problem, Problem, "a Problem")
    require_number("relative_width", relative_width, 0, strict=True)
    if max_cells is not None:
        require_integer("max_cells", max_cells, 1)
    require_function("monitor", monitor, "a record", optional=True)


def check_grows(data: LimitData, names: Sequence[str]) -> None:
    """ValueError if the growing loads, or the motion of supports, are zero everywhere."""
    growing = (data.force[GROWS], data.traction[GROWS], data.motion)
    if not any(load.any() for load in growing):
        raise ValueError(
            f"growing={in_words(list(names))}: these loads are zero, and so is each multiple"
        )


class Search:
    """The loop over meshes; only its records have units."""

    last: MeshBracket
    tolerance: float

    def __init__(self, mesh: Mesh, data: LimitData, shape: YieldShape) -> None:
        self.shape = shape
        self.original = data
        self.mesh = mesh
        self.data, self.unit = self.original.without_units()
        # without constant loads the stress zero is admissible, with the factor zero
        self.lower = -math.inf if data.has_constant else 0.0
        self.is_free = moves_freely(self.data)
        self.upper = 0.0 if self.is_free else math.inf
        self.records: list[LimitRecord] = []
        self.centre: np.ndarray | None = None
        self.is_last = False

    def run(
        self,
        tolerance: float,
        max_cells: int | None,
        monitor: Callable[[LimitRecord], None] | None,
    ) -> LimitStatus:
        """Solve and cut cells until the relative width is at most the tolerance."""
        self.tolerance = tolerance
        most = max_cells or MAX_CELLS[self.mesh.dim]
        while True:
            self.last, self.centre = self.solved(self.accuracy())
            record = self.record()
            try:
                if monitor is not None:
                    monitor(record)
            except StopIteration:
                return LimitStatus.STOPPED
            if self.is_free and self.upper == 0:
                return LimitStatus.FREE
            if self.last.overloaded:
                if self.last.mechanism is None:  # a certificate without a number
                    self.lower = self.upper = -math.inf
                return LimitStatus.OVERLOADED
            if self.last.unlimited:
                self.lower = self.upper = math.inf
                return LimitStatus.UNLIMITED
            if width_of(self.lower, self.upper) <= tolerance:
                return LimitStatus.REACHED
            if not self.refine(most):
                weak = self.centre is None
                return LimitStatus.TOO_WEAK if weak else LimitStatus.MESH_LIMIT

    def accuracy(self) -> ConicAccuracy:
        """What the conic programs of the next mesh are solved to."""
        gap = self.gap()
        return ConicAccuracy(gap, RESIDUALS, REFINEMENT * gap, REGULARISATION)

    def gap(self) -> float:
        """The gap that they may leave, without units."""
        between = self.upper - self.lower
        if not self.records or not math.isfinite(between):
            return min(FIRST, PRECISE * self.tolerance)
        return PRECISE * max(between, self.tolerance * abs(self.lower))

    def solved(self, accuracy: ConicAccuracy) -> tuple[MeshBracket, np.ndarray | None]:
        """Both bounds on the mesh, and the admissible stress that the lower bound starts from."""
        within = FINISHED * self.tolerance
        return bracket_on(
            self.data, self.shape, self.centre, accuracy, within, self.is_last
        )

    def singular(self) -> np.ndarray:
        """Boundary vertices, as booleans, around which stresses jump."""
        return singular_points(self.data)

    def carry(self, data: LimitData, parents: np.ndarray) -> None:
        """Transfer the data and the admissible stress to finer cells."""
        if self.centre is not None:
            self.centre = carried_centre(self.data, data, parents, self.centre)
        self.data = data

    def record(self) -> LimitRecord:
        """Update the bounds by the last mesh."""
        last = self.last
        self.lower = max(self.lower, last.lower)
        self.upper = min(self.upper, last.upper)
        # Loads that do work in a rigid motion are balanced up to rounding only.
        if self.is_free:
            self.lower = min(self.lower, self.upper)
        bounds = (self.lower * self.unit, self.upper * self.unit)
        count = len(last.data.cells.nodes)
        record = LimitRecord(count, last.unknowns, *bounds, last.steps, last.words)
        self.records.append(record)
        log.info("%s", record)
        return record

    def refine(self, max_cells: int) -> bool:
        """Cut cells with large gaps and cells of fans; False if that gives too many cells."""
        chosen = marked(self.last.marks, self.share())
        if self.data.cells.N == 2:
            data, parents = self.cut_triangles(chosen)
        else:
            data, parents = self.cut_tetrahedra(chosen)
        if len(data.cells.nodes) > max_cells:
            return False
        self.carry(data, parents)
        return True

    def share(self) -> float:
        """The share of the gap in the cells to cut; also decides whether the next mesh is last."""
        width = width_of(self.lower, self.upper)
        if not math.isfinite(width):
            return MARKING
        flat = self.data.cells.N == 2
        aim = AIM * self.tolerance * (FINISHED if flat else 1.0)
        share = (1 - aim / width) / EXPECTED
        self.is_last = flat and share <= ENOUGH
        return MARKING if share > ENOUGH else max(LEAST, share)

    def cut_triangles(self, chosen: np.ndarray) -> tuple[LimitData, np.ndarray]:
        """The data on finer triangles, and the parents of these."""
        data = self.last.data
        flow = self.last.mechanism
        dissipated = self.last.gaps if flow is None else flow.dissipated
        width = width_of(self.lower, self.upper)
        fans = fan_cells(data, self.singular(), dissipated, width)
        finer, parents = bisected_cells(data.cells, chosen, fans)
        return data.on(finer, parents), parents

    def cut_tetrahedra(self, chosen: np.ndarray) -> tuple[LimitData, np.ndarray]:
        """The data on finer tetrahedra, and the parents of these.

        Cells with several outer facets are cut first, if they keep the lower bound at zero.
        """
        finer, parents = split_corners(self.original)
        splits = len(finer.nodes) > len(self.data.cells.nodes)
        if splits and self.lower <= NOTHING * self.upper:
            whole = self.original.on(finer, parents)
            self.mesh = mesh_of(whole, self.mesh, 1.0)
        else:
            self.mesh, parents = bisected(self.mesh, chosen)
            finer = Simplices.of(self.mesh)
        self.original = self.original.on(finer, parents)
        data, _ = self.original.without_units()
        return data, parents
