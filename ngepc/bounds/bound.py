"""The bound of the energy error of a result, from an admissible stress."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from ngsolve import L2, GridFunction

from ngepc.bounds.airy import AirySpace
from ngepc.bounds.boundary import Boundary
from ngepc.bounds.conjugate import TO_PLANE, Conjugate
from ngepc.bounds.coverage import check_covered
from ngepc.bounds.element import STRESS_MAP, at_nodes, midpoint_rows
from ngepc.bounds.equilibration import Patches, end_moments
from ngepc.bounds.tightening import Effort, tightened
from ngepc.bounds.triangles import Triangles
from ngepc.local.factors import Factors
from ngepc.local.system import DiscreteProblem, State
from ngepc.model.problem import Problem

START_MAP = midpoint_rows(STRESS_MAP)
"""Stresses at the midpoints from edge moments and body force, shape (27, 14)."""


class Setting:
    """What bounds on one mesh have in common."""

    def __init__(self, discrete: DiscreteProblem) -> None:
        problem = discrete.problem
        check_covered(problem)
        self.discrete, self.problem = discrete, problem
        self.triangles = Triangles(problem.mesh)
        self.boundary = Boundary(problem, self.triangles)
        self.patches = Patches(self.boundary)
        self.space = AirySpace(self.boundary)
        self.conjugate = Conjugate(discrete.law)
        self.body_force = self._body_force()
        self.row_of = self._rows_of_contact_ends()

    def _body_force(self) -> np.ndarray:
        if self.problem.f is None:
            return np.zeros((len(self.triangles.nodes), 2))
        return self.discrete.points.at(self.problem.f)

    def _rows_of_contact_ends(self) -> np.ndarray:
        """The contact row of each end of the contact edges, -1 where there is none."""
        t, rows, edges = self.triangles, self.discrete.rows, self.boundary.contact
        of_vertex: dict[int, list[int]] = {}
        for row, vertex in enumerate(rows.vertices.tolist()):
            of_vertex.setdefault(vertex, []).append(row)
        found = np.full((len(edges), 2), -1)
        for i, edge in enumerate(edges.tolist()):
            for end in (0, 1):
                here = of_vertex.get(int(t.edges[edge, end]), [])
                if here:
                    found[i, end] = max(here, key=lambda r: rows.normals[r] @ t.normal[edge])
        return found


def pressure(setting: Setting, multipliers: np.ndarray) -> np.ndarray:
    """P >= 0 at the ends of contact edges from the contact forces, shape (contact edges, 2)."""
    rows = setting.discrete.rows
    if not len(rows):
        return np.zeros((len(setting.boundary.contact), 2))
    values = np.append(np.maximum(multipliers, 0.0) / rows.weights, 0.0)
    P = values[setting.row_of]
    return P


def in_plane(setting: Setting, mean: np.ndarray, deviator: np.ndarray) -> np.ndarray:
    """(a, b_0, b_1) of a stress with mean part and deviatoric coordinates."""
    first = mean if deviator.shape[1] == 2 else mean + deviator[:, 1] / np.sqrt(6.0)
    return np.stack([first, deviator[:, 0], deviator[:, -1]], axis=1)


def tensors(z: np.ndarray) -> np.ndarray:
    """2 x 2 matrices of in-plane coordinates."""
    v = z @ np.linalg.inv(TO_PLANE).T
    return np.stack([v[..., [0, 2]], v[..., [2, 1]]], axis=-2)


def balanced_stress(
    setting: Setting, state: State, tangent: Factors, contact_forces: np.ndarray
) -> np.ndarray:
    """In-plane stresses (nt, 3) in discrete equilibrium with loads and contact forces (nodes, N)."""
    discrete = setting.discrete
    law, points = discrete.law, discrete.points
    mean, deviator = law.bulk * state.volume, law.stress(state.at)
    for _ in range(2):
        missing = discrete.load - contact_forces - points.forces(mean, deviator)
        volume, e = points.strain(tangent.solve(missing))
        moduli = law.moduli(state.at, state.yielding)
        mean, deviator = mean + moduli.bulk * volume, deviator + moduli(e)
    return in_plane(setting, mean, deviator)


def run(state: State, effort: Effort = Effort(), timer=None):
    discrete = state.discrete
    tick = timer or (lambda name: None)
    setting = Setting(discrete); tick("setting")
    t, b = setting.triangles, setting.boundary
    tangent = Factors(discrete, "sparsecholesky")
    tangent.update(discrete.law.moduli(state.at, state.yielding)); tick("factor")
    P = pressure(setting, state.multipliers)
    contact = np.zeros((len(t.points), 2))
    on = b.contact
    m = np.zeros_like(b.traction)
    m[t.outer] = end_moments(b.traction[t.outer], t.length[t.outer])
    mp = end_moments(P, t.length[on])[:, :, None] * t.normal[on][:, None]
    m[on] -= mp
    for c in (0, 1):
        contact[:, c] = np.bincount(t.edges[on].ravel(), mp[:, :, c].ravel(), minlength=len(contact))
    sig = balanced_stress(setting, state, tangent, contact); tick("discrete")
    mu = setting.patches.moments(tensors(sig), setting.body_force, m); tick("patches")
    g = np.matmul(t.per_triangle(mu).reshape(-1, 6, 2), t.inverse.transpose(0, 2, 1)).reshape(-1, 12)
    f = np.matmul(t.inverse, setting.body_force[:, :, None])[:, :, 0] * t.det[:, None]
    z = setting.space.in_plane(np.concatenate([g, f], axis=1) @ START_MAP.T); tick("jm")
    strain = np.stack([state.volume, state.deviator[:, 0], state.deviator[:, -1]], axis=1)
    phi = discrete.law.energy_density(state.volume, state.at) + setting.conjugate.constant
    def gaps(z):
        mean = z.mean(axis=1)
        return setting.conjugate.integrals(at_nodes(z), t.area, t.area * (phi - np.einsum("tc,tc->t", mean, strain)))[0]
    un = np.einsum("eac,ec->ea", state.u[t.edges[on]], t.normal[on])
    c = ((b.gap - un) * end_moments(P, t.length[on]) + P * b.excess).sum()
    first = gaps(z).sum() + c
    z = tightened(setting.space, setting.conjugate, z, sig, effort); tick("tighten")
    eta = gaps(z); tick("integrals")
    return first, eta.sum() + c, eta.min(), c
