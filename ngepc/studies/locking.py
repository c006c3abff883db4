"""Volume locking: cantilever, Prandtl's punch and Cook's membrane by elements of order 1 and 2."""

import math
from collections.abc import Callable
from functools import partial

from ngsolve import IfPos, Mesh, x, y
from ngsolve.meshes import MakeStructured2DMesh

from ngepc.discretisation.factors import Factors
from ngepc.discretisation.points import Points
from ngepc.local.result import ExactResult
from ngepc.local.start import starting_state
from ngepc.local.system import DiscreteProblem
from ngepc.model.problem import Problem
from ngepc.model.tensile import lame_parameters
from ngepc.results.iteration import newton_iteration
from ngepc.results.result import Result
from ngepc.studies.examples import timed
from ngepc.studies.solid_problems import ELASTIC, metal
from ngepc.studies.work import OverMeshes, first_of

POISSON = 0.4999
MEAN = ", mean volume"
KINDS = ("P1", "P2", f"P2{MEAN}", "Q1", f"Q1{MEAN}", "Q2", f"Q2{MEAN}")
"""Triangles and quadrilaterals of order 1 and 2, and with tr eps averaged over each element."""


def cantilever(mesh: Callable[..., Mesh], n: int, order: int) -> Problem:
    """10 x 1 cells of 1/n, nearly incompressible, held at the left, sheared at the right."""
    body = mesh(nx=5 * n, ny=n, mapping=lambda s, t: (10 * s, t - 0.5))
    shear = {"right": (0, 1.5 * (1 - 4 * y * y))}
    return Problem(body, metal(1e3, POISSON, ELASTIC), "left", shear, order=order)


def punch(mesh: Callable[..., Mesh], n: int, order: int) -> Problem:
    """Half of a smooth punch of width 1, 0.06 down into a block 4 deep, hardly any hardening."""
    body = mesh(nx=n, ny=n, mapping=lambda s, t: (4 * s, 4 * t - 4))
    clay = metal(
        1e3, 0.3, math.sqrt(3), kinematic=1.5e-3 * lame_parameters(1e3, 0.3)[1]
    )
    walls = {"left|right": (0, None)}
    gap = IfPos(x - 0.5 - 1e-6, 10.0, -0.06)
    return Problem(
        body, clay, "bottom", prescribed=walls, contact="top", gap=gap, order=order
    )


def cook(mesh: Callable[..., Mesh], n: int, order: int) -> Problem:
    """Cook's membrane with E = 1, nearly incompressible, sheared by 1/16 at the right."""
    body = mesh(nx=n, ny=n, mapping=lambda s, t: (48 * s, 44 * s + t * (44 - 28 * s)))
    return Problem(
        body, metal(1.0, POISSON, ELASTIC), "left", {"right": (0, 1 / 16)}, order=order
    )


def deflection(result: Result) -> float:
    """Deflection of the cantilever's tip over that of beam theory (plane strain)."""
    young = 1000.0 / (1 - POISSON**2)
    nu = POISSON / (1 - POISSON)
    beam = ((4 + 5 * nu) * 10 / 4 + 2 * 10**3) / (6 * young / 12)
    return float(result.displacement(result.problem.mesh(10 - 1e-9, 0.0))[1]) / beam


def pressure(result: Result) -> float:
    """The mean pressure over that of Prandtl, (2 + pi) k with k = 1."""
    return result.contact_force / 0.5 / (2 + math.pi)


def tip(result: Result) -> float:
    """The vertical displacement of the upper right corner of Cook's membrane (length)."""
    return float(result.displacement(result.problem.mesh(48 - 1e-9, 60 - 1e-6))[1])


TESTS = {
    "cantilever, tip over beam theory": (cantilever, deflection, (2, 4, 8, 16)),
    "punch, pressure over (2 + pi) k": (punch, pressure, (8, 16, 32, 64)),
    "Cook's membrane, tip": (cook, tip, (4, 8, 16, 32)),
}
"""(Name, title of the number) -> problem, function of the number, cells along a side."""


def solve_with(problem: Problem, mean_volume: bool) -> ExactResult:
    """The default method at points whose volume strain may be averaged over each element."""
    parts = problem.mesh, problem.kinematics, problem.order
    discrete = DiscreteProblem(problem, Points(*parts, mean_volume=mean_volume))
    factors = Factors(discrete, "sparsecholesky")
    return newton_iteration(
        starting_state(discrete, None), factors, ExactResult, 1e-10, 300
    )


class Locking(OverMeshes):
    """All kinds of elements on ``levels`` meshes, 1 to 4, of each problem."""

    name = "locking"
    title = "Volume locking"
    columns = "problem, what is shown = {problem} | cells = {cells}"
    across = ("{elements}", "{value:.3f}{ending}")
    note = (
        "Triangles (P) and quadrilaterals (Q) of order 1 and 2, plane strain; mean volume averages "
        "tr eps over each element (for order 2 that is one number too few). Cantilever 10 x 1 and "
        "Cook's membrane: elastic, Poisson's ratio 0.4999; cells over the height, along a side. "
        "Punch: half of a smooth one of width 1 in a block 4 x 4, Poisson's ratio 0.3, h / mu = "
        "1e-3; the limit without hardening is 1."
    )

    def cells(self) -> list[dict]:
        """All kinds of elements on all meshes of all problems."""
        meshes = [
            (test, n)
            for test, (*_, f) in TESTS.items()
            for n in first_of(f, self.levels)
        ]
        return [
            {"problem": t, "elements": kind, "cells": n}
            for t, n in meshes
            for kind in KINDS
        ]

    def solve(self, problem: str, elements: str, cells: int) -> dict:
        """One problem on one mesh."""
        build, number, _ = TESTS[problem]
        mesh = partial(MakeStructured2DMesh, quads=elements.startswith("Q"))
        body = build(mesh, cells, int(elements[1]))
        result, found = timed(solve_with, body, elements.endswith(MEAN))
        return {"nodes": body.mesh.nv, **found, "value": number(result)}
