"""Functionals of a solution with their derivatives: forces, energies, displacements, integrals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from inspect import signature
from types import SimpleNamespace
from typing import NamedTuple

import ngsolve as ngs
import numpy as np
from netgen.meshing import NgException
from ngsolve.comp import SumOfIntegrals

from ngepc.checks.arguments import (
    boundary_names,
    require_coefficient,
    require_component,
    require_vector,
)
from ngepc.checks.kinds import require_attributes, require_instance, require_text
from ngepc.checks.sentences import in_words
from ngepc.discretisation.hill_law import HillLaw
from ngepc.discretisation.spaces import nodal
from ngepc.discretisation.supports import support_motion
from ngepc.goals.kinds import PointDisplacement, SupportReaction
from ngepc.local.system import State
from ngepc.model.located import located
from ngepc.sensitivity.contact import LinearContact
from ngepc.sensitivity.equations import Data
from ngepc.sensitivity.law_equations import (
    YieldSurface,
    equations_of_law,
    form_slope,
    yield_surfaces_of,
)
from ngepc.sensitivity.shape import on_moving_mesh

ACROSS = 1e-9
"""The component of a unit vector below which a roller does not hold it."""


class Slope(NamedTuple):
    """The value of a functional at a state, and the derivatives by the solution and by data."""

    value: float
    by: Data


def _contact_force(state: State) -> Slope:
    """The resultant of the normal contact forces, positive in compression (force)."""
    contact = np.zeros_like(state.contact)
    pressing = ~state.discrete.rows.tied
    contact[: len(pressing)] = pressing
    return Slope(float(contact @ state.contact), Data(contact=contact))


def _primal_energy(state: State) -> Slope:
    """J(u, p) of (2.14), with the sum of b |slip| where there is friction (force times length).

    p minimises J for given u, so that J depends on u and the data alone.
    """
    law = state.discrete.law
    weights = state.discrete.points.weights
    mean, stress = law.stress(state.at)
    contact = LinearContact(state)
    still = np.zeros(len(state.multipliers))
    slid = -(contact.along * contact.law.split(state.gaps)[1]).sum(axis=1)
    slip = np.where(contact.slips, np.maximum(slid, 0.0), 0.0)
    bound = np.where(contact.slips, contact.bound, 0.0)
    dragged = state.discrete.contact.forces(contact.stacked(still, bound))
    density = Data(bulk=0.5 * state.volume**2, volume=mean, strain=stress)
    for surface in yield_surfaces_of(state):
        density += _stored(surface)
    by = weights * density
    by += Data(
        u=state.discrete.supports.pull(state.u) - state.discrete.load + dragged,
        contact=contact.stacked(contact.coefficient * slip, still),
        load=-state.u,
        start=-dragged,
        cap=np.where(contact.grows, 0.0, slip),
        coefficient=np.where(contact.grows, state.multipliers * slip, 0.0),
    )
    return Slope(state.energy, by)


def _stored(surface: YieldSurface) -> Data:
    """The derivatives of the energy of a yield surface by its data; p minimises the energy."""
    law, at, _ = surface
    named = surface.named
    elastic = law.stress(at)[1] / law.two_mu[:, None]
    p = at.plastic_strain
    by = Data(hardening=0.5 * np.einsum("pd,pd->p", p, p), back=p)
    by[named("two_mu")] = 0.5 * ((elastic**2).sum(1) - (law.initial**2).sum(1))
    by[named("hardened")] = np.ones(len(p))
    by[named("initial")] = -law.two_mu[:, None] * (elastic + law.initial)
    if isinstance(law, HillLaw):
        by["form"] = at.radius[:, None, None] * form_slope(surface)
    return by


def _elastic_energy(state: State) -> Slope:
    """1/2 int sigma : (eps(u) - p_0 - p), the elastic energy (force times length)."""
    law = state.discrete.law
    points = state.discrete.points
    elastic = law.stress(state.at)[1] / law.two_mu[:, None]
    shapes = 0.5 * (elastic**2).sum(axis=1)
    volumes = 0.5 * state.volume**2
    by = Data(stress=elastic, mean=state.volume, bulk=-volumes, two_mu=-shapes)
    return Slope(
        points.integral(law.bulk * volumes + law.two_mu * shapes), points.weights * by
    )


def _dissipation(state: State) -> Slope:
    """Int beta |p| with the yield bound at the beginning of the step (force times length)."""
    points = state.discrete.points
    by = Data()
    for surface in yield_surfaces_of(state):
        bound = surface.law.beta
        gained = surface.at.gained
        by[surface.named("gained")] = bound
        by[surface.named("beta")] = gained
    lost = state.discrete.law.lost(state.at)
    return Slope(points.integral(lost), points.weights * by)


_NAMED = (_contact_force, _primal_energy, _elastic_energy, _dissipation)
NAMES = {function.__name__.lstrip("_"): function for function in _NAMED}


@dataclass(frozen=True)
class DisplacementAt(PointDisplacement):
    """One component of the displacement at a point (length).

    Parameters
    ----------
    point
        N coordinates, in the body.
    component
        0, 1 or 2.
    """

    def slope(self, state: State) -> Slope:
        """Value and derivatives at a state; ValueError if the point is not in the body."""
        points = state.discrete.points
        N = state.discrete.problem.N
        place = require_vector("point", self.point, (N,))
        component = require_component("component", self.component, N)
        there = located(points.mesh, np.array([place]))[0]
        if there["nr"] < 0:
            raise ValueError(f"point={self.point!r}: a point in the body is needed")
        element = ngs.ElementId(ngs.VOL, int(there["nr"]))
        inside = (float(there[axis]) for axis in "xyz")
        shape = np.array(points.scalar.GetFE(element).CalcShape(*inside))
        u = np.zeros_like(state.u)
        u[list(points.scalar.GetDofNrs(element)), component] = shape
        return Slope(float(np.vdot(u, state.u)), Data(u=u))


@dataclass(frozen=True)
class Reaction(SupportReaction):
    """One component of the force of a support on the body (force).

    Parameters
    ----------
    support
        Name of a clamped or prescribed boundary, or of several, 'a|b'.  A node that other supports
        hold, too, counts by an equal share of its force, as in ``equilibrium.reactions``.
    component
        0, 1 or 2.
    """

    def slope(self, state: State) -> Slope:
        """Value and derivatives: the work of all forces in a unit motion of the support.

        ValueError if the support does not hold the component.
        """
        problem = state.discrete.problem
        component = require_component("component", self.component, problem.N)
        names = boundary_names("support", self.support, problem.mesh)
        rolled = [name for name in names if name in problem.rollers]
        fixed = "|".join(name for name in names if name not in rolled)
        parts = [self._of_roller(state, name, component) for name in rolled]
        if fixed:
            parts.append(_of_components(state, fixed, component))
        by = Data()
        for part in parts:
            by += part.by
        return Slope(sum(part.value for part in parts), by)

    def _of_roller(self, state: State, name: str, component: int) -> Slope:
        """The part of the forces of a roller's rows, whatever its direction is."""
        contact = state.discrete.contact
        translation = np.zeros_like(state.u)
        translation[: state.discrete.problem.mesh.nv, component] = 1.0
        own = contact.rollers[name]
        along = np.zeros(len(contact))
        along[own] = -contact.displacement(translation)[own]
        if np.abs(along).max(initial=0.0) < ACROSS:
            raise ValueError(
                f"support={self.support!r}: it does not hold component {component}"
            )
        return Slope(float(along @ state.contact), Data(contact=along))


