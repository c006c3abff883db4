"""Receipts: files that prove an interval of the least energy of a body, or of a goal.

The file contains mesh, data, displacement, stress and contact pressure in the form that
``check_receipt`` reads: fields are given by Bernstein coefficients, first those of the vertices,
then those of the edges opposite to them.  The stress is given on the N + 1 parts of each cell on
which that of the error bound is a polynomial; in part k the centre takes the place of vertex k.
"""

from __future__ import annotations

import json
from copy import copy
from pathlib import Path

import numpy as np
from ngsolve import CF, ET, VOL, IntegrationRule

from ngepc._version import __version__
from ngepc.bounds.bound import ErrorBound, bound_data_of, bound_of_state, state_of
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.contact import BUBBLE, EDGES, LEVEL
from ngepc.bounds.counterpart import on_simplices
from ngepc.bounds.coverage import CONSTANT
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.data import BoundData
from ngepc.bounds.polynomials import NODES, coefficients
from ngepc.bounds.simplices import FACETS
from ngepc.checks.kinds import require_instance, require_path
from ngepc.discretisation.factors import Factors
from ngepc.goals import check_receipt
from ngepc.goals.adjoint_conditions import AdjointConditions
from ngepc.goals.goal_bound import GoalBound
from ngepc.goals.integrand import BoundPart
from ngepc.goals.receipt_file import in_file_order, numbered_sides
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.model.features import require_covered
from ngepc.model.problem import Problem
from ngepc.results.files import check_writable

COVERS = BOUNDED - {"friction", "hardening law", "initial strain", "plane stress"}
COVERS -= {"anisotropic yield", "cyclic hardening", "springs"}
COVERS -= {"rate", "two bodies", "held by contact", "hexahedra", "thickness"}
COVERS -= {"axisymmetric"}
"""Features that receipts cover."""

CLEARANCE = 1e-11
"""Fraction of the largest displacement by which bodies are moved away from the obstacle."""
CLEAR_OF_GOAL = 1e-6
"""The same for intervals of goals; mostly the distance is smaller."""
NARROW = 1e-9
"""Distance times lambda, as a fraction of the displacement of the adjoint."""
SPARE = 1e-3
"""Fraction by which lambda is enlarged, so that conditions hold in spite of rounding."""
EXACT = 1e-15
"""Tolerance of the conditions of an adjoint on contact facets."""
WIDER = 1e-12
"""Fraction of the intervals by which claims are widened, for rounding on other machines."""
_CENTRE = {
    2: IntegrationRule([(1 / 3, 1 / 3)], [1.0]),
    3: IntegrationRule([(1 / 4, 1 / 4, 1 / 4)], [1.0]),
}


@one_blas_thread
def write_receipt(
    result: ExactResult | GoalBound, path: str | Path
) -> tuple[float, float]:
    """Write the proof of an interval to a file, and check it.

    ``ngepc check FILE`` checks it, and so does ``check_receipt.py`` alone, with numpy.

    Parameters
    ----------
    result
        A result of ``semismooth_newton`` without gamma, converged or not: the file proves an
        interval of the least energy.  Or an interval of ``goal_bound``: the file proves that, too.
    path
        The file, which ends in .npz.

    Returns
    -------
    lower, upper
        An interval that contains the least energy of the continuous problem, or the goal.

    Raises
    ------
    TypeError
        If ``result`` is not the result of a solver or of ``goal_bound``.
    ValueError
        For problems without a receipt; the message names the reason: friction, hardening laws,
        initial strains, plane stress, data that are known from samples only, loads and histories
        that vary inside elements, obstacles that are not affine on facets, bodies in several
        pieces; and everything that error bounds do not cover.
    RuntimeError
        As ``error_bound``.
    """
    if not isinstance(result, GoalBound):
        what = "a result without gamma, or an interval of goal_bound,"
        require_instance("result", result, ExactResult, what)
    path = require_path("path", path, ".npz")
    goal = result if isinstance(result, GoalBound) else None
    problem = result.problem if goal is None else goal.bound.problem
    require_covered(problem, "a receipt", COVERS)
    check_writable(path)
    if goal is None:
        result = on_simplices(result)
        bound_data = bound_data_of(result.discrete)
        tangent = Factors(bound_data.discrete, "sparsecholesky")
        state = state_of(bound_data.discrete, result)
        bound = bound_of_state(bound_data, state, tangent)
    else:
        bound = goal.bound
        bound_data = bound_data_of(bound.state.discrete)
    check_written(bound_data, bound)
    layers, header = claims_of(bound_data, bound, goal)
    words = in_file_order(layers, header)
    header |= widened(check_receipt.proved_intervals(words, header))
    np.savez(path, header=json.dumps(header), receipt=words)
    name = "" if goal is None else "goal "
    return header[name + "lower"], header[name + "upper"]


