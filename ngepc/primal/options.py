"""How far and how carefully the primal solver iterates."""

from dataclasses import dataclass

from ngepc.checks.arguments import require_integer, require_number


@dataclass(frozen=True, kw_only=True)
class PrimalOptions:
    """How far and how carefully ``primal_newton`` iterates.

    Parameters
    ----------
    tolerance
        Bound for ``residual_norm``: the Euclidean norm of the nodal forces out of balance,
        contact forces >= 0 at touching nodes included, relative to the larger of the norms of
        the applied and of the internal nodal forces, or to the smaller of beta/h and
        4e-6 |C| |u|/h, where strains cancel in a body without forces; within [1e-13, 1).
    max_iterations
        Newton steps before the run gives up, >= 1.
    decrease
        Armijo's constant: energies must fall by this part of the slope, within (0, 1/2).
    curvature
        The line search ends where |phi'(t)| <= curvature |phi'(0)|, within (0, 1).
    max_evaluations
        Trial points of one line search, >= 1.

    Raises
    ------
    TypeError, ValueError
        For a value out of its range.
    """

    tolerance: float = 1e-10
    max_iterations: int = 100
    decrease: float = 1e-4
    curvature: float = 0.2
    max_evaluations: int = 40

    def __post_init__(self) -> None:
        require_number("tolerance", self.tolerance, 1e-13)
        require_integer("max_iterations", self.max_iterations, 1)
        require_integer("max_evaluations", self.max_evaluations, 1)
        for name, most in {"tolerance": 1.0, "decrease": 0.5, "curvature": 1.0}.items():
            value = require_number(name, getattr(self, name), 0, strict=True)
            if value >= most:
                raise ValueError(f"{name}={value!r}: a number < {most:g} is needed")
