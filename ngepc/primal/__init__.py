"""The independent witness: Newton's method for the reduced primal energy."""

from ngepc.primal.solver import PrimalOptions as PrimalOptions
from ngepc.primal.solver import primal_newton as primal_newton
