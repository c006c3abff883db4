"""Newton differentiability in numbers: with and without the norm gap of Assumption 6.4.

Definition 6.1 asks of M(q) = gamma [|q| - beta]^+ q/|q| that

    E(h) = M(q + h) - M(q) - G(q + h) h    has    ||E(h)||_Y / ||h||_X -> 0    as ||h||_X -> 0.

With X = Y = L2 that is false: let h move q across the yield surface on a disc of radius r; h goes
to zero with r, but E(h) is as large as h.  If X is stronger than Y, as L6 -> L2 of Lemma 6.3 or H1
-> H^(-1) for H_2 = H^1_0, the quotient goes to zero.  gamma and beta can be scaled to one.  The
directions h have a fixed height on shrinking discs: ``plateau`` is a null sequence in L2 and L6
only, ``log`` also in H1, with the slow rate log(1/r)^(-1/2).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import ngsolve as ng
import numpy as np
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.checks.arguments import require_integer
from ngepc.discretisation.quadrature import fine_rules
from ngepc.dual.saddle import RadialLaw
from ngepc.model.elements import element_nodes, vertex_coordinates
from ngepc.studies.work import Work

CELLS = 8
POINTS = 100
LARGEST_RADIUS = 0.25


def graded_mesh(levels: int) -> ng.Mesh:
    """The unit square, triangles halved ``levels`` times towards its centre.

    Within 2^(1-k)/4 of the centre the mesh width is about 2^(-k)/8.
    """
    mesh = MakeStructured2DMesh(quads=False, nx=CELLS, ny=CELLS)
    for k in range(2 * levels):
        x, y = vertex_coordinates(mesh)[element_nodes(mesh)[:, :3]].mean(axis=1).T - 0.5
        near = np.hypot(x, y) < 2 * LARGEST_RADIUS * 2.0 ** (-k / 2)
        mesh.SetRefinementFlags(near.tolist())
        mesh.Refine(onlyonce=True)
    return mesh


FAMILIES = {
    # 1 up to radius/2, linear to 0 at radius
    "plateau": lambda r, radius: np.clip(2 - 2 * r / radius, 0.0, 1.0),
    # capacity potential of the disc of this radius in the disc of LARGEST_RADIUS
    "log": lambda r, radius: np.clip(
        np.log(np.maximum(r, radius) / LARGEST_RADIUS)
        / math.log(radius / LARGEST_RADIUS),
        0.0,
        1.0,
    ),
}
"""Shapes as functions of the distance from the centre and a radius."""


def direction(mesh: ng.Mesh, shape: Callable, radius: float) -> ng.GridFunction:
    """(0.4, 0.3) times the shape around the centre, as a P1 field of H^1_0."""
    h = ng.GridFunction(ng.VectorValued(ng.H1(mesh, order=1, dirichlet=".*"), 2))
    x, y = vertex_coordinates(mesh).T - 0.5
    values = 0.5 * shape(np.hypot(x, y), radius)
    h.vec.FV().NumPy()[:] = np.concatenate([0.8 * values, 0.6 * values])
    return h


def quotients(q: ng.CoefficientFunction, h: ng.GridFunction) -> dict[str, float]:
    """Norms of h, and ||E(h)||_Y / ||h||_X for the pairs L2 -> L2, L6 -> L2, H1 -> H^(-1)."""
    mesh = h.space.mesh
    measure = ng.dx(intrules=fine_rules(2, POINTS))
    here = RadialLaw(q, 1.0)
    there = RadialLaw(q + h, 1.0)
    E = there.gradient - here.gradient - there.curvature * h
    r, s = h.space.TnT()
    B = ng.BilinearForm(ng.InnerProduct(ng.grad(r), ng.grad(s)) * ng.dx).Assemble().mat
    defect = ng.LinearForm(ng.InnerProduct(E, s) * measure).Assemble().vec
    riesz = (
        B.Inverse(h.space.FreeDofs(), inverse="sparsecholesky") * defect
    ).Evaluate()
    E_dual = math.sqrt(max(0.0, ng.InnerProduct(riesz, defect)))
    squares = [ng.InnerProduct(f, f) for f in (E, h, ng.grad(h))]
    E_L2, h_L2, h_H1 = (math.sqrt(ng.Integrate(f * measure, mesh)) for f in squares)
    h_L6 = ng.Integrate(squares[1] ** 3 * measure, mesh) ** (1 / 6)
    norms = {"h_L2": h_L2, "h_L6": h_L6, "h_H1": h_H1}
    return norms | {
        "L2_L2": E_L2 / h_L2,
        "L6_L2": E_L2 / h_L6,
        "H1_dual": E_dual / h_H1,
    }


def difference_quotients(levels: int = 7) -> list[dict]:
    """The quotients of Definition 6.1 along both families, radii 1/8, 1/16, ..., 2^(-2-levels).

    q = (0.9, 0) is constant, so that |q + h| > 1 where the shape of h exceeds about a quarter;
    1 <= levels <= 12.  A record has ``family``, ``radius`` and the numbers of ``quotients``.
    """
    require_integer("levels", levels, 1, 12)
    mesh = graded_mesh(levels + 3)
    q = ng.CoefficientFunction((0.9, 0.0))
    radii = [LARGEST_RADIUS / 2 ** (k + 1) for k in range(levels)]
    return [
        {
            "family": family,
            "radius": radius,
            **quotients(q, direction(mesh, shape, radius)),
        }
        for family, shape in FAMILIES.items()
        for radius in radii
    ]


@dataclass(eq=False)
class Differentiability(Work):
    """Difference quotients for directions on discs of ``levels`` radii."""

    levels: int = 7

    name = "differentiability"
    title = "Difference quotients of Definition 6.1"
    keeps = False
    columns = """family = {family} | radius = {radius:.3g} | h_L2 = {h_L2:.3g} | h_L6 = {h_L6:.3g}
        | h_H1 = {h_H1:.3g} | L2_L2 = {L2_L2:.3g} | L6_L2 = {L6_L2:.3g} | H1_dual = {H1_dual:.3g}"""
    note = (
        "||M(q+h) - M(q) - G(q+h) h|| / ||h|| for directions h on shrinking discs: it tends to "
        "zero between spaces with a norm gap and does not from L2 to L2, docs/differentiability.md."
    )

    def cells(self) -> list[dict]:
        """One cell with all radii."""
        return [{"levels": self.levels}]

    solve = staticmethod(difference_quotients)
