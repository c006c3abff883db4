"""Several time steps in a row: the load path, what the body remembers, the file of a history."""

from ngepc.evolution.solver import cold_start as cold_start
from ngepc.evolution.solver import evolve as evolve
