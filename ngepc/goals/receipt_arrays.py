"""The arrays of a receipt: what its file has of a body, and of the adjoint of a goal.

Fields are given on the cells of the file and on their sides; ``receipt_file`` puts them in order.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from ngsolve import CF, ET, VOL, IntegrationRule

from ngepc.bounds.boundary import Boundary
from ngepc.bounds.contact import EDGES_OF_NGSOLVE, LEVEL
from ngepc.bounds.coverage import BUBBLE
from ngepc.bounds.data import BoundData
from ngepc.bounds.outcome import ErrorBound
from ngepc.bounds.polynomials import NODES, coefficients
from ngepc.checks.sentences import in_words
from ngepc.goals import check_receipt
from ngepc.goals.adjoint_conditions import AdjointConditions
from ngepc.goals.goal_interval import GoalBound
from ngepc.goals.integrand import BoundPart
from ngepc.goals.receipt_file import basis_coordinates
from ngepc.goals.receipt_mesh import FileCells, Pieces, as_quadratic
from ngepc.local.system import State
from ngepc.model.problem import Problem

NO_OBSTACLE = 1e19
"""The gap of a receipt where there is no obstacle."""
EXACT = 1e-15
"""Tolerance of the conditions of an adjoint on contact facets."""
_CENTRE = {
    2: IntegrationRule([(1 / 3, 1 / 3)], [1.0]),
    3: IntegrationRule([(1 / 4, 1 / 4, 1 / 4)], [1.0]),
}


def receipt_arrays(
    file: FileOf, bound: ErrorBound, u: np.ndarray
) -> dict[str, np.ndarray]:
    """The arrays of a receipt of an energy for nodal displacements ``u``."""
    bound_data = file.bound_data
    at = bound_data.at_nodes.completed(bound.admissible)
    stress = np.concatenate([at.mean[..., None], at.deviator], axis=-1)
    arrays = file.supports() | file.loads(bound)
    arrays["body_force"] = file.cells.of_cells(constant_force(bound_data.problem))
    arrays["law"] = file.cells.of_cells(law_rows(bound_data))
    arrays["stress"] = file.stress(stress)
    arrays["u"] = file.displacement(u, u)
    return arrays


def goal_arrays(file: FileOf, goal: GoalBound, u: np.ndarray) -> dict[str, np.ndarray]:
    """The goal and its adjoint pair, for the nodal displacements ``u`` of the receipt."""
    bound_data = file.bound_data
    terms = goal.terms
    c = bound_data.cells
    conditions = AdjointConditions(bound_data, bound_data.contact.slack(u))
    z, _ = conditions.repaired(terms, goal.pair.z, goal.factor, EXACT)

    loaded = terms.load or bound_data.problem.changed(
        traction=None, body_force=None, pressure=None
    )
    at_rest = np.zeros((len(c.points), c.N))
    moved = at_rest if terms.motion is None else terms.motion[: len(c.points)]
    pressure = np.zeros((len(c.facets), c.N))
    pressure[bound_data.boundary.contact] = goal.pair.pressure
    pushes = np.zeros(len(c.facets))
    pushes[bound_data.boundary.contact] = terms.factor
    arrays = {
        "traction": vertex_tractions(Boundary(loaded, c)),
        "pressure": pressure,
        "gap": np.repeat(pushes[:, None], c.N, axis=1),
    }
    arrays = {name: file.cells.on_facets(values) for name, values in arrays.items()}
    arrays["body_force"] = file.cells.of_cells(constant_force(loaded))
    arrays["stress"] = file.stress(BoundPart(bound_data, goal.bound).stress(goal.pair))
    arrays["u"] = file.displacement(z, moved)
    return arrays


def clear_state(
    bound_data: BoundData,
    state: State,
    clearance: float,
    motion: np.ndarray | None = None,
) -> np.ndarray:
    """Displacements (nodes, N) at a distance from the obstacle, in spite of rounding.

    Vertices that supports hold are not changed: a closed gap there is refused, unless displacement
    and gap are zero, which have no rounding errors, and so is the ``motion`` of the support whose
    reaction is the goal.
    """
    contact = copy(bound_data.contact)
    contact.boundary = copy(bound_data.boundary)
    N = bound_data.cells.N
    free = bound_data.discrete.supports.free[contact.nodes[:, :N]]
    normal = np.where(free, contact.normal[:, None], 0.0)
    moves = np.einsum("eac,eac->ea", normal, normal) > LEVEL
    held = np.abs(state.u) + (0.0 if motion is None else np.abs(motion))
    held_u = held[contact.nodes[:, :N]].max(axis=2)
    at_rest = (held_u == 0) & (contact.boundary.gap[:, :N] == 0)
    if (~moves & ~at_rest & (contact.slack(state.u)[:, :N] < clearance)).any():
        raise ValueError(
            f"contact={in_words(bound_data.problem.contact)}: a receipt needs an open gap where "
            "supports hold vertices of the boundary at displacements that are not zero, "
            "or are those of the reaction"
        )
    contact.boundary.gap = contact.boundary.gap.copy()
    contact.boundary.gap[:, :N] -= clearance * moves
    return contact.cleared(state.u)


class FileOf:
    """What a file has of the data of a bound: fields on its cells, and on their sides."""

    def __init__(self, bound_data: BoundData, pieces: Pieces) -> None:
        self.bound_data = bound_data
        self.cells = FileCells(pieces)

    def supports(self) -> dict[str, np.ndarray]:
        """Which components are held, and which sides have an obstacle."""
        boundary = self.bound_data.boundary
        arrays = {"held": ~boundary.given}
        return {name: self.cells.of_facets(v) for name, v in arrays.items()}

    def loads(self, bound: ErrorBound) -> dict[str, np.ndarray]:
        """Tractions, obstacle and pressure on the sides of the boundary."""
        boundary = self.bound_data.boundary
        c = self.bound_data.cells
        gap = np.full((len(c.facets), c.N), NO_OBSTACLE)
        gap[boundary.contact] = boundary.gap[:, : c.N]
        pressure = np.zeros((len(c.facets), c.N))
        pressure[boundary.contact] = bound.pressure
        arrays = {
            "traction": vertex_tractions(boundary),
            "gap": gap,
            "pressure": pressure,
        }
        return {name: self.cells.on_facets(v) for name, v in arrays.items()}

    def displacement(self, u: np.ndarray, given: np.ndarray) -> np.ndarray:
        """Coefficients of nodal displacements, equal to ``given`` (vertices, N) on supports."""
        c = self.bound_data.cells
        local = u[c.nodes]
        if self.bound_data.problem.order == 2:
            local = self._with_edges(as_quadratic(local), u)
        found = self.cells.displacement(local)
        ends = self.cells.ends()
        held = np.repeat(self.supports()["held"][:, None], ends.shape[1], axis=1)
        side, place, component = np.nonzero(held)
        on_sides = self.cells.on_facets(given[c.facets])
        found[ends[side, place], component] = on_sides[held]
        return found

    def _with_edges(self, local: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Coefficients (cells of the mesh, k, N) plus those of NGSolve's edge functions."""
        c = self.bound_data.cells
        v = c.N + 1
        rows = np.arange(len(local))
        vertices, edges = np.split(
            self.bound_data.discrete.points.blocks[0].nodes, [v], axis=1
        )
        place = (vertices[:, :, None] == c.nodes[:, None]).argmax(axis=2)
        for edge, (i, j) in zip(edges.T, EDGES_OF_NGSOLVE[c.N], strict=True):
            between = check_receipt.BETWEEN[2, v][place[:, i], place[:, j]]
            local[rows, between] += BUBBLE / 2 * u[edge]
        return local

    def stress(self, stress: np.ndarray) -> np.ndarray:
        """Coefficients (cells, k, c) of stresses at nodes of parts, mean and deviator."""
        kinematics = self.bound_data.problem.kinematics
        basis = kinematics.basis
        S = np.einsum("tqd,dij->tqij", stress[..., 1:], basis)
        S += stress[..., 0, None, None] * np.eye(basis.shape[1])
        values = basis_coordinates(S, kinematics.name)
        k = NODES[values.shape[1]]
        c = values.shape[2]
        found = coefficients(values.reshape(-1, k, c)).reshape(-1, k, c)
        return self.cells.stress(found)


