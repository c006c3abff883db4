"""Receipts: files that prove that the least energy of a body lies in an interval.

The file contains mesh, data, displacement, stress and contact pressure in the form that
``check_receipt`` reads: each cell is cut into the N + 1 parts on which the stress of the error
bound is a polynomial, and fields are given by Bernstein coefficients, first those of the vertices,
then those of the edges opposite to them.
"""

from __future__ import annotations

import json
from copy import copy
from pathlib import Path

import numpy as np
from ngsolve import CF, ET, VOL, IntegrationRule

from ngepc._version import __version__
from ngepc.bounds.bound import ErrorBound, bound_data_of, bound_of_state, state_of
from ngepc.bounds.check_receipt import FORMAT, interval
from ngepc.bounds.contact import BUBBLE, EDGES, LEVEL
from ngepc.bounds.coverage import CONSTANT
from ngepc.bounds.coverage import COVERS as BOUNDED
from ngepc.bounds.data import BoundData
from ngepc.bounds.polynomials import NODES, coefficients
from ngepc.bounds.simplices import FACETS
from ngepc.checks.kinds import require_instance, require_path
from ngepc.discretisation.factors import Factors
from ngepc.linalg.blas import one_blas_thread
from ngepc.local.result import ExactResult
from ngepc.local.system import State
from ngepc.model.features import require_covered
from ngepc.results.files import check_writable

COVERS = BOUNDED - {"friction", "hardening law", "initial strain", "plane stress"}
COVERS -= {"anisotropic yield", "cyclic hardening"}
"""Features that receipts cover."""

RESOLVED = 0.02
"""Accuracy of the checker's plastic terms, relative to the bound."""
CLEARANCE = 1e-11
"""Fraction of the largest displacement by which bodies are moved away from the obstacle."""
WIDER = 1e-12
"""Fraction of the energies by which claims are widened, for rounding on other machines."""
_CENTRE = {
    2: IntegrationRule([(1 / 3, 1 / 3)], [1.0]),
    3: IntegrationRule([(1 / 4, 1 / 4, 1 / 4)], [1.0]),
}


@one_blas_thread
def write_receipt(result: ExactResult, path: str | Path) -> tuple[float, float]:
    """Write the proof that the least energy lies in an interval to a file, and check it.

    ``ngepc check FILE`` checks it, and so does ``check_receipt.py`` alone, with numpy.

    Parameters
    ----------
    result
        A result of ``semismooth_newton`` without gamma, converged or not.
    path
        The file, which ends in .npz.

    Returns
    -------
    lower, upper
        An interval that contains the least energy of the continuous problem.

    Raises
    ------
    TypeError
        If ``result`` is not the result of a solver.
    ValueError
        For problems without a receipt; the message names the reason: friction, hardening laws,
        initial strains, plane stress, data that are known from samples only, loads and histories
        that vary inside elements, obstacles that are not affine on facets, bodies in several
        pieces; and everything that error bounds do not cover.
    RuntimeError
        As ``error_bound``.
    """
    require_instance("result", result, ExactResult, "a result without gamma")
    path = require_path("path", path, ".npz")
    require_covered(result.problem, "a receipt", COVERS)
    check_writable(path)
    bound_data = bound_data_of(result.discrete)
    tangent = Factors(bound_data.discrete, "sparsecholesky")
    bound = bound_of_state(bound_data, state_of(bound_data.discrete, result), tangent)
    check_written(bound_data, bound)
    arrays = receipt_arrays(bound_data, bound)
    header = {
        "format": FORMAT,
        "made by": f"ngepc {__version__}",
        "kinematics": bound_data.problem.kinematics.name,
        "order": bound_data.problem.order,
        "resolution": RESOLVED * bound.total,
    }
    lower, upper = interval(arrays, header)
    wider = WIDER * (abs(lower) + abs(upper))
    header |= {"lower": lower - wider, "upper": upper + wider}
    np.savez(path, header=json.dumps(header), **arrays)
    return header["lower"], header["upper"]


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


