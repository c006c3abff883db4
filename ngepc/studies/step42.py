"""The default method against the primal one on the body of deal.II's step-42.

Box (0, 1)^3 fixed below, u_x = u_y = 0 on its sides, E = 2e5, nu = 0.3, beta = 400, isotropic
hardening 2 mu g / (1 - g) with g = 0.01; the sphere of radius 0.6 moves down by 0.01.  The radius
of the contact zone is 0.1, where equal cells of width 1/8 have one node.  Therefore a quarter of
the body is solved, on meshes graded towards the contact zone.
"""

from collections.abc import Sequence

import numpy as np
from ngsolve import Mesh

from ngepc.geometries import quarter_cube
from ngepc.local.pyamg import PyAMG
from ngepc.methods.newton import semismooth_newton
from ngepc.model.material import Material
from ngepc.model.obstacles import Sphere
from ngepc.model.problem import Problem
from ngepc.model.tensile import lame_parameters
from ngepc.results.options import NewtonOptions
from ngepc.results.result import Result
from ngepc.studies.examples import METHODS, peak_memory, solved_by, timed
from ngepc.studies.work import OverMeshes, first_of

BOUND = 400.0
CELLS = {"tetrahedra": (4, 6, 8, 12, 16), "hexahedra": (4, 6, 8, 12)}
"""Cells along each edge of the graded quarter."""
OWN = "hexahedra of step-42"
"""Equal cells, 8 x 8 x 8 on the whole body."""
REFINED = f"{OWN}, refined"
EQUAL = (4, 8, 16, 32)
"""Cells along an edge of the quarter: the equal cells of step-42, and their refinements."""
TOLERANCE = 1e-8
"""Options of the runs on these meshes."""

WHOLE = {"left|right|front|back": (0, 0, None)}
QUARTER = {
    "side_x|side_y": (0, 0, None),
    "mirror_x": (0, None, None),
    "mirror_y": (None, 0, None),
}


def step42_problem(mesh: Mesh, prescribed: dict = QUARTER) -> Problem:
    """The problem of step-42 on a mesh of ``geometries.quarter_cube``.

    For the whole cube, ``geometries.block``, with ``prescribed=WHOLE``.
    """
    lame_lambda, mu = lame_parameters(2e5, 0.3)
    elastic = {"lame_lambda": lame_lambda, "lame_mu": mu, "yield_stress": BOUND}
    hardening = {
        "hardening_modulus": 1 / BOUND,
        "hardening_stiffness": 2 * mu * 0.01 / 0.99,
    }
    steel = Material.isotropic(**elastic, **hardening)
    gap = Sphere((0.5, 0.5, 1.6), 0.6).gap(mesh, motion=(0.0, 0.0, -0.01))
    data = {"contact": "contact", "gap": gap, "prescribed": prescribed}
    return Problem(mesh, steel, **data, order=1)  # as in that program


def equal_cells(n: int) -> Mesh:
    """2n x 2n x 2n equal hexahedra on the whole body, the quarter of them that is solved on."""
    return quarter_cube.mesh(n, 2 * n, grading=0.0, simplices=False)


def multigrid_run(cells: int) -> Result:
    """The default method with multigrid on equal cells, nested from the mesh of step-42."""
    options = NewtonOptions(inverse=PyAMG(), tolerance=TOLERANCE)
    result = None
    for n in (n for n in EQUAL if n <= cells):
        result = semismooth_newton(
            step42_problem(equal_cells(n)), start=result, options=options
        )
    return result


class Step42(OverMeshes):
    """``levels`` meshes of each shape, 1 to 5 (hexahedra: at most 4), and that of step-42."""

    name = "step42"
    title = "Step-42: the default method and the primal one"
    columns = """mesh = {label} | nodes = {nodes} | method = {method} | steps = {steps}
        | touching = {touching} | F = {contact_force:.8f} | change = {change:.1e}
        | J = {energy:.12f} | peak = {peak_pressure:.6f} | CPU s = {cpu_s:.1f}
        | MB = {memory_mb:.0f}"""
    note = (
        "Contact force F of the whole body, its change from the next coarser mesh, energy and "
        "largest contact pressure, nodes in contact on the quarter, Newton steps. Step-42's own "
        "mesh has 8 x 8 x 8 cells on the whole body, where one node touches; its documentation "
        "prints F = 37.3058 there, and F = 56.794 after three adaptive refinements (52,497 "
        "unknowns, 38.4 s on 16 cores), whose finest cells are those of 64^3. Refined: with "
        f"PyAMG(), each mesh started from the one before, tolerance {TOLERANCE:g}; CPU s from the "
        "coarsest mesh on; MB: peak memory of the process."
    )

    def cells(self) -> list[dict]:
        """Tetrahedra, hexahedra, and the mesh of step-42 itself by both methods; refined."""
        first_of(CELLS["tetrahedra"], self.levels)
        meshes = [
            (shape, n) for shape, family in CELLS.items() for n in family[: self.levels]
        ]
        coarsest, *halved = EQUAL
        runs = [
            (*mesh, method)
            for mesh in (*meshes, (OWN, coarsest))
            for method in METHODS[::-1]
        ]
        runs += [(REFINED, n, "default") for n in halved[: max(0, self.levels - 2)]]
        return [
            {"mesh": shape, "cells": n, "method": method} for shape, n, method in runs
        ]

    def solve(self, mesh: str, cells: int, method: str) -> dict:
        """Forces and energies are those of the whole body, four times those of the quarter."""
        if mesh == REFINED:
            result, found = timed(multigrid_run, cells)
            found["memory_mb"] = peak_memory()
        else:
            graded = quarter_cube.mesh(cells, simplices=mesh == "tetrahedra")
            problem = step42_problem(equal_cells(cells) if mesh == OWN else graded)
            result, found = timed(solved_by, method, problem)
        forces = result.nodal_contact_forces
        nodes = result.problem.mesh.nv
        label = OWN if mesh == OWN else f"{cells}^3 cells on the quarter, {mesh}"
        if mesh == REFINED:
            label = (
                f"{2 * cells}^3 equal cells on the whole body, {3 * nodes:,} unknowns"
            )
        return found | {
            "label": label,
            "nodes": nodes,
            "energy": 4 * result.primal_energy,
            "contact_force": 4 * result.contact_force,
            "peak_pressure": float((forces / result.rows.weights).max()),
            "touching": int(np.count_nonzero(forces > 1e-6 * forces.max())),
        }

    def table_rows(self, records: Sequence[dict]) -> list[dict]:
        """The records with the change of F from the next coarser mesh."""
        rows = []
        before = {}
        for r in records:
            force = r["contact_force"]
            family = (r["mesh"].removesuffix(", refined"), r["method"])
            change = abs(force / before[family] - 1) if family in before else None
            rows.append(r | {"change": change})
            before[family] = force
        return rows