def widened(proved: dict[str, float]) -> dict[str, float]:
    """Claims from what the checker proves: rounding on other machines may differ."""
    claims = {}
    for name in ("", "goal "):
        if name + "lower" in proved:
            lower = proved[name + "lower"]
            upper = proved[name + "upper"]
            wider = WIDER * (abs(lower) + abs(upper))
            claims[name + "lower"] = lower - wider
            claims[name + "upper"] = upper + wider
    return claims


def claims_of(
    bound_data: BoundData, bound: ErrorBound, goal: GoalBound | None
) -> tuple[list[dict[str, np.ndarray]], dict[str, object]]:
    """The layers of the file, and its header without the intervals."""
    header = {
        "format": check_receipt.FORMAT,
        "made by": f"ngepc {__version__}",
        "kinematics": bound_data.problem.kinematics.name,
        "order": bound_data.problem.order,
    }
    file = FileMesh(bound_data)
    largest = np.abs(bound.state.u).max(initial=0.0)
    clearance = CLEAR_OF_GOAL * largest
    if goal is None:
        clearance = CLEARANCE * largest
        u = clear_state(bound_data, bound.state, clearance)
        return [receipt_arrays(file, bound, u)], header
    # rounding of z . n must be less than lambda times the distance
    moves = max(np.abs(goal.pair.z).max(), goal.terms.factor.max(initial=0.0))
    factor = max(goal.factor * (1 + SPARE), NARROW * moves / clearance)
    clearance = NARROW * moves / factor
    u = clear_state(bound_data, bound.state, clearance)
    layers = [receipt_arrays(file, bound, u), goal_arrays(file, goal, u)]
    return layers, header | {"goal": goal.name, "factor": factor}


def check_written(bound_data: BoundData, bound: ErrorBound) -> None:
    """Refuse problems without a receipt with a ValueError that names the argument."""
    law = bound_data.discrete.law
    if bound_data.lower is not None:
        raise ValueError("order=2: a receipt in three dimensions needs order=1")
    if not bound.guaranteed:
        raise ValueError(f"result: a receipt needs a proved bound. {bound.message}")
    if bound_data.carried.left.any():
        raise ValueError(
            "body_force, traction: a receipt needs a body force that is constant on "
            "elements and tractions that are affine"
        )
    gap = np.abs(bound_data.boundary.gap) * bound_data.contact.measure[:, None]
    if np.abs(bound_data.boundary.excess).max(initial=0.0) > CONSTANT * gap.max(
        initial=0
    ):
        raise ValueError("gap: a receipt needs an obstacle that is affine on facets")
    for name, values in (
        ("initial_hardening", law.back),
        ("initial_plastic_strain", law.initial),
        ("initial_hardening (alpha_1)", law.beta[:, None]),
    ):
        by_cell = values.reshape(-1, bound_data.each, values.shape[1])
        if np.ptp(by_cell, axis=1).any():
            raise ValueError(f"{name}: a receipt needs one value on each element")


def receipt_arrays(
    file: FileMesh, bound: ErrorBound, u: np.ndarray
) -> dict[str, np.ndarray]:
    """The arrays of a receipt of an energy for nodal displacements ``u``."""
    bound_data = file.bound_data
    stress = stress_coefficients(bound_data, bound)
    u = file.displacement(u)
    boundary = boundary_arrays(bound_data, bound, u)
    file.set_on_supports(u, boundary, boundary["prescribed"])
    mesh = {"points": file.points, "cells": file.cells, "u": u}
    stress = {"stress": file.turned(stress)}
    return mesh | stress | material_arrays(bound_data) | boundary


