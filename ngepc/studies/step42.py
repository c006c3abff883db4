"""The dual method against the primal one on the body of deal.II's step-42, with both errors.

Box (0, 1)^3 fixed below, u_x = u_y = 0 on its sides, E = 2e5, nu = 0.3, beta = 400, isotropic
hardening 2 mu g / (1 - g) with g = 0.01; the sphere of radius 0.6 has come down by 0.01.  It
touches within a radius of 0.1: equal cells of width 1/8 have one node there.  So the quarter of the
body that symmetry leaves is meshed towards the contact zone, and beside the difference of the two
methods stands the change from mesh to mesh.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from ngsolve import H1, GridFunction, Mesh

from ngepc.dual.newton import semismooth_newton
from ngepc.geometries import quarter_cube
from ngepc.model.material import Material, lame_parameters
from ngepc.model.obstacles import Sphere
from ngepc.model.problem import Problem
from ngepc.primal.solver import primal_newton
from ngepc.results.outcome import Result
from ngepc.studies.output import Table, write_table
from ngepc.studies.tables import Cell, CellStore, Outcome

DEPTH, BOUND = 0.01, 400.0
CELLS = {"tetrahedra": (4, 6, 8, 12, 16), "hexahedra": (4, 6, 8, 12)}
"""Cells along each edge of the graded quarter."""
OWN = "hexahedra of step-42"
"""Equal cells, 8 x 8 x 8 on the whole body."""

WHOLE = {"left|right|front|back": (0, 0, None)}
QUARTER = {
    "side_x|side_y": (0, 0, None),
    "mirror_x": (0, None, None),
    "mirror_y": (None, 0, None),
}

QUANTITIES = ("contact_force", "energy", "peak_pressure")


def step42_problem(mesh: Mesh, prescribed: dict | None = None) -> Problem:
    """The problem of step-42 on the whole cube (``geometries.block``) or on its quarter.

    Parameters
    ----------
    mesh
        Of ``geometries.quarter_cube``, or of ``geometries.block`` with ``prescribed=WHOLE``.
    prescribed
        Supports beside the clamped bottom; None for those of the quarter.
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


def compare(problem: Problem) -> dict:
    """Both methods on one mesh of the quarter.

    Returns
    -------
    dict
        'primal' and 'dual': status, steps, numbers of the whole body; 'displacement_difference':
        largest nodal |u_dual - u_primal| over the depth.
    """
    solvers = {
        "primal": lambda: primal_newton(problem),
        "dual": lambda: semismooth_newton(problem),
    }
    runs, found = {}, {}
    for name, solve in solvers.items():
        clock = time.process_time()
        runs[name] = result = solve().or_interrupted()
        found[name] = _numbers(result) | {"cpu_s": time.process_time() - clock}
    u, w = (_nodal(runs[name]) for name in ("dual", "primal"))
    found["displacement_difference"] = float(np.linalg.norm(u - w, axis=0).max() / DEPTH)
    return found


def _numbers(result: Result) -> dict:
    """Status, steps, and the numbers of the whole body: forces and energies times four."""
    mesh = result.problem.mesh
    pressure = GridFunction(H1(mesh, order=1))
    pressure.Set(result.contact_pressure, definedon=mesh.Boundaries("contact"))
    nodal = pressure.vec.FV().NumPy()
    return {
        "status": result.status.label,
        "iterations": result.iterations,
        "contact_force": 4 * result.contact_force,
        "energy": -4 * result.dual_energy,
        "peak_pressure": float(nodal.max()),
        "touching": int(np.count_nonzero(nodal > 1e-6 * nodal.max())),
    }


def _nodal(result: Result) -> np.ndarray:
    return result.displacement.vec.FV().NumPy().reshape(3, -1)


