"""Newton differentiability made visible: the norm gap of Assumption 6.4, and life without it.

Definition 6.1 asks of M(q) = gamma [|q| - beta]^+ q/|q| that

    E(h) = M(q + h) - M(q) - G(q + h) h    has    ||E(h)||_Y / ||h||_X -> 0    as ||h||_X -> 0.

With X = Y = L2 that is false: h that lifts q just inside the yield surface across it on a disc of
radius r goes to zero with r, and E(h) is as large as h.  Where X is stronger than Y, L6 -> L2 of
Lemma 6.3 or H1 -> H^(-1) for H_2 = H^1_0, the quotient goes to zero.  gamma and beta scale out and
are one here.  Directions on shrinking discs, of fixed height: ``plateau`` is a null sequence in L2
and L6 alone, ``logarithmic`` in H1 as well, though only as fast as log(1/r)^(-1/2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from ngsolve import (
    H1,
    BilinearForm,
    CoefficientFunction,
    GridFunction,
    InnerProduct,
    Integrate,
    LinearForm,
    Mesh,
    VectorValued,
    dx,
    grad,
)
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.checks.arguments import require_integer
from ngepc.discretisation.quadrature import fine_rules
from ngepc.dual.functional import RadialLaw
from ngepc.studies.work import Work

CELLS = 8
POINTS = 100
LARGEST_RADIUS = 0.25


def graded_mesh(levels: int) -> Mesh:
    """The unit square, triangles halved ``levels`` times towards its centre.

    Within 2^(1-k)/4 of the centre the mesh width is about 2^(-k)/8.
    """
    mesh = MakeStructured2DMesh(quads=False, nx=CELLS, ny=CELLS)
    for k in range(2 * levels):
        radius = 2 * LARGEST_RADIUS * 2.0 ** (-k / 2)
        for element in mesh.Elements():
            centre = np.mean([mesh[v].point for v in element.vertices], axis=0)
            near = math.hypot(centre[0] - 0.5, centre[1] - 0.5) < radius
            mesh.SetRefinementFlag(element, bool(near))
        mesh.Refine(onlyonce=True)
    return mesh


class NormGap:
    """E(h) for M(q) = [|q| - 1]^+ q / |q| on P1 fields with two components, H^1_0."""

    def __init__(self, mesh: Mesh) -> None:
        self.space = VectorValued(H1(mesh, order=1, dirichlet=".*"), 2)
        q, r = self.space.TnT()
        B = BilinearForm(InnerProduct(grad(q), grad(r)) * dx).Assemble().mat
        self._inverse = B.Inverse(self.space.FreeDofs(), inverse="sparsecholesky")

    def quotients(self, q: CoefficientFunction, h: GridFunction) -> dict[str, float]:
        """Norms of h, and ||E(h)||_Y / ||h||_X for the pairs L2 -> L2, L6 -> L2, H1 -> H^(-1)."""
        mesh, measure = self.space.mesh, dx(intrules=fine_rules(2, POINTS))
        here, there = RadialLaw(q, 1.0), RadialLaw(q + h, 1.0)
        E = there.gradient - here.gradient - there.curvature * h
        defect = LinearForm(InnerProduct(E, self.space.TestFunction()) * measure).Assemble().vec
        riesz = (self._inverse * defect).Evaluate()
        E_dual = math.sqrt(max(0.0, InnerProduct(riesz, defect)))
        E_L2, h_L2, h_H1 = (
            math.sqrt(Integrate(InnerProduct(f, f) * measure, mesh)) for f in (E, h, grad(h))
        )
        h_L6 = Integrate(InnerProduct(h, h) ** 3 * measure, mesh) ** (1 / 6)
        return {
            **{"h_L2": h_L2, "h_L6": h_L6, "h_H1": h_H1},
            **{"L2_L2": E_L2 / h_L2, "L6_L2": E_L2 / h_L6, "H1_dual": E_dual / h_H1},
        }


def plateau(distance: np.ndarray, radius: float) -> np.ndarray:
    """1 up to radius/2, linear to 0 at radius."""
    return np.clip(2 - 2 * distance / radius, 0.0, 1.0)


def logarithmic(distance: np.ndarray, radius: float) -> np.ndarray:
    """The capacity potential of the disc of that radius in the one of LARGEST_RADIUS."""
    ratio = np.log(np.maximum(distance, radius) / LARGEST_RADIUS)
    return np.clip(ratio / math.log(radius / LARGEST_RADIUS), 0.0, 1.0)


FAMILIES = {"plateau": plateau, "log": logarithmic}


def difference_quotients(levels: int = 7) -> list[dict]:
    """The quotients of Definition 6.1 along both families, radii 1/8, 1/16, ..., 2^(-2-levels).

    q = (0.9, 0) is constant and h = 0.5 (0.8, 0.6) times the shape, so that |q + h| > 1 where the
    shape exceeds about a quarter; 1 <= levels <= 12.  A record has ``family`` and ``radius`` beside
    what ``NormGap.quotients`` gives.
    """
    require_integer("levels", levels, 1, 12)
    mesh = graded_mesh(levels + 3)
    gap, q = NormGap(mesh), CoefficientFunction((0.9, 0.0))
    points = np.asarray(mesh.ngmesh.Coordinates())[:, :2]
    distance = np.hypot(points[:, 0] - 0.5, points[:, 1] - 0.5)
    rows = []
    for family, shape in FAMILIES.items():
        for k in range(levels):
            radius = LARGEST_RADIUS / 2 ** (k + 1)
            h, values = GridFunction(gap.space), 0.5 * shape(distance, radius)
            h.vec.FV().NumPy()[:] = np.concatenate([0.8 * values, 0.6 * values])
            rows.append({"family": family, "radius": radius, **gap.quotients(q, h)})
    return rows


@dataclass(eq=False)
class Differentiability(Work):
    """Difference quotients for directions on discs of ``levels`` radii."""

    levels: int = 7

    name, title, keeps = "differentiability", "Difference quotients of Definition 6.1", False
    columns = """family = {family} | radius = {radius:.3g} | h_L2 = {h_L2:.3g} | h_L6 = {h_L6:.3g}
        | h_H1 = {h_H1:.3g} | L2_L2 = {L2_L2:.3g} | L6_L2 = {L6_L2:.3g} | H1_dual = {H1_dual:.3g}"""
    note = (
        "||M(q+h) - M(q) - G(q+h) h|| / ||h|| for directions h on shrinking discs: it tends to "
        "zero between spaces with a norm gap and does not from L2 to L2, docs/differentiability.md."
    )

    def cells(self) -> list[dict]:
        """All radii in one."""
        return [{"levels": self.levels}]

    def solve(self, levels: int) -> list[dict]:
        """All quotients."""
        return difference_quotients(levels)
