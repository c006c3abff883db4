"""Contact in a Newton step: forces that satisfy the contact conditions, and their work."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ngepc.checks.sentences import counted
from ngepc.discretisation.body import Iterate
from ngepc.linalg.direct import FactorisationError
from ngepc.linalg.other_forces import STARTS, other_forces
from ngepc.linalg.secants import LEFT, Compliance, solve_by_secants

ROUNDING = 3e-14
"""Gaps of closed rows below this fraction of the displacements are zero."""

TURNING = 0.1
"""As ``LEFT`` where slip may turn, so that the conditions of a state are not quite linear."""

BESIDE = 1e-3  # distance from a kink at which the slope of friction is taken, as a part of the step

EXAMINED = 600
FEW = 60
"""Largest number of forces in a search for other equilibria, with factors and with iterations."""

SPRINGS = 1e4  # springs of rows over their stiffness, to invert a compliance (Woodbury)

PROBES = 40
DOUBT = 1e-6
EXHAUSTED = 1e-8
"""Most Lanczos steps, the probability that they miss a second solution, and the size of zero."""

FAR = 1e12
"""So many rigid motions of a step have no end."""

NOTHING = 1e-12
"""Smaller displacements, as a part of the largest displacement or slip, are rounding errors."""

Solve = Callable[[np.ndarray], np.ndarray]


UNSOLVABLE = {
    False: "the contact conditions of neighbouring nodes are dependent",
    True: "contact with friction was not solved: for a large coefficient there may be no solution "
    "or several; try a smaller load step",
}
"""Without and with friction: why there may be no forces that satisfy the conditions."""


SEARCHED = (
    f"Friction: a search from {STARTS} starts found no other equilibrium, which is no proof that "
    "there is none."
)
LINEARISED = (
    "Friction: no other contact state is an equilibrium of the body linearised at this solution, "
    "which is no proof for a body that yields."
)
"""Messages if uniqueness was neither proved nor disproved."""


def with_contact(
    here: Iterate, solve: Solve, compliance: Compliance
) -> tuple[np.ndarray, np.ndarray]:
    """Newton's step, and the forces of the rows that satisfy the contact conditions at its end.

    ``solve`` maps nodal forces to displacements, both (nodes, N).  FactorisationError if no forces
    are found.
    """
    conditions = here.body.contact
    change = solve(-here.free_residual)
    if conditions.absent:
        return change, here.contact

    answers = []

    def product(forces: np.ndarray) -> np.ndarray:
        """The displacement of the rows by forces; that of all nodes is kept."""
        answers.append(solve(conditions.forces(forces)))
        return conditions.displacement(answers[-1])

    gaps = here.gaps - conditions.displacement(change)
    sizes = (
        np.abs(here.u + change).max(initial=0.0),
        -conditions.normal(gaps).min(initial=0.0),
    )
    slack = ROUNDING * float(max(sizes))
    law = conditions.friction
    given = gaps, here.contact, slack
    # small problems between bounds cost less than the response
    response = None if law.is_box else law.response
    left = TURNING if law.d > 1 else LEFT
    proximal = conditions.proximal(here.body.row_stiffness)
    try:
        found = solve_by_secants(
            law, product, compliance, *given, response, left, springs=proximal
        )
    except np.linalg.LinAlgError:
        found = None
    if found is None:
        raise FactorisationError(UNSOLVABLE[law.d > 0])
    forces, parts = found
    for part, answer in zip(parts, answers, strict=True):
        change = change - part * answer
    # the forces of the springs belong to rollers
    springs = conditions.springs(here.body.row_stiffness)
    return change, forces + springs * conditions.displacement(change)


def several_solutions(
    here: Iterate,
    solve: Solve,
    most: int,
    stiffened: Callable[[np.ndarray], Solve] | None = None,
) -> tuple[bool, str]:
    """Whether Coulomb's law allows other forces at a solution, and a message about it.

    ``stiffened`` maps springs of the rows to the solver with these springs.  With it, uniqueness is
    tested first (``is_unique``), with the compliance S + 1/springs, unless contact alone holds a
    part.  If it is not proved, the rows that press and those closest to contact are examined, at
    most ``most`` forces with one solve each.  For few rows in the plane all states are enumerated,
    which is a proof if the body is elastic; otherwise it is a search.
    """
    conditions = here.body.contact
    cone = conditions.friction
    with_friction = (cone.coefficient > 0) & (cone.cap > 0) & ~cone.given
    if not conditions.processes.any(with_friction):
        return False, ""

    def compliance(d: np.ndarray) -> np.ndarray:
        """S d, the displacement of the rows by forces d."""
        return conditions.displacement(solve(conditions.forces(d)))

    can_be_proved = stiffened is not None and not here.body.floating.centres
    if can_be_proved and _proved_unique(here, compliance, stiffened):
        return False, ""

    n = here.multipliers
    pressing = n - here.body.row_stiffness[: len(n)] * here.open_gap
    order = np.argsort(np.where(cone.tied, -np.inf, -pressing), kind="stable")
    rows, left = np.split(order, [most // (cone.d + 1)])
    presses = (n[left] > 0).any() or cone.tied[left].any()
    if conditions.processes.size > 1 or presses:
        count = conditions.sum_of(np.ones(len(n), dtype=int))
        why = (
            f"Friction on {counted(count, 'row')}: whether there are other equilibria was not "
            "examined."
        )
        return False, why

    other = _other_forces(here, solve, rows)
    if other is None:
        if len(left) or not cone.enumerable:
            return False, SEARCHED
        return False, "" if here.plastic_measure == 0 else LINEARISED
    found = other[: len(rows)][~cone.tied[rows]].sum()
    ours = n[~cone.tied].sum()
    return True, f"One of them has the contact force {found:.6g} instead of {ours:.6g}."


def _proved_unique(
    here: Iterate, compliance: Solve, stiffened: Callable[[np.ndarray], Solve]
) -> bool:
    """Whether ``is_unique`` proves that there are no other forces, with springs on the rows."""
    conditions = here.body.contact
    gaps = here.gaps
    springs = SPRINGS * here.body.row_stiffness
    held = stiffened(springs)
    touching = ROUNDING * np.abs(gaps).max(initial=0.0)
    follows = conditions.friction.follows(here.contact, gaps, touching)

    def stiffness(g: np.ndarray) -> np.ndarray:
        """(S + 1/springs)^-1 g, by the tangent with springs on the rows (Woodbury)."""
        d = springs * g
        return d - springs * conditions.displacement(held(conditions.forces(d)))

    return is_unique(follows, lambda d: compliance(d) + d / springs, stiffness)


def _other_forces(here: Iterate, solve: Solve, rows: np.ndarray) -> np.ndarray | None:
    """Other forces of some rows that obey Coulomb's law, see ``other_forces``."""
    conditions = here.body.contact
    cone = conditions.friction
    chosen = cone.numbers(rows)
    S = conditions.compliance(solve, chosen)
    sizes = S.diagonal().copy()
    rigid = here.body.floating.compliance[chosen]
    springs = conditions.proximal(here.body.row_stiffness)
    if springs is not None:  # released like those of floating parts
        rigid = np.hstack([rigid, np.diag(springs[chosen] ** 0.5)])
    given = S, here.gaps[chosen], here.contact[chosen], sizes, rigid
    size = max(np.abs(here.u).max(), np.abs(here.slip).max(initial=0.0))
    return other_forces(cone.of(rows), *given, least=NOTHING * size)


