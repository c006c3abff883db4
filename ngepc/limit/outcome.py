"""The answer of a limit load: both bounds, how the search ended, stress and mechanism."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from ngsolve import CoefficientFunction, GridFunction, Mesh

from ngepc.bounds.sizes import power_of_two
from ngepc.checks.labelled import Labelled
from ngepc.checks.sentences import counted, outward
from ngepc.limit.bracket import MeshBracket
from ngepc.limit.fields import (
    cell_order,
    mesh_of,
    on_elements,
    stress_function,
    velocity_function,
)
from ngepc.limit.reading import limit_data
from ngepc.limit.yielding import SHAPES
from ngepc.model.elements import vertex_coordinates
from ngepc.model.problem import Problem
from ngepc.results.outcome import WithMessage

HARDENS = "Hardening is neglected: the strength is the yield stress of the material."

NEGATIVE = (
    "The factor is negative: the constant loads alone make the body collapse, and only growing "
    "loads against their direction could hold it."
)


class LimitStatus(Labelled):
    """How the search for a limit load ended; the value is the sentence for the user."""

    REACHED = "The bounds are as close as requested."
    MESH_LIMIT = (
        "The bounds are valid; a finer mesh would be needed, but max_cells forbids it."
    )
    STOPPED = "The monitor stopped the run; the bounds of the last mesh are valid."
    TOO_WEAK = (
        "No stress within the yield bound was found that balances the constant loads."
    )
    OVERLOADED = "The constant loads alone make the body collapse, whatever the growing loads are."
    UNLIMITED = (
        "No factor makes the body collapse: stresses within the yield bound balance each multiple"
        " of the growing loads."
    )
    FREE = (
        "The growing loads drive a rigid motion that supports and obstacles leave free: the limit"
        " load is zero."
    )

    @property
    def is_success(self) -> bool:
        """Whether the bounds are as close as requested; two zeros are."""
        return self in (LimitStatus.REACHED, LimitStatus.FREE)


@dataclass(frozen=True)
class LimitRecord:
    """The record of one mesh of ``limit_load``.

    Parameters
    ----------
    cells
        Elements of the mesh.
    unknowns
        Numbers of unknowns of the programs for the lower and the upper bound.
    lower, upper
        The best bounds up to this mesh.
    steps
        Steps of the interior point method for the lower and the upper bound.
    words
        Final status of the solver for both.
    """

    cells: int
    unknowns: tuple[int, int]
    lower: float
    upper: float
    steps: tuple[int, int]
    words: tuple[str, str]

    @property
    def relative_width(self) -> float:
        """(upper - lower) / lower."""
        return width_of(self.lower, self.upper)


def width_of(lower: float, upper: float) -> float:
    """(upper - lower) / |lower|, infinite where a bound is infinite or only the lower one zero."""
    if upper == lower and math.isfinite(lower):
        return 0.0
    if not math.isfinite(upper - lower) or lower == 0:
        return math.inf
    return (upper - lower) / abs(lower)


class Bracketed(WithMessage):
    """Width and last mesh of a result with both bounds: a limit load or a shakedown load."""

    problem: Problem
    lower: float
    upper: float
    last: MeshBracket

    @property
    def relative_width(self) -> float:
        """(upper - lower) / lower."""
        return width_of(self.lower, self.upper)

    @cached_property
    def mesh(self) -> Mesh:
        """The last mesh, on which the fields are given."""
        return mesh_of(self.last.data, self.problem.mesh, self.length)

    @property
    def length(self) -> float:
        """The unit of length of ``last``: the extent of the body, as a power of two."""
        extent = np.ptp(vertex_coordinates(self.problem.mesh), axis=0).max()
        return power_of_two(float(extent))


@dataclass(frozen=True, eq=False)
class LimitLoad(Bracketed):
    """The result of ``limit_load``.

    Parameters
    ----------
    problem
        The problem, on simplices where its mesh has other elements.
    growing
        The loads that grow, by name.
    lower, upper
        The body carries the load factor ``lower``, and none above ``upper``: both are infinite
        where it carries each factor, minus infinity where it carries none.  The factor multiplies
        the growing loads.  If supports move, it is the power of their reactions: for a punch with
        the displacement (0, -1) its force.
    status
        How the search ended.
    records
        One for each mesh.
    last
        Stress and mechanism of the last mesh, as arrays, in units of the extent of the body and of
        the largest yield bound, as powers of two.
    """

    problem: Problem
    growing: tuple[str, ...]
    lower: float
    upper: float
    status: LimitStatus
    records: list[LimitRecord]
    last: MeshBracket

    @property
    def message(self) -> str:
        """How the search ended, and what limit analysis neglects."""
        parts = [self.status.value, HARDENS]
        if self.upper < 0 and self.status is not LimitStatus.OVERLOADED:
            parts.insert(1, NEGATIVE)
        return " ".join(parts)

    @cached_property
    def mechanism(self) -> GridFunction | None:
        """The collapse mechanism, a velocity on ``mesh`` with a largest speed of one."""
        if self.last.mechanism is None:
            return None
        return velocity_function(self.mesh, self.last.data, self.last.mechanism)

    @cached_property
    def stress(self) -> CoefficientFunction | None:
        """An admissible stress, an N x N tensor on ``mesh`` (stress).

        In plane strain sigma_zz is the mean of the other two normal stresses.
        """
        if self.last.stress is None:
            return None
        shape = SHAPES[self.problem.kinematics.name]
        unit = strongest(self.problem)
        return stress_function(self.mesh, self.last.data, shape, self.last.stress, unit)

    @cached_property
    def indicators(self) -> GridFunction | None:
        """Dissipation minus power of the stress, over the power of the loads, for each element.

        They are nonnegative; with the terms on obstacles their sum is the relative width of the
        bounds of this mesh.  None without a stress or a mechanism, or if the lower bound is zero.
        """
        if self.last.stress is None or self.last.mechanism is None:
            return None
        if self.last.lower == 0:
            return None
        gaps = self.last.gaps[cell_order(self.last.data)]
        return on_elements(self.mesh, gaps / abs(self.last.lower))

    @cached_property
    def dissipation(self) -> GridFunction | None:
        """Density of dissipation of each element over the mean density of the body.

        None without a mechanism.
        """
        if self.last.mechanism is None:
            return None
        order = cell_order(self.last.data)
        dissipated = self.last.mechanism.dissipated[order]
        volume = self.last.data.cells.volume[order]
        density = dissipated / volume * volume.sum() / dissipated.sum()
        return on_elements(self.mesh, density)

    def __repr__(self) -> str:
        bracket = ", ".join(outward(self.lower, self.upper))
        meshes = counted(len(self.records), "mesh", "meshes")
        finest = counted(self.records[-1].cells, "element")
        return f"<LimitLoad: load factor in [{bracket}], {self.status.label}, {meshes}, {finest}>"


def strongest(problem: Problem) -> float:
    """The unit of stress of ``LimitLoad.last``: the largest yield bound, as a power of two."""
    return power_of_two(float(limit_data(problem, ()).bound.max()))
