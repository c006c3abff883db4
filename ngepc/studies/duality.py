"""J(y_gamma) + J*_gamma and its parts along a path: section 3 and Theorem 4.2 in numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.path.options import PathOptions
from ngepc.path.solver import follow_path
from ngepc.studies.examples import example
from ngepc.studies.work import Table, Work
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
"""Field of DualityReport -> column."""

NOTE = (
    "The five columns after J + J* add up to it. M1, M2, T vanish with 1/gamma (Theorem 4.2); "
    "what is left of the gap on a fixed mesh comes from z = 0 at the ends of Gamma_c and "
    "q = 0 on the boundary. Brackets [.]+: L2 norms of what violates (2.13) and (2.11). "
    "(3.8): L2 norm of q - (h p - dev sigma), whose element means are zero to rounding; (3.9): "
    "of |q| - beta minus the yield function of the stress."
)


class Duality(Work):
    """The study: the paths of both examples, on small meshes by default.

    Parameters
    ----------
    folder, progress
        As for ``Work``.
    lshape_nodes, wrench_nodes
        Members of the mesh families.
    gamma_end
        Last gamma of the paths, which rise by factors of ten.
    """

    name = "duality"

    def __init__(
        self,
        folder: Path,
        lshape_nodes: int = 833,
        wrench_nodes: int = 873,
        gamma_end: float = 1e6,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        super().__init__(folder, progress)
        self.options = PathOptions(growth=10.0, gamma_end=gamma_end, inner_scale=1e-8)
        self.nodes = {"lshape": lshape_nodes, "wrench": wrench_nodes}
        self._problems = {name: example(name, nodes) for name, nodes in self.nodes.items()}

    def run(self) -> list[dict]:
        """A record for each example and gamma."""
        return [record for name in self.nodes for record in self.along_path(name)]

    def along_path(self, name: str) -> list[dict]:
        """Follow the path of an example; returns a record for each gamma."""
        reports: list[dict] = []
        path = follow_path(
            self._problems[name],
            self.options,
            lambda s: self.progress(f"{name} gamma {s.gamma:9.4g}: {s.iterations} steps"),
            observer=lambda result: reports.append(duality_report(result).as_dict()),
        ).or_interrupted()
        return [
            {
                "example": name,
                "nodes": self.nodes[name],
                "gamma": step.gamma,
                "iterations": step.iterations,
                "status": step.status.label,
                **report,
            }
            for step, report in zip(path.steps, reports, strict=False)
        ]

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write duality.csv, duality.md and duality.json; returns their paths."""
        rows = [
            [r["example"], r["nodes"], f"{r['gamma']:.3g}", *(f"{r[key]:.3g}" for key in COLUMNS)]
            for r in table
        ]
        return Table(
            name=self.name,
            title="Duality",
            head=["example", "nodes", "gamma", *COLUMNS.values()],
            rows=rows,
            notes=[NOTE],
            cells=table,
        ).write(self.folder)
