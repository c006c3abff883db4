"""Tangents by a symbolic form of NGSolve in place of the fast assembly: ``SymbolicForms()``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from ngepc.checks.declared import Check, Declared
from ngepc.discretisation.stiffness import Blocks, SymbolicBlocks
from ngepc.linalg.direct import require_solver
from ngepc.local.factors import Factors, Tangent
from ngepc.local.iterative import Iterative
from ngepc.local.system import DiscreteProblem


@dataclass(frozen=True, kw_only=True)
class SymbolicForms(Declared):
    """A linear solver whose tangents are assembled by a form of NGSolve, the same but slower.

    Parameters
    ----------
    inverse
        The solver, as in ``NewtonOptions``.

    Raises
    ------
    ValueError
        If there is no such solver.
    """

    inverse: Annotated[str | Iterative, Check(require_solver)] = "sparsecholesky"

    @property
    def forcing(self) -> float | None:
        """As for ``Iterative``."""
        return getattr(self.inverse, "forcing", None)

    def tangent(self, discrete: DiscreteProblem, blocks: Blocks) -> Tangent:
        """The tangent of a discrete problem."""
        if not isinstance(discrete, DiscreteProblem):
            raise ValueError(f"inverse={self!r}: primal_newton has symbolic forms of its own")
        blocks = SymbolicBlocks(discrete.points, discrete.free, discrete.added)
        if isinstance(self.inverse, str):
            return Factors(discrete, self.inverse, blocks)
        return self.inverse.tangent(discrete, blocks)
