"""Features of problems, and the refusal of those that a method does not cover.

A method, bound, derivative or exporter lists the features that it covers in a constant ``COVERS``.
Whatever is not listed is refused, so that a new feature is refused everywhere until it is shown to
be right there.  Sets of features that several methods cover are named here; a new feature joins
none of them, but is added to the methods that cover it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

from ngepc.checks.arguments import is_number
from ngepc.checks.sentences import in_words
from ngepc.model.data import ProblemData
from ngepc.model.elements import has_elements_with, has_more_corners, is_straight
from ngepc.model.kinematics import KINEMATICS
from ngepc.model.places import Coulomb, Roller
from ngepc.model.support import floating_motions, holds_contact

Found = Mapping[str, object]
"""Argument of ``Problem`` -> its value, for arguments that have a feature; empty without it."""

MESH = "mesh"
"""The argument of features of the mesh; its value is described in words."""

BASIC_FEATURES = frozenset(
    {
        "plane strain",
        "two-dimensional",
        "solid",
        "kinematic hardening",
        "isotropic hardening",
        "obstacle",
    }
)
"""Features that every method covers."""

HISTORY_FEATURES = frozenset({"initial plastic strain", "initial hardening"})
"""History variables of earlier steps, without PEEQ."""

KINEMATICS_FEATURES = frozenset(
    {"plane stress", "axisymmetric", "other kinematics", "thickness"}
)
"""Kinematics other than plane strain, the paper's and solids; thickness of plane bodies."""

ELEMENT_FEATURES = frozenset(
    {"order 2", "quadrilaterals", "hexahedra", "prisms", "curved elements"}
)
"""Elements other than straight simplices of order one."""

LAW_FEATURES = frozenset({"hardening law", "rate", "initial strain"})
"""Laws other than linear hardening, and initial strains."""

CONTACT_FEATURES = frozenset(
    {
        "two bodies",
        "held by contact",
        "friction",
        "Coulomb friction",
        "contact at a clamp",
    }
)
"""Contact other than with rigid obstacles without friction."""

SUPPORT_FEATURES = frozenset({"rollers", "edges and points", "springs"})
"""Supports and loads other than components on boundaries."""


@dataclass(frozen=True)
class Feature:
    """A property of a problem that a method may or may not cover.

    Parameters
    ----------
    needed
        What a problem must have instead, for methods that do not cover the feature.
    found
        Called with a problem: which arguments have the feature, and their values.
    """

    needed: str
    found: Callable[[ProblemData], Found]


def _present(argument: str, problem: ProblemData) -> Found:
    """The argument, if it is given."""
    value = getattr(problem, argument)
    return {} if value is None else {argument: value}


def _in_material(argument: str, problem: ProblemData) -> Found:
    """The datum of the material, if it is given and not the number zero."""
    value = getattr(problem.material, argument)
    absent = value is None or (is_number(value) and value == 0)
    return {} if absent else {f"material.{argument}": value}


def _kinematics(name: str, problem: ProblemData) -> Found:
    """The kinematics, if it has this name."""
    given = problem.kinematics.name
    return {"kinematics": given} if given == name else {}


def _own_kinematics(problem: ProblemData) -> Found:
    """The kinematics, if it is none of those of the package."""
    given = problem.kinematics
    known = any(given.name == k.name and given.basis is k.basis for k in KINEMATICS)
    return {} if known else {"kinematics": given.name}


def _thickness(problem: ProblemData) -> Found:
    """The thickness, if it is other than one."""
    given = problem.thickness
    return {} if given in (None, 1) else {"thickness": given}


def _order(problem: ProblemData) -> Found:
    """The order of the displacements, if it is two."""
    return {"order": problem.order} if problem.order > 1 else {}


def _quadrilaterals(problem: ProblemData) -> Found:
    """The mesh of a plane body, if an element has more corners than a triangle."""
    mesh = problem.mesh
    found = mesh.dim == 2 and has_more_corners(mesh)
    return {MESH: "quadrilaterals"} if found else {}


def _solid_shape(name: str, corners: int, problem: ProblemData) -> Found:
    """The mesh of a solid, if an element has this number of corners."""
    mesh = problem.mesh
    found = mesh.dim == 3 and has_elements_with(mesh, corners)
    return {MESH: name} if found else {}


def _curved(problem: ProblemData) -> Found:
    """The mesh, if its elements are curved or moved by a deformation."""
    mesh = problem.mesh
    if mesh.deformation is not None:
        return {MESH: "a deformation"}
    return {} if is_straight(mesh) else {MESH: "curved elements"}


def _shared(problem: ProblemData) -> Found:
    """The mesh, if it is distributed over several processes."""
    size = max(problem.processes.size, problem.mesh.comm.size)
    return {MESH: f"a part on each of {size} processes"} if size > 1 else {}


def _history(problem: ProblemData) -> Found:
    """The hardening left by earlier steps."""
    names = ("initial_hardening", "initial_accumulated")
    return {n: value for name in names for n, value in _present(name, problem).items()}


def _obstacle(problem: ProblemData) -> Found:
    """Contact with a rigid obstacle."""
    return {"contact": problem.contact} if problem.contact_names else {}


def _two_bodies(problem: ProblemData) -> Found:
    """Contact between two bodies, or ties."""
    return {"contact": problem.contact} if problem.contact_pairs else {}


