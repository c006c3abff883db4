"""When the loop of Algorithm 7.1 has done enough, and whether an iterate that seems so is.

The residual of the iteration is updated with each step, by factors of the condensed (7.1) whose
errors it cannot see.  Here y is solved for again and corrected with D itself, and what rounding
leaves in that is estimated.  CONVERGED is said only where the residual *and* its rounding together
meet the rule: any other way of computing it in the same precision then finds the same.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from ngepc.dual.functional import DualFunctional, ResidualNorms
from ngepc.dual.iterates import Iterate
from ngepc.dual.system import NewtonSystem
from ngepc.results.outcome import IterationRecord, Status

CORRECTIONS = 3
"""Most steps with the last factors."""


class StoppingRule(Protocol):
    """When the loop of Algorithm 7.1 has done enough; its text is shown when it has not."""

    def met(self, record: IterationRecord) -> bool:
        """Whether the iterate with this record will do."""
        ...

    def __str__(self) -> str:
        """The rule as a text with its bounds."""
        ...


@dataclass(frozen=True)
class ResidualBelow:
    """||Psi_gamma||_{H*} < tolerance, the rule of Algorithm 7.1."""

    tolerance: float

    def met(self, record: IterationRecord) -> bool:
        """Whether the residual norm is below the tolerance."""
        return record.residual_norm < self.tolerance

    def __str__(self) -> str:
        """The tolerance."""
        return f"the tolerance {self.tolerance:.3g}"


@dataclass(frozen=True)
class End:
    """Why a run ends.

    Parameters
    ----------
    status
        The name of the reason.
    cause
        A sentence about what went wrong, where there is one.
    """

    status: Status
    cause: str = ""


def final_check(
    functional: DualFunctional, system: NewtonSystem, here: Iterate, rule: StoppingRule
) -> tuple[Iterate, End | None]:
    """Judge an iterate whose updated residual meets the rule: y and residual afresh, corrected.

    Parameters
    ----------
    functional
        J*_gamma.
    system
        The Newton system with the factors of the last step.
    here
        The iterate.
    rule
        The stopping rule.

    Returns
    -------
    tuple
        The iterate to go on from or to return; CONVERGED, STAGNATED, or None if further Newton
        steps may help.
    """
    here.refresh(functional)
    rounding, record = functional.rounding(here.y), here.record(functional)
    for _ in range(CORRECTIONS):
        if rule.met(with_residual(record, rounding, record)) or here.step is None:
            break
        following = corrected(functional, system, here)
        better = following.record(functional)
        if not better.residual_norm <= record.residual_norm / 2:
            break
        here, record = following, better
    if rule.met(with_residual(record, rounding, record)):
        return here, End(Status.CONVERGED)
    if rule.met(with_residual(record, rounding)):
        return here, None
    reach = (record.residual_norm + rounding.total) / functional.residual_unit
    return here, End(Status.STAGNATED, out_of_reach(rounding, rule, reach))


def with_residual(
    record: IterationRecord, norms: ResidualNorms, more: IterationRecord | None = None
) -> IterationRecord:
    """The record with these residual norms, added to those of ``more``."""
    fields = {f"{name}_residual_norm": norm for name, norm in norms.by_part.items()}
    fields["residual_norm"] = norms.total
    if more is not None:
        fields = {name: value + getattr(more, name) for name, value in fields.items()}
    return replace(record, **fields)


def corrected(functional: DualFunctional, system: NewtonSystem, here: Iterate) -> Iterate:
    """One more step with the factors of the last one: near a solution the active sets stay."""
    _, dv = system.solve((-here.residual).Evaluate())
    v = dv.CreateVector()
    v.data = here.v + dv
    following = Iterate.at(functional, v)
    following.number, following.step = here.number, here.step
    return following


def out_of_reach(rounding: ResidualNorms, rule: StoppingRule, reach: float) -> str:
    """The sentences for a rule that rounding does not let any iterate meet.

    ``reach`` is the residual with its rounding in the units of ``NewtonOptions.tolerance``.
    """
    return (
        f"Rounding alone leaves about {rounding.total:.2g} of the residual, in whatever way it is "
        "computed: the hardening is small beside the elastic moduli, or the loads are large, for "
        f"{rule}. A tolerance above {1.1 * reach:.2g} is within reach."
    )
