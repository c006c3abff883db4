"""Processor time of whole solves by each linear solver, for the choice that ngepc makes by default.

    python -m pytest benchmarks/test_solvers.py -s

The sphere on structured meshes, tolerance 1e-10, cold start, one thread.  PETSc is measured where
it is installed.  "default" names the solver that is chosen; its time is in the columns before.
Nothing is asserted about times.
"""

import time
from dataclasses import replace
from importlib.util import find_spec

import pytest

from ngepc import Coulomb, NewtonOptions, PETSc, PyAMG, semismooth_newton
from ngepc.geometries import block
from ngepc.studies.large import pressed

DIRECT = "sparsecholesky"
LARGEST = 15_000
"""The most unknowns for which the direct solver is measured."""

FRICTION = {"": None, "Tresca": 5.0, "Coulomb(0.3)": Coulomb(0.3)}
CASES = [
    ("tetrahedra", 1, "", (10, 13, 16)),
    ("tetrahedra", 2, "", (5, 6, 8, 10)),
    ("hexahedra", 1, "", (10, 13)),
    ("hexahedra", 2, "", (5, 6, 8)),
    ("tetrahedra", 1, "Tresca", (7, 10)),
    ("tetrahedra", 1, "Coulomb(0.3)", (10, 13)),
    ("tetrahedra", 2, "Coulomb(0.3)", (7,)),
]


def solvers(unknowns):
    """The solvers to compare, by name."""
    found = {"PyAMG": PyAMG()}
    if unknowns < LARGEST:
        found["factors"] = DIRECT
    if find_spec("petsc4py"):
        found["PETSc"] = PETSc()
    return found


def problem_of(shape, order, friction, n):
    """The sphere on n x n x n cells."""
    mesh = block.structured_mesh(n, n, n, simplices=shape == "tetrahedra")
    return replace(pressed(mesh, 100.0, order), friction=FRICTION[friction])


@pytest.mark.parametrize(("shape", "order", "friction", "widths"), CASES)
def test_solvers(shape, order, friction, widths, capsys):
    for n in widths:
        problem = problem_of(shape, order, friction, n)
        unknowns = 3 * (order * n + 1) ** 3
        times = []
        for name, inverse in solvers(unknowns).items():
            start = time.process_time()
            result = semismooth_newton(
                problem, options=NewtonOptions(inverse=inverse, tolerance=1e-10)
            )
            spent = time.process_time() - start
            assert result.status.is_success
            times.append(f"{name} {spent:.2f} s")
        chosen = semismooth_newton(problem).linear_solver
        with capsys.disabled():
            line = f"{shape}, order {order}, {friction or 'no friction'}, {unknowns} unknowns"
            print(f"\n{line}: {', '.join(times)}; default {chosen}")