def constant_force(problem: Problem) -> np.ndarray:
    """Body forces that are constant on the elements, (elements, N)."""
    N = problem.N
    if problem.f is None:
        return np.zeros((problem.mesh.ne, N))
    shape = ET.TRIG if N == 2 else ET.TET
    places = problem.mesh.MapToAllElements({shape: _CENTRE[N]}, VOL)
    return np.asarray(problem.f(places)).reshape(-1, N)


def law_rows(bound_data: BoundData) -> np.ndarray:
    """Material and history of each cell: moduli, stored energy, and coordinates of stresses."""
    law = bound_data.discrete.law
    material = bound_data.problem.material
    basis = bound_data.problem.kinematics.basis

    def tensors(values: np.ndarray) -> np.ndarray:
        """Deviatoric coordinates in the basis of the checker."""
        S = np.einsum("td,dij->tij", values, basis)
        return basis_coordinates(S, bound_data.problem.kinematics.name)[:, 1:]

    lame = np.asarray(bound_data.discrete.points.at(material.lame_lambda))
    bulk = basis.shape[1] * lame + law.two_mu
    moduli = np.column_stack([bulk, law.two_mu / 2, law.hardening, law.beta])
    start = law.two_mu[:, None] * (law.initial + law.distortion)
    swelling = bulk * law.swelling / np.sqrt(basis.shape[1])
    stored = law.two_mu / 2 * (law.initial**2).sum(axis=1)
    rows = [moduli, np.column_stack([stored, swelling]), tensors(start)]
    return np.hstack([*rows, tensors(law.back)])[:: bound_data.each]


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
