"""Functionals of a solution with their derivatives: forces, energies, displacements, integrals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature
from types import SimpleNamespace
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from ngsolve import (
    H1,
    VOL,
    BilinearForm,
    CoefficientFunction,
    ElementId,
    GridFunction,
    Id,
    InnerProduct,
    Variation,
    ds,
    dx,
)
from ngsolve.comp import SumOfIntegrals

from ngepc.checks.arguments import boundary_names, require_integer, require_vector
from ngepc.checks.declared import Check, Declared, Text, Vector
from ngepc.checks.kinds import require_attributes, require_instance, require_text
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.pointfunctions import PointFunctions
from ngepc.local.system import State
from ngepc.sensitivity.contact import RowSides
from ngepc.sensitivity.radial import Data


class Slope(NamedTuple):
    """The value of a functional at a state, and the derivatives by the solution and by data."""

    value: float
    by: Data


class Functional(Protocol):
    """What derivatives are taken of."""

    def slope(self, state: State) -> Slope:
        """Value and derivatives at a state."""
        ...


def _contact_force(state: State) -> Slope:
    """The resultant of the normal contact forces, positive in compression (force)."""
    contact, pressing = np.zeros_like(state.contact), ~state.discrete.rows.tied
    contact[: len(pressing)] = pressing
    return Slope(float(contact @ state.contact), Data(contact=contact))


def _primal_energy(state: State) -> Slope:
    """J(u, p) of (2.14), with the sum of b |slip| where there is friction (force times length).

    p is best for u, so that J depends on u and on the data.
    """
    law, at = state.discrete.law, state.at
    elastic = law.stress(at) / law.two_mu[:, None]
    sides, still = RowSides(state), np.zeros(len(state.multipliers))
    slip, bound = (np.where(sides.slips, a, 0.0) for a in (sides.slip, sides.bound))
    dragged = state.discrete.contact.forces(sides.stacked(still, bound))
    by = Data(
        u=state.internal_forces - state.discrete.load + dragged,
        contact=sides.stacked(sides.coefficient * slip, still),
        two_mu=0.5 * ((elastic**2).sum(1) - (law.initial**2).sum(1)),
        bulk=0.5 * state.volume**2,
        hardening=0.5 * at.gained**2,
        beta=at.gained,
        back=at.plastic_strain,
        initial=-law.two_mu[:, None] * (elastic + law.initial),
        load=-state.u,
        start=-dragged,
        cap=np.where(sides.grows, 0.0, slip),
        coefficient=np.where(sides.grows, state.multipliers * slip, 0.0),
    )
    return Slope(state.energy, by)


def _elastic_energy(state: State) -> Slope:
    """1/2 int sigma : (eps(u) - p_0 - p), what the body gives back (force times length)."""
    law = state.discrete.law
    elastic = law.stress(state.at) / law.two_mu[:, None]
    shapes, volumes = 0.5 * (elastic**2).sum(axis=1), 0.5 * state.volume**2
    energy = state.discrete.points.integral(law.bulk * volumes + law.two_mu * shapes)
    by = Data(stress=elastic, mean=state.volume, bulk=-volumes, two_mu=-shapes)
    return Slope(energy, by)


def _dissipation(state: State) -> Slope:
    """Int beta |p|, what the plastic strain of the step costs (force times length)."""
    beta, at = state.discrete.law.beta, state.at
    value = state.discrete.points.integral(beta * at.gained)
    return Slope(value, Data(p=beta[:, None] * at.direction, beta=at.gained))


_SLOPES = (_contact_force, _primal_energy, _elastic_energy, _dissipation)
NAMES = {slope.__name__[1:]: SimpleNamespace(slope=slope) for slope in _SLOPES}
"""Functionals that a name is enough for."""


Component = Annotated[int, Check(require_integer, least=0, most=2)]


@dataclass(frozen=True)
class DisplacementAt(Declared):
    """One component of the displacement at a point (length).

    Parameters
    ----------
    point
        N coordinates, in the body.
    component
        0, 1 or 2.
    """

    point: Vector
    component: Component

    def slope(self, state: State) -> Slope:
        """Value and derivatives at a state.

        Raises
        ------
        TypeError, ValueError
            If the point is not in the body, or there is no such component.
        """
        points, N = state.discrete.points, state.discrete.problem.N
        place = require_vector("point", self.point, (N,))
        component = require_integer("component", self.component, 0, N - 1)
        if not points.mesh.Contains(*place):
            raise ValueError(f"point={self.point!r}: a point in the body is needed")
        there = points.mesh(*place)
        element = ElementId(VOL, there.nr)
        shape = np.array(points.scalar.GetFE(element).CalcShape(*there.pnt))
        u = np.zeros_like(state.u)
        u[list(points.scalar.GetDofNrs(element)), component] = shape
        return Slope(float(np.vdot(u, state.u)), Data(u=u))


@dataclass(frozen=True)
class Reaction(Declared):
    """One component of the force of a support on the body (force).

    Parameters
    ----------
    support
        Name of a clamped or prescribed boundary.
    component
        0, 1 or 2.
    """

    support: Text
    component: Component

    def slope(self, state: State) -> Slope:
        """Value and derivatives at a state: the work of all forces in a motion of the support.

        Raises
        ------
        TypeError, ValueError
            If there is no such support or component.
        """
        discrete, problem = state.discrete, state.discrete.problem
        component = require_integer("component", self.component, 0, problem.N - 1)
        (name,) = boundary_names("support", self.support, problem.mesh)
        region = problem.mesh.Boundaries(name)
        there = np.array(discrete.supports.space.components[component].GetDofs(region), dtype=bool)
        there[problem.mesh.nv :] = False
        motion = np.zeros_like(state.u)
        motion[there, component] = ~discrete.supports.free[there, component]
        if not motion.any():
            raise ValueError(f"support={self.support!r}: it does not hold component {component}")
        volume, e = discrete.points.strain(motion)
        by = Data(u=discrete.supports.pull(motion), stress=e, mean=volume, load=-motion)
        by["contact"] = discrete.contact.displacement(motion)
        return Slope(float(np.vdot(motion, state.missing)), by)


Form = Callable[..., SumOfIntegrals]
"""(u, plastic strain p_0 + p, stress) -> integrals of them; a fourth argument is the pressure."""


@dataclass(frozen=True, eq=False)
class FormFunctional:
    """Integrals of displacement, plastic strain, stress and contact pressure.

    The form is called with the displacement u, the plastic strain p_0 + p and the stress, two
    tensors, and the ``contact_pressure`` of results if it takes four arguments; it returns
    integrals such as ``InnerProduct(u, u) * ds("contact")``.  Plastic strain and stress are the
    polynomials through their values at the points; they have no values on boundaries.
    """

    form: Form

    def slope(self, state: State) -> Slope:
        """Value and derivatives at a state, by ``Variation`` of the form.

        TypeError if the form does not return integrals.
        """
        discrete, rows, mesh = state.discrete, state.discrete.rows, state.discrete.problem.mesh
        points, law = discrete.points, discrete.law
        functions, kinematics = PointFunctions(points), points.kinematics
        stress = law.stress(state.at), law.bulk * state.volume
        parts = [functions.function(v) for v in (law.initial + state.at.plastic_strain, *stress)]
        area = np.bincount(rows.vertices, rows.weights, mesh.nv)[rows.vertices]
        share = np.where(rows.tied, 0.0, 1 / area)
        pressure = np.bincount(rows.vertices, share * state.multipliers, mesh.nv)
        space = discrete.supports.space
        for part in (*(part.space for part in parts), H1(mesh, order=1)):
            space = space * part
        (u, p, tau, mean, on_contact), _ = space.TnT()
        sigma = mean * Id(kinematics.size) + kinematics.tensor(tau)
        given = (u, kinematics.tensor(p), sigma, on_contact)
        integrals = self.form(*given[: len(signature(self.form).parameters)])
        if not isinstance(integrals, SumOfIntegrals):
            raise TypeError(f"functional returned {integrals!r}: integrals are needed")
        form, here, slope = BilinearForm(space), GridFunction(space), GridFunction(space)
        form += Variation(integrals)
        values = [state.u.T.ravel(), *(part.vec.FV().NumPy() for part in parts), pressure]
        for field, numbers in zip(here.components, values, strict=True):
            field.vec.FV().NumPy()[:] = numbers
        form.Apply(here.vec, slope.vec)
        of_u, *of_points, of_pressure = (c.vec.FV().NumPy() for c in slope.components)
        contact = np.zeros_like(state.contact)
        contact[: len(rows)] = share * of_pressure[rows.vertices]
        of_p, of_tau, of_mean = (
            functions.transposed(v, k) / points.weights[:, None]
            for v, k in zip(of_points, (kinematics.d, kinematics.d, 1), strict=True)
        )
        by = Data(u=nodal(of_u, discrete.problem).copy(), contact=contact)
        by += Data(p=of_p, initial=of_p, stress=of_tau, mean=of_mean[:, 0])
        return Slope(float(form.Energy(here.vec)), by)


def misfit(observed: CoefficientFunction, boundary: str | None = None) -> FormFunctional:
    """Int |u - observed|^2 over a boundary, or over the body."""
    require_instance("observed", observed, CoefficientFunction, "a vector coefficient")
    require_text("boundary", boundary, optional=True)
    measure = dx if boundary is None else ds(boundary)
    return FormFunctional(lambda u, p, stress: InnerProduct(u - observed, u - observed) * measure)


def as_functional(functional: object) -> Functional:
    """A functional from its name, a form, or itself.

    TypeError, ValueError if it is none of them.
    """
    if isinstance(functional, str):
        if functional not in NAMES:
            raise ValueError(f"functional={functional!r}: one of {', '.join(NAMES)} is needed")
        return NAMES[functional]
    if callable(functional):
        return FormFunctional(functional)
    require_attributes("functional", functional, ["slope"], "a name, a form or a functional")
    return functional
