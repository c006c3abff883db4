"""Options of Newton's method, for the exact method and for the paper's."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from ngepc.checks.arguments import require_integer, require_number
from ngepc.checks.declared import Check, Count, Declared
from ngepc.checks.sentences import in_words
from ngepc.linalg.direct import require_solver
from ngepc.linalg.linesearch import Armijo, LineSearch


@dataclass(frozen=True, kw_only=True)
class NewtonOptions(Declared):
    """Options of Newton's method; those marked (D_gamma) are for regularised problems alone.

    Parameters
    ----------
    tolerance
        Bound for the relative forces out of balance; (D_gamma): for ||Psi_gamma||_{H*} in the
        regularisation's reference units, 1e-10 in the paper.
    max_iterations
        Largest number of Newton steps.
    quadrature_points
        (D_gamma) Points for nonsmooth terms on each element that a kink crosses; 400 in the paper.
    linesearch
        (D_gamma) ``Armijo()``, or None for full steps.
    inverse
        None chooses the fastest: factors for plane and small bodies, else multigrid, and the result
        says which (``linear_solver``).  Or NGSolve's name of a direct solver that does LDL^T, or,
        without gamma, ``PETSc()`` or ``PyAMG()`` for large bodies, ``SymbolicForms()`` for tangents
        by NGSolve's form.

    Raises
    ------
    TypeError, ValueError
        If an option is out of its range.
    """

    tolerance: Annotated[float, Check(require_number, least=1e-16)] = 1e-10
    max_iterations: Count = 300
    quadrature_points: Annotated[int, Check(require_integer, least=1, most=900)] = 400
    linesearch: LineSearch | None = field(default_factory=Armijo)
    inverse: Annotated[str | object | None, Check(require_solver)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.linesearch is not None and not hasattr(self.linesearch, "search"):
            raise TypeError(
                f"linesearch={in_words(self.linesearch)}: Armijo(...) or None is needed"
            )

    @property
    def direct_solver(self) -> str | object:
        """The linear solver of regularised problems: factors, by default NGSolve's own."""
        return "sparsecholesky" if self.inverse is None else self.inverse