def _of_components(state: State, support: str, component: int) -> Slope:
    """A component of the force of a support that holds components."""
    discrete = state.discrete
    motion = support_motion(discrete.problem, support, component)
    volume, e = discrete.points.strain(motion)
    by = discrete.points.weights * Data(stress=e, mean=volume)
    by += Data(u=discrete.supports.pull(motion), load=-motion)
    by["contact"] = discrete.contact.displacement(motion)
    return Slope(float(np.vdot(motion, state.residual_force)), by)


Functional = DisplacementAt | Reaction
"""A functional: an object with ``slope``, which returns its value and derivatives."""

Form = Callable[..., SumOfIntegrals]
"""A function (u, plastic strain, stress) or (u, plastic strain, stress, pressure) -> integrals.

u is the displacement, the plastic strain p_0 + p and the stress are tensors, the pressure is the
``contact_pressure`` of results.  An example of an integral is ``InnerProduct(u, u) *
ds("contact")``.  Plastic strain and stress are the polynomials that interpolate their values at the
points; they have no values on boundaries.  An integral over no part of the mesh, as by a misspelt
name, is refused; among several names, 'a|b', NGSolve ignores one that the mesh does not have.
"""


def _of_form(form: Form, state: State) -> Slope:
    """Value and derivatives of a form, by ``Variation``; TypeError if it returns no integrals."""
    discrete = state.discrete
    rows = state.discrete.rows
    mesh = state.discrete.problem.mesh
    law = discrete.law
    functions = discrete.points.functions
    kinematics = discrete.points.kinematics
    total = law.initial + state.at.plastic_strain
    mean, deviator = law.stress(state.at)
    values = {"p": total, "stress": deviator, "mean": mean}
    parts = [functions.function(value) for value in values.values()]
    area = discrete.contact.vertex_areas
    forces = rows.at_vertices(np.where(rows.tied, 0.0, state.multipliers), mesh.nv)
    share = 1 / np.where(area > 0, area, np.inf)
    pressure = share * forces
    space = discrete.supports.space
    for part in (*(part.space for part in parts), ngs.H1(mesh, order=1)):
        space = space * part
    (u, p, tau, mean, on_contact), _ = space.TnT()
    sigma = mean * ngs.Id(kinematics.size) + kinematics.tensor(tau)
    given = (u, kinematics.tensor(p), sigma, on_contact)
    integrals = form(*given[: len(signature(form).parameters)])
    _require_integrals(integrals, mesh)
    varied = ngs.BilinearForm(space)
    here = ngs.GridFunction(space)
    slope = ngs.GridFunction(space)
    varied += ngs.Variation(integrals)
    vectors = state.u.T.ravel(), *(part.vec.FV().NumPy() for part in parts), pressure
    here.vec.FV().NumPy()[:] = np.concatenate(vectors)
    varied.Apply(here.vec, slope.vec)
    of_u, *of_points, of_pressure = (c.vec.FV().NumPy() for c in slope.components)
    contact = np.zeros_like(state.contact)
    of_rows = rows.between(share * of_pressure)
    contact[: len(rows)] = np.where(rows.tied, 0.0, of_rows)
    by = Data(u=nodal(of_u, discrete.problem).copy(), contact=contact)
    for (name, value), of in zip(values.items(), of_points, strict=True):
        by[name] = functions.transposed(of, value.size // len(value)).reshape(
            value.shape
        )
    return Slope(float(varied.Energy(here.vec)), by + Data(initial=by["p"]))


