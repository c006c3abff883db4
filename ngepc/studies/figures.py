"""Figures 2, 3, 5 and 6: plastic strains, plastic zones and yield functions at the end of a path.

The paths are Algorithm 7.2 up to the gamma in the captions: for Example (b) 10 * 7^7 = 8.24e6, the
end of Table 3 on the finest mesh; for Example (a) 5^13 = 1.22e9 from gamma_0 = 1 by factors of 5,
which the caption (1.2e9) allows and the text leaves open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from ngsolve import Integrate

from ngepc.dual.path import follow_path
from ngepc.dual.path_options import PathOptions
from ngepc.dual.result import DualResult
from ngepc.pictures.fields import plot_field, plot_mesh, plot_plastic_zone
from ngepc.pictures.sampling import body_corners
from ngepc.pictures.style import beside, save_figure
from ngepc.studies.examples import THRESHOLDS, example
from ngepc.studies.work import Cell, Work, ending

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

BODY = {2: "lshape", 3: "lshape", 5: "wrench", 6: "wrench"}
HIGHEST_STRAIN = {"lshape": 0.2, "wrench": 0.04}
"""Upper end of the colour scales; the strains at the re-entrant corners grow with refinement."""


def drawn(number: int, result: DualResult) -> Figure:
    """Figure 2, 3, 5 or 6 from a result for its example."""
    body = BODY[number]
    bound = result.problem.beta
    draws = {
        "zone": lambda a: plot_plastic_zone(result, THRESHOLDS[body], axes=a),
        "strain": lambda a: plot_field(result, vmin=0.0, vmax=HIGHEST_STRAIN[body], axes=a),
        "excess": lambda a: plot_field(result, "yield_function", vmin=-bound, vmax=0.0, axes=a),
        "mesh": lambda a: plot_mesh(result, axes=a),
    }
    panels = {2: ("strain", "zone"), 3: ("excess",), 5: ("mesh", "strain"), 6: ("excess", "zone")}
    height = 4.0 if body == "lshape" else 2.6
    figure = beside(*(draws[name] for name in panels[number]), height=height)
    if number == 5:
        before, after = figure.axes[:2]
        before.set(xlim=after.get_xlim(), ylim=after.get_ylim())
    return figure


def field_numbers(result: DualResult, threshold: float) -> dict[str, float]:
    """What can be read from the figures: extremes, the area of the zone, energies."""
    mesh = result.problem.mesh
    strain = body_corners(result.fields, result.fields.equivalent_plastic_strain).values
    excess = body_corners(result.fields, result.yield_function).values
    return {
        "plastic_strain_max": float(strain.max()),
        "zone_area": Integrate(result.fields.plastic_zone(threshold), mesh),
        "body_area": Integrate(1.0, mesh),
        "yield_function_max": float(excess.max()),
        "dual_energy": result.dual_energy,
        "primal_energy": result.primal_energy,
        "contact_force": result.contact_force,
    }


@dataclass(eq=False)
class Figures(Work):
    """The figures in ``only``, from 2, 3, 5 and 6; paths are kept gamma by gamma."""

    only: Sequence[int] | None = None
    lshape_nodes: int = 3201
    wrench_nodes: int = 6353

    name, title, keeps = "figures", "Figures 2, 3, 5 and 6", False
    columns = (
        ("figure", "[{figure}]({file})"),
        ("shows", "{shows}"),
        ("nodes", "{nodes}"),
        ("gamma", lambda r: f"{r['gamma']:.3g}{ending(r)}"),
        ("Newton steps", lambda r: sum(r["inner_iterations"])),
        ("max |p|_F", "{plastic_strain_max:.4g}"),
        ("zone / body", lambda r: f"{r['zone_area'] / r['body_area']:.4f}"),
    )
    note = (
        "Deformed configurations, displacement not scaled; lengths and stresses in the units of "
        "the examples. max |p|_F of Example (a) grows without bound under refinement (re-entrant "
        "corner)."
    )

    def __post_init__(self) -> None:
        self.only = tuple(CAPTIONS if self.only is None else self.only)
        if not self.only or set(self.only) - set(CAPTIONS):
            raise ValueError(f"only={self.only}: figures {', '.join(map(str, CAPTIONS))}")
        for cell in self.cells():
            example(cell.row, cell.nodes)

    def cells(self) -> list[Cell]:
        """The path of each example whose figures are wanted."""
        nodes = {"lshape": self.lshape_nodes, "wrench": self.wrench_nodes}
        return [Cell(name, n) for name, n in nodes.items() if name in map(BODY.get, self.only)]

    def solve(self, cell: Cell) -> list[dict]:
        """Follow the path of an example, which keeps itself, and draw figureN.png at its end."""
        folder = self.folder / "cells"
        folder.mkdir(parents=True, exist_ok=True)
        path = follow_path(
            example(cell.row, cell.nodes),
            PATHS[cell.row],
            lambda s: self.progress(f"{cell.row} gamma {s.gamma:9.4g}: {s.iterations} steps"),
            checkpoint=folder / f"figures-{cell.name}.npz",
        ).or_interrupted()
        numbers = {
            "example": cell.row,
            "nodes": cell.nodes,
            "gamma": path.gamma_end,
            "status": path.status.label,
            "residual_norm": path.residual_norms[-1],
            "inner_iterations": path.inner_iterations,
            **field_numbers(path.last, THRESHOLDS[cell.row]),
        }
        found = []
        for number in (n for n in self.only if BODY[n] == cell.row):
            file = f"figure{number}.png"
            save_figure(drawn(number, path.last), self.folder / file)
            found.append({"figure": number, "file": file, "shows": CAPTIONS[number], **numbers})
        return found

    def draw(self, records: Sequence[dict]) -> list[Path]:
        """The pictures that ``solve`` has drawn."""
        return [self.folder / record["file"] for record in records]
