"""Data of a ``Material`` from the numbers of a tensile test, as on data sheets.

In a bar under tension sigma with the plastic strain e (PEEQ) von Mises' law says

    sigma = R + H' e,    H' = dR/de = E E_t / (E - E_t),    E_t the slope d sigma / d strain,

where |dev sigma| = (2/3)^(1/2) sigma and |p| = (3/2)^(1/2) e.  Hence the bound of |dev sigma| is
(2/3)^(1/2) R, and the hardening per |p| is 2/3 H', kinematic and isotropic alike.  These factors
are those of tensors in three dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import dropwhile, pairwise

from ngepc.checks.arguments import Coefficient, is_number, require_datum, require_number
from ngepc.checks.kinds import require_sequence
from ngepc.checks.sentences import in_words
from ngepc.model.hardening import HardeningLaw, Tabulated

PEEQ = math.sqrt(2 / 3)
"""|p|_F times it is the equivalent plastic strain of engineers: the axial one of a bar."""

KINDS = ("isotropic", "kinematic", "mixed")
"""Kinds of hardening of ``Material.metal``."""

ELASTIC = 1e-4  # largest apparent plastic strain of the first point of a measured curve


def lame_parameters(young: float, poisson: float) -> tuple[float, float]:
    """(lambda, mu) from Young's modulus > 0 and Poisson's ratio in (-1, 1/2), in three dimensions.

    Raises
    ------
    TypeError, ValueError
        If a value is out of its range.
    """
    require_number("young", young, 0, strict=True)
    require_number("poisson", poisson, -1, strict=True, below=0.5)
    return elastic_data(young, poisson)


def elastic_data(
    young: Coefficient, poisson: Coefficient
) -> tuple[Coefficient, Coefficient]:
    """``lame_parameters`` of numbers or scalar coefficients, whose ranges ``Problem`` checks."""
    E = require_datum("young", young, 0, strict=True)
    nu = poisson
    if is_number(poisson):
        nu = require_number("poisson", poisson, -1, strict=True, below=0.5)
    else:
        require_datum("poisson", poisson)
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def plastic_modulus_of(young: Coefficient, tangent_modulus: Coefficient) -> Coefficient:
    """H' = E E_t / (E - E_t) from the slope E_t of a stress-strain curve, 0 <= E_t < E."""
    slope = require_datum("tangent_modulus", tangent_modulus, 0)
    if is_number(slope) and is_number(young) and slope >= young:
        raise ValueError(
            f"tangent_modulus={slope:g}: less than young={young:g} is needed"
        )
    return young * slope / (young - slope)


def hardening_of(
    yield_stress: Coefficient, plastic_modulus: Coefficient, share: float
) -> dict[str, object]:
    """Fields of ``Material`` for linear hardening, of which a share is kinematic."""
    R = require_datum("yield_stress", yield_stress, 0, strict=True)
    H = require_datum("plastic_modulus", plastic_modulus, 0)
    bound = PEEQ * R
    data: dict[str, object] = {"yield_stress": bound}
    if is_number(H) and H == 0:
        return data | {"law": Tabulated([0.0], [R])}
    if share > 0:
        data["hardening"] = share * (2 / 3 * H)
    if share < 1:
        data["hardening_modulus"] = 1 / bound
        data["hardening_stiffness"] = (1 - share) * (2 / 3 * H)
    return data


def law_of_curve(
    young: float, curve: Sequence[tuple[float, float]], yield_stress: float | None
) -> HardeningLaw:
    """The law of a measured curve of (total strain, stress), straight between the points.

    Points below ``yield_stress`` are elastic and left out; without it the first point beyond the
    origin is where the bar begins to yield.  A yield plateau, points at the same stress, is kept.
    """
    require_number("young with curve", young, 0, strict=True)
    require_sequence("curve", curve, "pairs (strain, stress)")
    points = [pair for pair in _pairs(curve) if pair[1] > 0]
    if not points:
        raise ValueError(
            f"curve={in_words(curve)}: points beyond the origin are needed"
        )
    R = yield_stress
    if R is None:
        R = _first_stress(curve, young, *points[0])
    R = require_number("yield_stress with curve", R, 0, strict=True)
    later = _beyond_yielding(curve, young, points, R)
    table = [(0.0, R), *((strain - stress / young, stress) for strain, stress in later)]
    for (before, last), (plastic, stress) in pairwise(table):
        if not plastic > before:
            raise ValueError(
                f"curve={in_words(curve)}: at the stress {stress:g} the plastic "
                "strain, the total one less "
                f"stress/young, is {plastic:.3g}, after {before:.3g}: increasing ones are needed"
            )
        if stress < last:
            raise ValueError(
                f"curve={in_words(curve)}: the stress falls from {last:g} to "
                f"{stress:g}: stresses that "
                "never fall are needed (softening is not covered)"
            )
    return Tabulated(*(list(column) for column in zip(*table, strict=True)))