def goal_arrays(
    file: FileMesh, goal: GoalBound, u: np.ndarray
) -> dict[str, np.ndarray]:
    """The goal and its adjoint pair, for the nodal displacements ``u`` of the receipt."""
    bound_data = file.bound_data
    terms = goal.terms
    c = bound_data.cells
    conditions = AdjointConditions(bound_data, bound_data.contact.slack(u))
    z, _ = conditions.repaired(terms, goal.pair.z, goal.factor, EXACT)

    loaded = terms.load or bound_data.problem.changed(
        traction=None, body_force=None, pressure=None
    )
    force = constant_force(loaded)
    traction = vertex_tractions(Boundary(loaded, c))
    at_rest = np.zeros((len(c.points), c.N))
    moved = at_rest if terms.motion is None else terms.motion[: len(c.points)]
    pressure = np.zeros((len(c.facets), c.N))
    pressure[bound_data.boundary.contact] = goal.pair.pressure
    pushes = np.zeros(len(c.facets))
    pushes[bound_data.boundary.contact] = terms.factor

    order = bound_data.problem.order
    on_facets = {
        "prescribed": moved[c.facets],
        "traction": traction,
        "pressure": pressure,
        "gap": np.repeat(pushes[:, None], c.N, axis=1),
    }
    arrays = {name: elevated(v, order)[c.outer] for name, v in on_facets.items()}
    arrays["body_force"] = force
    stress = BoundPart(bound_data, goal.bound).stress(goal.pair)
    arrays["stress"] = file.turned(tensor_coefficients(bound_data, stress))
    arrays["u"] = file.displacement(z)
    file.set_on_supports(arrays["u"], support_arrays(bound_data), arrays["prescribed"])
    return arrays


def clear_state(bound_data: BoundData, state: State, clearance: float) -> np.ndarray:
    """Displacements (nodes, N) at a distance from the obstacle, in spite of rounding.

    Vertices that supports hold are not changed.
    """
    contact = copy(bound_data.contact)
    contact.boundary = copy(bound_data.boundary)
    N = bound_data.cells.N
    free = bound_data.discrete.supports.free[contact.nodes[:, :N]]
    normal = np.where(free, contact.normal[:, None], 0.0)
    moves = np.einsum("eac,eac->ea", normal, normal) > LEVEL
    contact.boundary.gap = contact.boundary.gap - clearance * moves
    return contact.cleared(state.u)


class FileMesh:
    """The mesh of a file: ``cells`` with ascending vertices, and the places of their ``sides``."""

    def __init__(self, bound_data: BoundData) -> None:
        c = bound_data.cells
        self.bound_data = bound_data
        self.points = c.points
        self._order = c.nodes.argsort(axis=1)
        self.cells = np.take_along_axis(c.nodes, self._order, axis=1)
        self.sides = numbered_sides(self.cells)

    def set_on_supports(
        self, u: np.ndarray, boundary: dict[str, np.ndarray], values: np.ndarray
    ) -> None:
        """Set coefficients at the nodes to ``values`` (sides, k, N) where supports hold them."""
        nodes = boundary["boundary"]
        if self.bound_data.problem.order == 2:
            out = np.flatnonzero(self.sides[0] == self.sides[1])
            nodes = np.column_stack([nodes, len(self.points) + out])
        held = np.repeat(boundary["held"][:, None], nodes.shape[1], axis=1)
        side, place, component = np.nonzero(held)
        u[nodes[side, place], component] = values[held]

    def turned(self, c: np.ndarray) -> np.ndarray:
        """Coefficients on the parts (cells, parts, k, ...), reordered as the vertices of cells.

        On part k they are given at the vertices of facet k, and at the centre.
        """
        N = self.bound_data.cells.N
        place = np.array(
            [
                [FACETS[N][k].index(v) if v != k else N for v in range(N + 1)]
                for k in range(N + 1)
            ]
        )
        part = self._order[:, :, None]
        place = place[part, self._order[:, None]]
        if c.shape[1] > N + 1:
            place = np.concatenate([place, place + N + 1], axis=2)
        c = c.reshape(len(self.cells), N + 1, *c.shape[1:])
        cell = np.arange(len(c))[:, None, None]
        return c[cell, part, place]

    def displacement(self, u: np.ndarray) -> np.ndarray:
        """Coefficients at vertices, and sides for order two, from nodal displacements."""
        vertices = u[: len(self.points)]
        if self.bound_data.problem.order == 1:
            return vertices.copy()
        nodes = self.bound_data.discrete.points.blocks[0].nodes
        on_edges = np.zeros((len(nodes), 3, u.shape[1]))
        for k, (i, j) in enumerate(EDGES[2]):
            ends = np.sort(nodes[:, [i, j]], axis=1)
            mean = (u[ends[:, 0]] + u[ends[:, 1]]) / 2
            on_edges[:, 3 - i - j] = mean + BUBBLE / 2 * u[nodes[:, 3 + k]]
        order = nodes[:, :3].argsort(axis=1)
        side, cell = np.divmod(self.sides[0], len(nodes))
        return np.concatenate([vertices, on_edges[cell, order[cell, side]]])


