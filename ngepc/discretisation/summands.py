"""A tangent as a sum of matrices over parts of the elements, whose products threads make together.

A product with half of the blocks of a symmetric matrix writes to the rows of both nodes of a block.
Matrices of two halves of the body share the rows between them, and each writes to a vector of its
own: nobody waits, and the sum has the same digits for any number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import reduce

import numpy as np
from ngsolve import BaseMatrix, Mesh

from ngepc.discretisation.stiffness import Stiffness
from ngepc.linalg.cores import in_order
from ngepc.model.elements import elements_by_shape, vertex_coordinates

LARGE = 30_000
"""Unknowns from which on products are divided: they take half a millisecond there."""

LOWER = 0.56
"""Part of the elements that the calling thread takes: it begins while the other one is woken up.

On a virtual machine with two cores, where a product takes 1.3 ms, that is 0.1 ms later.
"""


def element_parts(mesh: Mesh, unknowns: int) -> list[np.ndarray | None]:
    """Booleans, which elements are in the lower and in the upper part along the longest side.

    One part, None, has all of them if there are few unknowns.
    """
    if unknowns < LARGE:
        return [None]
    x = vertex_coordinates(mesh)
    along = x[:, np.argmax(np.ptp(x, axis=0))]
    centres = np.empty(mesh.ne)
    for numbers, nodes in elements_by_shape(mesh):
        centres[numbers] = along[nodes].mean(axis=1)
    upper = np.zeros(mesh.ne, dtype=bool)
    upper[np.argsort(centres, kind="stable")[round(LOWER * mesh.ne) :]] = True
    return [~upper, upper]


class Summand:
    """One of the matrices: its blocks are the ``chosen`` ones of the tangent, in ascending order.

    Blocks that another one has are ``elsewhere``, zero here.
    """

    def __init__(
        self, matrix: BaseMatrix, blocks: np.ndarray, chosen: np.ndarray
    ) -> None:
        self._matrix = matrix
        self._blocks = blocks
        self._left = matrix.CreateColVector()
        self._product = self._left.FV().NumPy()
        self.chosen = chosen
        self.elsewhere = np.zeros(0, dtype=int)

    def take(self, blocks: np.ndarray) -> None:
        """Take the values from all blocks of the tangent."""
        np.take(blocks, self.chosen, axis=0, out=self._blocks, mode="clip")
        self._blocks[self.elsewhere] = 0.0

    def replace(self, numbers: np.ndarray, blocks: np.ndarray) -> None:
        """New values of those of some blocks that are here."""
        place = np.searchsorted(self.chosen, numbers)
        here = self.chosen.take(place, mode="clip") == numbers
        self._blocks[place[here]] = blocks[here]
        self._blocks[self.elsewhere] = 0.0

    def times(self, right: object) -> np.ndarray:
        """The product with a vector of NGSolve, flat, valid until the next one."""
        self._matrix.Mult(right, self._left)
        return self._product


class Summands:
    """The ``blocks`` of a tangent, (blocks, N, N), and matrices for its products.

    ``parts`` are booleans over the elements, by default one with all of them: then the blocks are
    those of its matrix, and are stored once.
    """

    def __init__(
        self, stiffness: Stiffness, parts: Sequence[np.ndarray | None] = (None,)
    ) -> None:
        matrices = [stiffness.matrix(part) for part in parts]
        entries = [stiffness.entries(matrix) for matrix in matrices]
        numbers = [stiffness.numbers(matrix) for matrix in matrices]
        self._summands = list(map(Summand, matrices, entries, numbers))
        self.blocks = entries[0]
        self._copied: list[Summand] = []
        if len(parts) > 1:
            self.blocks = np.empty((len(stiffness.rows), stiffness.N, stiffness.N))
            self._copied = self._summands
            self._find_repeated()
        self._right = matrices[0].CreateColVector()
        self._given = self._right.FV().NumPy()

    def _find_repeated(self) -> None:
        """A block that several matrices have is zero in all but the first one."""
        known = np.zeros(len(self.blocks), dtype=bool)
        for summand in self._summands:
            summand.elsewhere = np.flatnonzero(known[summand.chosen])
            known[summand.chosen] = True

    def renew(self) -> None:
        """Make products with the present ``blocks``."""
        taken = in_order(lambda summand: summand.take(self.blocks), self._copied)
        deque(taken, maxlen=0)

    def replace(self, numbers: np.ndarray, blocks: np.ndarray) -> None:
        """Change some blocks, also for products."""
        self.blocks[numbers] = blocks
        for summand in self._copied:
            summand.replace(numbers, blocks)

    def times(self, x: np.ndarray) -> np.ndarray:
        """The tangent times nodal displacements, flat."""
        self._given[:] = x
        first, *others = in_order(lambda s: s.times(self._right), self._summands)
        return reduce(np.add, others, first) if others else first.copy()
