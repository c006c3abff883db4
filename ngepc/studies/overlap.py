"""Overlap of bodies between contact nodes, and the stability of contact pressures.

A rigid sphere on a block, and a roller on a block as a pair of bodies, on meshes that get finer.
"""

import numpy as np
from ngsolve import Mesh, sqrt, x, y
from ngsolve.meshes import MakeStructured3DMesh

from ngepc.local.result import ExactResult
from ngepc.local.system import DiscreteProblem
from ngepc.methods.newton import semismooth_newton
from ngepc.model.material import Material
from ngepc.model.problem import Problem
from ngepc.studies.contact_problems import roller
from ngepc.studies.examples import timed
from ngepc.studies.work import OverMeshes, first_of

FORCE = 0.409
"""Force on the sphere on fine meshes, of ngepc and of CalculiX with quadratic elements."""

DEPTH = 0.003
"""Indentation of the sphere of radius 10 into a block of edge 1 (length)."""

HALF_WIDTH = 6.21
RADIUS = 50.0
"""Half width of the contact of the roller, as published, and the radius of the roller."""

MOST_ROWS = 400
"""Largest number of contact rows for which the stability of the pressure is computed."""

CELLS = {
    "sphere, tetrahedra": (2, 4, 6, 8),
    "sphere, hexahedra": (2, 4, 5, 6),
    "roller on a block": (1.6, 0.8, 0.4, 0.2),
}
"""Body and elements -> cells along an edge, or the width of elements at the contact."""


def graded_quarter(cells: int, *, hexahedra: bool) -> Mesh:
    """A quarter of a block; cells grow away from the point of contact, (0, 0, 1)."""

    def graded(s: float) -> float:
        """A coordinate that grades the mesh towards zero."""
        return s * (0.35 + 0.65 * s)

    return MakeStructured3DMesh(
        hexes=hexahedra,
        nx=cells,
        ny=cells,
        nz=3 * cells // 2,
        mapping=lambda x, y, z: (graded(x) / 2, graded(y) / 2, 1 - graded(1 - z)),
    )


def sphere(cells: int, order: int, *, hexahedra: bool) -> Problem:
    """A quarter of a block under a rigid sphere."""
    mesh = graded_quarter(cells, hexahedra=hexahedra)
    elastic = {"lame_lambda": 1e3, "lame_mu": 1e3, "yield_stress": 0.5}
    steel = Material.kinematic(**elastic, hardening=100.0)
    held = {"back": (0, None, None), "left": (None, 0, None)}
    gap = 10.0 - sqrt(100.0 - x**2 - y**2) - DEPTH
    return Problem(
        mesh, steel, "bottom", contact="top", gap=gap, prescribed=held, order=order
    )


def pressure_stability(discrete: DiscreteProblem, shear: float) -> float:
    """The smallest eigenvalue of 2 mu S in the norm of forces lambda, sum of h/w lambda^2.

    S = R K^-1 R' is the compliance of the contact rows R for the elastic stiffness K, w are their
    areas and h = w^(1/(N-1)) the widths of the facets.  The eigenvalue is the square of the inf-sup
    constant between displacements in the energy norm and forces in a discrete H^-1/2 norm.  It is 0
    if some pressure does no work on any displacement.
    """
    contact = discrete.contact
    rows = contact.rows
    compliance = contact.compliance(discrete.elastic.solve, np.arange(len(rows)))
    width = rows.weights ** (1 / (discrete.problem.N - 1))
    scale = np.sqrt(rows.weights / width)
    scaled = 2 * shear * compliance * np.outer(scale, scale)
    return float(np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0])


def deepest(result: ExactResult) -> float:
    """Largest overlap of the undeformed bodies (length)."""
    return HALF_WIDTH**2 / (2 * RADIUS) if result.problem.contact_pairs else DEPTH


class BetweenNodes(OverMeshes):
    """``levels`` meshes, 1 to 4, of each body, with displacements of order one and two."""

    name = "overlap"
    title = "Contact between the nodes"
    columns = """body = {body} | cells or width = {cells} | order = {order}
        | vertices = {nodes:,} | rows = {rows} | Newton steps = {steps}
        | force, error = {error:+.2%} | overlap over depth = {overlap:.1e}
        | 2 mu beta^2 = {stability:.3f}"""
    note = (
        "Sphere: a rigid one of radius 10 pressed 0.003 into a quarter of a block of edge 1, "
        f"h/mu = 0.1; its force on the whole block is {FORCE} on fine meshes; the depth is 0.003. "
        "Roller: NAFEMS R94, elastic, two bodies whose meshes do not match; the depth is what "
        f"undeformed bodies overlap at its published half width, {HALF_WIDTH}. Overlap: the "
        "deepest one at any point. 2 mu beta^2: the smallest eigenvalue of the compliance of the "
        f"contact rows, for the sphere with up to {MOST_ROWS} rows."
    )

    def cells(self) -> list[dict]:
        """Both orders on all meshes of all bodies."""
        meshes = [
            (body, n)
            for body, family in CELLS.items()
            for n in first_of(family, self.levels)
        ]
        return [
            {"body": body, "cells": n, "order": order}
            for body, n in meshes
            for order in (1, 2)
        ]

    def solve(self, body: str, cells: float, order: int) -> dict:
        """One body on one mesh."""
        rigid = body.startswith("sphere")
        hexahedra = body.endswith("hexahedra")
        problem = (
            sphere(int(cells), order, hexahedra=hexahedra)
            if rigid
            else roller(cells, order)
        )
        result, found = timed(semismooth_newton, problem)
        few = rigid and len(result.rows) <= MOST_ROWS
        force = 4 * result.contact_force
        return found | {
            "nodes": problem.mesh.nv,
            "rows": len(result.rows),
            "error": force / FORCE - 1 if rigid else None,
            "overlap": result.penetration / deepest(result),
            "stability": pressure_stability(result.discrete, 1e3) if few else None,
        }