def stress_coefficients(bound_data: BoundData, bound: ErrorBound) -> np.ndarray:
    """The stress on the parts of the cells, (parts, k, n, n)."""
    at = bound_data.at_nodes.completed(bound.admissible)
    stress = np.concatenate([at.mean[..., None], at.deviator], axis=-1)
    return tensor_coefficients(bound_data, stress)


def tensor_coefficients(bound_data: BoundData, stress: np.ndarray) -> np.ndarray:
    """Coefficients (parts, k, n, n) of stresses at nodes of parts, mean and deviator."""
    basis = bound_data.problem.kinematics.basis
    S = np.einsum("tqd,dij->tqij", stress[..., 1:], basis)
    S += stress[..., 0, None, None] * np.eye(basis.shape[1])
    k = NODES[S.shape[1]]
    values = S.reshape(-1, k, basis.shape[1] ** 2)
    return coefficients(values).reshape(-1, k, *basis.shape[1:])


def constant_force(problem: Problem) -> np.ndarray:
    """Body forces that are constant on the elements, (elements, N)."""
    N = problem.N
    if problem.f is None:
        return np.zeros((problem.mesh.ne, N))
    shape = ET.TRIG if N == 2 else ET.TET
    places = problem.mesh.MapToAllElements({shape: _CENTRE[N]}, VOL)
    return np.asarray(problem.f(places)).reshape(-1, N)


def material_arrays(bound_data: BoundData) -> dict[str, np.ndarray]:
    """Material, history and body force of each cell."""
    law = bound_data.discrete.law
    points = bound_data.discrete.points
    problem = bound_data.problem
    basis = problem.kinematics.basis

    def spread(values: np.ndarray) -> np.ndarray:
        """One value for each cell from one for each point."""
        return np.asarray(values)[:: bound_data.each]

    def tensors(values: np.ndarray) -> np.ndarray:
        """Deviatoric coordinates at points as tensors for each cell."""
        return np.einsum("td,dij->tij", spread(values), basis)

    return {
        "lame_lambda": spread(points.at(problem.material.lame_lambda)),
        "mu": spread(law.two_mu / 2),
        "hardening": spread(law.hardening),
        "beta": spread(law.beta),
        "initial": tensors(law.initial),
        "back": tensors(law.back),
        "body_force": constant_force(problem),
    }


def vertex_tractions(boundary: Boundary) -> np.ndarray:
    """Affine tractions of a problem at the vertices of its facets, (facets, N, N)."""
    problem = boundary.problem
    N = boundary.cells.N
    traction = np.zeros((len(boundary.cells.facets), N, N))
    on = boundary.on(tuple(problem.tractions), "traction")
    default = CF((0.0,) * N)
    g = problem.mesh.BoundaryCF(problem.tractions, default=default)
    values = boundary.at_vertices(boundary.values(g, on), on)
    traction[boundary.facet[on]] = values
    return traction


def support_arrays(bound_data: BoundData) -> dict[str, np.ndarray]:
    """The outer facets, ascending, with supports and obstacles."""
    boundary = bound_data.boundary
    c = bound_data.cells
    contact = np.zeros(len(c.facets), dtype=bool)
    contact[boundary.contact] = True
    arrays = {"boundary": c.facets, "held": ~boundary.given, "contact": contact}
    return {name: values[c.outer] for name, values in arrays.items()}


def boundary_arrays(
    bound_data: BoundData, bound: ErrorBound, u: np.ndarray
) -> dict[str, np.ndarray]:
    """Supports, tractions, obstacle and pressure of the outer facets, ascending."""
    boundary = bound_data.boundary
    c = bound_data.cells
    gap = np.zeros((len(c.facets), c.N))
    gap[boundary.contact] = boundary.gap
    pressure = np.zeros((len(c.facets), c.N))
    pressure[boundary.contact] = bound.pressure
    held = ~boundary.given & c.outer[:, None]
    arrays = {
        "prescribed": np.where(held[:, None], u[c.facets], 0.0),
        "traction": vertex_tractions(boundary),
        "gap": gap,
        "pressure": pressure,
    }
    order = bound_data.problem.order
    on_sides = {k: elevated(v, order)[c.outer] for k, v in arrays.items()}
    return support_arrays(bound_data) | on_sides


def elevated(values: np.ndarray, order: int) -> np.ndarray:
    """Coefficients of affine functions from vertex values (facets, N, ...)."""
    if order == 1:
        return values
    middle = (values[:, :1] + values[:, 1:]) / 2
    return np.concatenate([values, middle], axis=1)
