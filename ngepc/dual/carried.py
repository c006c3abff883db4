"""An earlier result as the start of another problem: on another mesh, with another gamma.

Nodal values are carried over by P1 interpolation.  What belongs together in two regularisations
are equal multipliers: |p| = gamma_q [|q| - beta]^+ and mu = gamma_z [z]^+, so that the excess of
|q| and of z is scaled by the quotient of the gammas.
"""

from __future__ import annotations

import numpy as np
from ngsolve import H1, GridFunction
from ngsolve.la import BaseVector

from ngepc.discretisation.prolongation import prolongate
from ngepc.dual.functional import DualFunctional
from ngepc.dual.parts import CONTACT, PLASTIC
from ngepc.dual.result import DualResult
from ngepc.model.problem import as_scalar


def carried_over(start: DualResult | None, functional: DualFunctional) -> BaseVector:
    """v in H_h of a new problem from an earlier result, on this or another mesh; zero from None."""
    new, v = functional.blocks, functional.blocks.H_vector()
    if start is None:
        return v
    old = start.functional.blocks
    same_mesh = old.problem.mesh is new.problem.mesh
    for name, part in new.parts.items():
        values, source, target = old.part_of(start.v, name), old.parts[name].space, part.space
        if same_mesh and source.ndof == target.ndof:
            carried = values.FV().NumPy() * np.array(target.FreeDofs(), dtype=float)
        else:
            carried = prolongate(source, values, target)
        new.part_of(v, name).FV().NumPy()[:] = carried
    _keep_multipliers(start.functional, functional, v)
    return v


def _keep_multipliers(old: DualFunctional, new: DualFunctional, v: BaseVector) -> None:
    """Scale the excess of z and |q| by the quotients of the gammas, in place."""
    problem, before, after = new.blocks.problem, old.weights, new.weights
    if before.plastic != after.plastic:
        beta = GridFunction(H1(problem.mesh, order=1))  # where it jumps, the mean
        beta.Set(as_scalar(problem.beta))
        q = new.blocks.part_of(v, PLASTIC).FV().NumPy().reshape(problem.kinematics.d, -1)
        q[:] = scaled_excess(q, beta.vec.FV().NumPy(), before.plastic / after.plastic)
    if CONTACT in new.blocks.parts:
        z = new.blocks.part_of(v, CONTACT).FV().NumPy()
        z[z > 0] *= before.contact / after.contact


def scaled_excess(q: np.ndarray, threshold: np.ndarray | float, ratio: float) -> np.ndarray:
    """Nodal values q, shape (d, nodes), with |q| - threshold times ``ratio`` where positive."""
    size = np.sqrt((q * q).sum(axis=0))
    excess = np.maximum(size - threshold, 0.0)
    return q * (1 + (ratio - 1) * excess / np.where(size > 0, size, 1.0))
