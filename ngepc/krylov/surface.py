"""Approximate Schur complements L T^(-1) L^T of surface parts: how the body yields to z.

In three dimensions it is the compliance of an elastic half-space under a normal force,
(1 - nu^2) / (pi E |x - y|) (Boussinesq): an operator from H^(-1/2) to H^(1/2) like the true one, so
that the constants do not depend on the mesh.  Elsewhere diag(L diag(T)^(-1) L^T) serves; its
condition number grows with the number of nodes across the contact zone.
"""

from __future__ import annotations

import numpy as np
from ngsolve import BND, FESpace, Integrate, LinearForm, ds
from ngsolve.la import SparseMatrixd

from ngepc.fractional import from_dense, to_dense
from ngepc.krylov.matrices import entries
from ngepc.problem import Problem, as_scalar


def half_space(problem: Problem, Z: FESpace) -> np.ndarray:
    """The compliance between the nodes of Gamma_c, shape (Z.ndof, Z.ndof).

    A nodal value of z is a force on a disc with the lumped area of the node; the mean of
    1 / |x - y| over two points of a disc of radius a is 16 / (3 pi a).
    """
    names = "|".join(problem.contact_names)
    x = np.zeros((Z.ndof, 3))
    points = np.asarray(problem.mesh.ngmesh.Coordinates())
    for element in problem.mesh.Elements(BND):
        if element.mat in problem.contact_names:
            x[list(Z.GetDofNrs(element))] = points[[v.nr for v in element.vertices]]
    area = np.array(LinearForm(Z.TestFunction() * ds(names)).Assemble().vec.FV().NumPy())
    lame, mu = (as_scalar(m) for m in (problem.material.lame_lambda, problem.material.lame_mu))
    compliance = (lame + 2 * mu) / (4 * mu * (lame + mu))  # (1 - nu^2) / E
    mean = Integrate(compliance * ds(names), problem.mesh) / area.sum()
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    np.fill_diagonal(distance, 3 * np.pi / 16 * np.sqrt(area / np.pi))
    return mean / np.pi * np.outer(area, area) / distance


def diagonal(L: SparseMatrixd, T: SparseMatrixd) -> np.ndarray:
    """diag(L diag(T)^(-1) L^T) as a matrix."""
    i, j, values = entries(T)
    weights = 1 / values[i == j]
    i, j, values = entries(L)
    return np.diag(np.bincount(i, values**2 * weights[j], minlength=L.height))


def inverse(S: SparseMatrixd, schur: np.ndarray, free: np.ndarray) -> SparseMatrixd:
    """(S + schur)^(-1) on the free degrees of freedom, zero elsewhere."""
    result = np.zeros_like(schur)
    chosen = np.ix_(free, free)
    result[chosen] = np.linalg.inv((to_dense(S) + schur)[chosen])
    return from_dense(result)
