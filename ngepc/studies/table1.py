"""Table 1: Newton steps of Algorithm 7.1 for Example (a) over meshes and gamma."""

from __future__ import annotations

import math
from functools import cache

from ngepc.dual.newton import semismooth_newton
from ngepc.dual.regularisation import Coupled
from ngepc.dual.result import DualResult
from ngepc.geometries import lshape
from ngepc.model.examples import lshape_problem
from ngepc.model.problem import Problem
from ngepc.results.outcome import History, IterationRecord, Status
from ngepc.results.restore import restore
from ngepc.studies.count_table import CountTable, cell_gamma
from ngepc.studies.paper import TABLE_1
from ngepc.studies.tables import Cell


@cache
def example(nodes: int) -> Problem:
    """Example (a) on the mesh with so many nodes."""
    return lshape_problem(lshape.paper_mesh(nodes))


class Table1(CountTable):
    """Row '1e4' starts from the prolongated 417-node solution, '1e5*' from the next coarser mesh.

    The parameters are those of ``CountTable``.
    """

    number, paper, family = 1, TABLE_1, lshape.PAPER_NODES
    about = (
        "Newton steps of Algorithm 7.1 for Example (a). Start: the prolongated solution on 417 "
        "nodes; rows with * start from the next coarser mesh."
    )

    def solve(self, cell: Cell) -> DualResult:
        """Solve one cell, from the solution of another."""
        start = self.start_of(cell)
        begin = None if start is None else self.result(start)
        return semismooth_newton(example(cell.nodes), cell_gamma(cell), begin, self.options)

    def result(self, cell: Cell) -> DualResult:
        """A solved cell as a result with all its fields."""
        outcome = self.outcome(cell)
        history = History([IterationRecord(**row) for row in outcome.record["history"]])
        status = Status[outcome.record["status"].upper()]
        v, regularisation = outcome.arrays["v"], Coupled(cell_gamma(cell))
        return restore(example(cell.nodes), regularisation, v, self.options, status, history)

    def start_of(self, cell: Cell) -> Cell | None:
        """Where a cell starts: the 417-node solution, or the next coarser mesh's when nested.

        The 417-node solution itself is reached from v = 0 by steps of a factor of ten in gamma.
        """
        if cell.nodes == lshape.COARSE_NODES:
            gamma = cell_gamma(cell)
            return Cell(f"1e{round(math.log10(gamma)) - 1}", cell.nodes) if gamma > 1e3 else None
        if cell.row.endswith("*") and cell.nodes > lshape.PAPER_NODES[0]:
            finer = lshape.PAPER_NODES.index(cell.nodes)
            return Cell(cell.row, lshape.PAPER_NODES[finer - 1])
        return Cell(cell.row.rstrip("*"), lshape.COARSE_NODES)