class Step42:
    """The study; each mesh is solved once and kept in ``folder``/cells.

    Parameters
    ----------
    folder
        Where results go.
    levels
        Meshes of each shape, 1 to 5 (hexahedra: at most 4).
    progress
        Called with a line of text after each mesh.
    """

    def __init__(
        self, folder: Path, levels: int, progress: Callable[[str], None] = lambda line: None
    ) -> None:
        self.folder, self.levels, self.progress = Path(folder), levels, progress
        self._store = CellStore(self.folder / "cells", {"study": "step42"})

    def run(self) -> list[dict]:
        """One record for each mesh."""
        meshes = [(shape, n) for shape, cells in CELLS.items() for n in cells[: self.levels]]
        return [self._get(shape, n) for shape, n in [*meshes, (OWN, 4)]]

    def _get(self, shape: str, n: int) -> dict:
        cell = Cell(f"step42 {shape}, {n}", 0)
        record = self._store.get(cell, lambda _: self._solve(shape, n)).record
        forces = [record[name]["contact_force"] for name in ("primal", "dual")]
        self.progress(f"{shape}, {n}: {forces[0]:.4f} and {forces[1]:.4f}")
        return record

    def _solve(self, shape: str, n: int) -> Outcome:
        if shape == OWN:
            mesh = quarter_cube.mesh(n, 2 * n, grading=0.0, simplices=False)
        else:
            mesh = quarter_cube.mesh(n, simplices=shape == "tetrahedra")
        return Outcome(
            {"mesh": shape, "cells": n, "nodes": mesh.nv, **compare(step42_problem(mesh))}
        )

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write step42.csv, step42.md and step42.json; returns their paths."""
        return write_table(
            self.folder,
            Table(
                name="step42",
                title="Step-42: the dual method against the primal one",
                head=HEAD,
                rows=[_row(r, before) for r, before in with_coarser(table)],
                notes=NOTES,
                cells=[_flat(r) for r in table],
            ),
        )


def with_coarser(table: Sequence[dict]) -> list[tuple[dict, dict | None]]:
    """Each record with that of the next coarser mesh of its kind, None where there is none."""
    coarser = [None, *table[:-1]]
    return [
        (r, b if b is not None and b["mesh"] == r["mesh"] else None)
        for r, b in zip(table, coarser, strict=True)
    ]


def relative(record: dict, one: str, other: str, quantity: str) -> float:
    """The difference of a quantity between two methods on a mesh, relative to the second."""
    return abs(record[one][quantity] / record[other][quantity] - 1)


HEAD = (
    *("mesh of the quarter", "nodes", "touching", "steps", "F primal", "F dual"),
    *(f"{name}: dual; mesh" for name in ("F", "energy", "peak")),
    "max of u",
)
NOTES = (
    "Contact force F of the whole body, nodes in contact on the quarter and Newton steps, by the "
    "primal and by the dual method. In the next three columns, each relative: difference of the "
    "dual method to the primal one on the mesh; change of the primal value from the next "
    "coarser mesh, less than its discretisation error. The energy is J of the primal and -J* of "
    "the dual method. The last column is the largest nodal difference of the displacements, dual "
    "to primal, over the depth 0.01. Step-42's own mesh has 8 x 8 x 8 cells on the whole body, "
    "where one node touches; its documentation prints F = 37.3058.",
)
COLUMNS = ("primal", "dual")


def _row(record: dict, coarser: dict | None) -> list[str]:
    runs = [record[name] for name in COLUMNS]
    errors = []
    for quantity in QUANTITIES:
        mesh = "-"
        if coarser is not None:
            change = record["primal"][quantity] / coarser["primal"][quantity] - 1
            mesh = f"{abs(change):.1e}"
        errors.append(f"{relative(record, 'dual', 'primal', quantity):.1e}; {mesh}")
    name = OWN if record["mesh"] == OWN else f"{record['cells']}^3 cells, {record['mesh']}"
    return [
        name,
        str(record["nodes"]),
        *(", ".join(str(run[key]) for run in runs) for key in ("touching", "iterations")),
        *(f"{run['contact_force']:.4f}" for run in runs),
        *errors,
        f"{record['displacement_difference']:.1e}",
    ]


def _flat(record: dict) -> dict:
    """The record with one level of names: 'dual_contact_force' and the like."""
    flat = {}
    for key, value in record.items():
        if isinstance(value, dict):
            flat |= {f"{key}_{name}": item for name, item in value.items()}
        else:
            flat[key] = value
    return flat
