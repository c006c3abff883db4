"""The shifts mu^ and nu^ of section 4 as multipliers: a first-order augmented Lagrangian method.

If mu^ and nu^ are the multipliers |mu| and |nu| of a solution of the constrained dual problem,
M^1 and M^2 have their minimum at that solution for *every* gamma.  The update

    mu^ <- [mu^ + gamma z]^+,      nu^ <- [nu^ + gamma (|q| - beta)]^+

by the multipliers of the last regularised solution makes that so in the limit: z <= 0 and
|q| <= beta hold with a moderate gamma.  The Tichonov term stays, with its 1/gamma.

For contact the error falls by a constant factor per update.  For plasticity the first update gains
most: q is affine on an element, so that |q| <= beta binds at vertices and the multiplier of the
discrete problem gathers there.
"""

from __future__ import annotations

from dataclasses import replace

from ngsolve import CoefficientFunction, IfPos, Norm

from ngepc.checks.arguments import require_integer
from ngepc.checks.kinds import require_instance
from ngepc.dual.newton import NewtonOptions, semismooth_newton
from ngepc.dual.regularisation import Coupled
from ngepc.dual.result import DualResult
from ngepc.model.problem import Problem, as_scalar
from ngepc.results.outcome import Status


def positive_part(f: CoefficientFunction) -> CoefficientFunction:
    """[f]^+."""
    return IfPos(f, f, 0.0)


def updated_shifts(result: DualResult) -> Coupled:
    """The regularisation of ``result`` with its multipliers mu and |nu| as the next shifts."""
    w, old = result.functional.weights, result.regularisation
    excess = Norm(result.plastic_dual) - as_scalar(w.yield_bound)
    nu = positive_part(as_scalar(w.plastic_shift) + w.plastic * excess)
    if not result.problem.contact_names:
        return replace(old, plastic_shift=nu)
    mu = positive_part(as_scalar(w.contact_shift) + w.contact * result.normal_stress)
    return replace(old, contact_shift=mu, plastic_shift=nu)


def augmented_lagrangian(
    problem: Problem,
    regularisation: Coupled,
    updates: int = 5,
    options: NewtonOptions | None = None,
) -> list[DualResult]:
    """Solve, update the shifts, solve again from there.

    Parameters
    ----------
    problem
        The data.
    regularisation
        gamma and the first shifts, usually none.
    updates
        Number of updates, >= 0.
    options
        As for ``semismooth_newton``.

    Returns
    -------
    list of DualResult
        One for each choice of the shifts; it ends early with the first that did not converge.

    Raises
    ------
    TypeError, ValueError
        If an argument is not legal.
    """
    require_instance("regularisation", regularisation, Coupled, "Coupled(gamma, ...)")
    require_integer("updates", updates, 0)
    results = [semismooth_newton(problem, options=options, regularisation=regularisation)]
    for _ in range(int(updates)):
        last = results[-1]
        if last.status is not Status.CONVERGED:
            break
        following = updated_shifts(last)
        results.append(semismooth_newton(problem, None, last, options, regularisation=following))
    return results
