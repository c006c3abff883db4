"""How far V is from its limit for large gamma, by the factors of the last Newton step.

With tau = 1/gamma_T the minimal value V(tau) of J*_gamma is concave and

    V' = b(v, v) / 2,    V'' = -<B v, H^(-1) B v>,

H the Newton matrix reduced to v: one back-substitution, the chord step towards tau = 0.  If
V - V_0 falls like tau^s, then tau V' = s (V - V_0) and s = 1 + tau V'' / V'.
"""

from __future__ import annotations

import math

from ngsolve import InnerProduct

from ngepc.dual.functional import FactorisationError, NewtonSystem
from ngepc.dual.iterates import Iterate
from ngepc.dual.result import DualResult
from ngepc.krylov.iterative import KrylovError
from ngepc.results.outcome import Status

LEAST_POWER = 0.1
"""Lower bound of s: there V hardly follows gamma, and the estimate is only a large number."""


def regularisation_part(result: DualResult, system: NewtonSystem) -> tuple[float, float]:
    """Estimates of V - V_0 and of its power s in 1/gamma_T, for a balanced result.

    Parameters
    ----------
    result
        A result with ``Balanced``, whose only error from gamma is that of the Tichonov term.
    system
        Newton system with the factors that ``result`` was found with; it is factorised at
        ``result.v`` where it has none.

    Returns
    -------
    tuple of float
        V - V_0 (force times length), infinite for a result that has not converged, and s, cut
        off to [LEAST_POWER, 1].
    """
    if result.status is not Status.CONVERGED:
        return math.inf, LEAST_POWER
    functional, here = result.functional, Iterate.at(result.functional, result.v)
    term = functional.tichonov_gradient(result.v)
    size = InnerProduct(term, result.v) / 2
    if size <= 0:
        return 0.0, 1.0
    try:
        if not system.has_factors:
            system.factorise(result.v)
        _, dv = system.direction(result.v, (here.residual - term).Evaluate())
        power = 1 - InnerProduct(term, dv) / size
    except (FactorisationError, KrylovError):
        power = math.nan
    power = min(1.0, power) if power > LEAST_POWER else LEAST_POWER
    return size / power, power
