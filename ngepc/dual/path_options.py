"""Parameters and inner stopping rule of Algorithm 7.2."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Annotated

from ngepc.checks.arguments import require_number
from ngepc.checks.declared import Check, Count, Declared, Fraction, Positive
from ngepc.checks.kinds import require_instance
from ngepc.dual.blocks import CONTACT, PLASTIC
from ngepc.dual.functional import ResidualNorms
from ngepc.dual.newton import NewtonOptions
from ngepc.dual.stopping import ResidualBelow


@dataclass(frozen=True, kw_only=True)
class PathOptions(Declared):
    """How Algorithm 7.2 is run; the defaults are those of Table 3.

    Parameters
    ----------
    gamma_start, growth
        gamma_0 > 0 and theta > 1: gamma_k = gamma_0 theta^k.
    inner_tolerance
        tau_in > 0: problem k is solved until ||Psi_z|| < c max(h_c, tau_in / sqrt(gamma_k)) and
        ||Psi_q|| < c max(h, tau_in / sqrt(gamma_k)), after one Newton step at least.
    inner_scale
        c > 0.  With c = 1 as printed the start v = 0 of Example (b) passes; 0.1 is the plastic
        residual there (docs/reading.md).
    outer_tolerance
        tau_out > 0: the path ends when V_gamma changes by less than the fraction tau_out h.
    gamma_end
        Follow the path up to this gamma instead, whatever V_gamma does.
    residual_tolerance, reduction
        The safeguard of section 7: a path that ends with ||Psi_gamma|| above the tolerance goes
        on with tau_out times ``reduction`` in (0, 1).  From there on the inner tolerances are
        at most this one; alone they stay above c h, however far the path is followed.  None for
        no such check.
    max_outer_iterations
        Most values of gamma.
    newton
        Limits, quadrature, line search and direct solver of Algorithm 7.1.  Its tolerance is the
        residual that counts as zero: it ends a problem without a step.

    Raises
    ------
    TypeError, ValueError
        If an option is out of its range.
    """

    gamma_start: Positive = 10.0
    growth: Annotated[float, Check(require_number, least=1, strict=True)] = 7.0
    inner_tolerance: Positive = 10.0
    inner_scale: Positive = 0.1
    outer_tolerance: Positive = 0.7
    gamma_end: Positive | None = None
    residual_tolerance: Positive | None = None
    reduction: Fraction = 0.5
    max_outer_iterations: Count = 30
    newton: NewtonOptions = field(default_factory=partial(NewtonOptions, max_iterations=1000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gamma_end is not None:
            require_number("gamma_end", self.gamma_end, self.gamma_start)
            if self.residual_tolerance is not None:
                raise ValueError("gamma_end and residual_tolerance: give one of them, not both")
        require_instance("newton", self.newton, NewtonOptions, "NewtonOptions(...)")

    def gamma(self, k: int) -> float:
        """gamma_k; the last one is ``gamma_end`` where that is given."""
        gamma = self.gamma_start * self.growth**k
        return gamma if self.gamma_end is None else min(gamma, self.gamma_end)


@dataclass(frozen=True)
class InnerRule(ResidualBelow):
    """Step (iv)(a) of Algorithm 7.2: bounds for ||Psi_z|| and ||Psi_q||, at least one step.

    A start with a residual norm below ``tolerance`` needs no step.
    """

    contact: float
    plastic: float

    def met(self, norms: ResidualNorms, steps: int) -> bool:
        """Whether both residuals are below their bounds."""
        if steps == 0:
            return super().met(norms, steps)
        return norms.get(CONTACT, 0.0) < self.contact and norms[PLASTIC] < self.plastic

    def __str__(self) -> str:
        return f"the tolerances {self.contact:.3g} (contact) and {self.plastic:.3g} (plastic)"
