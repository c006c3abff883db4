"""The data of a time step, checked when the problem is made; no spaces and no solvers."""
