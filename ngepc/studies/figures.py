"""Figures 2, 3, 5 and 6: plastic strains, plastic zones and yield functions at the end of a path.

The paths are Algorithm 7.2 up to the gamma in the captions: for Example (b) 10 * 7^7 = 8.24e6, the
end of Table 3 on the finest mesh; for Example (a) 5^13 = 1.22e9 from gamma_0 = 1 by factors of 5,
which the caption (1.2e9) allows and the text leaves open.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from ngsolve import Integrate

from ngepc.dual.result import DualResult
from ngepc.geometries import lshape, wrench
from ngepc.model.examples import lshape_problem, wrench_problem
from ngepc.model.problem import Problem
from ngepc.path.options import PathOptions
from ngepc.path.result import PathResult
from ngepc.path.solver import follow_path
from ngepc.pictures import plot_field, plot_mesh, plot_plastic_zone, plot_yield_function
from ngepc.pictures.figures import THRESHOLDS, save
from ngepc.pictures.picture import beside
from ngepc.pictures.sampling import body_corners
from ngepc.studies.output import Table, write_table

Progress = Callable[[str], None]

PATHS = {
    "lshape": PathOptions(gamma_start=1.0, growth=5.0, gamma_end=5.0**13),
    "wrench": PathOptions(gamma_end=10.0 * 7.0**7),
}
"""How gamma of the captions is reached."""

CAPTIONS = {
    2: "Example (a): |p_gamma|_F, plastic zone |p_gamma|_F > 0.1 (paper: gamma = 1.2e9)",
    3: "Example (a): yield function (3.9) (paper: beside Figure 2)",
    5: "Example (b): initial configuration, |p_gamma|_F (paper: gamma = 8.24e6)",
    6: "Example (b): yield function, plastic zone |p_gamma|_F > 1e-2 (paper: gamma = 8.24e6)",
}
"""Figure number -> what it shows, all in the deformed configuration."""

HIGHEST_STRAIN = {"lshape": 0.2, "wrench": 0.04}
"""Upper end of the colour scales; the strains at the re-entrant corners grow with refinement."""

BODY = {2: "lshape", 3: "lshape", 5: "wrench", 6: "wrench"}


def example(name: str, nodes: int) -> Problem:
    """An example on the member of its mesh family with so many nodes."""
    if name == "lshape":
        return lshape_problem(lshape.paper_mesh(nodes))
    return wrench_problem(wrench.paper_mesh(nodes))


def draw(number: int, result: DualResult) -> Figure:
    """Figure 2, 3, 5 or 6 from a result for its example."""
    threshold = THRESHOLDS[BODY[number]]

    def zone(axes: Axes) -> Figure:
        return plot_plastic_zone(result, threshold, axes=axes)

    def strain(axes: Axes) -> Figure:
        return plot_field(result, vmin=0.0, vmax=HIGHEST_STRAIN[BODY[number]], axes=axes)

    def excess(axes: Axes | None) -> Figure:
        return plot_yield_function(result, vmin=-result.problem.beta, vmax=0.0, axes=axes)

    if number == 3:
        return excess(None)
    panels = {
        2: (strain, zone),
        5: (lambda axes: plot_mesh(result, axes=axes), strain),
        6: (excess, zone),
    }
    figure = beside(*panels[number], height=4.0 if BODY[number] == "lshape" else 2.6)
    if number == 5:
        before, after = figure.axes[:2]
        before.set(xlim=after.get_xlim(), ylim=after.get_ylim())
    return figure


def field_numbers(result: DualResult, threshold: float) -> dict[str, float]:
    """What can be read from the figures: extremes, the area of the zone, energies."""
    strain = body_corners(result.fields, result.fields.equivalent_plastic_strain).values
    excess = body_corners(result.fields, result.yield_function).values
    u = np.array([result.displacement.components[i].vec.FV().NumPy() for i in range(2)])
    return {
        "plastic_strain_max": float(strain.max()),
        "zone_area": Integrate(result.fields.plastic_zone(threshold), result.problem.mesh),
        "body_area": Integrate(1.0, result.problem.mesh),
        "yield_function_max": float(excess.max()),
        "displacement_max": float(np.linalg.norm(u, axis=0).max()),
        "dual_energy": result.dual_energy,
        "primal_energy": result.primal_energy,
        "contact_force": result.contact_force,
    }


@dataclass
class Figures:
    """The study; paths are kept in ``folder``/cells, gamma by gamma.

    Parameters
    ----------
    folder
        Where results go.
    nodes
        Example -> node count of its mesh.
    numbers
        Which figures, from 2, 3, 5, 6.
    progress
        Called with a line of text after each gamma.

    Raises
    ------
    ValueError
        For other numbers.
    """

    folder: Path
    nodes: dict[str, int] = field(default_factory=lambda: {"lshape": 3201, "wrench": 6353})
    numbers: Sequence[int] = tuple(CAPTIONS)
    progress: Progress = lambda line: None

    def __post_init__(self) -> None:
        if not self.numbers or set(self.numbers) - set(CAPTIONS):
            raise ValueError(f"numbers={self.numbers}: figures {', '.join(map(str, CAPTIONS))}")

    def path(self, name: str) -> PathResult:
        """The path of an example, from disk or followed now."""
        problem, cells = example(name, self.nodes[name]), self.folder / "cells"
        cells.mkdir(parents=True, exist_ok=True)
        return follow_path(
            problem,
            PATHS[name],
            lambda s: self.progress(
                f"{name} gamma {s.gamma:9.4g}: {s.iterations} steps, {s.status.label}"
            ),
            checkpoint=cells / f"figures-{name}-{self.nodes[name]}.npz",
        ).or_interrupted()

    def run(self) -> list[dict]:
        """Draw the figures as figureN.png; returns one record for each."""
        table = []
        for name in dict.fromkeys(BODY[number] for number in self.numbers):
            path = self.path(name)
            numbers = [n for n in self.numbers if BODY[n] == name]
            table += [self._drawn(number, path) for number in numbers]
        return table

    def _drawn(self, number: int, path: PathResult) -> dict:
        name = BODY[number]
        picture = save(draw(number, path.last), self.folder / f"figure{number}.png")
        return {
            "figure": number,
            "file": picture.name,
            "shows": CAPTIONS[number],
            "example": name,
            "nodes": path.last.problem.mesh.nv,
            "gamma": path.gamma_end,
            "status": path.status.label,
            "residual_norm": path.residual_norms[-1],
            "inner_iterations": path.inner_iterations,
            **field_numbers(path.last, THRESHOLDS[name]),
        }

    def write(self, table: Sequence[dict]) -> list[Path]:
        """Write figures.csv, figures.md and figures.json; returns all paths, PNGs included."""
        head = ["figure", "shows", "nodes", "gamma", "Newton steps", "max |p|_F", "zone / body"]
        rows = [
            [
                f"[{r['figure']}]({r['file']})",
                r["shows"],
                r["nodes"],
                f"{r['gamma']:.3g}" + ("" if r["status"] == "converged" else f" {r['status']}"),
                sum(r["inner_iterations"]),
                f"{r['plastic_strain_max']:.4g}",
                f"{r['zone_area'] / r['body_area']:.4f}",
            ]
            for r in table
        ]
        notes = [
            "Deformed configurations, displacement not scaled; lengths and stresses in the units "
            "of the examples. max |p|_F of Example (a) grows without bound under refinement "
            "(re-entrant corner).",
        ]
        title = "Figures 2, 3, 5 and 6"
        written = write_table(
            self.folder,
            Table(name="figures", title=title, head=head, rows=rows, notes=notes, cells=table),
        )
        return [*(self.folder / r["file"] for r in table), *written]