def _require_integrals(integrals: object, mesh: ngs.Mesh) -> None:
    """TypeError for something else, ValueError if one of them is over no part of the mesh."""
    if not isinstance(integrals, SumOfIntegrals):
        raise TypeError(f"functional returned {integrals!r}: integrals are needed")
    for integral in integrals:
        try:
            measure = ngs.Integrate(ngs.CF(1.0) * integral.symbol, mesh)
        except NgException:  # over inner facets
            continue
        if measure == 0:
            boundaries = in_words(sorted(set(mesh.GetBoundaries())))
            materials = in_words(sorted(set(mesh.GetMaterials())))
            raise ValueError(
                "functional has an integral over no part of the mesh: names of its boundaries "
                f"{boundaries}, or of its materials {materials}, are needed"
            )


def misfit(
    observed: ngs.CoefficientFunction, boundary: str | None = None
) -> Functional:
    """Int |u - observed|^2 over a boundary, or over the body."""
    require_instance(
        "observed", observed, ngs.CoefficientFunction, "a vector coefficient"
    )
    require_text("boundary", boundary, optional=True)
    return SimpleNamespace(slope=partial(_misfit, observed, boundary))


def _misfit(
    observed: ngs.CoefficientFunction, boundary: str | None, state: State
) -> Slope:
    """The same for a state; ValueError for other components, and names that are no boundary."""
    problem = state.discrete.problem
    require_coefficient("observed", observed, [(problem.N,)])
    measure = ngs.dx
    if boundary is not None:
        names = boundary_names("boundary", boundary, problem.mesh)
        measure = ngs.ds("|".join(names))

    def squared(u: ngs.CoefficientFunction, _p: object, _s: object) -> SumOfIntegrals:
        """The integral of the squared difference."""
        return ngs.InnerProduct(u - observed, u - observed) * measure

    return _of_form(squared, state)


def _require_arguments(form: Form) -> None:
    """TypeError if a form has other than three or four arguments."""
    count = len(signature(form).parameters)
    if count not in (3, 4):
        raise TypeError(
            f"functional={in_words(form)}: a function (u, p, stress) or (u, p, stress, pressure) "
            f"that returns integrals is needed, such as lambda u, p, stress: u[0] * ds('right'); "
            f"it has {count} argument{'s' * (count != 1)}"
        )


def as_functional(functional: object) -> Functional:
    """A functional from its name, a form, or itself.

    TypeError, ValueError if it is none of them.
    """
    if isinstance(functional, str):
        if functional not in NAMES:
            raise ValueError(
                f"functional={in_words(functional)}: one of {', '.join(NAMES)} is needed"
            )
        functional = SimpleNamespace(slope=NAMES[functional])
    elif callable(functional):
        _require_arguments(functional)
        functional = SimpleNamespace(slope=partial(_of_form, functional))
    require_attributes(
        "functional", functional, ["slope"], "a name, a form or a functional"
    )
    return functional


def slope_by_mesh(functional: Functional, state: State, change: Data) -> float:
    """The contribution of a motion of the mesh to the derivative of a functional."""
    if "shape" not in change:
        return 0.0
    found = on_moving_mesh(
        state, change["shape"], lambda there: functional.slope(there).value
    )
    data = equations_of_law(state).forward(found)
    carried = functional.slope(state).by.paired(data)
    return float(found["value"]) - carried
