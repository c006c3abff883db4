"""The fastest linear solver for a body: factors where cuts are small, else multigrid."""

from __future__ import annotations

from ngepc.local import petsc, pyamg
from ngepc.local.cuts import unknowns_of_cube
from ngepc.local.iterative import Iterative
from ngepc.local.system import DiscreteProblem
from ngepc.model.elements import has_more_corners

DIRECT = "sparsecholesky"

MOST_BY_FACTORS = 3500
"""Free components of displacements of a cube up to which factors are faster, as measured by
``benchmarks/test_solvers.py``.  Other solids are compared with a cube whose cuts are as large."""

MOST_BY_FACTORS_LARGER = 4500
"""The same for elements of order 1 and for hexahedra and prisms, whose multigrid takes longer, and
with Coulomb's friction, whose search for other equilibria has many solves."""

MOST_BY_FACTORS_TRESCA = 1000
"""The same with Tresca's friction, under which the forces of all contact rows are unknowns."""


def fastest_solver(body: DiscreteProblem) -> str | Iterative:
    """The linear solver for ``NewtonOptions(inverse=None)``.

    Factors in the plane, where their cost grows little faster than the number of nodes, and for
    small, slender or thin bodies in space.  Others use multigrid, ``PyAMG()`` where pyamg is
    installed, else ``PETSc()``.  Only PETSc covers meshes that processes share.
    """
    problem = body.problem
    if problem.processes.size > 1:
        return petsc.PETSc()
    if problem.N == 2:
        return DIRECT
    if few_for_factors(body):
        return DIRECT
    if pyamg.pyamg is not None:
        return pyamg.PyAMG()
    return DIRECT if petsc.petsc is None else petsc.PETSc()


def few_for_factors(body: DiscreteProblem, times: float = 1.0) -> bool:
    """Whether a body, or else a cube with cuts as large, has at most this many ``times`` the most.

    The most free components for which factors are faster, ``most_by_factors``.
    """
    most = times * most_by_factors(body)
    return body.free.sum() <= most or unknowns_of_cube(body) <= most


def most_by_factors(body: DiscreteProblem) -> float:
    """Free components of displacements of a cube up to which multigrid takes longer than factors.

    Where the body is nearly incompressible multigrid needs more iterations.
    """
    problem = body.problem
    if body.contact.friction.given.any():
        return MOST_BY_FACTORS_TRESCA
    most = MOST_BY_FACTORS
    bricks = has_more_corners(problem.mesh)
    if problem.order == 1 or bricks or body.contact.friction.d:
        most = MOST_BY_FACTORS_LARGER
    stiffest = float((body.law.bulk / body.law.two_mu).max())
    return most * max(1.0, stiffest) ** (1 / 3)


def solver_name(inverse: object) -> str:
    """The name of a linear solver in results."""
    return inverse if isinstance(inverse, str) else type(inverse).__name__
