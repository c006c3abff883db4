"""What the bound covers, and which argument is to blame where it does not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from ngsolve import BND, ET, VOL, CoefficientFunction, IntegrationRule

from ngepc.model.contact import Coulomb
from ngepc.model.loading import require_linear, require_plain
from ngepc.model.problem import Problem
from ngepc.model.rules import has_straight_simplices

CONSTANT = 1e-10
"""Part of its largest value by which a coefficient may vary on an element and count as constant."""

AFFINE = ("initial_plastic_strain", "initial_hardening (alpha_2)")
"""What may be affine on the triangles where displacements are of order two."""

_INSIDE = {
    ET.TRIG: IntegrationRule(
        [
            *((1 / 3, 1 / 3), (0.1, 0.1), (0.8, 0.1), (0.1, 0.8)),
            *((0.4, 0.4), (0.2, 0.4), (0.4, 0.2)),
        ],
        [1 / 14] * 7,
    ),
    ET.TET: IntegrationRule(
        [(0.25, 0.25, 0.25), (0.1, 0.1, 0.1), (0.7, 0.1, 0.1), (0.1, 0.7, 0.1), (0.1, 0.1, 0.7)],
        [1 / 30] * 5,
    ),
}


class FacetRule:
    """Points on a boundary facet, its vertices first.

    Parameters
    ----------
    shape
        The shape of the facet.
    inside
        Barycentric coordinates of the points that are no vertices.
    weights
        Of all points; they add up to 1.

    Attributes
    ----------
    shares
        Barycentric coordinates of all points.
    """

    def __init__(self, shape: ET, inside: Sequence[Sequence[float]], weights: list[float]) -> None:
        self.shape, corners = shape, np.eye(len(inside[0]))
        self.shares, self.weights = np.concatenate([corners, inside]), np.array(weights)
        self.rule = IntegrationRule([tuple(p[:-1]) for p in self.shares.tolist()], weights)

    def affine_defect(self, values: np.ndarray) -> np.ndarray:
        """By how much values (facets, points, k) exceed the affine function of their vertices."""
        return values - self.shares @ values[:, : self.shares.shape[1]]

    def check_affine(self, name: str, values: np.ndarray) -> None:
        """Refuse what is not affine on each facet.

        Raises
        ------
        ValueError
            Naming the argument.
        """
        defect = np.abs(self.affine_defect(values)).max(initial=0.0)
        if defect > CONSTANT * np.abs(values).max(initial=1e-300):
            raise ValueError(f"{name} is not affine on the boundary elements: bounds need it")


_GAUSS = math.sqrt(3 / 7) / 2
_NEAR, _FAR = ((6 + sign * math.sqrt(15)) / 21 for sign in (-1, 1))

FACET_RULES = {
    2: FacetRule(
        ET.SEGM,
        [(t, 1 - t) for t in (0.5, 0.5 - _GAUSS, 0.5 + _GAUSS)],
        [1 / 20, 1 / 20, 16 / 45, 49 / 180, 49 / 180],
    ),
    3: FacetRule(
        ET.TRIG,
        [(1 / 3, 1 / 3, 1 / 3)]
        + [
            tuple(1 - 2 * a if i == k else a for i in range(3))
            for a in (_NEAR, _FAR)
            for k in range(3)
        ],
        [0.0] * 3
        + [9 / 40]
        + [(155 - math.sqrt(15)) / 1200] * 3
        + [(155 + math.sqrt(15)) / 1200] * 3,
    ),
}
"""The rules of Lobatto (degree seven) and Radon (degree five, with the vertices) by dimension."""


def check_covered(problem: Problem) -> None:
    """Refuse by name what there is no guaranteed bound for.

    Raises
    ------
    ValueError
        Naming the argument, its value and what is needed.
    """
    if problem.kinematics.hoop:
        raise ValueError(f"kinematics={problem.kinematics.name!r}: bounds need a plane problem")
    if problem.order == 2 and problem.N == 3:
        needed = "displacements of order 1 in three dimensions"
        raise ValueError(f"order={problem.order}: bounds need {needed}")
    if not has_straight_simplices(problem.mesh):
        raise ValueError(
            "mesh: bounds need triangles or tetrahedra with straight edges;"
            " error_indicators(result) estimates on others, without a guarantee"
        )
    if problem.contact_pairs:
        raise ValueError(
            f"contact={problem.contact!r}: bounds need rigid obstacles, not two bodies"
        )
    require_linear(problem, "bounds need")
    if isinstance(problem.friction, Coulomb):
        raise ValueError(f"friction={problem.friction!r}: bounds need a given bound F of friction")
    require_plain(problem, "bounds need loads and components of displacements on boundaries")
    material, (scalar, back) = problem.material, problem.alpha_0
    coefficients = {
        "lame_lambda": material.lame_lambda,
        "lame_mu": material.lame_mu,
        "yield_stress": material.yield_stress,
        "hardening": material.effective_hardening,
        "initial_plastic_strain": problem.initial_plastic_strain,
        "initial_hardening": None if problem.initial_hardening is None else scalar,
        "initial_hardening (alpha_2)": None if problem.initial_hardening is None else back,
        "body_force": problem.f if problem.order == 2 else None,
    }
    for name, value in coefficients.items():
        affine = problem.order == 2 and name in AFFINE
        if isinstance(value, CoefficientFunction) and varies_inside(problem, value, affine):
            needed = "affine functions" if affine else "one value"
            raise ValueError(f"{name} varies inside elements: bounds need {needed} on each element")


def require_frictionless(problem: Problem, what: str) -> None:
    """Refuse friction, by name, where what slips would have to be known on other data.

    Raises
    ------
    ValueError
        Naming the argument and its value.
    """
    if problem.friction is not None:
        raise ValueError(f"friction={problem.friction!r}: {what} needs contact without friction")


def varies_inside(problem: Problem, value: CoefficientFunction, affine: bool = False) -> bool:
    """Whether a coefficient is more than a constant, or an affine function, on an element."""
    points = problem.mesh.MapToAllElements(_INSIDE, VOL)
    values = np.asarray(value(points)).reshape(problem.mesh.ne, -1, value.dim)
    size = np.abs(values).max(initial=1e-300)
    if affine:
        known = np.array([(1.0, *p) for p in _INSIDE[ET.TRIG].points])[:, : problem.N + 1]
        values = values - known @ (np.linalg.pinv(known) @ values)
    return np.ptp(values, axis=1).max() > CONSTANT * size


def on_facets(problem: Problem, value: CoefficientFunction) -> np.ndarray:
    """A coefficient at the rule's points of all boundary elements, shape (elements, points, k)."""
    rule = FACET_RULES[problem.N]
    points = problem.mesh.MapToAllElements({rule.shape: rule.rule}, BND)
    return np.asarray(value(points)).reshape(-1, len(rule.weights), value.dim)
