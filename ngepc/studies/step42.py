"""The default method against the primal one on the body of deal.II's step-42.

Box (0, 1)^3 fixed below, u_x = u_y = 0 on its sides, E = 2e5, nu = 0.3, beta = 400, isotropic
hardening 2 mu g / (1 - g) with g = 0.01; the sphere of radius 0.6 has come down by 0.01.  It
touches within a radius of 0.1: equal cells of width 1/8 have one node there.  So the quarter of the
body that symmetry leaves is meshed towards the contact zone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from ngsolve import Mesh

from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.geometries import quarter_cube
from ngepc.local.pyamg import PyAMG
from ngepc.model.material import Material, lame_parameters
from ngepc.model.obstacles import Sphere
from ngepc.model.problem import Problem
from ngepc.results.result import Result
from ngepc.studies.examples import peak_memory, solved_by, timed
from ngepc.studies.work import Entry, Work, first_of, steps

DEPTH, BOUND = 0.01, 400.0
CELLS = {"tetrahedra": (4, 6, 8, 12, 16), "hexahedra": (4, 6, 8, 12)}
"""Cells along each edge of the graded quarter."""
OWN = "hexahedra of step-42"
"""Equal cells, 8 x 8 x 8 on the whole body."""
REFINED, HALVED = "hexahedra of step-42, refined", (8, 16, 32)
"""The same halved everywhere, so many along an edge of the quarter, for the default method."""
TOLERANCE = 1e-8
"""Of the runs on them."""

WHOLE = {"left|right|front|back": (0, 0, None)}
QUARTER = {
    "side_x|side_y": (0, 0, None),
    "mirror_x": (0, None, None),
    "mirror_y": (None, 0, None),
}
METHODS = ("primal", "default")
NOTE = (
    "Contact force F of the whole body, nodes in contact on the quarter and Newton steps, by the "
    "primal method and the default one. F, energy, peak (largest contact pressure): their relative "
    "differences; max of u: the largest nodal one of the displacements over the depth 0.01. "
    "The change of F is from the next coarser mesh, less than its discretisation "
    "error. Step-42's own mesh has 8 x 8 x 8 cells on the whole body, where one node touches; its "
    "documentation prints F = 37.3058 there, and F = 56.794 after three adaptive refinements "
    "(52,497 unknowns, 38.4 s on 16 cores), whose finest cells are those of 64^3. Refined rows: "
    "the default method with PyAMG(), each mesh started from the one before, tolerance "
    f"{TOLERANCE:g}; CPU s from the coarsest mesh on, MB: the most that the process has held."
)


def step42_problem(mesh: Mesh, prescribed: dict | None = None) -> Problem:
    """The problem of step-42 on a mesh of ``geometries.quarter_cube``.

    For the whole cube, ``geometries.block``, with ``prescribed=WHOLE``.
    """
    lame_lambda, lame_mu = lame_parameters(2e5, 0.3)
    material = Material.isotropic(
        lame_lambda=lame_lambda,
        lame_mu=lame_mu,
        yield_stress=BOUND,
        hardening_modulus=1 / BOUND,
        hardening_stiffness=2 * lame_mu * 0.01 / 0.99,
    )
    gap = Sphere((0.5, 0.5, 1.6), 0.6).gap(mesh, motion=(0.0, 0.0, -DEPTH))
    supports = QUARTER if prescribed is None else prescribed
    return Problem(mesh, material, contact="contact", gap=gap, prescribed=supports)


def equal_cells(n: int) -> Mesh:
    """2n x 2n x 2n equal hexahedra on the whole body, the quarter of them that is solved on."""
    return quarter_cube.mesh(n, 2 * n, grading=0.0, simplices=False)


def compare_methods(problem: Problem) -> dict:
    """Both methods on one mesh of the quarter: method -> status, steps, numbers of the whole body.

    'displacement_difference' is the largest nodal one of the displacements over the depth.
    """
    runs = {method: timed(partial(solved_by, method, problem)) for method in METHODS}
    nodal = [r.displacement.vec.FV().NumPy().reshape(3, -1) for r, _ in runs.values()]
    apart = np.linalg.norm(nodal[0] - nodal[1], axis=0).max()
    found = {method: of_whole_body(*run) for method, run in runs.items()}
    return found | {"displacement_difference": float(apart / DEPTH)}


def of_whole_body(result: Result, told: dict) -> dict:
    """What ``timed`` tells, and the numbers of the whole body: forces and energies times four."""
    forces = result.nodal_contact_forces
    return told | {
        "energy": 4 * result.primal_energy,
        "contact_force": 4 * result.contact_force,
        "peak_pressure": float((forces / result.rows.weights).max()),
        "touching": int(np.count_nonzero(forces > 1e-6 * forces.max())),
    }


def solve_refined(cells: int) -> dict:
    """The default method with multigrid on equal cells, nested from the mesh of step-42."""

    def nested_run() -> Result:
        result = None
        for n in (n for n in (4, *HALVED) if n <= cells):
            problem = step42_problem(equal_cells(n))
            result = semismooth_newton(problem, start=result, options=options)
        return result

    options = NewtonOptions(inverse=PyAMG(), tolerance=TOLERANCE)
    result, told = timed(nested_run)
    found = {"nodes": result.problem.mesh.nv, "default": of_whole_body(result, told)}
    return found | {"memory_mb": peak_memory()}


def relative(record: dict, quantity: str) -> float:
    """The difference of a quantity between the methods, relative to the primal one."""
    return abs(record["default"][quantity] / record["primal"][quantity] - 1)


def _apart(quantity: str) -> Entry:
    return lambda record: f"{relative(record, quantity):.1e}" if "primal" in record else ""


def _both(number: Callable[[dict], object]) -> Entry:
    return lambda record: ", ".join(str(number(record[m])) for m in METHODS if m in record)


def _mesh(record: dict) -> str:
    n = record["cells"]
    if record["mesh"] == REFINED:
        return f"{2 * n}^3 equal cells on the whole body, {3 * record['nodes']:,} unknowns"
    return OWN if record["mesh"] == OWN else f"{n}^3 cells on the quarter, {record['mesh']}"


@dataclass(eq=False)
class Step42(Work):
    """``levels`` meshes of each shape, 1 to 5 (hexahedra: at most 4), and that of step-42."""

    levels: int = 3

    name, title, note = "step42", "Step-42: the default method against the primal one", NOTE
    columns = (
        ("mesh", _mesh),
        ("nodes", "{nodes}"),
        ("touching", _both(lambda run: run["touching"])),
        ("steps", _both(steps)),
        ("F primal", "{primal[contact_force]:.4f}"),
        ("F default", "{default[contact_force]:.4f}"),
        ("F", _apart("contact_force")),
        ("energy", _apart("energy")),
        ("peak", _apart("peak_pressure")),
        ("max of u", "{displacement_difference:.1e}"),
        ("change of F from mesh to mesh", "{change:.1e}"),
        ("CPU s", _both(lambda run: f"{run['cpu_s']:.1f}")),
        ("MB", "{memory_mb:.0f}"),
    )

    def cells(self) -> list[dict]:
        """Tetrahedra, hexahedra, and the mesh of step-42 itself."""
        first_of(CELLS["tetrahedra"], self.levels)
        meshes = [(shape, n) for shape, family in CELLS.items() for n in family[: self.levels]]
        meshes += [(OWN, 4), *((REFINED, n) for n in HALVED[: max(0, self.levels - 2)])]
        return [{"mesh": shape, "cells": n} for shape, n in meshes]

    def solve(self, mesh: str, cells: int) -> dict:
        """Both methods, or the default one, on a mesh."""
        if mesh == REFINED:
            return solve_refined(cells)
        graded = quarter_cube.mesh(cells, simplices=mesh == "tetrahedra")
        problem = step42_problem(equal_cells(cells) if mesh == OWN else graded)
        return {"nodes": problem.mesh.nv, **compare_methods(problem)}

    def told(self, records: Sequence[dict]) -> list[dict]:
        """The records with the change of F from the next coarser mesh."""
        told = [dict(record) for record in records]
        for coarser, record in pairwise(told):
            if record["mesh"] in (coarser["mesh"], REFINED):
                after, before = (r["default"]["contact_force"] for r in (record, coarser))
                record["change"] = abs(after / before - 1)
        return told
