"""What is to be solved: body, material, kinematics, obstacles, loads and supports as a ``Problem``.

A problem is checked when it is made.  Nothing here knows a finite element space or a solver.
"""
