"""Exact contact: z <= 0 as a constraint instead of the penalty M^1.

The normal stress z is P1 on Gamma_c, so that z <= 0 everywhere means z_i <= 0 at the nodes.  M^1 is
then the indicator of a convex cone, the multiplier an element of its normal cone,

    lambda_i >= 0,    lambda_i z_i = 0,    Psi + lambda = 0,

and lambda_i is the open gap (psi - u.n, phi_i).  See docs/balanced.md.
"""

from __future__ import annotations

import numpy as np
from ngsolve import FESpace, LinearForm, ds
from ngsolve.la import BaseVector, SparseMatrixd

from ngepc.model.problem import Problem
from ngepc.parallel import Nodes

EPSILON = float(np.finfo(float).eps)


class ContactConstraint:
    """The indicator of z <= 0: the ``Penalty`` of exact contact.

    Parameters
    ----------
    problem
        The data.
    Z
        The space of z.

    Attributes
    ----------
    nodes
        Free degrees of freedom of Z, the m nodes where z_i <= 0 is asked for.
    masses
        Their lumped boundary mass (length or area), shape (m,).
    """

    def __init__(self, problem: Problem, Z: FESpace) -> None:
        on_contact = ds("|".join(problem.contact_names))
        w, diagonal = Z.TestFunction(), np.arange(Z.ndof, dtype=np.int32)
        zeros = np.zeros(Z.ndof)
        self._zero = SparseMatrixd.CreateFromCOO(diagonal, diagonal, zeros, Z.ndof, Z.ndof)
        self._no_gradient = BaseVector(Z.ndof)
        self._no_gradient[:] = 0.0
        self.nodes = Nodes(Z, np.array(Z.FreeDofs(), dtype=bool))
        self.masses = self.nodes.of_functional(LinearForm(w * on_contact).Assemble().vec)

    def values(self, z: BaseVector) -> np.ndarray:
        """The values z_i at the nodes, shape (m,)."""
        return self.nodes.of_function(z)

    def energy(self, z: BaseVector) -> float:
        """0 where z <= 0 holds, infinity elsewhere."""
        return 0.0 if self.values(z).max(initial=0.0) <= 0 else np.inf

    def active(self, z: BaseVector) -> float:
        """Measure of the nodes with z_i < 0: contact."""
        return float(self.masses[self.values(z) < 0].sum())

    def gradient(self, z: BaseVector) -> BaseVector:
        """Zero: the multipliers are added by ``stationary``."""
        return self._no_gradient

    def pattern(self) -> SparseMatrixd:
        """A matrix of zeros."""
        return self._zero

    def hessian(self, z: BaseVector) -> SparseMatrixd:
        """Zero: ``ConstrainedSystem`` treats the constraint exactly."""
        return self._zero

    def stationary(self, z: BaseVector, r: BaseVector) -> BaseVector:
        """Psi + lambda with the lambda of the normal cone at z that makes each |entry| smallest.

        It vanishes exactly where z is optimal: at nodes with z_i < 0 it is Psi_i, at the others
        the positive part of Psi_i, which pushes z_i below zero.
        """
        natural = r.CreateVector()
        natural.data = r
        positive = np.maximum(self.nodes.of_functional(r), 0.0)
        self.nodes.set_functional(natural, positive, self.values(z) >= 0)
        return natural

    def project(self, z: BaseVector) -> None:
        """Replace z_i by min(z_i, 0), in place."""
        entries = z.FV().NumPy()
        entries[self.nodes.dofs] = np.minimum(entries[self.nodes.dofs], 0.0)

    def longest_step(self, z: BaseVector, dz: BaseVector) -> float:
        """The largest alpha with z + alpha dz <= 0 for feasible z, infinity if there is none.

        It is less by a few roundings, so that the sum is not positive in floating point either.
        """
        values, change = self.values(z), self.values(dz)
        rising = change > 0
        return float((-values[rising] / change[rising]).min(initial=np.inf)) * (1 - 8 * EPSILON)
