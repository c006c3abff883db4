"""Approximate Schur complements L T^(-1) L^T of surface parts: how the body yields to z."""

from __future__ import annotations

import numpy as np
from ngsolve.la import SparseMatrixd

from ngepc.dual.fractional import from_dense, to_dense
from ngepc.krylov.multigrid import VCycle

SCALE = 2.0
"""Of the multilevel sum, which is between 1 and 4 times smaller than L T^(-1) L^T."""


def schur_complement(L: SparseMatrixd, elastic: VCycle) -> np.ndarray:
    """L C L^T with the multilevel sum C of ``VCycle.compliance`` in place of T^(-1), dense."""
    return SCALE * elastic.compliance(L)


def inverse(S: SparseMatrixd, schur: np.ndarray, free: np.ndarray) -> SparseMatrixd:
    """(S + schur)^(-1) on the free degrees of freedom, zero elsewhere."""
    result = np.zeros_like(schur)
    chosen = np.ix_(free, free)
    result[chosen] = np.linalg.inv((to_dense(S) + schur)[chosen])
    return from_dense(result)
