"""The lambda of the narrowest interval of a goal, with the adjoint that is made for it.

The width of an interval is about A/lambda + lambda B, with the errors A of the adjoint and B of the
energy, see ``goal_bound``; but the adjoint depends on lambda, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ngepc.bounds.outcome import ErrorBound
from ngepc.goals.adjoint import Adjoint, AdjointProblem, Start
from ngepc.goals.integrand import BoundPart, Integrand
from ngepc.goals.sub_elements import SubElements

STEP = 1.3
"""Factor between the lambdas that are tried for one adjoint."""
TRIES = 20
BELOW = 0.75
ABOVE = 1.3
"""An adjoint is kept if the best lambda over its own one is expected to be between these."""
SLIDING = (0.25, 0.5, 0.75, 0.95)
"""With friction lambdas are tried for which so many nodes have |z_t| <= lambda |s_h|."""
REBUILDS = 2
LARGEST = 1e12
"""The largest lambda over the first one that is tried where a condition is violated."""
UNBOUNDED = 12
"""How often lambda is doubled where the supremum is infinite, as without hardening."""
UNMOVED = 1e-12
"""Lambda of a goal that no load of the problem moves, times displacements over the adjoint's."""
LEAST = 1e-13
"""The least error bound that lambda is chosen for, relative to the strain energy."""
FIRST = 1.1
"""The first lambda over (E_z/E)^(1/2) (E/B)^(1/3), with the energies of adjoint and result.

The third power of the best one is 2 A lambda/B, see ``LambdaSearch.best``, and A lambda mostly is
about E_z (E_z/E)^(1/2).
"""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An adjoint, the best lambda for it, and an estimate of the width of the interval."""

    adjoint: Adjoint
    integrand: Integrand | SubElements
    factor: float
    width: float

    @cached_property
    def suprema(self) -> tuple[np.ndarray, np.ndarray]:
        """Integrals over the cells from above, for both signs."""
        return self.integrand.bounds(self.factor)

    def finite(self) -> Candidate:
        """The candidate with a larger lambda where the suprema are infinite.

        Without hardening they are finite where lambda times what the stress of the bound lacks to
        the yield bound exceeds the stress of the adjoint.
        """
        found = self
        for _ in range(UNBOUNDED):
            if all(np.isfinite(side).all() for side in found.suprema):
                return found
            found = replace(found, factor=2 * found.factor)
        return found


def size_of_energy(bound: ErrorBound) -> float:
    """An energy to compare others with; zero if the solution is known to be free of strain."""
    return bound.strain_energy or bound.total


class LambdaSearch:
    """The search for the best lambda of a goal, for a state with its error bound."""

    def __init__(
        self, bound: ErrorBound, adjoints: AdjointProblem, of_bound: BoundPart
    ) -> None:
        self.bound = bound
        self._adjoints = adjoints
        self._of_bound = of_bound

    def _first(self, start: Start) -> float:
        """The first lambda for a goal; what suffices if its adjoint does not move."""
        energy = size_of_energy(self.bound)
        first = FIRST * math.sqrt(self._adjoints.energy(start) / energy)
        first *= (energy / max(self.bound.total, 1e-12 * energy)) ** (1 / 3)
        if first > 0:
            return first
        wanted = np.abs(start.goal.factor).max(initial=0.0)
        largest = np.abs(self.bound.state.u).max()
        if wanted == 0:
            moved = np.abs(start.base.z + start.lift).max()
            quotient = moved / largest if moved and largest else 1.0
            return float(UNMOVED * quotient)
        enough = self._adjoints.enough(start.goal)
        if math.isfinite(enough):
            return enough
        return float(wanted / largest)

    def best(self, start: Start, near: float | None = None) -> Candidate:
        """The best lambda and its adjoint, from a lambda ``near`` the best, if one is known.

        Of one adjoint the error A does not depend on lambda, and the width is about A/lambda +
        lambda B.  The cuts at the edges of contact, which are made for a lambda, mostly rule A: it
        falls like 1/lambda.  So 2 A lambda/B is the third power of the best one.
        """
        factor = self._first(start) if near is None else near
        best = found = self.candidate(start, factor)
        error = max(self.bound.total, LEAST * self.bound.strain_energy)
        if not (found.adjoint.energy > 0 and error > 0):
            return self._climbed(start, best)
        wanted = math.sqrt(found.adjoint.energy / error)
        kept = wanted < found.factor or not self._adjoints.presses.any()
        if kept and self._adjoints.admits(start.goal, found.adjoint, wanted):
            width = found.integrand.estimate(wanted)
            # an exact adjoint asks for lambda = 0, where yielding strains are unlimited
            if width < found.width:
                found = replace(found, factor=wanted, width=width)
            return self._climbed(start, found)
        for _ in range(REBUILDS):
            made = found.factor
            wanted = (2 * found.adjoint.energy * made / error) ** (1 / 3)
            if BELOW <= wanted / made <= ABOVE:
                break
            found = self.candidate(start, wanted)
            if found.width < best.width:
                best = found
            if found.factor > ABOVE * wanted:
                break  # smaller ones cannot be kept
        return self._climbed(start, best)

    def _climbed(self, start: Start, found: Candidate) -> Candidate:
        """A candidate with the best lambda that its adjoint admits."""
        found = self._past_slips(found)
        factor = found.factor
        width = found.width
        for step in (STEP, 1 / STEP):
            for _ in range(TRIES):
                following = step * factor
                if not self._adjoints.admits(start.goal, found.adjoint, following):
                    break
                trial = found.integrand.estimate(following)
                if trial >= width:
                    break
                factor = following
                width = trial
            if factor != found.factor:
                break  # on the other side the width is larger
        return replace(found, factor=factor, width=width)

    def _past_slips(self, found: Candidate) -> Candidate:
        """The candidate with a larger lambda, if that is better with friction.

        Where lambda |s_h| exceeds |z_t|, friction adds no more than to the error bound.  So the
        width has several minima as a function of lambda.
        """
        bound_data = self._adjoints.bound_data
        contact = bound_data.contact
        if not bound_data.boundary.friction.any():
            return found
        state = self.bound.state
        slip = np.linalg.norm(contact.slip(state.u), axis=2)
        along = np.linalg.norm(contact.tangential(found.adjoint.z), axis=2)
        slides = slip > state.touching_distance
        if not slides.any():
            return found
        for factor in np.quantile(along[slides] / slip[slides], SLIDING).tolist():
            if factor > found.factor:
                width = found.integrand.estimate(factor)
                if width < found.width:
                    found = replace(found, factor=factor, width=width)
        return found

    def candidate(self, start: Start, factor: float) -> Candidate:
        """The adjoint that is made for a lambda, or for a larger one."""
        adjoint = self._adjoints.of(start, factor)
        largest = LARGEST * factor
        while not math.isfinite(adjoint.least):
            factor *= 8
            if factor > largest:
                raise RuntimeError(
                    f"goal={start.goal.name}: a support holds a vertex that touches the obstacle, "
                    "and how both share the force there has no bound, only their sum has, which "
                    "balances the loads; end the contact boundary or open the gap before the "
                    "support, or ask for 'work' or a displacement"
                )
            adjoint = self._adjoints.of(start, factor)
        integrand = self._of_bound.integrand(adjoint)
        return Candidate(adjoint, integrand, factor, integrand.estimate(factor))