def is_unique(follows: np.ndarray, compliance: Solve, stiffness: Solve) -> bool:
    """Whether no change d of the forces has d.E'Sd >= d.Sd, with E n = (0, mu e n).

    Two solutions differ by a d with d.Sd <= d.E'Sd, e at one of them: their normal parts have
    d_n.(Sd)_n <= 0, and friction as ``FrictionCone.follows`` says (Renard, SIAM J. Math. Anal. 38,
    2006, for the continuous problem).  Since

        d.Sd - d.E'Sd = (d - Ed/2).S(d - Ed/2) - Ed.SEd/4,

    whose first term is at least n.Cn for n = d_n, with C^-1 the normal part of S^-1, there is none
    if n.E'SEn < 4 n.Cn for all n.  The largest quotient is that of Lanczos' method in the product
    C, from a random start, with as many steps as leave a chance of ``DOUBT`` that it is 1 or more
    (Kuczynski and Wozniakowski, SIAM J. Matrix Anal. Appl. 13, 1992, for a direction of uniform
    probability).  ``follows`` is mu e (m, d), ``compliance`` and ``stiffness`` are d -> S d and its
    inverse, both for (n, t).
    """
    m = len(follows)
    no_tangents = np.zeros(follows.size)
    directions = np.zeros((0, m))  # and their products with C
    products = directions
    T = np.zeros((PROBES + 1, PROBES + 1))
    g = np.random.default_rng(0).standard_normal(m)
    n = stiffness(np.append(g, no_tangents))[:m]
    for k in range(PROBES):
        size = float(np.sqrt(max(n @ g, 0.0)))
        if k:
            left = 1 - np.linalg.eigvalsh(T[:k, :k])[-1]
            if not (left > 0 and np.isfinite(size)):
                return False
            probability = 1.648 * np.sqrt(m) * np.exp(-(2 * k - 1) * np.sqrt(left))
            if probability <= DOUBT or size <= EXHAUSTED:
                return True
            T[k, k - 1] = T[k - 1, k] = size
        v = n / size
        directions = np.vstack([directions, v])
        products = np.vstack([products, g / size])
        slanted = follows * v[:, None]  # E v
        slip = compliance(np.append(0 * v, slanted))[m:].reshape(follows.shape)
        g = (follows * slip).sum(axis=1) / 4  # E'SEv/4
        n = stiffness(np.append(g, no_tangents))[:m]
        T[k, k] = n @ products[k]
        for _ in range(2):  # one pass leaves rounding errors
            shares = products @ n
            n = n - shares @ directions
            g = g - shares @ products
    return False