def _beyond_yielding(
    curve: object, young: float, points: Sequence[tuple[float, float]], R: float
) -> list[tuple[float, float]]:
    """The points that are neither elastic nor the one where the bar begins to yield."""
    reached = list(dropwhile(lambda pair: pair[1] < R, points))
    if not reached:
        raise ValueError(
            f"yield_stress={R:g}: the curve ends below it, at the stress "
            f"{points[-1][1]:g} (curve={in_words(curve)})"
        )
    strain, stress = reached[0]
    _require_total(curve, young, strain, stress)
    begins_to_yield = stress == R and strain - stress / young <= ELASTIC
    return reached[1:] if begins_to_yield else reached


def _pairs(curve: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points of a curve as numbers."""
    points = []
    for number, pair in enumerate(curve):
        name = f"curve[{number}]"
        require_sequence(name, pair, "two numbers (strain, stress)")
        if len(pair) != 2:
            raise ValueError(
                f"{name}={in_words(pair)}: a pair (strain, stress) is needed"
            )
        strain, stress = (require_number(name, value, 0) for value in pair)
        points.append((strain, stress))
    return points


def _require_total(curve: object, young: float, strain: float, stress: float) -> None:
    """Refuse plastic strains: where the bar begins to yield they are zero, total ones are not."""
    elastic = stress / young
    if strain < elastic / 2:
        raise ValueError(
            f"curve={in_words(curve)}: at the stress {stress:g} the strain is {strain:g}, but "
            f"the elastic strain alone is stress/young={elastic:.3g}: total strains are needed "
            "(Tabulated takes plastic strains, for Material.with_law)"
        )


def _first_stress(curve: object, young: float, strain: float, stress: float) -> float:
    """The stress of the first point, which has to lie on the elastic line."""
    _require_total(curve, young, strain, stress)
    plastic = strain - stress / young
    if abs(plastic) > ELASTIC:
        raise ValueError(
            f"curve={in_words(curve)}: at its first point {stress:g} the plastic "
            f"strain is {plastic:.3g}, "
            "not 0: yield_stress= is needed, where the curve leaves the elastic line"
        )
    return stress


def plastic_data(
    young: Coefficient,
    yield_stress: Coefficient | None,
    ways: Mapping[str, object],
    share: float,
) -> dict[str, object]:
    """Fields of ``Material`` for the hardening that is given in one of several ways."""
    named = [name for name, value in ways.items() if value is not None]
    if len(named) != 1:
        given_names = " and ".join(named) if named else "no hardening"
        needed = f"one of {', '.join(ways)} is needed"
        raise ValueError(
            f"{given_names} given: {needed} (plastic_modulus=0: perfect plasticity)"
        )
    (name,) = named
    value = ways[name]
    if name == "curve":
        if share > 0:
            raise ValueError(
                f"curve={in_words(value)}: kind='isotropic' is needed with a curve "
                "(Material.cyclic takes the curve of cyclic loading)"
            )
        law = law_of_curve(young, value, yield_stress)
        return {"yield_stress": PEEQ * law.stress(0.0), "law": law}
    if yield_stress is None:
        raise ValueError(
            "yield_stress=None: the stress at which a bar yields is needed"
        )
    if name == "tangent_modulus":
        value = plastic_modulus_of(young, value)
    return hardening_of(yield_stress, value, share)


def kinematic_share_of(kind: str, share: float | None) -> float:
    """The part of the hardening that is kinematic, by the kind of hardening."""
    if kind not in KINDS:
        raise ValueError(f"kind={kind!r}: one of {', '.join(KINDS)} is needed")
    if kind != "mixed":
        if share is not None:
            raise ValueError(f"kinematic_share={share!r}: kind='mixed' is needed")
        return float(kind == "kinematic")
    if share is None:
        raise ValueError("kind='mixed': kinematic_share in (0, 1) is needed")
    return require_number("kinematic_share", share, 0, strict=True, below=1)
