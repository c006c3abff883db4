"""An earlier result as the start of another problem: on another mesh, with another gamma.

Nodal values are carried over by P1 interpolation.  What belongs together in two regularisations
are equal multipliers: |p| = gamma_q [|q| - threshold]^+ and mu = gamma_z [z]^+, so that the excess
of |q| and of z is scaled by the quotient of the gammas.
"""

from __future__ import annotations

import numpy as np
from ngsolve import H1, GridFunction, Mesh
from ngsolve.la import BaseVector

from ngepc.checks.arguments import Coefficient, is_number
from ngepc.discretisation.prolongation import prolongate
from ngepc.dual.functional import DualFunctional
from ngepc.dual.parameters import Weights
from ngepc.dual.parts import CONTACT, PLASTIC
from ngepc.dual.result import DualResult
from ngepc.model.problem import as_scalar


def carried_over(start: DualResult, functional: DualFunctional) -> BaseVector:
    """The dual variable of an earlier result as a start for another functional.

    Parameters
    ----------
    start
        The result, on this or another mesh of the body.
    functional
        J*_gamma of the new problem.

    Returns
    -------
    BaseVector
        v in H_h of the new problem.
    """
    old, new = start.functional.blocks, functional.blocks
    same_mesh, v = old.problem.mesh is new.problem.mesh, new.H_vector()
    for name, part in new.parts.items():
        values, source, target = old.part_of(start.v, name), old.parts[name].space, part.space
        if same_mesh and source.ndof == target.ndof:
            carried = values.FV().NumPy() * np.array(target.FreeDofs(), dtype=float)
        else:
            carried = prolongate(source, values, target)
        new.part_of(v, name).FV().NumPy()[:] = carried
    _keep_multipliers(start.functional.weights, functional, v)
    return v


def _keep_multipliers(before: Weights, new: DualFunctional, v: BaseVector) -> None:
    """Scale the excess of z and |q| by the quotients of the gammas, in place."""
    after, part_of = new.weights, new.blocks.part_of
    if before.plastic != after.plastic:
        q = part_of(v, PLASTIC).FV().NumPy()
        threshold = _nodal(before.threshold, new.blocks.problem.mesh)
        values = q.reshape(new.blocks.problem.kinematics.d, -1)
        q[:] = scaled_excess(values, threshold, before.plastic / after.plastic).ravel()
    if CONTACT in new.blocks.parts:
        z = part_of(v, CONTACT).FV().NumPy()
        z[z > 0] *= before.contact / after.contact


def scaled_excess(q: np.ndarray, threshold: np.ndarray, ratio: float) -> np.ndarray:
    """Q with |q| - threshold times ``ratio`` where that is positive, in the same direction.

    Parameters
    ----------
    q
        Nodal values, shape (d, nodes).
    threshold
        Nodal values or a single number.
    ratio
        The factor.
    """
    size = np.sqrt((q * q).sum(axis=0))
    excess = np.maximum(size - threshold, 0.0)
    return q * (1 + (ratio - 1) * excess / np.where(size > 0, size, 1.0))


def _nodal(coefficient: Coefficient, mesh: Mesh) -> np.ndarray:
    """The values of a coefficient at the vertices, averaged where it jumps; shape (nv,) or ()."""
    if is_number(coefficient):
        return np.array(float(coefficient))
    values = GridFunction(H1(mesh, order=1))
    values.Set(as_scalar(coefficient))
    return np.array(values.vec.FV().NumPy())