def receipt_arrays(bound_data: BoundData, bound: ErrorBound) -> dict[str, np.ndarray]:
    """The arrays of the file."""
    parts = PartedMesh(bound_data)
    u = parts.displacement(clear_state(bound_data, bound.state))
    stress = stress_coefficients(bound_data, bound)
    boundary = boundary_arrays(bound_data, bound, u)
    nodes = parts.side_nodes(boundary["boundary"])
    held = np.repeat(boundary["held"][:, None], nodes.shape[1], axis=1)
    side, place, component = np.nonzero(held)
    u[nodes[side, place], component] = boundary["prescribed"][held]
    mesh = {"points": parts.points, "cells": parts.cells, "u": u}
    stress = {"stress": parts.turned(stress)}
    return mesh | stress | material_arrays(bound_data) | boundary


def clear_state(bound_data: BoundData, state: State) -> np.ndarray:
    """Displacements (nodes, N) that do not penetrate the obstacle in spite of rounding.

    Vertices that supports hold are not changed.
    """
    contact = copy(bound_data.contact)
    contact.boundary = copy(bound_data.boundary)
    N = bound_data.cells.N
    free = bound_data.discrete.supports.free[contact.nodes[:, :N]]
    normal = np.where(free, contact.normal[:, None], 0.0)
    moves = np.einsum("eac,eac->ea", normal, normal) > LEVEL
    clearance = CLEARANCE * np.abs(state.u).max(initial=0.0)
    contact.boundary.gap = contact.boundary.gap - clearance * moves
    return contact.cleared(state.u)