def contact_work(
    here: Iterate, change: np.ndarray, following: np.ndarray
) -> tuple[Callable[[float], float], np.ndarray]:
    """The contribution of contact to the slope of the energy along a step ``change``.

    The slope at t of the sum of bound times |slip|, and the nodal forces of rows that do no work:
    normal ones of rows that stay closed and tangential ones of rows that stick, at the end of the
    step, where they balance it but for rounding; rows that slip dissipate their bound, taken there,
    times the slip.  Gaps and slips below rounding count as zero.
    """
    conditions = here.body.contact
    if conditions.absent:
        return (lambda t: 0.0), np.zeros_like(change)
    touching = here.touching_distance
    closed = (here.open_gap <= touching) & (conditions.normal(following) > 0)
    closed |= conditions.rows.tied
    if not conditions.friction.d:
        return (lambda t: 0.0), conditions.forces(np.where(closed, following, 0.0))
    slip = here.slip
    way = conditions.tangential(conditions.displacement(change))
    moves = np.linalg.norm(np.stack([slip, slip + way]), axis=2).max(axis=0) > touching
    way = np.where(moves[:, None], way, 0.0)
    bound = conditions.bound(following)
    idle = np.append(closed, np.repeat(~moves, conditions.friction.d))

    def slope(t: float) -> float:
        """Just before t (just after 0)."""
        there = slip + max(t * (1 - BESIDE), BESIDE) * way
        along = np.einsum("ij,ij->i", there, way)
        size = np.linalg.norm(there, axis=1)
        return float(conditions.sum_of(bound * along / np.where(size > 0, size, 1.0)))

    return slope, conditions.forces(np.where(idle, following, 0.0))


def with_travel(here: Iterate, change: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """A step with the whole of its rigid motion z, where only weak springs resist that.

    These make z too short.  Along z the energy changes by loads and friction alone; the motion ends
    where it no longer falls, or at an obstacle; rows that press or are tied stay where they are.  A
    motion without an end is not changed.
    """
    conditions = here.body.contact
    closed = conditions.rows.tied | (conditions.normal(contact) > 0)
    z = here.body.floating.rigid_part(change, closed)
    row_motion = conditions.displacement(z)
    gaps = here.gaps - conditions.displacement(change)
    nearing = conditions.normal(row_motion)
    meets = ~closed & (nearing > NOTHING * np.abs(z).max(initial=0.0))
    left = np.maximum(conditions.normal(gaps)[meets], 0.0)
    most = float((left / nearing[meets]).min(initial=FAR))

    slip = -conditions.tangential(gaps)
    along = conditions.tangential(row_motion)
    bound = conditions.bound(contact)
    work = float(np.vdot(here.body.load, z))

    def slope(s: float) -> float:
        """The derivative of the energy along z, at s z beyond the step."""
        moved = slip + s * along
        size = np.linalg.norm(moved, axis=1)
        rubbing = np.einsum("ij,ij->i", moved, along) / np.where(size > 0, size, 1.0)
        return float(bound @ rubbing) - work

    length = travel(slope, most)
    return change + length * z if length else change


def travel(slope: Callable[[float], float], most: float) -> float:
    """The length at which a slope, which grows, is no longer negative; ``most`` at most.

    Zero if it is not negative at first, or up to ``FAR``.
    """
    low = 0.0
    high = min(1.0, most)
    if slope(BESIDE * high) >= 0 or (most == FAR and slope(FAR) < 0):
        return 0.0
    while high < most and slope(high) < 0:
        low = high
        high = min(2 * high, most)
    if slope(high) <= 0:
        return high
    while high - low > BESIDE * high:
        middle = (low + high) / 2
        if slope(middle) < 0:
            low = middle
        else:
            high = middle
    return low
