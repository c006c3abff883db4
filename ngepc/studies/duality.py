"""J(y_gamma) + J*_gamma and its parts along a path: section 3 and Theorem 4.2 in numbers."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from ngepc.dual.path import follow_path
from ngepc.dual.path_options import PathOptions
from ngepc.studies.examples import example
from ngepc.studies.work import Cell, Work
from ngepc.theory.duality import duality_report

COLUMNS = {
    "gap": "J + J*",
    "contact_term": "(z, u.n - psi)",
    "plastic_term": "int beta|p| + (q, p)",
    "contact_penalty": "M1",
    "plastic_penalty": "M2",
    "tichonov": "T",
    "penetration": "[u.n - psi]+",
    "complementarity": "int |z (u.n - psi)|",
    "tension": "[z]+",
    "stress_deviation": "(3.8)",
    "yield_deviation": "(3.9)",
}
"""Field of DualityReport -> head."""

NOTE = (
    "The five columns after J + J* add up to it. M1, M2, T vanish with 1/gamma (Theorem 4.2); "
    "what is left of the gap on a fixed mesh comes from z = 0 at the ends of Gamma_c and "
    "q = 0 on the boundary. Brackets [.]+: L2 norms of what violates (2.13) and (2.11). "
    "(3.8): L2 norm of q - (h p - dev sigma), whose element means are zero to rounding; (3.9): "
    "of |q| - beta minus the yield function of the stress."
)


@dataclass(eq=False)
class Duality(Work):
    """The paths of both examples to ``gamma_end`` by factors of ten, on small meshes by default."""

    lshape_nodes: int = 833
    wrench_nodes: int = 873
    gamma_end: float = 1e6

    name, title, note = "duality", "Duality", NOTE
    settings = ("gamma_end",)
    columns = (
        ("example", "{example}"),
        ("nodes", "{nodes}"),
        ("gamma", "{gamma:.3g}"),
        *((head, f"{{{part}:.3g}}") for part, head in COLUMNS.items()),
    )

    def __post_init__(self) -> None:
        self.options = PathOptions(growth=10.0, gamma_end=self.gamma_end, inner_scale=1e-8)
        for cell in self.cells():
            example(cell.row, cell.nodes)

    def cells(self) -> list[Cell]:
        """A path for each example."""
        return [Cell("lshape", self.lshape_nodes), Cell("wrench", self.wrench_nodes)]

    def solve(self, cell: Cell) -> list[dict]:
        """Follow the path of an example: a record for each gamma."""
        reports: list[dict] = []
        path = follow_path(
            example(cell.row, cell.nodes),
            self.options,
            lambda s: self.progress(f"{cell.row} gamma {s.gamma:9.4g}: {s.iterations} steps"),
            observer=lambda result: reports.append(asdict(duality_report(result))),
        ).or_interrupted()
        return [
            {
                "example": cell.row,
                "nodes": cell.nodes,
                "gamma": step.gamma,
                "iterations": step.iterations,
                "status": step.status.label,
                **report,
            }
            for step, report in zip(path.steps, reports, strict=False)
        ]
