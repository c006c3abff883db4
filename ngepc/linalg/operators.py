"""Matrices that are known by what they do to a vector."""

from __future__ import annotations

from ngsolve.la import BaseMatrix, BaseVector, SparseMatrixd


class SquareOperator(BaseMatrix):
    """What NGSolve asks of such a matrix besides ``Mult``.

    Parameters
    ----------
    like
        A real sparse matrix of the same size, with vectors of the right kind.
    """

    def __init__(self, like: SparseMatrixd) -> None:
        super().__init__()
        self._like = like

    def Height(self) -> int:
        """Number of rows."""
        return self._like.height

    def Width(self) -> int:
        """Number of columns."""
        return self._like.height

    def CreateVector(self, col: bool) -> BaseVector:
        """A vector of the right size."""
        return self._like.CreateColVector()

    def IsComplex(self) -> bool:
        """False."""
        return False
