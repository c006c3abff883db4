"""The data of a time step, not yet checked, and quantities that follow from them."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from typing import ClassVar, TypeVar

import numpy as np
from ngsolve import CoefficientFunction, Id, Mesh

from ngepc.checks.arguments import (
    Coefficient,
    boundary_names,
    is_number,
    require_components,
)
from ngepc.checks.coefficients import as_constant
from ngepc.checks.sentences import in_words
from ngepc.model.elements import outward_normal
from ngepc.model.kinematics import TWO_DIMENSIONAL, Kinematics
from ngepc.model.material import Material, split_hardening
from ngepc.model.places import Contact, Coulomb, Place, Roller, places
from ngepc.model.processes import Team, nodal_processes_of, processes_of
from ngepc.model.viscosity import RateLaw

Vector = CoefficientFunction | Sequence[Coefficient]
"""A vector-valued CoefficientFunction, or a sequence of N numbers and scalar coefficients."""

Components = tuple | list | np.ndarray

Data = TypeVar("Data", bound="ProblemData")

ACTING = ("traction", "pressure", "prescribed", "springs")
"""Arguments that map places to values."""

HISTORY = (
    "initial_plastic_strain",
    "initial_hardening",
    "initial_accumulated",
    "initial_strain",
)
"""Arguments for the history of the body, and the stress-free strain."""

LEFT = (*HISTORY, "initial_displacement", "duration")
"""Arguments that the steps before determine."""


class DefaultOrder(int):
    """The default order of displacements: a copy with other data chooses its own default."""


@dataclass(frozen=True, eq=False)
class ProblemData:
    """The fields of ``Problem``, and quantities that follow from them in the paper's notation."""

    mesh: Mesh
    material: Material
    clamped: str | Sequence[str] | None = "clamped"
    traction: Mapping[Place, Vector] | None = None
    contact: str | Contact | Sequence[str | Contact] | None = None
    gap: Coefficient | Mapping[str, Coefficient] | None = None
    body_force: Vector | None = None
    initial_plastic_strain: CoefficientFunction | None = None
    initial_hardening: Coefficient | tuple | None = None
    prescribed: Mapping[Place, Sequence[Coefficient | None] | Roller] | None = None
    friction: Coefficient | Coulomb | None = None
    initial_displacement: Vector | None = None
    initial_accumulated: Coefficient | None = None
    kinematics: Kinematics | str | None = None
    order: int | None = None
    pressure: Mapping[str, Coefficient] | None = None
    springs: Mapping[Place, Coefficient | Sequence[Coefficient]] | None = None
    initial_strain: Coefficient | None = None
    duration: float | None = None
    thickness: float | None = None

    solved_on: ClassVar[object] = None
    """The state of the mesh when the problem was solved, ``own.MeshState``; None before."""

    def as_solved_on(self: Data, state: object) -> Data:
        """A copy that was solved while its mesh had this state."""
        other = copy(self)
        vars(other)["solved_on"] = state
        return other

    @property
    def given(self) -> dict[str, object]:
        """Name of each argument -> its given value."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def N(self) -> int:
        """Space dimension, 2 or 3."""
        return self.mesh.dim

    @property
    def processes(self) -> Team:
        """The processes that share the mesh, by its vertices."""
        return processes_of(self.mesh)

    @property
    def nodal_processes(self) -> Team:
        """The same processes by the nodes of the displacements."""
        return nodal_processes_of(self.mesh, self.order)

    @property
    def normal(self) -> CoefficientFunction:
        """The outer unit normal n; ``specialcf.normal`` points inward on some CSG2d edges."""
        return outward_normal(self.mesh)

    @property
    def clamped_names(self) -> tuple[str, ...]:
        """Names of Gamma_d."""
        return (
            ()
            if self.clamped is None
            else boundary_names("clamped", self.clamped, self.mesh)
        )

    @property
    def contact_pairs(self) -> tuple[Contact, ...]:
        """The pairs of boundaries of two bodies that touch or are tied."""
        parts = (
            self.contact if isinstance(self.contact, tuple | list) else (self.contact,)
        )
        return tuple(part for part in parts if isinstance(part, Contact))

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of Gamma_c, where rigid obstacles are; empty without."""
        names = self.contact
        pairs = self.contact_pairs
        if pairs:
            names = (
                None if names in pairs else [n for n in names if n not in pairs] or None
            )
        return () if names is None else boundary_names("contact", names, self.mesh)

    @property
    def touching_names(self) -> tuple[str, ...]:
        """Names of all boundaries with contact conditions: Gamma_c and the first of each pair."""
        firsts = [
            boundary_names("contact", p.first, self.mesh) for p in self.contact_pairs
        ]
        return tuple(dict.fromkeys(sum(firsts, self.contact_names)))

    def single(self, argument: str) -> dict:
        """A mapping by place with one entry for each boundary of a key 'a|b'."""
        given = getattr(self, argument) or {}
        return {
            p: v for key, v in given.items() for p in places(argument, key, self.mesh)
        }

    @property
    def acting(self) -> list[tuple[str, Place, object]]:
        """(argument, single place, value) of all loads, given displacements and springs."""
        return [(name, *item) for name in ACTING for item in self.single(name).items()]

    @property
    def loads(self) -> dict[Place, CoefficientFunction]:
        """Single place -> force per area, per length (edges) or force (points)."""
        given = self.single("traction").items()
        loads = {place: require_components("traction", g, self.N) for place, g in given}
        for name, value in self.single("pressure").items():
            push = -as_scalar(value) * self.normal
            loads[name] = loads[name] + push if name in loads else push
        return loads

    @property
    def tractions(self) -> dict[str, CoefficientFunction]:
        """Single boundary name -> g as a vector-valued coefficient, pressure included."""
        return {name: g for name, g in self.loads.items() if isinstance(name, str)}

    @property
    def held(self) -> list[tuple[str, Place, int, Coefficient]]:
        """(argument, single place, component, displacement) of all supports."""
        given = [
            (f"clamped={name!r}", name, (0.0,) * self.N) for name in self.clamped_names
        ]
        each = self.single("prescribed").items()
        given += [
            (f"prescribed[{p!r}]", p, c) for p, c in each if not isinstance(c, Roller)
        ]
        return [
            (a, p, i, u) for a, p, c in given for i, u in enumerate(c) if u is not None
        ]

    @property
    def rollers(self) -> dict[Place, Roller]:
        """Single place -> its support along one direction."""
        return {
            p: c for p, c in self.single("prescribed").items() if isinstance(c, Roller)
        }

    @property
    def spring_constants(self) -> dict[Place, list[tuple]]:
        """Single place -> (direction, stiffness along it), None for the normal."""
        axes = np.eye(self.N).tolist()
        given = self.single("springs")
        return {
            place: list(zip(axes, k, strict=True))
            if isinstance(k, Components)
            else [(None, k)]
            for place, k in given.items()
        }

    @property
    def gaps(self) -> dict[str, CoefficientFunction]:
        """Single contact boundary name -> psi as a scalar coefficient."""
        return {name: as_scalar(gap) for name, gap in self.given_gaps.items()}

    @property
    def given_gaps(self) -> dict[str, Coefficient]:
        """Single contact boundary name -> its gap as it was given."""
        names = self.contact_names
        if not isinstance(self.gap, Mapping):
            return dict.fromkeys(names, self.gap)
        given = self.single("gap")
        return {name: given[name] for name in names}

    @property
    def psi(self) -> CoefficientFunction:
        """The gap on the whole contact boundary, zero elsewhere."""
        return self.mesh.BoundaryCF(self.gaps, default=0.0)

    @property
    def f(self) -> CoefficientFunction | None:
        """Body force as a vector-valued coefficient, or None."""
        f = self.body_force
        return None if f is None else require_components("body_force", f, self.N)

    @property
    def u_0(self) -> CoefficientFunction | None:
        """Displacement at the beginning of the step as a vector-valued coefficient, or None."""
        u_0 = self.initial_displacement
        return (
            None
            if u_0 is None
            else require_components("initial_displacement", u_0, self.N)
        )

    @property
    def p_0(self) -> CoefficientFunction:
        """Initial plastic strain, a tensor."""
        p_0 = self.initial_plastic_strain
        return self.kinematics.zero() if p_0 is None else p_0

    @property
    def eps_0(self) -> CoefficientFunction:
        """Initial strain, a tensor."""
        given = self.initial_strain
        if given is None:
            return self.kinematics.zero()
        tensor = len(getattr(given, "dims", ())) == 2
        return given if tensor else as_scalar(given) * Id(self.kinematics.size)

    @property
    def alpha_0(self) -> tuple[CoefficientFunction, CoefficientFunction]:
        """Initial hardening (alpha_1, dev alpha_2): a scalar and a tensor."""
        scalar, back_stress = split_hardening(self.initial_hardening)
        back_stress = self.kinematics.zero() if back_stress is None else back_stress
        return as_scalar(scalar or 0.0), self.kinematics.deviator(back_stress)

    @property
    def accumulated_0(self) -> CoefficientFunction:
        """PEEQ at the beginning of the step, scalar."""
        return as_scalar(self.initial_accumulated or 0.0)

    @property
    def rate(self) -> RateLaw | None:
        """The law of the rate, or None; ValueError if the duration of the time step is missing."""
        law = self.material.rate
        if law is not None and self.duration is None:
            needed = (
                "duration= is needed, the length of the time step; evolve sets it if the steps "
                "begin before the first time, see Schedule(begin=...)"
            )
            raise ValueError(
                f"material.rate={in_words(law)} without a time step: {needed}"
            )
        return law

    @property
    def effective_hardening(self) -> CoefficientFunction:
        """The scalar h in H~ p : p = h |p|^2."""
        return as_scalar(self.material.effective_hardening)

    @property
    def beta(self) -> Coefficient:
        """The yield bound, a number if the data are numbers."""
        scalar, _ = split_hardening(self.initial_hardening)
        return self.material.yield_bound(scalar or 0.0, self.initial_accumulated or 0.0)