def _floating(problem: ProblemData) -> Found:
    """Contact that is the only support of a part of the body."""
    return {"contact": problem.contact} if floating_motions(problem) else {}


def _coulomb(problem: ProblemData) -> Found:
    """Friction that depends on the pressure."""
    given = problem.friction
    return {"friction": given} if isinstance(given, Coulomb) else {}


def _meeting(problem: ProblemData) -> Found:
    """Contact that meets a clamp, or another support that holds its normal displacement."""
    return {"contact": problem.contact} if holds_contact(problem) else {}


def _rollers(problem: ProblemData) -> Found:
    """Supports along one direction."""
    given = problem.single("prescribed").items()
    return {f"prescribed[{p!r}]": v for p, v in given if isinstance(v, Roller)}


def _on_edges_and_points(problem: ProblemData) -> Found:
    """Loads and supports on edges and at points."""
    return {
        f"{argument}[{place!r}]": value
        for argument, place, value in problem.acting
        if not isinstance(place, str)
    }


def _springs(problem: ProblemData) -> Found:
    """Elastic foundations."""
    given = problem.single("springs").items()
    return {f"springs[{place!r}]": value for place, value in given}


def _feature(needed: str, found: Callable, *arguments: object) -> Feature:
    """A feature with these arguments of its search."""
    return Feature(needed, partial(found, *arguments))


_BOUNDARIES = "loads and components of displacements on boundaries"

FEATURES = {
    "plane strain": _feature("another kinematics", _kinematics, "plane strain"),
    "two-dimensional": _feature("another kinematics", _kinematics, "two-dimensional"),
    "plane stress": _feature("plane strain or a solid", _kinematics, "plane stress"),
    "axisymmetric": _feature("a plane problem or a solid", _kinematics, "axisymmetric"),
    "solid": _feature("a plane problem", _kinematics, "solid"),
    "other kinematics": _feature("a kinematics of ngepc", _own_kinematics),
    "thickness": _feature("thickness=None, a body of thickness 1", _thickness),
    "order 2": _feature("displacements of order 1 (order=1)", _order),
    "quadrilaterals": _feature("triangles only", _quadrilaterals),
    "hexahedra": _feature("tetrahedra only", _solid_shape, "hexahedra", 8),
    "prisms": _feature("tetrahedra only", _solid_shape, "prisms", 6),
    "curved elements": _feature(
        "straight edges (mesh.Curve(1) makes them), and points of mesh.ngmesh that are moved in "
        "place of mesh.SetDeformation",
        _curved,
    ),
    "shared mesh": _feature("a mesh of one process", _shared),
    "kinematic hardening": _feature(
        "isotropic hardening alone", _in_material, "hardening"
    ),
    "isotropic hardening": _feature(
        "kinematic hardening alone", _in_material, "hardening_modulus"
    ),
    "hardening law": _feature("linear hardening, without a law", _in_material, "law"),
    "rate": _feature("a material without a rate", _in_material, "rate"),
    "anisotropic yield": _feature("von Mises yield", _in_material, "hill"),
    "cyclic hardening": _feature("a single yield surface", _in_material, "overlay"),
    "initial plastic strain": _feature(
        "a body without a history", _present, "initial_plastic_strain"
    ),
    "initial hardening": _feature("a body without a history", _history),
    "initial strain": _feature("no initial strain", _present, "initial_strain"),
    "obstacle": _feature("a body without contact", _obstacle),
    "two bodies": _feature("rigid obstacles only, not two bodies", _two_bodies),
    "held by contact": _feature("supports that hold every part", _floating),
    "friction": _feature("contact without friction", _present, "friction"),
    "Coulomb friction": _feature("a given bound F of friction", _coulomb),
    "contact at a clamp": _feature(
        "contact away from supports that hold its normal displacement, (2.2)", _meeting
    ),
    "rollers": _feature(_BOUNDARIES, _rollers),
    "edges and points": _feature(_BOUNDARIES, _on_edges_and_points),
    "springs": _feature("rigid supports, without springs", _springs),
}
"""Name of each feature -> what is needed instead, and the function that finds it."""


def features_of(problem: ProblemData) -> dict[str, tuple[str, object]]:
    """The features of a problem.

    Returns
    -------
    dict
        Name of a feature, see ``FEATURES`` -> the first (argument, value) that has it.
    """
    found = {name: feature.found(problem) for name, feature in FEATURES.items()}
    return {name: next(iter(has.items())) for name, has in found.items() if has}


def is_covered(problem: ProblemData, covers: frozenset[str]) -> bool:
    """Whether a problem has these features only."""
    others = (feature for name, feature in FEATURES.items() if name not in covers)
    return not any(feature.found(problem) for feature in others)


def require_covered(
    problem: ProblemData, what: str, covers: frozenset[str], advice: str = ""
) -> None:
    """Refuse a problem with a feature that ``what`` does not cover.

    Parameters
    ----------
    problem
        The problem.
    what
        The method, for the message.
    covers
        Names of the features that it covers.
    advice
        Added to the message: what to do instead.

    Raises
    ------
    ValueError
        Naming the argument, its value, and what is needed instead.
    """
    for name, feature in FEATURES.items():
        if name not in covers:
            for argument, value in feature.found(problem).items():
                reason = f"{what} needs {feature.needed}{advice}"
                if argument == MESH:
                    raise ValueError(f"mesh has {value}: {reason}")
                raise ValueError(f"{argument}={in_words(value)}: {reason}")