class PartedMesh:
    """The mesh of the N + 1 parts of each cell; a part consists of a facet and the centre.

    ``points`` are the vertices of the mesh and the centres.  ``cells`` are the vertices of the
    parts, ascending, for order two followed by the numbers of the edges opposite to them.
    """

    def __init__(self, bound_data: BoundData) -> None:
        c = bound_data.cells
        self.bound_data = bound_data
        count = len(c.points)
        centres = c.points[c.nodes].mean(axis=1)
        self.points = np.concatenate([c.points, centres])
        number = count + np.arange(len(c.nodes))
        sides = c.nodes[:, np.array(FACETS[c.N])]
        middle = np.broadcast_to(number[:, None, None], (*sides.shape[:2], 1))
        corners = np.concatenate([sides, middle], axis=2).reshape(-1, c.N + 1)
        self._order = corners.argsort(axis=1)
        self.cells = np.take_along_axis(corners, self._order, axis=1)
        if bound_data.problem.order == 2:
            a = self.cells[:, [1, 0, 0]]
            b = self.cells[:, [2, 2, 1]]
            keys = self._key(a, b)
            self._edges, edge = np.unique(keys, return_inverse=True)
            edge = edge.reshape(keys.shape) + len(self.points)
            self.cells = np.concatenate([self.cells, edge], axis=1)

    def _key(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """One number for an edge with ascending ends."""
        return a.astype(np.int64) * len(self.points) + b

    def side_nodes(self, sides: np.ndarray) -> np.ndarray:
        """The nodes of sides with ascending vertices: the vertices, and the edge for order two."""
        if self.bound_data.problem.order == 1:
            return sides
        edge = np.searchsorted(self._edges, self._key(sides[:, 0], sides[:, 1]))
        return np.column_stack([sides, len(self.points) + edge])

    def turned(self, c: np.ndarray) -> np.ndarray:
        """Coefficients on the parts (parts, k, ...), reordered as the vertices of ``cells``."""
        order = self._order
        if c.shape[1] > order.shape[1]:
            order = np.concatenate([order, order + order.shape[1]], axis=1)
        places = order.reshape(*order.shape, *[1] * (c.ndim - 2))
        return np.take_along_axis(c, places, axis=1)

    def displacement(self, u: np.ndarray) -> np.ndarray:
        """Coefficients at the nodes from nodal displacements of the discrete problem."""
        c = self.bound_data.cells
        at_vertices = u[c.nodes]
        vertices = u[: len(c.points)]
        if self.bound_data.problem.order == 1:
            return np.concatenate([vertices, at_vertices.mean(axis=1)])
        nodes = self.bound_data.discrete.points.blocks[0].nodes
        values = np.zeros((len(self._edges), c.N))
        to_centre = np.zeros((len(nodes), 3, c.N))
        centre = np.zeros((len(nodes), c.N))
        for corner in range(3):
            to_centre[:, corner] += u[nodes[:, corner]] / 3
            centre += u[nodes[:, corner]] / 9
        for k, (i, j) in enumerate(EDGES[2]):
            ends = np.sort(nodes[:, [i, j]], axis=1)
            mean = (u[ends[:, 0]] + u[ends[:, 1]]) / 2 + BUBBLE / 2 * u[nodes[:, 3 + k]]
            values[np.searchsorted(self._edges, self._key(*ends.T))] = mean
            to_centre[:, i] += mean / 3
            to_centre[:, j] += mean / 3
            centre += 2 * mean / 9
        number = len(c.points) + np.arange(len(nodes))
        for corner in range(3):
            edge = np.searchsorted(self._edges, self._key(nodes[:, corner], number))
            values[edge] = to_centre[:, corner]
        return np.concatenate([vertices, centre, values])


def stress_coefficients(bound_data: BoundData, bound: ErrorBound) -> np.ndarray:
    """The stress on the parts of the cells, (parts, k, n, n)."""
    at = bound_data.at_nodes.completed(bound.admissible)
    basis = bound_data.problem.kinematics.basis
    S = np.einsum("tqd,dij->tqij", at.deviator, basis)
    S += at.mean[..., None, None] * np.eye(basis.shape[1])
    k = NODES[S.shape[1]]
    values = S.reshape(-1, k, basis.shape[1] ** 2)
    return coefficients(values).reshape(-1, k, *basis.shape[1:])


def material_arrays(bound_data: BoundData) -> dict[str, np.ndarray]:
    """Material, history and body force of each part."""
    law = bound_data.discrete.law
    points = bound_data.discrete.points
    problem = bound_data.problem
    parts = bound_data.cells.N + 1
    basis = problem.kinematics.basis

    def spread(values: np.ndarray) -> np.ndarray:
        """One value for each part from one for each point."""
        return np.repeat(np.asarray(values)[:: bound_data.each], parts, axis=0)

    def tensors(values: np.ndarray) -> np.ndarray:
        """Deviatoric coordinates at points as tensors for each part."""
        return np.einsum("td,dij->tij", spread(values), basis)[:, None]

    force = np.zeros((len(bound_data.cells.nodes), problem.N))
    if problem.f is not None:
        shape = ET.TRIG if problem.N == 2 else ET.TET
        places = problem.mesh.MapToAllElements({shape: _CENTRE[problem.N]}, VOL)
        force = np.asarray(problem.f(places)).reshape(force.shape)
    return {
        "lame_lambda": spread(points.at(problem.material.lame_lambda)),
        "mu": spread(law.two_mu / 2),
        "hardening": spread(law.hardening),
        "beta": spread(law.beta),
        "initial": tensors(law.initial),
        "back": tensors(law.back),
        "body_force": np.repeat(force, parts, axis=0),
    }


def boundary_arrays(
    bound_data: BoundData, bound: ErrorBound, u: np.ndarray
) -> dict[str, np.ndarray]:
    """Supports, tractions, obstacle and pressure of the outer facets, ascending."""
    boundary = bound_data.boundary
    c = bound_data.cells
    facets = c.facets
    N = c.N
    names = tuple(bound_data.problem.tractions)
    on = boundary.on(names, "traction")
    default = CF((0.0,) * N)
    g = bound_data.problem.mesh.BoundaryCF(
        bound_data.problem.tractions, default=default
    )
    traction = np.zeros((len(facets), N, N))
    traction[boundary.facet[on]] = boundary.at_vertices(boundary.values(g, on), on)
    gap = np.zeros((len(facets), N))
    gap[boundary.contact] = boundary.gap
    pressure = np.zeros((len(facets), N))
    pressure[boundary.contact] = bound.pressure
    contact = np.zeros(len(facets), dtype=bool)
    contact[boundary.contact] = True
    held = ~boundary.given & c.outer[:, None]
    prescribed = np.where(held[:, None], u[facets], 0.0)
    order = bound_data.problem.order
    arrays = {
        "prescribed": elevated(prescribed, order),
        "traction": elevated(traction, order),
        "gap": elevated(gap, order),
        "pressure": elevated(pressure, order),
    }
    arrays |= {"boundary": facets, "held": held, "contact": contact}
    return {name: values[c.outer] for name, values in arrays.items()}


def elevated(values: np.ndarray, order: int) -> np.ndarray:
    """Coefficients of affine functions from vertex values (facets, N, ...)."""
    if order == 1:
        return values
    middle = (values[:, :1] + values[:, 1:]) / 2
    return np.concatenate([values, middle], axis=1)