def same_fields(one: ProblemData, other: ProblemData, *names: str) -> bool:
    """Whether two problems have the same objects in some fields."""
    return all(getattr(one, name) is getattr(other, name) for name in names)


def as_scalar(value: Coefficient) -> CoefficientFunction:
    """A number or scalar coefficient as a CoefficientFunction."""
    return as_constant(value) if is_number(value) else value


def of_order_one(problem: ProblemData) -> ProblemData:
    """The same problem with displacements of order 1, if the order is the default one."""
    if not isinstance(problem.order, DefaultOrder) or problem.order == 1:
        return problem
    other = copy(problem)
    vars(other)["order"] = 1
    return other


def order_note(problem: ProblemData, why: str = "") -> str:
    """A note on displacements of order 1 for the user; empty with the law of the paper."""
    if problem.order > 1 or problem.kinematics is TWO_DIMENSIONAL:
        return ""
    return (
        f"Displacements are of order 1{why}: they are too stiff in bending and where plastic flow "
        "preserves the volume (docs/locking.md)."
    )


def moved_gap(gap: object, distance: float) -> object:
    """A gap, or gaps by boundary, increased by a distance."""
    if isinstance(gap, Mapping):
        return {name: moved_gap(one, distance) for name, one in gap.items()}
    return gap + distance
