"""What a problem may have that some methods do not cover: each refuses what it lacks, by name."""

from __future__ import annotations

from ngepc.model.contact import Coulomb
from ngepc.model.elements import vertices_of
from ngepc.model.given import Given
from ngepc.model.places import Roller

NEEDED = {
    "revolution": "a plane problem or a solid",
    "order": "displacements of order 1",
    "pairs": "rigid obstacles only, not two bodies",
    "law": "linear hardening, without a law",
    "strain": "no initial strain",
    "friction": "contact without friction",
    "Coulomb": "a given bound F of friction",
    "places": "loads and components of displacements on boundaries",
    "corner": "contact away from the clamped boundary, (2.2)",
}
"""Name of what a problem may have -> what is needed instead."""


def require_without(problem: Given, what: str, *limits: str, advice: str = "") -> None:
    """Refuse by name what ``what`` does not cover, names of ``NEEDED``."""
    p, friction = problem, problem.friction
    ends = (vertices_of(p.mesh, names) for names in (p.clamped_names, p.contact_names))
    has = {
        "revolution": {"kinematics": p.kinematics.name if p.kinematics.hoop else None},
        "order": {"order": p.order if p.order > 1 else None},
        "pairs": {"contact": p.contact if p.contact_pairs else None},
        "law": {"material.law": p.material.law},
        "strain": {"initial_strain": p.initial_strain},
        "friction": {"friction": friction},
        "Coulomb": {"friction": friction if isinstance(friction, Coulomb) else None},
        "places": {
            f"{argument}[{place!r}]": value
            for argument, place, value in p.acting
            if argument == "springs" or isinstance(value, Roller) or not isinstance(place, str)
        },
        "corner": {"contact": p.contact if set.intersection(*ends) else None},
    }
    for limit in limits:
        for argument, value in has[limit].items():
            if value is not None:
                raise ValueError(f"{argument}={value!r}: {what} needs {NEEDED[limit]}{advice}")
