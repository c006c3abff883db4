"""What the bound covers, and which argument is to blame where it does not."""

from __future__ import annotations

import math

import numpy as np
from ngsolve import BND, ET, VOL, CoefficientFunction, IntegrationRule

from ngepc.model.problem import Problem, as_scalar
from ngepc.model.rules import has_straight_simplices

CONSTANT = 1e-10
"""Part of its largest value by which a coefficient may vary on an element and count as constant."""

_INSIDE = IntegrationRule([(1 / 3, 1 / 3), (0.1, 0.1), (0.8, 0.1), (0.1, 0.8)], [0.125] * 4)

_INNER = math.sqrt(3 / 7) / 2

ENDS_AND_INSIDE = IntegrationRule(
    points=[(1.0,), (0.0,), (0.5,), (0.5 - _INNER,), (0.5 + _INNER,)],
    weights=[1 / 20, 1 / 20, 16 / 45, 49 / 180, 49 / 180],
)
"""Points on a boundary segment, its vertices first: Lobatto's rule of degree seven."""

SHARES = np.array([[t[0], 1 - t[0]] for t in ENDS_AND_INSIDE.points])
"""Hat functions of the vertices at these points."""


def check_covered(problem: Problem) -> None:
    """Refuse by name what there is no guaranteed bound for.

    Raises
    ------
    ValueError
        Naming the argument, its value and what is needed.
    """
    if problem.N == 3:
        raise ValueError("mesh: bounds need a body in two dimensions, this one has three")
    if problem.kinematics.hoop:
        raise ValueError(f"kinematics={problem.kinematics.name!r}: bounds need a plane problem")
    if problem.order != 1:
        raise ValueError(f"order={problem.order}: bounds need displacements of order 1")
    if not has_straight_simplices(problem.mesh):
        raise ValueError("mesh: bounds need triangles with straight edges")
    if problem.friction is not None:
        raise ValueError(f"friction={problem.friction!r}: bounds need contact without friction")
    material, (scalar, back) = problem.material, problem.alpha_0
    coefficients = {
        "lame_lambda": as_scalar(material.lame_lambda),
        "lame_mu": as_scalar(material.lame_mu),
        "yield_stress": as_scalar(material.yield_stress),
        "hardening": problem.effective_hardening,
        "initial_plastic_strain": problem.initial_plastic_strain,
        "initial_hardening": None if problem.initial_hardening is None else scalar,
        "initial_hardening (alpha_2)": None if problem.initial_hardening is None else back,
        "body_force": problem.f,
    }
    for name, value in coefficients.items():
        if value is not None:
            check_constant(problem, name, value)


def check_constant(problem: Problem, name: str, value: CoefficientFunction) -> None:
    """One value on each element."""
    points = problem.mesh.MapToAllElements({ET.TRIG: _INSIDE}, VOL)
    values = np.asarray(value(points)).reshape(problem.mesh.ne, len(_INSIDE), -1)
    if np.ptp(values, axis=1).max() > CONSTANT * np.abs(values).max(initial=1e-300):
        raise ValueError(f"{name} varies inside elements: bounds need one value on each element")


def on_segments(problem: Problem, value: CoefficientFunction) -> np.ndarray:
    """A coefficient at ENDS_AND_INSIDE of all boundary segments, shape (segments, 5, k)."""
    points = problem.mesh.MapToAllElements({ET.SEGM: ENDS_AND_INSIDE}, BND)
    return np.asarray(value(points)).reshape(-1, len(ENDS_AND_INSIDE.points), value.dim)


def affine_defect(values: np.ndarray) -> np.ndarray:
    """By how much (segments, 5, k) exceed the line between their ends."""
    return values - SHARES @ values[:, :2]


def check_affine(name: str, values: np.ndarray) -> None:
    """An affine function on each segment."""
    defect = np.abs(affine_defect(values)).max(initial=0.0)
    if defect > CONSTANT * np.abs(values).max(initial=1e-300):
        raise ValueError(f"{name} is not affine along the segments of the mesh: bounds need it")
