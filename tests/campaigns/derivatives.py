"""Exact derivatives against central differences, Taylor's formula and the envelope theorem.

Differences are of fourth order with the step STEP, relative to the size of a parameter; errors are
relative to the largest derivative of the functional.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from campaigns.random_data import (
    carried,
    four_times,
    functionals,
    last_state,
    law_of,
    moved,
    once,
    random_problem,
    sizes,
)

from ngepc.model.places import Coulomb
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.equations import STENCIL, Data
from ngepc.sensitivity.functionals import as_functional
from ngepc.sensitivity.gradient import gradient, states_of
from ngepc.sensitivity.law_equations import equations_of_law, yield_surfaces_of
from ngepc.sensitivity.parameters import Direction, changed_data
from ngepc.studies.work import Work

STEP = 3e-5
"""The step of differences, relative to the size of the parameters."""

LENGTHS = tuple(size * 0.5 ** np.arange(4) for size in (1e-3, 1e-4, 1e-5))
"""Lengths of the changes whose Taylor remainders are compared, three series of them."""

ORDER = 1.95
"""The least order of remainders that counts as the second."""


class Comparison(NamedTuple):
    """A derivative against its difference, relative to the largest one of the functional.

    It is ``smooth`` if no row or point changes side in between.
    """

    functional: str
    parameter: str
    error: float
    smooth: bool


def compared(problem, solve=once, every=slice(None)):
    """Gradients of all functionals by the parameters in ``sizes``, compared with differences."""
    result, amounts, found = solve(problem), sizes(problem), []
    chosen = functionals(problem)
    gradients = {
        key: gradient(result, value, list(amounts)) for key, value in chosen.items()
    }
    for name, amount in list(amounts.items())[every]:
        problems = [moved(problem, {name: k * STEP * amount}) for k in STENCIL]
        others = [solve(other, result) for other in problems]
        smooth, states = (
            all(same_sides(result, o) for o in others),
            list(map(last_state, others)),
        )
        for key, functional in chosen.items():
            values = [functional.slope(state).value for state in states]
            difference = float(np.dot(list(STENCIL.values()), values)) / STEP
            slopes = gradients[key]
            size = max(abs(slopes[n] * a) for n, a in amounts.items()) or 1.0
            error = abs(slopes[name] * amount - difference) / size
            found.append(Comparison(key, name, error, smooth))
    return found


def same_sides(one, other):
    """Whether the same points yield and the same rows touch and slip in all steps."""
    pairs = zip(states_of(one), states_of(other), strict=True)
    return all(
        all(
            (x.at.yields == y.at.yields).all()
            for x, y in zip(yield_surfaces_of(a), yield_surfaces_of(b), strict=True)
        )
        and LinearContact(a).same_sides(LinearContact(b))
        for a, b in ((here(), there()) for here, there in pairs)
    )


def taylor_slopes(problem, seed):
    """The order of the remainders F(m + t dm) - F(m) - t F' dm in a random direction.

    The lengths t are so small that no row or point changes its status, and for each functional
    those of the first series that shows the order 2: where terms of the second order nearly
    vanish, those of the third hide them on larger lengths.  The remainder of a wrong derivative
    is of order 1 on small lengths.
    """
    result = once(problem)
    amounts = sizes(problem)
    random = np.random.default_rng(seed)
    rates = {name: amount * random.uniform(-1, 1) for name, amount in amounts.items()}
    slopes = {
        key: gradient(result, functional, list(rates))
        for key, functional in functionals(problem).items()
    }
    orders = {}
    for lengths in LENGTHS:
        others = [
            once(moved(problem, {n: t * r for n, r in rates.items()})) for t in lengths
        ]
        smooth = all(same_sides(result, other) for other in others)
        if not smooth and lengths is not LENGTHS[-1]:
            continue
        for key, functional in functionals(problem).items():
            if orders.get(key, 0.0) < ORDER:
                orders[key] = remainder_order(
                    functional, slopes[key], rates, others, lengths
                )
        if min(orders.values()) >= ORDER:
            break
    return orders


def remainder_order(functional, slopes, rates, others, lengths):
    """The slope of the remainders of a functional over the lengths, both in logarithms."""
    rate = sum(slopes[name] * r for name, r in rates.items())
    values = np.array([functional.slope(last_state(other)).value for other in others])
    rest = np.abs(values - slopes.functional - lengths * rate)
    return float(np.polyfit(np.log(lengths), np.log(rest), 1)[0])


def envelope_error(problem):
    """The largest difference of dJ/dm and the explicit partial derivative, relative.

    None if rows slip with Coulomb friction, as the solution does not minimise J then.
    """
    result, names = once(problem), list(sizes(problem))
    state, energy = result.state, as_functional("primal_energy")
    contact, held = LinearContact(state), ~state.discrete.free
    if (contact.slips & (contact.coefficient > 0)).any():
        return None
    partial = equations_of_law(state).backward(energy.slope(state).by)
    gaps = np.where(
        np.arange(len(state.contact)) < len(state.multipliers), -state.contact, 0.0
    )
    partial += Data(gaps=gaps, values=np.where(held, state.residual_force, 0.0))
    slopes = gradient(result, energy, names)
    expected = {n: partial.paired(changed_data(state, Direction(n))) for n in names}
    amounts = sizes(problem)
    size = max(abs(slopes[n] * amounts[n]) for n in names)
    return max(abs(slopes[n] - expected[n]) * amounts[n] for n in names) / size


@dataclass(eq=False)
class Derivatives(Work):
    """``count`` random problems, every fifth a history of four steps."""

    count: int = 200

    name, title = "derivatives", "Derivatives against differences"
    columns = """ = {group} | problems = {problems} | numbers = {compared}
        | across a kink = {kinks} | largest error = {error:.1e} | Taylor slope = {slope:.3f}
        | envelope = {envelope:.1e}"""
    note = (
        "Gradients of contact force, energy, a displacement, a reaction and integrals of u, p and "
        "stress by all data, compared with central differences of fourth order, relative step "
        f"{STEP:g}; errors relative to the largest derivative of the functional, without "
        "differences across which a row or point changes side. Taylor: the smallest order of a "
        "remainder in a random direction. Envelope: dJ/dm against the explicit partial derivative, "
        "where friction has no bound that follows the pressure."
    )

    def cells(self):
        """The problems by seed."""
        return [{"seed": seed} for seed in range(self.count)]

    def solve(self, seed):
        """Differences for all, Taylor remainders and the envelope theorem for single steps."""
        problem = carried(random_problem(seed))
        steps = 4 if seed % 5 == 2 else 1
        part = slice(None) if steps == 1 else slice(seed % 3, None, 3)
        found = compared(problem, once if steps == 1 else four_times, part)
        smooth = [c.error for c in found if c.smooth]
        friction = "Coulomb" if isinstance(problem.friction, Coulomb) else "Tresca"
        return {
            "kinematics": problem.kinematics.name,
            "order": problem.order,
            "friction": "none" if problem.friction is None else friction,
            "bodies": 2 if problem.contact_pairs else 1,
            "law": law_of(problem.material),
            "steps": steps,
            "compared": len(smooth),
            "across a kink": len(found) - len(smooth),
            "largest error": max(smooth, default=0.0),
            "Taylor": min(taylor_slopes(problem, seed).values())
            if steps == 1
            else None,
            "envelope": envelope_error(problem) if steps == 1 else None,
        }

    def succeeded(self, records):
        """Whether derivatives agree with differences, Taylor's formula, the envelope theorem."""
        return all(
            r["largest error"] < 1e-6
            and (r["Taylor"] or 2) > ORDER
            and (r["envelope"] or 0) < 1e-10
            for r in records
        )

    def table_rows(self, records):
        """Groups of problems."""
        groups = {"all": list(records)}
        for key in ("kinematics", "order", "friction", "bodies", "law", "steps"):
            for record in records:
                groups.setdefault(f"{key} {record[key]}", []).append(record)
        return [of_group(label, group) for label, group in groups.items()]


def of_group(label, group):
    """The numbers of a group of problems; None for what no problem of it has."""
    slopes = [r["Taylor"] for r in group if r["Taylor"] is not None]
    return {
        "group": label,
        "problems": len(group),
        "compared": sum(r["compared"] for r in group),
        "kinks": sum(r["across a kink"] for r in group),
        "error": max(r["largest error"] for r in group),
        "slope": min(slopes, default=None),
        "envelope": max(
            (r["envelope"] for r in group if r["envelope"] is not None), default=None
        ),
    }
