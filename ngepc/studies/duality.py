"""J(y_gamma) + J*_gamma and its parts along a path: section 3 and Theorem 4.2 in numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ngepc.path.options import PathOptions
from ngepc.path.solver import follow_path
from ngepc.studies.figures import example
from ngepc.studies.output import Table, write_table
from ngepc.theory.duality import duality_report

Progress = Callable[[str], None]

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


def duality_along_path(
    name: str, nodes: int, options: PathOptions, progress: Progress = lambda line: None
) -> list[dict]:
    """Follow the path of an example; returns a record for each gamma.

    Parameters
    ----------
    name, nodes
        'lshape' or 'wrench', and a member of its mesh family.
    options
        Path options; small inner tolerances make the records those of exact solutions.
    progress
        Called with a line of text after each gamma.
    """
    reports: list[dict] = []
    path = follow_path(
        example(name, nodes),
        options,
        lambda s: progress(f"{name} gamma {s.gamma:9.4g}: {s.iterations} steps"),
        observer=lambda result: reports.append(duality_report(result).as_dict()),
    ).or_interrupted()
    return [
        {
            "example": name,
            "nodes": nodes,
            "gamma": step.gamma,
            "iterations": step.iterations,
            "status": step.status.label,
            **report,
        }
        for step, report in zip(path.steps, reports, strict=False)
    ]


def write_duality(folder: Path, table: Sequence[dict]) -> list[Path]:
    """Write duality.csv, duality.md and duality.json; returns their paths."""
    head = ["example", "nodes", "gamma", *COLUMNS.values()]
    rows = [
        [r["example"], r["nodes"], f"{r['gamma']:.3g}", *(f"{r[key]:.3g}" for key in COLUMNS)]
        for r in table
    ]
    notes = [
        "The five columns after J + J* add up to it. M1, M2, T vanish with 1/gamma (Theorem 4.2); "
        "what is left of the gap on a fixed mesh comes from z = 0 at the ends of Gamma_c and "
        "q = 0 on the boundary. Brackets [.]+: L2 norms of what violates (2.13) and (2.11). "
        "(3.8): L2 norm of q - (h p - dev sigma), whose element means are zero to rounding; (3.9): "
        "of |q| - beta minus the yield function of the stress."
    ]
    return write_table(
        folder,
        Table(name="duality", title="Duality", head=head, rows=rows, notes=notes, cells=table),
    )
