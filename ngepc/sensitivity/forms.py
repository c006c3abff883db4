"""Forms of NGSolve as functionals, and how users name one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from inspect import signature

import numpy as np
from ngsolve import (
    H1,
    BilinearForm,
    CoefficientFunction,
    GridFunction,
    Id,
    InnerProduct,
    Variation,
    ds,
    dx,
)
from ngsolve.comp import SumOfIntegrals

from ngepc.checks.kinds import require_attributes, require_instance, require_text
from ngepc.discretisation.loads import nodal
from ngepc.discretisation.pointfunctions import PointFunctions
from ngepc.local.system import State
from ngepc.sensitivity.functionals import NAMES, Functional, Slope

Form = Callable[..., SumOfIntegrals]
"""(u, plastic strain p_0 + p, stress) -> integrals of them; a fourth argument is the pressure."""


@dataclass(frozen=True, eq=False)
class FormFunctional:
    """Integrals of displacement, plastic strain, stress and contact pressure.

    Plastic strain and stress are the polynomials through their values at the points; they have no
    values on boundaries.

    The form is called with the displacement u, the plastic strain p_0 + p and the stress, two
    tensors, and the ``contact_pressure`` of results if it takes four arguments; it returns
    integrals such as ``InnerProduct(u, u) * ds("contact")``.
    """

    form: Form

    def slope(self, state: State) -> Slope:
        """Value and derivative at a state, by ``Variation`` of the form.

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
        form, here = BilinearForm(space), GridFunction(space)
        form += Variation(integrals)
        values = [state.u.T.ravel(), *(part.vec.FV().NumPy() for part in parts), pressure]
        for field, numbers in zip(here.components, values, strict=True):
            field.vec.FV().NumPy()[:] = numbers
        slope = GridFunction(space)
        form.Apply(here.vec, slope.vec)
        of_u, *of_points, of_pressure = (c.vec.FV().NumPy() for c in slope.components)
        contact = np.zeros_like(state.contact)
        contact[: len(rows)] = share * of_pressure[rows.vertices]
        d, weights = kinematics.d, points.weights[:, None]
        of_p, of_tau, of_mean = (
            functions.transposed(v, k) / weights for v, k in zip(of_points, (d, d, 1), strict=True)
        )
        return Slope(
            float(form.Energy(here.vec)),
            u=nodal(of_u, discrete.problem).copy(),
            p=of_p,
            stress=of_tau,
            mean=of_mean[:, 0],
            contact=contact,
            explicit={"initial": of_p},
        )


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
