"""Tangents as forms that NGSolve assembles: slower than sums over elements, but formulas."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from ngsolve import CF, BilinearForm, InnerProduct, Mesh, Trace, dx
from ngsolve.comp import ProxyFunction, SumOfIntegrals

from ngepc.discretisation.moduli import Moduli
from ngepc.discretisation.points import Points
from ngepc.discretisation.stiffness import Stiffness


class SymbolicStiffness(Stiffness):
    """A tangent assembled by a symbolic form of NGSolve: slower, but the formula is visible.

    ``form`` maps a trial and a test function to the form, ``enter`` sets its coefficients for given
    data.
    """

    def __init__(
        self,
        mesh: Mesh,
        order: int,
        free: np.ndarray,
        form: Callable[[ProxyFunction, ProxyFunction], SumOfIntegrals],
        enter: Callable[[Any], object],
    ) -> None:
        super().__init__(mesh, order, free)
        self._form = BilinearForm(self._space, symmetric=True, symmetric_storage=True)
        self._form += form(*self._space.TnT())
        self._enter = enter

    def summed(self, data: Any, out: np.ndarray | None = None) -> np.ndarray:
        """See ``Stiffness``."""
        self._enter(data)
        blocks = self.entries(self._form.Assemble().mat)
        if out is None:
            return blocks
        out[:] = blocks
        return out


def by_moduli(points: Points, free: np.ndarray) -> SymbolicStiffness:
    """The same as ``ElementStiffness``."""
    functions = points.functions
    kinematics = points.kinematics
    s = 1 + kinematics.d
    count = len(points)
    shapes = [(count,)] * 3 + [(count, kinematics.d), (count, s * s)]
    known = [functions.function(np.zeros(shape)) for shape in shapes]

    def form(u: ProxyFunction, v: ProxyFunction) -> SumOfIntegrals:
        """The stiffness form with the moduli of the points."""
        bulk, across, extra, direction, coupling = known
        strain_u = kinematics.strain(u)
        strain_v = kinematics.strain(v)
        volume_u = Trace(strain_u)
        volume_v = Trace(strain_v)
        e = kinematics.coordinates(strain_u)
        d = kinematics.coordinates(strain_v)

        along = InnerProduct(direction, e) * InnerProduct(direction, d)
        power = bulk * volume_u * volume_v + across * InnerProduct(e, d)
        power = power + extra * along
        if kinematics.thin:
            matrix = CF(tuple(coupling[i] for i in range(s * s)), dims=(s, s))
            stresses = matrix * CF((volume_u, e))
            power = power + InnerProduct(stresses, CF((volume_v, d)))
        return (kinematics.weight * power).Compile() * dx(intrules=points.rules)

    def enter(moduli: Moduli) -> None:
        """Store moduli in the functions of the form."""
        data = (moduli.bulk, moduli.across, moduli.extra, moduli.direction)
        if moduli.coupling is not None:
            data = (*data, moduli.coupling.reshape(count, -1))
        for function, values in zip(known, data, strict=False):
            function.vec.data = functions.function(values).vec

    return SymbolicStiffness(points.mesh, points.order, free, form, enter)
