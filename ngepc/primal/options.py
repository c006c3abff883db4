"""How far the primal solver iterates."""

from dataclasses import dataclass

from ngepc.checks.arguments import require_integer, require_number


@dataclass(frozen=True, kw_only=True)
class PrimalOptions:
    """How far ``primal_newton`` iterates.

    Parameters
    ----------
    tolerance
        Bound for ``residual_norm``: the Euclidean norm of the nodal forces out of balance and of
        what contact leaves, relative to the larger of the norms of the applied and of the internal
        nodal forces, or to the smaller of beta/h and 4e-6 |K| |u|, where strains cancel in a body
        without forces; within [1e-13, 1).
    max_iterations
        Newton steps before the run gives up, >= 1.

    Raises
    ------
    TypeError, ValueError
        For a value out of its range.
    """

    tolerance: float = 1e-10
    max_iterations: int = 100

    def __post_init__(self) -> None:
        require_integer("max_iterations", self.max_iterations, 1)
        if require_number("tolerance", self.tolerance, 1e-13) >= 1:
            raise ValueError(f"tolerance={self.tolerance!r}: a number < 1 is needed")
