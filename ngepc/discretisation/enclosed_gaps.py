"""What the formulas of gaps prove about them on contact boundaries."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from ngsolve import BND, ET, CoefficientFunction, IntegrationRule, Mesh

from ngepc.discretisation.formulas import formula_of, formula_on
from ngepc.discretisation.lattices import parts_of_edges
from ngepc.discretisation.operations import FacetCorners, Operation, Values
from ngepc.discretisation.polynomials import is_polynomial
from ngepc.discretisation.sampling import FOLLOWED, rounding_of_gaps
from ngepc.linalg.intervals import Intervals
from ngepc.linalg.jets import Jet
from ngepc.model.elements import cells_of, elements_by_type, is_straight
from ngepc.model.problem import Problem

OF_OBSTACLES = 2
"""The highest degree of obstacles whose lowest point between nodes is known."""
CORNERS = {ET.SEGM: 2, ET.TRIG: 3, ET.QUAD: 4}
CHECKED = {shape: IntegrationRule(shape, 4) for shape in CORNERS}
"""Points where values of NGSolve are compared with enclosures."""
ROUNDING = 1e-10
"""Rounding errors of NGSolve's values, relative to the largest one."""


def gaps_are_enclosed(problem: Problem) -> bool:
    """Whether each gap is a polynomial of degree two or has a formula that limits it.

    The formula is evaluated on boxes around the boundary elements, so that it limits the gap on
    all parts of them too.  Bounds of bodies of revolution use polynomials only.
    """
    return _each_is(problem, _has_limits, by_formula=not problem.kinematics.hoop)


def gaps_are_followed(problem: Problem) -> bool:
    """Whether the lattice of ``Scan`` cannot miss a variation of a gap.

    Between its points the second derivatives allow ``FOLLOWED`` of the largest gap at most.
    """
    return _each_is(problem, _is_followed)


def _each_is(
    problem: Problem,
    known: Callable[[Mesh, str, CoefficientFunction, Operation], bool],
    by_formula: bool = True,
) -> bool:
    """Whether each gap is a polynomial of degree two, or is known by its formula."""
    mesh = problem.mesh
    for name, gap in problem.gaps.items():
        if is_polynomial(gap, mesh, OF_OBSTACLES):
            continue
        formula = formula_of(gap) if by_formula and is_straight(mesh) else None
        unknown = formula is None or not known(mesh, name, gap, formula)
        if problem.processes.any(np.array([unknown])):
            return False
    return True


def _has_limits(
    mesh: Mesh, name: str, gap: CoefficientFunction, formula: Operation
) -> bool:
    for facets in _facets_of(mesh, name):
        whole = formula_on(formula, _boxes(facets)).whole
        if not (whole.finite.all() and _agrees(mesh, facets.values(gap), whole)):
            return False
    return True


def _is_followed(
    mesh: Mesh, name: str, gap: CoefficientFunction, formula: Operation
) -> bool:
    parts = parts_of_edges(mesh, BND)
    for facets in _facets_of(mesh, name):
        if facets.places.shape[1] != mesh.dim:
            return False
        jet = formula_on(formula, facets)
        if not (jet.is_smooth.all() and _agrees(mesh, facets.values(gap), jet.whole)):
            return False
        largest = jet.value[:, 1:].size.max(initial=0.0)
        missed = max(FOLLOWED * largest, rounding_of_gaps(mesh))
        if _bending(jet) / parts**2 > missed:
            return False
    return True


def _bending(jet: Jet) -> float:
    """The largest distance of a function from its affine interpolant on a simplex, or more."""
    if jet.second is None:
        return 0.0
    return float(jet.second.size.sum(axis=(1, 2)).max(initial=0.0)) / 8


def _facets_of(mesh: Mesh, name: str) -> Iterator[FacetCorners]:
    """The elements of a boundary, shape by shape."""
    nodes, region = cells_of(mesh, mesh.dim - 1)
    names = np.array(mesh.GetBoundaries())
    there = nodes[names[region] == name]
    points = np.array([vertex.point for vertex in mesh.vertices])
    region = mesh.Boundaries(name)
    for shape, places in elements_by_type(mesh, mesh.dim - 1, region.Mask()).items():
        corners = there[places, : CORNERS[shape]]
        yield FacetCorners(
            Intervals.exactly(points[corners]), _values_on(mesh, name, shape)
        )


def _values_on(mesh: Mesh, name: str, shape: ET) -> Values:
    """The values of a coefficient on the elements of a boundary with this shape."""
    rule = CHECKED[shape]
    points = mesh.MapToAllElements({shape: rule}, mesh.Boundaries(name))

    def values(value: CoefficientFunction) -> np.ndarray:
        """See ``Values``."""
        return np.asarray(value(points)).reshape(-1, len(rule), value.dim)

    return values


def _boxes(facets: FacetCorners) -> FacetCorners:
    """Boxes around facets."""
    box = facets.places.hull_along(1)
    return FacetCorners(box[:, None], facets.values)


def _agrees(mesh: Mesh, values: np.ndarray, whole: Intervals) -> bool:
    """Whether values (facets, points, 1) lie in intervals (facets,) but for rounding errors."""
    error = ROUNDING * np.abs(values).max(initial=0.0) + rounding_of_gaps(mesh)
    above = values[:, :, 0] >= whole.low[:, None] - error
    below = values[:, :, 0] <= whole.high[:, None] + error
    return bool((above & below).all())
