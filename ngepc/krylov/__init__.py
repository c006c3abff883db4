"""Krylov solvers for (7.1) on large bodies: MINRES with a multigrid cycle for each block.

``solver`` is the object that a user passes in, ``system`` the Newton system, ``contact`` the one
with z <= 0; ``hierarchy`` and ``multigrid`` make the cycles, ``tangent`` the elasticity they are
made of.
"""
