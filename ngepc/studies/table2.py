"""Table 2: Newton steps of Algorithm 7.1 for Example (b), from v = 0."""

from __future__ import annotations

from ngepc.dual.newton import semismooth_newton
from ngepc.dual.result import DualResult
from ngepc.geometries import wrench
from ngepc.model.examples import wrench_problem
from ngepc.studies.count_table import CountTable, cell_gamma
from ngepc.studies.paper import TABLE_2
from ngepc.studies.tables import Cell


class Table2(CountTable):
    """Every cell starts from v = 0.  The parameters are those of ``CountTable``."""

    number, paper, family = 2, TABLE_2, wrench.PAPER_NODES
    about = (
        "Newton steps of Algorithm 7.1 for Example (b) from v = 0. The paper prints 24927 nodes "
        "for the mesh with 24993; its polygon is lost, ours is reconstructed (docs/reading.md)."
    )

    def solve(self, cell: Cell) -> DualResult:
        """Solve one cell."""
        problem = wrench_problem(wrench.paper_mesh(cell.nodes))
        return semismooth_newton(problem, cell_gamma(cell), options=self.options)
