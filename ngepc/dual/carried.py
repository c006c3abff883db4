"""An earlier result as the start of another problem: on another mesh, with another gamma.

Nodal values are carried over by P1 interpolation.  What belongs together in two regularisations
are equal multipliers: |p| = gamma_q [|q| - threshold]^+ and mu = gamma_z [z]^+, so that the excess
of |q| and of z is scaled by the quotient of the gammas.  For the hardening split this is the
change of variable q -> q + h_G p of docs/balanced.md.
"""

from __future__ import annotations

import numpy as np
from ngsolve import H1, GridFunction, Mesh
from ngsolve.la import BaseVector

from ngepc.checks.arguments import Coefficient, is_number
from ngepc.discretisation.prolongation import prolongate
from ngepc.dual.functional import DualFunctional
from ngepc.dual.result import DualResult
from ngepc.model.problem import as_scalar
from ngepc.model.tensors import coordinates_count
from ngepc.parallel import from_all


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
    for i, (source, target) in enumerate(zip(old.spaces, new.spaces, strict=True)):
        values = old.part_of(start.v, i)
        if same_mesh and source.ndofglobal == target.ndofglobal:
            carried = values.FV().NumPy() * np.array(target.FreeDofs(), dtype=float)
        else:
            carried = prolongate(source, values, target)
        new.part_of(v, i).FV().NumPy()[:] = carried
    _keep_multipliers(start.functional, functional, v)
    return v


def _keep_multipliers(old: DualFunctional, new: DualFunctional, v: BaseVector) -> None:
    """Scale the excess of z and |q| by the quotients of the gammas, in place."""
    problem, before, after = new.blocks.problem, old.regularisation, new.regularisation
    mesh, q = problem.mesh, new.blocks.part_of(v, len(new.blocks.parts) - 1).FV().NumPy()
    ratio = nodal(before.gamma_plastic(old.blocks.problem), mesh)
    ratio = ratio / nodal(after.gamma_plastic(problem), mesh)
    if any(from_all(bool(np.any(ratio != 1)), mesh)):
        shift = as_scalar(before.plastic_shift) / as_scalar(before.gamma_plastic(problem))
        threshold = nodal(as_scalar(before.yield_bound(problem)) - shift, mesh)
        q[:] = scaled_excess(q.reshape(coordinates_count(problem.N), -1), threshold, ratio).ravel()
    penalties = not (before.exact_contact or after.exact_contact)
    if problem.contact_names and penalties:
        z = new.blocks.part_of(v, 0).FV().NumPy()
        z[z > 0] *= before.gamma_contact / after.gamma_contact


def scaled_excess(q: np.ndarray, threshold: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Q with |q| - threshold times ``ratio`` where that is positive, in the same direction.

    Parameters
    ----------
    q
        Nodal values, shape (d, nodes).
    threshold, ratio
        Nodal values or single numbers.
    """
    size = np.sqrt((q * q).sum(axis=0))
    excess = np.maximum(size - threshold, 0.0)
    return q * (1 + (ratio - 1) * excess / np.where(size > 0, size, 1.0))


def nodal(coefficient: Coefficient, mesh: Mesh) -> np.ndarray:
    """The values of a coefficient at the vertices, averaged where it jumps; shape (nv,) or ()."""
    if is_number(coefficient):
        return np.array(float(coefficient))
    values = GridFunction(H1(mesh, order=1))
    values.Set(as_scalar(coefficient))
    return np.array(values.vec.FV().NumPy())
