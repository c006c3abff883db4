"""Contact in a Newton step: the forces that meet its conditions, and the work along the step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.discretisation.conditions import ContactConditions
from ngepc.linalg.secants import Compliance, solve_by_secants

ROUNDING = 3e-14
"""Gaps of closed rows below this part of the displacements are zero."""

EXAMINED, FEW = 600, 60
"""Most forces of rows among which other equilibria are looked for: a solve with factors for each,
or one by iterations."""

SPRINGS = 1e4
"""Springs of rows beside their stiffness, which turn a compliance round (Woodbury's formula)."""

PROBES, DOUBT, EXHAUSTED = 40, 1e-6, 1e-8
"""Lanczos steps at most, the chance that they miss a second solution, and what counts as zero."""

Solve = Callable[[np.ndarray], np.ndarray]

BESIDE = 1e-3
"""Where the slope of friction is taken beside a kink, as a part of the step length."""


def with_contact(
    conditions: ContactConditions,
    solve: Callable[[np.ndarray], np.ndarray],
    u: np.ndarray,
    forces: np.ndarray,
    change: np.ndarray,
    compliance: Compliance,
    row_stiffness: np.ndarray,
    slack: float = 0.0,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Newton's step and the forces at its end, where they meet the conditions; None if none do.

    It starts from ``u`` with ``forces`` of the rows; ``change`` is the step that leaves these as
    they are.  ``solve`` maps nodal forces (nodes, N) to displacements by the tangent, ``slack`` is
    what the gaps may miss (length), at least their rounding.
    """

    def product(more: np.ndarray) -> np.ndarray:
        """What the rows move by more forces, which change the step."""
        nonlocal change
        answer = solve(conditions.forces(more))
        change = change - answer
        return conditions.displacement(answer)

    gaps = conditions.gaps(u) - conditions.displacement(change)
    sizes = np.abs(u + change).max(initial=0.0), -conditions.normal(gaps).min(initial=0.0)
    slack = max(slack, ROUNDING * float(max(sizes)))
    found = solve_by_secants(conditions.friction, product, compliance, gaps, forces, slack)
    if found is None:
        return None
    # what the springs of rollers carry is rounding that belongs to these
    return change, found + conditions.springs(row_stiffness) * conditions.displacement(change)


def rival(
    conditions: ContactConditions,
    solve: Callable[[np.ndarray], np.ndarray],
    gaps: np.ndarray,
    forces: np.ndarray,
    row_stiffness: np.ndarray,
    most: int,
    stiffened: Callable[[np.ndarray], Solve] | None = None,
) -> tuple[bool, str]:
    """Whether Coulomb's law has other forces at a solution than these, and a sentence about it.

    With ``stiffened``, springs of the rows -> the solver with them, uniqueness is tested first
    (``is_unique``), with the compliance S + 1/springs.  Where it is not proved all rows that press
    and those closest to it are examined, ``most`` forces at most, each with one solve; other
    parameters as for ``with_contact``, ``gaps`` those of the solution.
    """
    cone, processes = conditions.friction, conditions.processes
    if not processes.any(np.isinf(cone.cap) & (cone.coefficient > 0)):
        return False, ""
    if stiffened is not None and _is_unique(
        conditions, solve, gaps, forces, SPRINGS * row_stiffness, stiffened
    ):
        return False, ""
    n = conditions.normal(forces)
    pressing = n - conditions.normal(row_stiffness * gaps)
    order = np.argsort(np.where(cone.tied, -np.inf, -pressing), kind="stable")
    rows, left = np.split(order, [most // (cone.d + 1)])
    if processes.size > 1 or (n[left] > 0).any() or cone.tied[left].any():
        count = conditions.sum_of(np.ones(len(n), dtype=int))
        why = f"Friction on {count} rows: whether there are other equilibria was not examined."
        return False, why
    chosen = cone.numbers(rows)
    unit = (np.arange(len(forces)) == chosen[:, None]).astype(float)
    S = np.array([conditions.displacement(solve(conditions.forces(e)))[chosen] for e in unit])
    other = cone.of(rows).rival(S, gaps[chosen], forces[chosen])
    if other is None:
        return False, ""
    if not np.isfinite(other).all():
        return True, "The Jacobian has a negative determinant, so that there are at least two more."
    found = other[: len(rows)][~cone.tied[rows]].sum()
    ours = n[~cone.tied].sum()
    return True, f"One of them has the contact force {found:.6g} instead of {ours:.6g}."


def _is_unique(
    conditions: ContactConditions,
    solve: Solve,
    gaps: np.ndarray,
    forces: np.ndarray,
    springs: np.ndarray,
    stiffened: Callable[[np.ndarray], Solve],
) -> bool:
    """Whether ``is_unique`` holds at a solution."""
    held = stiffened(springs)

    def compliance(d: np.ndarray) -> np.ndarray:
        """S d, with springs that make it positive definite."""
        return conditions.displacement(solve(conditions.forces(d))) + d / springs

    def stiffness(g: np.ndarray) -> np.ndarray:
        """Its inverse, by the tangent with springs on the rows (Woodbury)."""
        d = springs * g
        return d - springs * conditions.displacement(held(conditions.forces(d)))

    rounding = ROUNDING * np.abs(gaps).max(initial=0.0)
    follows = conditions.friction.follows(forces, gaps, rounding)
    return is_unique(follows, compliance, stiffness)


def is_unique(follows: np.ndarray, compliance: Solve, stiffness: Solve) -> bool:
    """Whether no change d of the forces has d.E'Sd >= d.Sd, with E'g = (mu e.g_t, 0).

    Two solutions differ by a d with d.Sd <= d.E'Sd, e at one of them: their normal parts have
    d_n.(Sd)_n <= 0, and friction as ``FrictionCone.follows`` says (Renard, SIAM J. Math. Anal. 38,
    2006, for the continuous problem).  The largest quotient is that of Lanczos' method in the
    product S, from a random start, with as many steps as leave a chance of ``DOUBT`` that it is 1
    or more (Kuczynski and Wozniakowski, SIAM J. Matrix Anal. Appl. 13, 1992, for a direction of
    uniform probability).  ``follows`` is mu e (m, d), ``compliance`` and ``stiffness`` are d -> S d
    and its inverse, both for (n, t).
    """

    def pulled(g: np.ndarray) -> np.ndarray:
        """E'g."""
        along = (follows * g[m:].reshape(follows.shape)).sum(axis=1)
        return np.concatenate([along, np.zeros(follows.size)])

    def pushed(d: np.ndarray) -> np.ndarray:
        """E d."""
        return np.concatenate([np.zeros(m), (follows * d[:m, None]).ravel()])

    m, known, T = len(follows), [], np.zeros((PROBES + 1, PROBES + 1))
    g = np.random.default_rng(0).standard_normal(m + follows.size)
    d = stiffness(g)
    for k in range(PROBES):
        size = float(np.sqrt(max(d @ g, 0.0)))
        if k:
            values = np.linalg.eigvalsh(T[:k, :k])
            spread = (1 - values[-1]) / (1 - values[0])
            if not (spread > 0 and np.isfinite(size)):
                return False
            chance = 1.648 * np.sqrt(len(g)) * np.exp(-(2 * k - 1) * np.sqrt(spread))
            if chance <= DOUBT or size <= EXHAUSTED:
                return True
            T[k, k - 1] = T[k - 1, k] = size
        v, Sv = d / size, g / size
        known.append((v, Sv))
        back, slanted = pulled(Sv), pushed(v)
        d, g = (slanted + stiffness(back)) / 2, (compliance(slanted) + back) / 2
        T[k, k] = d @ Sv
        for v, Sv in known * 2:
            share = d @ Sv
            d, g = d - share * v, g - share * Sv
    return False


class ContactWork:
    """What contact adds to the slope of the energy along a step.

    Normal forces of rows that stay closed and tangential ones of rows that stick do no work; rows
    that slip dissipate their bound, taken at the end of the step, times the way.

    The step goes from u with ``forces`` by ``change`` to where they are ``following``; gaps, slips
    below ``touching`` are rounding.  ``held`` are nodal forces of the rows that do no work.
    """

    def __init__(
        self,
        conditions: ContactConditions,
        u: np.ndarray,
        forces: np.ndarray,
        change: np.ndarray,
        following: np.ndarray,
        touching: float,
    ) -> None:
        gaps, self._sum = conditions.gaps(u), conditions.sum_of
        self._slip = -conditions.tangential(gaps)
        way = conditions.tangential(conditions.displacement(change))
        ends = np.linalg.norm(np.stack([self._slip, self._slip + way]), axis=2)
        moves = ends.max(axis=0) > touching
        self._way, self._bound = np.where(moves[:, None], way, 0.0), conditions.bound(following)
        touches = conditions.normal(gaps) <= touching
        self.held = conditions.forces(conditions.held(forces, following, touches, ~moves))

    def slope(self, t: float) -> float:
        """d/dt of the sum of bound times |slip|, just before t (just after 0)."""
        slip = self._slip + max(t * (1 - BESIDE), BESIDE) * self._way
        along, size = np.einsum("ij,ij->i", slip, self._way), np.linalg.norm(slip, axis=1)
        return float(self._sum(self._bound * along / np.where(size > 0, size, 1.0)))
