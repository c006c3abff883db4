"""What a problem may have that some methods do not cover: each refuses what it lacks, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ngepc.model.contact import Coulomb
from ngepc.model.elements import vertices_of
from ngepc.model.given import Given
from ngepc.model.loading import CHECKS
from ngepc.model.places import Roller


def _concentrated(problem: Given) -> dict[str, object]:
    """Springs, rollers, and what acts at points and edges."""
    return {
        f"{argument}[{place!r}]": value
        for argument in CHECKS
        for place, value in problem.single(argument).items()
        if argument == "springs" or isinstance(value, Roller) or not isinstance(place, str)
    }


def _corner(problem: Given) -> dict[str, object]:
    """Contact that meets a clamped boundary."""
    clamped, contact = problem.clamped_names, problem.contact_names
    apart = not clamped or not contact
    meet = not apart and vertices_of(problem.mesh, clamped) & vertices_of(problem.mesh, contact)
    return {"contact": problem.contact} if meet else {}


Found = Callable[[Given], Mapping[str, object]]
"""Argument -> value of what a problem has; None for nothing."""

LIMITS: dict[str, tuple[Found, str]] = {
    "revolution": (
        lambda p: {"kinematics": p.kinematics.name if p.kinematics.hoop else None},
        "a plane problem or a solid",
    ),
    "order": (lambda p: {"order": p.order if p.order > 1 else None}, "displacements of order 1"),
    "pairs": (
        lambda p: {"contact": p.contact if p.contact_pairs else None},
        "rigid obstacles only, not two bodies",
    ),
    "law": (lambda p: {"material.law": p.material.law}, "linear hardening, without a law"),
    "strain": (lambda p: {"initial_strain": p.initial_strain}, "no initial strain"),
    "friction": (lambda p: {"friction": p.friction}, "contact without friction"),
    "Coulomb": (
        lambda p: {"friction": p.friction if isinstance(p.friction, Coulomb) else None},
        "a given bound F of friction",
    ),
    "places": (_concentrated, "loads and components of displacements on boundaries"),
    "corner": (_corner, "contact away from the clamped boundary, (2.2)"),
}
"""Name -> what a problem has of it, and what is needed instead."""


def require_without(problem: Given, what: str, *limits: str, advice: str = "") -> None:
    """Refuse by name what ``what`` does not cover, names of ``LIMITS``."""
    for found, needed in (LIMITS[limit] for limit in limits):
        for argument, value in found(problem).items():
            if value is not None:
                raise ValueError(f"{argument}={value!r}: {what} needs {needed}{advice}")
