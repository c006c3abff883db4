"""Forces of the loads of a problem at the nodes, with rules that see loads inside elements.

Nodal arrays have shape (nodes, N): one row for each degree of freedom of a displacement component.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import combinations_with_replacement, product

import numpy as np
from ngsolve import (
    BND,
    CF,
    VOL,
    BitArray,
    CoefficientFunction,
    ElementId,
    FESpace,
    InnerProduct,
    LinearForm,
    Parameter,
    ds,
    dx,
)
from ngsolve.comp import DifferentialSymbol, ProxyFunction

from ngepc.discretisation.lattices import SIMPLICES, with_last_share
from ngepc.discretisation.polynomials import HIGHEST
from ngepc.discretisation.sampling import Scan
from ngepc.model.elements import has_more_corners, regions_of
from ngepc.model.places import Edge, Place, Point, values_at
from ngepc.model.problem import Problem

BONUS_ORDER = 3
"""The least order that rules of loads have beyond twice that of the displacements."""


def bonus_order(problem: Problem) -> int:
    """The order that rules of loads have beyond twice that of the displacements, k.

    They are exact for loads that are cubic in position.  In each reference coordinate a shape
    function has degree k, the load at most 3, the determinant of the map N - 1 where elements are
    no simplices, and the radius of bodies of revolution 1; rules have the order 2 k + bonus.
    """
    bent = problem.N - 1 if has_more_corners(problem.mesh) else 0
    needed = HIGHEST + bent + bool(problem.kinematics.hoop) - problem.order
    return max(BONUS_ORDER, needed)


def work_of(
    problem: Problem,
    v: CoefficientFunction | ProxyFunction,
    scans: Mapping[Place | None, Scan] | None = None,
) -> list:
    """The integrals of int_Gn g . v + int f . v; forces at points have none.

    Elements that ``scanned_loads`` treats with adaptive rules are left out.
    """
    weight = problem.kinematics.weight
    scans = {} if scans is None else scans
    work = []
    for place, g in problem.loads.items():
        if not isinstance(place, Point):
            measure = region_measure(problem, place, scans.get(place))
            work.append(weight * InnerProduct(g, v) * measure)
    if problem.f is not None:
        ordinary = _ordinary_elements(scans.get(None))
        measure = dx(bonus_intorder=bonus_order(problem), **ordinary)
        work.append(weight * InnerProduct(problem.f, v) * measure)
    return work


def scanned_loads(problem: Problem) -> dict[Place | None, Scan]:
    """Scans of the loads that vary inside elements: body force (None) and tractions."""
    mesh = problem.mesh
    found = {}
    if problem.f is not None:
        found[None] = Scan(mesh, problem.f, VOL)
    for place, g in problem.loads.items():
        if isinstance(place, str):
            mask = np.array(mesh.Boundaries(place).Mask(), dtype=bool)
            region = regions_of(mesh, mesh.dim - 1)
            found[place] = Scan(mesh, g, BND, mask[region])
    return {place: scan for place, scan in found.items() if len(scan.hidden)}


def _ordinary_elements(scan: Scan | None) -> dict:
    """Arguments of a measure that leave out the elements which a scan has found."""
    if scan is None:
        return {}
    count = scan.mesh.ne if scan.kind == VOL else scan.mesh.GetNE(BND)
    ordinary = BitArray(count)
    ordinary.Set()
    for number in scan.hidden.tolist():
        ordinary.Clear(number)
    return {"definedonelements": ordinary}


def hidden_forces(problem: Problem, scan: Scan, scalar: FESpace) -> np.ndarray:
    """Nodal forces (nodes, N) of a load on the elements that a scan has found."""
    forces = np.zeros((scalar.ndof, problem.N))
    for number in scan.hidden.tolist():
        rule = scan.rule(number)
        element = ElementId(scan.kind, number)
        weight = 1.0
        if problem.kinematics.hoop:
            weight = scan.at(number, rule.shares, problem.kinematics.weight)
        shapes = shapes_at(scalar, element, rule.shares)
        work = rule.weights[:, None] * weight * rule.values
        forces[list(scalar.GetDofNrs(element))] += shapes.T @ work
    return forces


def shapes_at(scalar: FESpace, element: ElementId, shares: np.ndarray) -> np.ndarray:
    """Functions of order one or two of an element at points given by shares, (points, functions).

    They are combinations of products: of two barycentric coordinates on simplices, of powers of the
    coordinates up to two on other shapes.  Their values at as many nodes determine them.
    """
    finite = scalar.GetFE(element)
    if scalar.mesh[element].type in SIMPLICES.values():
        pairs = list(combinations_with_replacement(range(shares.shape[1]), 2))
        unit = np.eye(shares.shape[1])
        nodes = np.array([(unit[i] + unit[j]) / 2 for i, j in pairs])
        products = partial(_products, pairs=pairs)
    else:
        places = product((0.0, 0.5, 1.0), repeat=shares.shape[1] - 1)
        nodes = with_last_share(np.array(list(places)))
        products = _powers
    known = np.array([np.array(finite.CalcShape(*node[:-1])) for node in nodes])
    factors = np.linalg.solve(products(nodes), known)
    return products(shares) @ factors


def _products(shares: np.ndarray, pairs: list[tuple[int, int]]) -> np.ndarray:
    """Products of two barycentric coordinates, (points, pairs)."""
    first, second = np.transpose(pairs)
    return shares[:, first] * shares[:, second]


def _powers(shares: np.ndarray) -> np.ndarray:
    """Products of powers 0, 1 and 2 of each coordinate of a reference element."""
    exponents = list(product(range(3), repeat=shares.shape[1] - 1))
    return np.stack(
        [np.prod(shares[:, :-1] ** power, axis=1) for power in exponents], 1
    )


def region_measure(
    problem: Problem, place: str | Edge, scan: Scan | None = None
) -> DifferentialSymbol:
    """Ds on a boundary or along edges, with points for data that vary.

    Elements where a scan has found something are left out.
    """
    bonus = bonus_order(problem)
    if isinstance(place, str):
        return ds(place, bonus_intorder=bonus, **_ordinary_elements(scan))
    return dx(definedon=problem.mesh.BBoundaries(place.name), bonus_intorder=bonus)


def applied_forces(problem: Problem, scalar: FESpace) -> np.ndarray:
    """Nodal forces of all loads, shape (nodes, N); ``scalar`` is the space of one component."""
    scans = scanned_loads(problem)
    direction = [Parameter(0.0) for _ in range(problem.N)]
    load = LinearForm(scalar)
    for term in work_of(problem, scalar.TestFunction() * CF(tuple(direction)), scans):
        load += term
    forces = np.empty((scalar.ndof, problem.N))
    for component, along in zip(direction, forces.T, strict=True):
        component.Set(1.0)
        along[:] = load.Assemble().vec.FV().NumPy()
        component.Set(0.0)
    for scan in scans.values():
        forces += hidden_forces(problem, scan, scalar)
    for place, g in problem.loads.items():
        if isinstance(place, Point):
            vertices, values = values_at(g, problem.mesh, place)
            forces[vertices] += values
    return problem.nodal_processes.summed(forces)
