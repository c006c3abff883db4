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
from ngepc.sensitivity.functionals import (
    ContactForce,
    Dissipation,
    ElasticEnergy,
    Functional,
    PrimalEnergy,
    Slope,
)

Form = Callable[..., SumOfIntegrals]
"""(u, plastic strain p_0 + p, stress) -> integrals of them; a fourth argument is the pressure."""


@dataclass(frozen=True, eq=False)
class FormFunctional:
    """Integrals of displacement, plastic strain, stress and contact pressure.

    Plastic strain and stress are the polynomials through their values at the points; they have no
    values on boundaries.

    Parameters
    ----------
    form
        Called with the displacement u, the plastic strain p_0 + p and the stress, two tensors, and
        the ``contact_pressure`` of results if it takes four arguments; returns integrals such as
        ``InnerProduct(u, u) * ds("contact")``.
    """

    form: Form

    def slope(self, state: State) -> Slope:
        """Value and derivative at a state, by ``Variation`` of the form.

        Raises
        ------
        TypeError
            If the form does not return integrals.
        """
        discrete, kinematics = state.discrete, state.discrete.points.kinematics
        law, d, functions = discrete.law, kinematics.d, PointFunctions(discrete.points)
        parts = (
            functions.function(law.initial + state.at.plastic_strain),
            functions.function(law.stress(state.at)),
            functions.function(law.bulk * state.volume),
        )
        rows, mesh = discrete.rows, discrete.problem.mesh
        area = np.bincount(rows.vertices, rows.weights, mesh.nv)[rows.vertices]
        share = np.where(rows.tied, 0.0, 1 / area)
        pressure = np.bincount(rows.vertices, share * state.multipliers, mesh.nv)
        space = discrete.supports.space
        for part in parts:
            space = space * part.space
        space = space * H1(mesh, order=1)
        (u, p, tau, mean, on_contact), _ = space.TnT()
        stress = mean * Id(kinematics.size) + kinematics.tensor(tau)
        given = (u, kinematics.tensor(p), stress, on_contact)
        integrals = self.form(*given[: len(signature(self.form).parameters)])
        if not isinstance(integrals, SumOfIntegrals):
            raise TypeError(f"functional returned {integrals!r}: integrals are needed")
        form = BilinearForm(space)
        form += Variation(integrals)
        vectors = [state.u.T.ravel(), *(part.vec.FV().NumPy() for part in parts), pressure]
        value, slope = _value_and_slope(form, np.concatenate(vectors))
        cuts = np.cumsum([len(v) for v in vectors])[:-1]
        of_u, of_p, of_tau, of_mean, of_pressure = np.split(slope, cuts)
        contact = np.zeros_like(state.contact)
        contact[: len(rows)] = share * of_pressure[rows.vertices]
        weights = discrete.points.weights
        of_p, of_tau = (functions.transposed(v, d) / weights[:, None] for v in (of_p, of_tau))
        return Slope(
            value,
            u=nodal(of_u, discrete.problem),
            p=of_p,
            stress=of_tau,
            mean=functions.transposed(of_mean, 1)[:, 0] / weights,
            contact=contact,
            explicit={"initial": of_p},
        )


def _value_and_slope(form: BilinearForm, coefficients: np.ndarray) -> tuple[float, np.ndarray]:
    here = GridFunction(form.space).vec
    here.FV().NumPy()[:] = coefficients
    slope = here.CreateVector()
    form.Apply(here, slope)
    return float(form.Energy(here)), slope.FV().NumPy().copy()


def misfit(observed: CoefficientFunction, boundary: str | None = None) -> FormFunctional:
    """Int |u - observed|^2 over a boundary, or over the body."""
    require_instance("observed", observed, CoefficientFunction, "a vector coefficient")
    require_text("boundary", boundary, optional=True)
    measure = dx if boundary is None else ds(boundary)
    return FormFunctional(lambda u, p, stress: InnerProduct(u - observed, u - observed) * measure)


NAMES = {
    "contact_force": ContactForce(),
    "primal_energy": PrimalEnergy(),
    "elastic_energy": ElasticEnergy(),
    "dissipation": Dissipation(),
}
"""Functionals that a name is enough for."""


def as_functional(functional: object) -> Functional:
    """A functional from its name, a form, or itself.

    Raises
    ------
    TypeError, ValueError
        If it is none of them.
    """
    if isinstance(functional, str):
        if functional not in NAMES:
            raise ValueError(f"functional={functional!r}: one of {', '.join(NAMES)} is needed")
        return NAMES[functional]
    if callable(functional):
        return FormFunctional(functional)
    require_attributes("functional", functional, ["slope"], "a name, a form or a functional")
    return functional
