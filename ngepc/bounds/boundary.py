"""Loads, supports and obstacles on the boundary edges of a triangulation."""

from __future__ import annotations

import numpy as np
from ngsolve import CF

from ngepc.bounds.coverage import (
    ENDS_AND_INSIDE,
    SHARES,
    affine_defect,
    check_affine,
    on_segments,
)
from ngepc.bounds.triangles import Triangles
from ngepc.checks.arguments import boundary_names
from ngepc.model.problem import Problem, as_scalar


class Boundary:
    """What is given on each edge of the outer boundary.

    Parameters
    ----------
    problem, triangles
        The data and the edges of its mesh.

    Attributes
    ----------
    given
        Boolean, shape (ne, 2): components of the traction that are known, contact included.
    traction
        g at the two ends of each edge (stress), zero elsewhere, shape (ne, 2, 2).
    contact
        Numbers of the contact edges.
    gap
        A function at the ends of the contact edges that is affine and nowhere above psi (length),
        shape (contact edges, 2).
    excess
        int over the edge of (psi - gap) times each end's hat function, shape (contact edges, 2).

    Raises
    ------
    ValueError
        For tractions or prescribed displacements that are not affine on edges, and for boundaries
        inside the body.
    """

    def __init__(self, problem: Problem, triangles: Triangles) -> None:
        self.problem, self.triangles = problem, triangles
        mesh, count = problem.mesh, len(triangles.edges)
        segments = mesh.ngmesh.Elements1D().NumPy()
        self._vertices = segments["nodes"][:, :2].astype(int) - 1
        self._edge = triangles.edges_between(self._vertices)
        names = mesh.GetBoundaries()
        self._name = np.array([names[k - 1] for k in segments["index"].tolist()], dtype=object)
        self.given = np.repeat(triangles.outer[:, None], 2, axis=1)
        self.given[self._edge] &= ~self._held()
        self.traction = np.zeros((count, 2, 2))
        self._read_tractions()
        self._read_contact()

    def _on(self, names: tuple[str, ...], argument: str) -> np.ndarray:
        """Which segments have one of these names; they lie on the outer boundary."""
        chosen = np.isin(self._name, list(names))
        if not self.triangles.outer[self._edge[chosen]].all():
            raise ValueError(f"{argument}: bounds need it on the outer boundary of the body")
        return chosen

    def _held(self) -> np.ndarray:
        """Components that a support holds, shape (segments, 2)."""
        problem, held = self.problem, np.zeros((len(self._edge), 2), dtype=bool)
        held[self._on(problem.clamped_names, f"clamped={problem.clamped!r}")] = True
        for key, components in (problem.prescribed or {}).items():
            argument = f"prescribed[{key!r}]"
            on = self._on(boundary_names("prescribed", key, problem.mesh), argument)
            for c, value in enumerate(components):
                if value is not None:
                    held[on, c] = True
                    check_affine(argument, on_segments(problem, as_scalar(value))[on])
        return held

    def _read_tractions(self) -> None:
        tractions = self.problem.tractions
        if not tractions:
            return
        on = self._on(tuple(tractions), "traction")
        g = self.problem.mesh.BoundaryCF(tractions, default=CF((0.0, 0.0)))
        values = on_segments(self.problem, g)[on]
        check_affine("traction", values)
        self.traction[self._edge[on]] = self._ends(values[:, :2], self._vertices[on])

    def _read_contact(self) -> None:
        on = self._on(self.problem.contact_names, f"contact={self.problem.contact!r}")
        self.contact = self._edge[on]
        if not on.any():
            self.gap = self.excess = np.zeros((0, 2))
            return
        psi = on_segments(self.problem, self.problem.psi)[on]
        above = psi[:, :2, 0] + np.minimum(affine_defect(psi)[:, :, 0].min(axis=1), 0.0)[:, None]
        weights = self.triangles.length[self.contact][:, None] * np.array(ENDS_AND_INSIDE.weights)
        more = weights * (psi[:, :, 0] - above @ SHARES.T)
        self.gap = self._ends(above, self._vertices[on])
        self.excess = self._ends(more @ SHARES, self._vertices[on])

    def on_contact(self, values: np.ndarray) -> np.ndarray:
        """Values at ENDS_AND_INSIDE of all segments -> at the ends of the contact edges."""
        on = np.isin(self._edge, self.contact)
        return self._ends(values[on][:, :2, 0], self._vertices[on])

    def _ends(self, values: np.ndarray, vertices: np.ndarray) -> np.ndarray:
        """Values at the vertices of segments in the order of the edge's ends."""
        turned = vertices[:, 0] > vertices[:, 1]
        return np.where(turned.reshape(-1, *[1] * (values.ndim - 1)), values[:, ::-1], values)
